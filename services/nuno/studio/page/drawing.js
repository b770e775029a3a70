import { add } from "./math.js";
import { Stage } from "./stage.js";
import { Surface } from "./surface.js";

const COLOURS = { ridge: [0.85, 0.28, 0.11], valley: [0.12, 0.44, 0.77], paint: [0.15, 0.15, 0.18] };
const same = (a, b) => a.length === b.length && a.every((value, i) => value === b[i]);
// How strong the colour of a line is that is in the cloth already.
const APPLIED = 0.5;
/** A stage with lines on its cloth. */
export class Drawing extends Stage {
  constructor(canvas, lines) {
    super(canvas);
    Object.assign(this, { lines, base: null, drawn: null, veiled: false });
  }

  show(frame) {
    const before = this.cloth, shown = super.show(frame);
    if (frame.state === "start") this.begin();
    else if (frame.faces && !shown.first && this.cloth.count) this.lines.carry((place) => this.cloth.nearest(before.at(place)));
    return shown;
  }

  /** A start is shown: lines lie on it as they lay on the one before. */
  begin() {
    const { base } = this;
    if (base && this.cloth.count && !same(base.cloth.faces, this.cloth.faces)) this.lines.rebase((place) => this.cloth.nearest(base.cloth.at(place)));
    this.lines.restart();
    this.base = { cloth: this.cloth, pieces: this.pieces };
  }

  /** The same places on the cloth of the start, whose vertices are the first of each piece's still; none where the run
    is of another cloth, or there is no start. */
  basePlaces(points) {
    const { base } = this;
    if (!base) return null;
    if (base.cloth.faces === this.cloth.faces) return points;
    const x = new Float32Array(base.cloth.x.length), fits = base.pieces.length === this.pieces.length && base.pieces.every((piece, i) => piece.stop - piece.start <= this.pieces[i].stop - this.pieces[i].start);
    if (!fits) return null;
    base.pieces.forEach(({ start, stop }, i) => {
      const now = this.pieces[i].start;
      x.set(this.cloth.x.subarray(3 * now, 3 * (now + stop - start)), 3 * start);
    });
    const before = new Surface(x, base.cloth.faces);
    return points.map((place) => before.nearest(this.cloth.at(place)));
  }

  paint() {
    const parts = [], fins = [];
    if (!this.veiled) {
      for (const line of this.lines.list)
        if (!this.lines.hidden.has(line.id)) this.ribbon(this.lines.placesOf(line.id).points, line, parts, fins, this.lines.applied.has(line.id));
    }
    if (this.drawn) this.ribbon(this.drawn.points, this.drawn, parts, fins, false);
    this.painter.setLines(parts, fins);
    super.paint();
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
