import { add, Camera, dot } from "./math.js";
import { Painter } from "./gl.js";
import { rgb } from "./scale.js";
import { Surface } from "./surface.js";

const CLOTH = [0.9, 0.87, 0.82], BODY = [0.66, 0.69, 0.73];

const empty = () => new Surface(new Float32Array(0), new Uint32Array(0));

// Not taken: rerun's web viewer in a frame. Without a graphics card it draws less than one picture a second of a dancer in
// a skirt, where this keeps up with the solver; and it asks other hosts for files, which no page here may.
/** The cloth and the bodies as they are, seen by a camera, which several stages may share. */
export class Stage {
  /** aside: pixels of the canvas that lie under panels. */
  constructor(canvas, { camera = new Camera(), aside = 0 } = {}) {
    Object.assign(this, { canvas, camera, aside, cloth: empty(), body: empty(), pieces: [], shape: -1, wires: false, normals: new Float32Array(0) });
    this.painter = new Painter(canvas);
    camera.watched.add(this);
    this.sizes = new ResizeObserver(() => this.resize());
    this.sizes.observe(canvas);
    this.over = new AbortController();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.resize(), { signal: this.over.signal });
    this.resize();
  }

  /** Show nothing more. */
  close() {
    this.closed = true;
    this.camera.watched.delete(this);
    this.sizes.disconnect();
    this.over.abort();
    this.painter.close();
  }

  resize() { this.size(); this.paper(); this.dirty(); }

  /** What is behind the cloth is the canvas's own background, which may be another in the dark. */
  paper() {
    const [r, g, b, a = 1] = (getComputedStyle(this.canvas).backgroundColor.match(/[\d.]+/g) ?? []).map(Number);
    if (r !== undefined && a > 0) this.painter.ground = [r / 255, g / 255, b / 255];
  }

  /** The camera is this stage's until another one takes it. */
  size() {
    this.camera.width = this.canvas.clientWidth || 1;
    this.camera.height = this.canvas.clientHeight || 1;
  }

  /** Draw once before the next picture. */
  dirty() {
    if (this.asked || this.closed) return;
    this.asked = true;
    requestAnimationFrame(() => { this.asked = false; this.paint(); });
  }

  /** Take in a frame: origin [m], x of 3 n positions about it, pieces of the cloth { start, stop, colour }; faces and
    bodyFaces where triangles are others than before, with edges, pairs of vertices, that are shown as lines where no
    triangle is; body, 3 b positions, where bodies are elsewhere; and colours, 3 n numbers, for others than the scene's. */
  show(frame) {
    const first = this.shape < 0, changed = frame.faces !== undefined;
    this.origin = frame.origin;
    this.cloth = new Surface(frame.x, changed ? frame.faces : this.cloth.faces);
    if (frame.body) this.body = new Surface(frame.body, changed ? frame.bodyFaces : this.body.faces);
    this.pieces = frame.pieces;
    if (changed) this.setTopology(frame.edges ?? new Uint32Array(0));
    if (first) this.fit(this.body.x);
    if (changed && this.worn?.faces !== frame.faces.length) this.wear();
    if (changed) this.lay();
    this.shape = frame.shape ?? 0;
    this.normals = this.cloth.normals();
    this.painter.move("cloth", frame.x, this.normals);
    this.hang();
    if (frame.body) this.painter.move("body", frame.body, this.body.normals());
    if (frame.colours) this.colour(frame.colours);
    this.dirty();
    return { first };
  }

  setTopology(edges) {
    const body = new Float32Array(this.body.x.length);
    for (let i = 0; i < body.length; i += 3) body.set(BODY, i);
    this.painter.setTopology("cloth", this.cloth.faces, this.ownColours());
    this.painter.setTopology("body", this.body.faces, body);
    const bare = new Uint8Array(this.cloth.x.length / 3).fill(1);
    for (const vertex of this.cloth.faces) bare[vertex] = 0;
    const loose = [...bare.keys()].filter((vertex) => bare[vertex]), pairs = [];
    for (let e = 0; loose.length && e < edges.length; e += 2) if (bare[edges[e]] || bare[edges[e + 1]]) pairs.push(edges[e], edges[e + 1]);
    this.painter.setLinks(new Uint32Array(pairs), new Uint32Array(loose));
  }

  /** The floor is below all that is there at first. */
  lay() {
    const low = [this.cloth.x, this.body.x].reduce((least, x) => { for (let i = 1; i < x.length; i += 3) least = x[i] < least ? x[i] : least; return least; }, Infinity);
    this.painter.floor = isFinite(low) ? low - 1e-3 * this.camera.size : null;
  }

  /** Print an image on the cloth: uv has places on it of each triangle's three corners, NaN for triangles without; nothing takes it off. */
  wear(uv = [], image = null) {
    const { faces } = this.cloth, corners = [...faces.keys()].filter((k) => uv[2 * k] === uv[2 * k] && 2 * k < uv.length), at = new Float32Array(3 * corners.length);
    corners.forEach((k, i) => at.set([uv[2 * k], uv[2 * k + 1], 0], 3 * i));
    this.worn = { faces: faces.length, corners: Uint32Array.from(corners, (k) => faces[k]) };
    this.painter.setTopology("print", Uint32Array.from(corners.keys()), at);
    if (image) this.painter.print(image);
    this.hang();
    this.dirty();
  }

  /** What is printed hangs as the cloth does. */
  hang() {
    if (!this.worn?.corners.length || !this.normals.length) return;
    const [x, n] = [this.cloth.x, this.normals].map((values) => { const found = new Float32Array(3 * this.worn.corners.length); this.worn.corners.forEach((v, i) => { found[3 * i] = values[3 * v]; found[3 * i + 1] = values[3 * v + 1]; found[3 * i + 2] = values[3 * v + 2]; }); return found; });
    this.painter.move("print", x, n);
  }

  /** The cloth's colours as the scene has them, three of each vertex. */
  ownColours() {
    const colours = new Float32Array(this.cloth.x.length);
    for (let i = 0; i < colours.length; i += 3) colours.set(CLOTH, i);
    for (const piece of this.pieces)
      for (let v = piece.start; piece.colour && v < piece.stop; v++) colours.set(rgb(piece.colour), 3 * v);
    return colours;
  }

  /** Colour the cloth by 3 n numbers from 0 to 1, or as the scene has it. It holds until triangles change. */
  colour(colours) { this.painter.printed = !colours; this.painter.colour("cloth", colours ?? this.ownColours()); this.dirty(); }

  /** Look at all that is there from a side [rad] about the vertical: a body's front faces +z. */
  from(azimuth) { this.fit(this.body.x); Object.assign(this.camera, { azimuth, elevation: 0.08 }); this.camera.changed(); }

  /** Look at the whole cloth, and at points beside it that are near. */
  fit(beside = []) { this.size(); this.camera.fit(this.cloth.x, this.cloth.facing(), this.aside, beside); this.camera.changed(); }

  /** The place on the cloth that a pixel shows, null where it shows something else. */
  pick(px, py) {
    this.size();
    const { origin, direction } = this.camera.ray(px, py), hit = this.cloth.pick(origin, direction);
    return hit && !this.body.pick(origin, direction, hit.t) ? hit : null;
  }

  /** The point that a pixel shows: of the cloth, a body or, beside these, as far away as what is looked at. */
  point(px, py) {
    this.size();
    const { camera } = this, { origin, direction } = camera.ray(px, py), cloth = this.cloth.pick(origin, direction);
    const hit = this.body.pick(origin, direction, cloth?.t) ?? cloth;
    return add(origin, direction, hit?.t ?? -camera.distance / dot(direction, camera.axes().back));
  }

  paint() {
    if (this.closed) return;
    this.size();
    this.painter.draw(this.camera, this.wires);
    this.onpaint?.();
  }
}
