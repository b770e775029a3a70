import { ask, PAGE } from "./ask.js";
import { dock } from "./dock.js";
import { make } from "./dom.js";
import { Draw } from "./draw.js";
import { Drawing } from "./drawing.js";
import { wordsOf } from "./form.js";
import { Hand } from "./hand.js";
import { Lines } from "./lines.js";
import { follow, frameOf } from "./link.js";
import { Paint } from "./paint.js";
import { toast } from "./say.js";
import { colours, DECADES, stretched } from "./scale.js";
import { Bar, sides } from "./screen.js";
import { factor } from "./words.js";

/** How long a text stays as it is [ms] until its cloth is built. */
const STAYS = 700;
/** How long cloth may be built [ms] until that is said, where another is shown meanwhile. */
const SOON = 1000;
/** The server's answer to the last that was no longer wanted: what is wanted next must not overtake it. */
let left = null;
/** Wall time that pictures are counted in [ms]. */
const SPAN = 2000;

/** The cloth of a scene that is open: as it is at the start, and while a run of it goes on as that has it.

  Nothing is asked for while it is not on the screen: neither a start, nor frames of a run. */
export class Cloth {
  constructor(scene) {
    Object.assign(this, { scene, visible: false, built: null, wanted: null, live: "", frame: null, number: 0, times: [], stretch: false });
    this.lines = new Lines();
    this.draw = new Draw(this);
    this.paint = new Paint(this);
    this.box = this.build();
    this.over = new AbortController();
    try {
      this.stage = new Drawing(this.canvas, this.lines);
    } catch (error) {
      this.say(`This browser cannot show the cloth: ${error.message}. A present Firefox, Chrome, Edge or Safari can.`);
      this.box.querySelector(".tools").hidden = true;
      return;
    }
    this.hand = new Hand(this.stage, () => (this.draw.on ? { kind: this.draw.kind, height: this.draw.height } : this.paint.pen), (pieces, places) => (this.draw.on ? this.draw.drawn(pieces) : this.paint.drawn(places)));
    this.canvas.addEventListener("keydown", (e) => this.keys(e));
    const seen = new Map();
    this.seen = new IntersectionObserver((changes) => {
      for (const { target, isIntersecting } of changes) seen.set(target, isIntersecting);
      this.visible = [...seen.values()].some(Boolean);
      this.update();
    });
    for (const one of [this.canvas, this.flat]) this.seen.observe(one);
    window.addEventListener("pagehide", () => this.forget(), { signal: this.over.signal });
    document.addEventListener("visibilitychange", () => this.update(), { signal: this.over.signal });
    dock.hearers.add(this.hear = () => this.update());
  }

  build() {
    const button = (id, textContent, title, does) => make("button", { type: "button", id: `cloth-${id}`, textContent, title, onclick: does });
    this.canvas = make("canvas", { id: "cloth", tabIndex: 0, ariaLabel: "The cloth. Drag or arrow keys turn it, with Shift they move it, the wheel or + and - come nearer." });
    this.flat = make("img", { id: "cloth-flat", draggable: false, alt: "The cloth as it begins, from above" });
    this.said = make("p", { className: "said", id: "cloth-said", role: "status" });
    this.figures = make("span", { className: "figures", id: "cloth-figures" });
    this.back = button("back", "Back to start", "The cloth as the text has it", () => { this.live = ""; this.built = null; this.update(); });
    this.draft = button("weave", "Weave", "Draw another weave for this cloth (key W)", () => this.weave());
    this.scale = new Bar("cloth-scale", "stretch", "", DECADES).box;
    return make("section", { className: "side cloth", ariaLabel: "Cloth" }, this.canvas, this.flat,
      make("div", { className: "tools" }, button("fit", "Whole", "The whole cloth (key F)", () => this.stage.fit()), ...sides(() => this.stage), button("mesh", "Triangles", "Key M", () => this.mesh()),
        button("stretch", "Stretch", "Colour the cloth by how far its threads are stretched (key S)", () => this.colour()),
        button("draw", "Draw lines", "Ridges and valleys on the cloth by hand (key D)", () => this.draw.toggle()),
        this.scene.large ? button("paint", "Paint", "Dye, paste and stencils on cloth to dye (key P)", () => this.paint.toggle()) : "",
        this.scene.large ? this.draft : "", this.back,
        this.scene.large ? button("large", "Larger", "Hide what is chosen (key L)", () => this.scene.large()) : ""),
      this.draw.box, this.draw.labels, this.paint.box,
      make("div", { className: "below" }, this.said, this.scale, this.figures));
  }

