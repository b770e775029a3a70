// Pixels of a drag that a press of an arrow key is as much as, and how much nearer a press of + comes.
const PRESS = 24, NEARER = 0.87;
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

/** A drag turns the view, with Shift or the middle button it moves it, the wheel comes nearer; or so by arrow keys, + and -. */
export class Orbit {
  constructor(stage) {
    Object.assign(this, { stage, mode: "", last: null });
    const { canvas } = stage;
    canvas.addEventListener("pointerdown", (e) => this.down(e));
    canvas.addEventListener("pointermove", (e) => this.move(e));
    canvas.addEventListener("pointerup", (e) => this.up(e));
    canvas.addEventListener("pointercancel", () => this.cancel());
    canvas.addEventListener("contextmenu", (e) => e.preventDefault());
    canvas.addEventListener("keydown", (e) => this.press(e));
    canvas.addEventListener("wheel", (e) => {
      e.preventDefault();
      stage.camera.zoom(Math.exp(Math.max(-240, Math.min(240, e.deltaY * (e.deltaMode ? 30 : 1))) * 0.0015), stage.point(e.offsetX, e.offsetY));
      stage.camera.changed();
    }, { passive: false });
  }

  down(e) {
    this.stage.canvas.focus();
    if (this.mode) return;
    this.stage.canvas.setPointerCapture(e.pointerId);
    this.last = { x: e.offsetX, y: e.offsetY };
    this.mode = this.begin(e);
    this.stage.canvas.classList.toggle("turning", ["turn", "shift"].includes(this.mode));
  }

  /** What a drag does that begins so. */
  begin(e) { return e.button === 1 || e.shiftKey ? "shift" : "turn"; }

  move(e) { if (this.mode) this.step(e.offsetX, e.offsetY); }

  step(x, y) {
    const dx = x - this.last.x, dy = y - this.last.y, { camera } = this.stage;
    if (this.mode === "turn") camera.turn(dx, dy);
    else { this.stage.size(); camera.move(dx, dy); }
    this.last = { x, y };
    camera.changed();
  }

  press(e) {
    if (e.ctrlKey || e.metaKey || e.altKey) return;
    const { camera } = this.stage, arrow = ARROWS[e.key]?.map((s) => s * PRESS), zoom = { "+": NEARER, "=": NEARER, "-": 1 / NEARER }[e.key];
    if (!arrow && !zoom) return;
    e.preventDefault();
    if (zoom) camera.zoom(zoom);
    else if (e.shiftKey) { this.stage.size(); camera.move(...arrow); }
    else camera.turn(...arrow);
    camera.changed();
  }

  up() { this.cancel(); }

  cancel() {
    this.mode = "";
    this.stage.canvas.classList.remove("turning");
  }
}
