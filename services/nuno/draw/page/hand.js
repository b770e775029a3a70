import { thin } from "./lines.js";
import { length, add } from "./math.js";

const STEP = 3, LEAST = 8, CLOSE = 0.5;
// Pixels between two samples of a line, that a line must have at least, and that it may be moved by thinning it.
const RING = 18;
// A line whose ends are as near as so many pixels is a ring.
const LEAP = 30;
// A line that goes on this many times further off than the pixels between two samples are wide is on another layer.

/** Pointer and wheel: a drag on the cloth draws, beside it it turns the view. */
export class Hand {
  constructor(stage, pen, done) {
    Object.assign(this, { stage, pen, done, mode: "", last: null });
    const { canvas } = stage;
    canvas.addEventListener("pointerdown", (e) => this.down(e));
    canvas.addEventListener("pointermove", (e) => this.move(e));
    canvas.addEventListener("pointerup", (e) => this.up(e));
    canvas.addEventListener("pointercancel", () => this.cancel());
    canvas.addEventListener("contextmenu", (e) => e.preventDefault());
    canvas.addEventListener("wheel", (e) => {
      e.preventDefault();
      stage.camera.zoom(Math.exp(Math.max(-240, Math.min(240, e.deltaY * (e.deltaMode ? 30 : 1))) * 0.0015));
      stage.dirty();
    }, { passive: false });
  }

  down(e) {
    this.stage.canvas.focus();
    if (this.mode) return;
    this.stage.canvas.setPointerCapture(e.pointerId);
    this.last = { x: e.offsetX, y: e.offsetY };
    const hit = e.button === 0 && !e.shiftKey && this.stage.pick(e.offsetX, e.offsetY);
    this.mode = hit ? "draw" : e.button === 1 || e.shiftKey ? "shift" : "turn";
    if (hit) { this.samples = [{ ...this.sample(hit), x: e.offsetX, y: e.offsetY }]; this.preview(); }
    this.stage.canvas.classList.toggle("turning", !hit);
  }

  move(e) {
    if (!this.mode) {
      this.stage.canvas.classList.toggle("on-cloth", !e.shiftKey && this.stage.pick(e.offsetX, e.offsetY) !== null);
      return;
    }
    const seen = this.mode === "draw" && e.getCoalescedEvents?.().length ? e.getCoalescedEvents() : [e];
    for (const one of seen) this.step(one.offsetX, one.offsetY);
    this.stage.dirty();
  }

  step(x, y) {
    const dx = x - this.last.x, dy = y - this.last.y;
    if (this.mode === "draw") {
      const n = Math.ceil(Math.hypot(dx, dy) / STEP);
      for (let i = 1; i <= n; i++) {
        const at = { x: this.last.x + (dx * i) / n, y: this.last.y + (dy * i) / n }, hit = this.stage.pick(at.x, at.y);
        this.samples.push(hit ? { ...this.sample(hit), ...at } : { ...at, place: null });
      }
      this.preview();
    } else if (this.mode === "turn") this.stage.camera.turn(dx, dy);
    else this.stage.camera.move(dx, dy);
    this.last = { x, y };
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
      this.done(pieces);
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
    this.mode = "";
    this.stage.drawn = null;
    this.stage.canvas.classList.remove("turning");
    this.stage.dirty();
  }
}