  say(text) { this.said.replaceChildren(text); }

  /** Whether the scene's cloth is dyed and does not move: a run has no positions of it. */
  get flatly() { return Boolean(this.scene.data?.dye && !this.scene.data.objects?.length); }

  get running() { return dock.going && dock.now.scene === this.scene.name; }

  /** Whether the start is to be built before a run is followed, for lines that go into the text. */
  get startFirst() { return this.draw.wanted && !this.number && this.scene.good && this.built === null; }

  /** Whether the scene says how its dyed cloth is woven. */
  get woven() { return this.scene.data?.dye?.cloth?.plugin === "woven"; }

  /** Draw another weave for the cloth, as a draft that lies beside the scene. */
  weave() {
    if (!this.woven) return;
    if (this.scene.own) location.hash = `#weave=${encodeURIComponent(this.scene.name)}`;
    else toast("Save the scene under a name of yours first", "The draft of its weave is to lie beside it.");
  }

  /** Show what is to be seen now, or nothing more. */
  update() {
    if (this.over.signal.aborted || !this.stage) return;
    this.back.hidden = !this.live || this.running;
    this.draft.hidden = !this.woven;
    const text = this.scene.text?.value;
    if (this.running) this.ran = text;
    else if (this.ran !== text) this.live = "";
    const runs = this.running && !this.startFirst && !this.flatly;
    if (!this.visible || document.hidden || runs) this.forget();
    if (!this.visible || document.hidden) this.rest();
    else if (runs) this.run();
    else {
      this.rest();
      if (!this.live) this.start();
    }
    this.count();
    this.draw.changed();
    this.paint.update();
  }

  rest() { this.following?.abort(); this.following = null; }

  /** The cloth that is being built is no longer wanted: neither the browser nor the server goes on with it. */
  forget() {
    if (!this.building) return;
    this.building.abort();
    Object.assign(this, { building: null, wanted: null });
    this.say(this.words ?? "");
    left = ask("leave", { page: PAGE }, { keepalive: true });  // also of a page that is closed
  }

  /** Follow the run. */
  run() {
    const { run, live } = dock.now;
    if (!live || (this.following && this.live === run)) return;
    this.rest();
    Object.assign(this, { live: run, times: [] });
    const { signal } = this.following = new AbortController();
    follow(`live?run=${encodeURIComponent(run)}&`, (frame) => this.take(frame), (gone) => this.say(gone ? "The run's cloth does not come." : this.words ?? ""), signal);
  }

