import { make } from "./dom.js";

/** How many times as fast as real time, and how long [s] a replay takes at most unless it is asked for. */
const SPEEDS = [0.05, 0.1, 0.25, 0.5, 1, 2, 4, 10, 30, 100, 300, 1000, 3000, 10000], LONGEST = 60;

/** A clock over frames: play, pause, step, speed, and a time line. Frames are shown as they are; one that is not there
  yet is waited for. */
export class Player {
  /** times [s] of the frames; reels of the frames; show(i) is called with each that is shown. */
  constructor(times, reels, show) {
    Object.assign(this, { times, reels, show, index: -1, playing: false });
    const long = times.length ? times.at(-1) - times[0] : 0, usual = SPEEDS.find((speed) => speed >= 1 && long / speed <= LONGEST) ?? SPEEDS.at(-1);
    this.digits = Math.max(0, Math.min(4, 1 - Math.floor(Math.log10(long / times.length || 1))));
    const button = (id, textContent, title, does) => make("button", { type: "button", id, textContent, title, onclick: does });
    this.play = button("play", "Play", "Space", () => this.toggle());
    this.line = make("input", { type: "range", id: "time-line", min: 0, max: Math.max(0, times.length - 1), step: 1, value: 0, ariaLabel: "Time" });
    this.line.addEventListener("input", () => { this.pause(); this.go(Number(this.line.value)); });
    this.said = make("output", { id: "time-said", htmlFor: "time-line" });
    this.speed = make("select", { id: "speed", ariaLabel: "Speed", title: "Of the replay, against real time" },
      ...SPEEDS.filter((speed) => speed <= 4 * usual).map((value) => make("option", { value, textContent: `${value} ×`, selected: value === usual })));
    this.back = button("back", "‹", "One frame back (key ,)", () => { this.pause(); this.go(this.index - 1); });
    this.on = button("on", "›", "One frame on (key .)", () => { this.pause(); this.go(this.index + 1); });
    this.box = make("div", { className: "player" }, this.play, this.back, this.on, this.line, this.said, this.speed);
    this.back.ariaLabel = "One frame back";
    this.on.ariaLabel = "One frame on";
  }

  /** Show a frame, once it is there. */
  async go(i) {
    const index = Math.max(0, Math.min(this.times.length - 1, i));
    this.tell(index);
    const frames = await Promise.all(this.reels.map((reel) => reel.need(index)));
    if (this.index !== index) return;  // another one is wanted by now
    if (frames.every(Boolean)) this.show(index);
    else this.lost(index);
    for (const reel of this.reels) reel.ahead(index);
  }

  /** What cannot be read is told, and the frame before it stays. */
  lost() {
    this.pause();
    this.onlost?.(this.reels.map((reel) => reel.problem(this.index)).find(Boolean) ?? "This frame cannot be read.");
  }

  tell(index) {
    this.index = index;
    this.line.value = index;
    this.said.textContent = `${[this.times[index], this.times.at(-1)].map((t) => t.toFixed(this.digits)).join(" of ")} s`;
    this.line.setAttribute("aria-valuetext", this.said.textContent);
    this.back.disabled = index === 0;
    this.on.disabled = index === this.times.length - 1;
  }

  /** The frame at a time [s]. */
  seek(t) { this.pause(); this.go(this.before(t)); }

  /** The last frame until a time. */
  before(t) {
    let low = 0, high = this.times.length;
    while (high - low > 1) { const middle = (low + high) >> 1; if (this.times[middle] <= t) low = middle; else high = middle; }
    return low;
  }

  toggle() { if (this.playing) this.pause(); else this.start(); }

  start() {
    if (this.times.length < 2) return;
    if (this.index >= this.times.length - 1) this.tell(0);
    Object.assign(this, { playing: true, t: this.times[Math.max(0, this.index)], then: performance.now() });
    this.play.textContent = "Pause";
    requestAnimationFrame((now) => this.tick(now));
  }

  pause() { this.playing = false; this.play.textContent = "Play"; }

  tick(now) {
    if (!this.playing) return;
    // A pause of the browser's, as in a hidden tab, is no time of the replay.
    const t = this.t + Math.min(1, (now - this.then) / 1000) * Number(this.speed.value), index = this.before(t);
    this.then = now;
    for (const reel of this.reels) reel.ahead(index);
    if (this.reels.every((reel) => reel.at(index))) {
      this.t = t;
      if (index !== this.index) { this.tell(index); this.show(index); }
      if (index === this.times.length - 1) { this.pause(); return; }
    } else if (this.reels.some((reel) => reel.problem(index))) { this.tell(index); this.lost(); return; }
    requestAnimationFrame((later) => this.tick(later));
  }

  keys(e) {
    if (e.ctrlKey || e.metaKey || e.altKey || e.target.matches?.("select, textarea, input:not([type=range])")) return;
    const does = { " ": this.play, ",": this.back, ".": this.on }[e.key];
    if (!does || (e.key === " " && e.target.matches?.("button, a, summary"))) return;
    e.preventDefault();
    does.click();
  }

  close() { this.pause(); for (const reel of this.reels) reel.close(); }
}
