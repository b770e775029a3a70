import { add } from "./math.js";

/** Triangles at one moment: picked by rays, and nearest places found. */
export class Surface {
  /** x: 3 n positions, faces: 3 f vertices, counter-clockwise seen from outside. */
  constructor(x, faces) { this.x = x; this.faces = faces; }

  get count() { return this.faces.length / 3; }

  /** 3 n unit normals of the vertices, weighted by the areas of their triangles. */
  normals() {
    const { x, faces } = this, n = new Float32Array(x.length);
    for (let f = 0; f < faces.length; f += 3) {
      const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
      const ux = x[b] - x[a], uy = x[b + 1] - x[a + 1], uz = x[b + 2] - x[a + 2];
      const vx = x[c] - x[a], vy = x[c + 1] - x[a + 1], vz = x[c + 2] - x[a + 2];
      const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
      for (const i of [a, b, c]) { n[i] += nx; n[i + 1] += ny; n[i + 2] += nz; }
    }
    for (let i = 0; i < n.length; i += 3) {
      const l = Math.hypot(n[i], n[i + 1], n[i + 2]) || 1;
      n[i] /= l; n[i + 1] /= l; n[i + 2] /= l;
    }
    return n;
  }

  /** The first triangle that a ray meets: { face, u, v, t }, u and v of its second and third corner; or null. */
  pick(origin, direction, limit = Infinity) {
    const { x, faces } = this, [ox, oy, oz] = origin, [dx, dy, dz] = direction;
    let best = limit, face = -1, bu = 0, bv = 0;
    for (let f = 0; f < faces.length; f += 3) {
      const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
      const ax = x[a], ay = x[a + 1], az = x[a + 2];
      const ux = x[b] - ax, uy = x[b + 1] - ay, uz = x[b + 2] - az;
      const vx = x[c] - ax, vy = x[c + 1] - ay, vz = x[c + 2] - az;
      const px = dy * vz - dz * vy, py = dz * vx - dx * vz, pz = dx * vy - dy * vx;
      const det = ux * px + uy * py + uz * pz;
      if (det === 0) continue;
      const sx = ox - ax, sy = oy - ay, sz = oz - az, inv = 1 / det;
      const u = (sx * px + sy * py + sz * pz) * inv;
      if (u < 0 || u > 1) continue;
      const qx = sy * uz - sz * uy, qy = sz * ux - sx * uz, qz = sx * uy - sy * ux;
      const v = (dx * qx + dy * qy + dz * qz) * inv;
      if (v < 0 || u + v > 1) continue;
      const t = (vx * qx + vy * qy + vz * qz) * inv;
      if (t > 0 && t < best) { best = t; face = f / 3; bu = u; bv = v; }
    }
    return face < 0 ? null : { face, u: bu, v: bv, t: best };
  }

  /** Where a place [face, u, v] is; of positions or of anything else that vertices have. */
  at([face, u, v], values = this.x) {
    const [a, b, c] = [0, 1, 2].map((k) => 3 * this.faces[3 * face + k]), w = 1 - u - v;
    return [0, 1, 2].map((k) => w * values[a + k] + u * values[b + k] + v * values[c + k]);
  }

  /** The mean of a face's corners at a place { face, u, v }, of one number for each vertex. */
  mean({ face, u, v }, values) { return [1 - u - v, u, v].reduce((sum, share, k) => sum + share * values[this.faces[3 * face + k]], 0); }

  /** The nearest place [face, u, v] to a point (Ericson, Real-Time Collision Detection, 5.1.5). */
  nearest(p) {
    // A triangle lies within `reach` of its middle: those whose middles are too far are passed over.
    const middles = this.middles(), far0 = this.far(p, middles), limit = (Math.sqrt(far0) + 2 * this.reach) ** 2;
    let best = Infinity, place = [0, 1 / 3, 1 / 3];
    for (let f = 0; f < this.count; f++) {
      if ((middles[3 * f] - p[0]) ** 2 + (middles[3 * f + 1] - p[1]) ** 2 + (middles[3 * f + 2] - p[2]) ** 2 > limit) continue;
      const [u, v] = this.nearestIn(f, p), d = add(this.at([f, u, v]), p, -1);
      const far = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
      if (far < best) { best = far; place = [f, u, v]; }
    }
    return place;
  }

  /** The middles of all triangles, and how far a corner is from one at most. */
  middles() {
    if (this.known) return this.known;
    const { x, faces } = this, m = (this.known = new Float64Array(faces.length));
    let reach = 0;
    for (let f = 0; f < faces.length; f += 3) {
      for (let c = 0; c < 3; c++) for (let k = 0; k < 3; k++) m[f + k] += x[3 * faces[f + c] + k] / 3;
      for (let c = 0; c < 3; c++) {
        const i = 3 * faces[f + c];
        reach = Math.max(reach, (x[i] - m[f]) ** 2 + (x[i + 1] - m[f + 1]) ** 2 + (x[i + 2] - m[f + 2]) ** 2);
      }
    }
    this.reach = Math.sqrt(reach);
    return m;
  }

  /** The least square of a distance from p to a middle. */
  far(p, middles) {
    let least = Infinity;
    for (let i = 0; i < middles.length; i += 3)
      least = Math.min(least, (middles[i] - p[0]) ** 2 + (middles[i + 1] - p[1]) ** 2 + (middles[i + 2] - p[2]) ** 2);
    return least;
  }

  nearestIn(f, p) {
    const { x, faces } = this, a = 3 * faces[3 * f], b = 3 * faces[3 * f + 1], c = 3 * faces[3 * f + 2];
    let d1 = 0, d2 = 0, d3 = 0, d4 = 0, d5 = 0, d6 = 0;
    for (let k = 0; k < 3; k++) {
      const ab = x[b + k] - x[a + k], ac = x[c + k] - x[a + k], ap = p[k] - x[a + k];
      d1 += ab * ap; d2 += ac * ap;
      d3 += ab * (ap - ab); d4 += ac * (ap - ab);
      d5 += ab * (ap - ac); d6 += ac * (ap - ac);
    }
    if (d1 <= 0 && d2 <= 0) return [0, 0];
    if (d3 >= 0 && d4 <= d3) return [1, 0];
    const vc = d1 * d4 - d3 * d2;
    if (vc <= 0 && d1 >= 0 && d3 <= 0) return [d1 / (d1 - d3), 0];
    if (d6 >= 0 && d5 <= d6) return [0, 1];
    const vb = d5 * d2 - d1 * d6;
    if (vb <= 0 && d2 >= 0 && d6 <= 0) return [0, d2 / (d2 - d6)];
    const va = d3 * d6 - d5 * d4;
    if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
      const w = (d4 - d3) / (d4 - d3 + d5 - d6);
      return [1 - w, w];
    }
    const s = va + vb + vc;
    return [vb / s, vc / s];
  }

  /** The mean of the triangles' normals by area, as long as they agree (0 to 1). */
  facing() {
    const { x, faces } = this, sum = [0, 0, 0];
    let area = 0;
    for (let f = 0; f < faces.length; f += 3) {
      const [a, b, c] = [0, 1, 2].map((k) => 3 * faces[f + k]);
      const u = [0, 1, 2].map((k) => x[b + k] - x[a + k]), v = [0, 1, 2].map((k) => x[c + k] - x[a + k]);
      const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
      for (let k = 0; k < 3; k++) sum[k] += n[k];
      area += Math.hypot(...n);
    }
    return sum.map((s) => s / (area || 1));
  }
}