  /** Build the cloth of the text, where it is another than what is shown, once it has stood for a while. */
  start() {
    const { text } = this.scene;
    if (!text || !this.scene.good || [this.built, this.wanted, this.waiting].includes(text.value)) return;
    this.waiting = text.value;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.see(), this.built === null ? 0 : STAYS);
  }

  async see() {
    const { value } = this.scene.text;
    this.waiting = null;
    if (this.over.signal.aborted || !this.visible || (this.running && !this.startFirst && !this.flatly) || !this.scene.good) return;
    this.building?.abort();  // the server ends what this page has asked for before
    const building = this.building = new AbortController(), flat = this.flatly;
    this.wanted = value;
    setTimeout(() => { if (this.building === building) this.say("Building the cloth …"); }, this.built === null ? 0 : SOON);
    await left;
    const answer = await ask(flat ? "dyed" : "see", { scene: this.scene.name, text: value, page: PAGE }, { signal: building.signal });
    if (this.building !== building) return;
    this.building = null;
    this.say(this.words ?? "");
    this.box.classList.toggle("flat", flat);
    if (answer.ok && flat) {
      this.flat.src = `flat?number=${answer.number}`;
      this.say("The cloth as it begins: it lies flat and does not move. Paint puts dye, paste and stencils on it.");
    } else if (answer.ok) {
      const frame = await frameOf(`start?number=${answer.number}`).catch(() => null);
      if (frame && !this.live && !this.over.signal.aborted) { this.number = answer.number; this.uv = frame.uv; this.take(frame, answer.words); this.print(frame); }
    } else if (this.scene.text.value === value) this.said.replaceChildren(answer.words ? wordsOf(answer) : answer.problem);
    Object.assign(this, { built: value, wanted: null });
    this.update();
  }

  /** Print on the cloth of the start what is printed or dyed there. */
  async print({ uv, printed }) {
    const { number, scene, stage } = this;
    if (!uv) return;
    const dyed = printed ? null : await ask("dyed", { scene: scene.name, text: scene.text.value, page: `${PAGE}-dye` });
    const image = make("img", { src: dyed ? `flat?number=${dyed.number}` : `start?number=${number}&image=1` });
    if (await image.decode().then(() => true, () => false) && this.number === number && stage.worn?.faces === 0.5 * uv.length) stage.wear(uv, image);
  }

  take(frame, words = this.words) {
    if (frame.state === "lost") { this.say(frame.message); return; }
    if (frame.faces) this.topology = { edges: frame.edges, rest: frame.rest };
    this.frame = { ...this.topology, ...frame };
    this.words = words ?? "";
    if (this.stretch) frame.colours = colours(stretched(this.frame));
    this.stage.show(frame);
    if (frame.faces) { this.say(this.lacks()); this.draw.changed(); }
    if (frame.faces) this.paint.dress();
    if (this.draw.wanted) { this.draw.wanted = false; this.draw.toggle(true); }
    const now = performance.now();
    this.times = [...this.times.filter((time) => now - time < SPAN), now];
  }

  /** What is not shown of this cloth, in words. */
  lacks() {
    const loose = !this.frame.faces?.length && this.frame.x.length;
    return [this.frame.x.length ? "" : "This scene has no cloth to be shown.", loose ? "This cloth has no triangles: its links are shown as lines." : "",
      this.words && `${this.words[0].toUpperCase()}${this.words.slice(1)}.`].filter(Boolean).join(" ");
  }

  /** Pictures a second that were shown, and the run's real-time factor. */
  count() {
    const now = performance.now(), recent = this.times.filter((time) => now - time < SPAN);
    const rate = recent.length > 1 ? (1000 * (recent.length - 1)) / (now - recent[0]) : 0;
    const shown = this.following && dock.now.state === "running" && rate;
    this.figures.textContent = shown ? [`${Math.round(rate)} pictures/s`, factor(dock.now.factor)].filter(Boolean).join(" · ") : "";
  }

  mesh() {
    this.stage.wires = !this.stage.wires;
    document.getElementById("cloth-mesh").setAttribute("aria-pressed", String(this.stage.wires));
    this.stage.dirty();
  }

  colour() {
    this.stretch = !this.stretch;
    this.scale.hidden = !this.stretch;
    document.getElementById("cloth-stretch").setAttribute("aria-pressed", String(this.stretch));
    if (this.frame) this.stage.colour(this.stretch ? colours(stretched(this.frame)) : undefined);
  }

  keys(e) {
    if (e.ctrlKey || e.metaKey || e.altKey) return;
    if (e.key === " ") { e.preventDefault(); document.getElementById(dock.going ? "pause" : "run")?.click(); }
    const id = { f: "fit", m: "mesh", s: "stretch", d: "draw", p: "paint", w: "weave", l: "large" }[e.key.toLowerCase()];
    if (id) { e.preventDefault(); document.getElementById(`cloth-${id}`)?.click(); }
  }

  close() {
    if (!this.stage) return;
    this.over.abort();
    this.rest();
    this.forget();
    this.seen.disconnect();
    dock.hearers.delete(this.hear);
    this.stage.close();
  }
}
