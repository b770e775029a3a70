import { thin } from "./lines.js";
import { length, add } from "./math.js";
import { Orbit } from "./orbit.js";

const STEP = 3, LEAST = 8, CLOSE = 0.5;
// Pixels between two samples of a line, that a line must have at least, and that it may be moved by thinning it.
const RING = 18;
// A line whose ends are as near as so many pixels is a ring.
const LEAP = 30;
// A line that goes on this many times further off than the pixels between two samples are wide is on another layer.

/** Where there is a pen, a drag on the cloth draws, beside it it turns the view. */
export class Hand extends Orbit {
  constructor(stage, pen, done) {
    super(stage);
    Object.assign(this, { pen, done });
  }

  begin(e) {
    const hit = this.pen() && e.button === 0 && !e.shiftKey && this.stage.pick(e.offsetX, e.offsetY);
    if (!hit) return super.begin(e);
    this.samples = [{ ...this.sample(hit), x: e.offsetX, y: e.offsetY }];
    this.preview();
    return "draw";
  }

  move(e) {
    if (!this.mode) this.stage.canvas.classList.toggle("on-cloth", Boolean(this.pen()) && !e.shiftKey && this.stage.pick(e.offsetX, e.offsetY) !== null);
    else if (this.mode === "draw" && e.getCoalescedEvents?.().length) for (const one of e.getCoalescedEvents()) this.step(one.offsetX, one.offsetY);
    else this.step(e.offsetX, e.offsetY);
  }

  step(x, y) {
    if (this.mode !== "draw") { super.step(x, y); return; }
    const dx = x - this.last.x, dy = y - this.last.y, n = Math.ceil(Math.hypot(dx, dy) / STEP);
    for (let i = 1; i <= n; i++) {
      const at = { x: this.last.x + (dx * i) / n, y: this.last.y + (dy * i) / n }, hit = this.stage.pick(at.x, at.y);
      this.samples.push(hit ? { ...this.sample(hit), ...at } : { ...at, place: null });
    }
    this.last = { x, y };
    this.preview();
  }

  sample(hit) {
    const place = [hit.face, hit.u, hit.v];
    return { place, shape: this.stage.shape, size: this.stage.camera.pixel(hit.t) };
  }

  /** Places of triangles that are no more are left out: the cloth was given others while the line was drawn. */
  get fresh() { return this.samples.filter((s) => !s.place || s.shape === this.stage.shape); }

  preview() {
    this.stage.drawn = { ...this.pen(), points: this.fresh.filter((s) => s.place).map((s) => s.place) };
    this.stage.dirty();
  }

  up(e) {
    if (this.mode === "draw") {
      this.step(e.offsetX, e.offsetY);
      const runs = this.runs();
      const pieces = runs.map((run) => ({ points: this.thinned(run), closed: this.closes(run) })).filter(({ points }) => points.length > 1);
      this.done(pieces, this.fresh.map((s) => s.place));
    }
    this.cancel();
  }

  /** Samples on the cloth as runs that do not leave it or leap to another layer; short ones are slips. */
  runs() {
    const runs = [[]];
    for (const s of this.fresh) {
      const run = runs[runs.length - 1];
      if (!s.place) { if (run.length) runs.push([]); continue; }
      const p = this.stage.cloth.at(s.place), last = run[run.length - 1];
      if (last && length(add(p, last.p, -1)) > LEAP * STEP * s.size) runs.push([]);
      runs[runs.length - 1].push({ ...s, p });
    }
    return runs.filter((run) => run.length > 1 && this.pixels(run) >= LEAST);
  }

  pixels(run) { return run.slice(1).reduce((sum, s, i) => sum + Math.hypot(s.x - run[i].x, s.y - run[i].y), 0); }

  /** Whether a line comes back to where it began. */
  closes(run) {
    const a = run[0], b = run[run.length - 1];
    return Math.hypot(a.x - b.x, a.y - b.y) <= RING && this.pixels(run) > 6 * RING;
  }

  thinned(run) { return thin(run, CLOSE * Math.min(...run.map((s) => s.size))).map((s) => s.place); }

  cancel() {
    super.cancel();
    this.stage.drawn = null;
    this.stage.dirty();
  }
}
