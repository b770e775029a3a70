import { Camera, add } from "./math.js";
import { Painter } from "./gl.js";
import { Surface } from "./surface.js";

const CLOTH = [0.9, 0.87, 0.82], BODY = [0.66, 0.69, 0.73];
export const COLOURS = { ridge: [0.85, 0.28, 0.11], valley: [0.12, 0.44, 0.77] };
// How strong the colour of a line is that is in the cloth already.
const APPLIED = 0.5;

const rgb = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255);
const empty = () => new Surface(new Float32Array(0), new Uint32Array(0));

/** The cloth, the bodies and the lines as they are, seen by one camera. */
export class Stage {
  constructor(canvas, lines) {
    Object.assign(this, { canvas, lines, camera: new Camera(), cloth: empty(), body: empty(), shape: -1, base: null, wires: false, drawn: null, veiled: false });
    this.painter = new Painter(canvas);
    this.normals = new Float32Array(0);
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.resize();
  }

  resize() {
    this.camera.width = this.canvas.clientWidth || 1;
    this.camera.height = this.canvas.clientHeight || 1;
    this.dirty();
  }

  /** Draw once before the next picture. */
  dirty() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame(() => { this.asked = false; this.paint(); });
  }

  /** Take in a frame of the server's. */
  show(frame) {
    const first = this.shape < 0, changed = frame.faces !== undefined;
    const origin = this.origin = frame.origin;
    const cloth = new Surface(frame.x, changed ? frame.faces : this.cloth.faces);
    if (changed && !first) this.carryLines(cloth, frame);
    this.cloth = cloth;
    if (frame.body) this.body = new Surface(frame.body, changed ? frame.bodyFaces : this.body.faces);
    if (changed) this.setTopology(frame);
    this.pieces = frame.pieces;
    if (first) { this.base = { faces: frame.faces, count: frame.x.length, pieces: frame.pieces }; this.fit(); }
    this.shape = frame.shape;
    this.normals = cloth.normals();
    this.painter.move("cloth", frame.x, this.normals);
    if (frame.body) this.painter.move("body", frame.body, this.body.normals());
    this.dirty();
    return { first, origin };
  }

  setTopology(frame) {
    const colours = new Float32Array(frame.x.length);
    for (let i = 0; i < colours.length; i += 3) colours.set(CLOTH, i);
    for (const piece of frame.pieces)
      for (let v = piece.start; piece.colour && v < piece.stop; v++) colours.set(rgb(piece.colour), 3 * v);
    const body = new Float32Array(frame.body.length);
    for (let i = 0; i < body.length; i += 3) body.set(BODY, i);
    this.painter.setTopology("cloth", frame.faces, colours);
    this.painter.setTopology("body", frame.bodyFaces, body);
  }

  /** Triangles have changed: lines lie where they lay, on those that are there now. */
  carryLines(cloth, frame) {
    if (frame.state === "start") { this.lines.restart(); this.base.faces = frame.faces; }
    else this.lines.carry((place) => cloth.nearest(this.cloth.at(place)));
  }

  /** The same places on the cloth that the page began with, whose vertices are the first of each piece's still. */
  basePlaces(points) {
    if (this.base.faces === this.cloth.faces) return points;
    const x = new Float32Array(this.base.count);
    this.base.pieces.forEach(({ start, stop }, i) => {
      const now = this.pieces[i].start;
      x.set(this.cloth.x.subarray(3 * now, 3 * (now + stop - start)), 3 * start);
    });
    const before = new Surface(x, this.base.faces);
    return points.map((place) => before.nearest(this.cloth.at(place)));
  }

  fit() { this.camera.fit(this.cloth.x, this.cloth.facing()); this.dirty(); }

  /** The place on the cloth that a pixel shows, null where it shows something else. */
  pick(px, py) {
    const { origin, direction } = this.camera.ray(px, py), hit = this.cloth.pick(origin, direction);
    return hit && !this.body.pick(origin, direction, hit.t) ? hit : null;
  }

  paint() {
    const parts = [], fins = [];
    if (!this.veiled) {
      for (const line of this.lines.list)
        if (!this.lines.hidden.has(line.id)) this.ribbon(this.lines.placesOf(line.id).points, line, parts, fins, this.lines.applied.has(line.id));
    }
    if (this.drawn) this.ribbon(this.drawn.points, this.drawn, parts, fins, false);
    this.painter.setLines(parts, fins);
    this.painter.draw(this.camera, this.wires);
    this.onpaint?.();
  }

  /** A line on the cloth, and as a curtain how far it will rise or sink. */
  ribbon(points, { kind, height, closed }, parts, fins, applied) {
    const colour = COLOURS[kind], tint = [...(applied ? colour.map((c) => 1 - APPLIED * (1 - c)) : colour), 1];
    const rise = kind === "ridge" ? height : -height, sheer = [...colour, 0.4], faint = [...colour, 0.75];
    let last = null;
    for (const place of closed ? [...points, points[0]] : points) {
      const p = this.cloth.at(place), top = add(p, this.cloth.at(place, this.normals), rise);
      if (last) {
        parts.push(...last.p, ...p, ...tint);
        if (!applied) fins.push(
          ...last.p, ...sheer, ...p, ...sheer, ...top, ...faint, ...last.p, ...sheer, ...top, ...faint, ...last.top, ...faint);
      }
      last = { p, top };
    }
  }
}
