// Vectors are arrays of three; matrices are columns in turn, as WebGL takes them.
export const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const length = (a) => Math.hypot(a[0], a[1], a[2]);
export const unit = (a) => { const l = length(a) || 1; return [a[0] / l, a[1] / l, a[2] / l]; };

/** Turned by an angle about the vertical, then raised by another: where the eye stands as seen from the target. */
export function toward(azimuth, elevation) {
  const c = Math.cos(elevation);
  return [Math.sin(azimuth) * c, Math.sin(elevation), Math.cos(azimuth) * c];
}

/** Of a picture's height and width, how much is filled: cloth moves, and is turned. */
const FILLED = 0.78;

export class Camera {
  constructor() {
    Object.assign(this, { target: [0, 0, 0], distance: 2, azimuth: 0.35, elevation: 0.2, width: 1, height: 1, size: 1 });
    this.slope = Math.tan(0.25);  // as pictures have it
    /** Stages that show what it sees. */
    this.watched = new Set();
  }

  /** It has been moved: all of them are to be drawn anew. */
  changed() { for (const stage of this.watched) stage.dirty(); }

  get eye() { return add(this.target, toward(this.azimuth, this.elevation), this.distance); }

  axes() {
    const back = toward(this.azimuth, this.elevation);
    const right = [Math.cos(this.azimuth), 0, -Math.sin(this.azimuth)];
    return { right, up: cross(back, right), back };
  }

  /** The product of projection and view. */
  matrix() {
    const { right, up, back } = this.axes(), eye = this.eye;
    const near = Math.max(this.distance * 0.01, this.size * 1e-3), far = this.distance + 40 * this.size;
    const f = 1 / this.slope, a = f * this.height / this.width;
    const p = (far + near) / (near - far), q = 2 * far * near / (near - far);
    const m = new Float32Array(16);
    const rows = [[a, right], [f, up], [p, back], [-1, back]];
    rows.forEach(([s, axis], r) => {
      for (let c = 0; c < 3; c++) m[4 * c + r] = s * axis[c];
      m[12 + r] = -s * dot(axis, eye);
    });
    m[14] += q;
    return m;
  }

  /** Origin and direction of the line of sight through a pixel (CSS pixels from the upper left). */
  ray(px, py) {
    const { right, up, back } = this.axes();
    const x = (2 * px / this.width - 1) * this.slope * this.width / this.height, y = (1 - 2 * py / this.height) * this.slope;
    return { origin: this.eye, direction: unit(add(add(add([0, 0, 0], back, -1), right, x), up, y)) };
  }

  /** Pixel that shows a point, and its distance along the line of sight; null behind the eye. */
  project(p) {
    const { right, up, back } = this.axes(), d = add(p, this.eye, -1), z = -dot(d, back);
    if (z <= 0) return null;
    const s = this.height / 2 / (this.slope * z);
    return { x: this.width / 2 + s * dot(d, right), y: this.height / 2 - s * dot(d, up), z };
  }

  /** Length of a pixel at a distance. */
  pixel(z) { return 2 * this.slope * z / this.height; }

  /** Look at all points of x from where the cloth faces, with some pixels of room left for panels; and at those of
    `beside` that are no farther from x than it is large, as a dancer is and a floor's corners are not. */
  fit(x, normal, aside = 0, beside = []) {
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity], points = [];
    const take = (p, i) => {
      points.push([p[i], p[i + 1], p[i + 2]]);
      for (let k = 0; k < 3; k++) {
        low[k] = Math.min(low[k], p[i + k]);
        high[k] = Math.max(high[k], p[i + k]);
      }
    };
    for (let i = 0; i < x.length; i += 3) if (isFinite(x[i] + x[i + 1] + x[i + 2])) take(x, i);
    const reach = length(add(high, low, -1)), least = low.map((v) => v - reach), most = high.map((v) => v + reach);
    for (let i = 0; i < beside.length; i += 3)
      if ([0, 1, 2].every((k) => least[k] <= beside[i + k] && beside[i + k] <= most[k])) take(beside, i);
    if (!isFinite(low[0])) return;
    this.target = [0, 1, 2].map((k) => (low[k] + high[k]) / 2);
    this.size = length(add(high, low, -1)) || 1;
    if (normal) {
      // A mean of normals: that of a skirt, which faces all ways, is short, and says little of where to look from.
      this.azimuth = (Math.hypot(normal[0], normal[2]) > 0.3 ? Math.atan2(normal[0], normal[2]) : 0) + 0.3;
      this.elevation = 0.7 * Math.asin(Math.max(-1, Math.min(1, normal[1]))) + 0.15;
    }
    // So far that each point is within a share of the picture: d units nearer to the eye than the target, it is seen at
    // |offset| / (slope (distance - d)) of half the picture.
    const room = Math.max(0.3, (this.width - aside) / this.width), { right, up, back } = this.axes();
    const tall = FILLED * this.slope, wide = tall * room * this.width / this.height;
    this.distance = points.reduce((most, p) => {
      const d = add(p, this.target, -1);
      return Math.max(most, dot(d, back) + Math.max(Math.abs(dot(d, right)) / wide, Math.abs(dot(d, up)) / tall));
    }, 0.1 * this.size);
  }

  turn(dx, dy) {
    this.azimuth -= dx * 0.007;
    this.elevation = Math.max(-1.5, Math.min(1.5, this.elevation + dy * 0.007));
  }

  move(dx, dy) {
    const { right, up } = this.axes(), s = this.pixel(this.distance);
    this.target = add(add(this.target, right, -dx * s), up, dy * s);
  }

  /** Come nearer to a point, which is seen where it was. */
  zoom(factor, point = this.target) {
    const before = this.distance;
    this.distance = Math.max(0.02 * this.size, Math.min(20 * this.size, before * factor));
    this.target = add(point, add(this.target, point, -1), this.distance / before);
  }
}
