import { ask } from "./ask.js";
import { download, make } from "./dom.js";
import { Panel, mm } from "./panel.js";
import { taken, toast } from "./say.js";
import { count } from "./words.js";

/** How long no line is altered [ms] until they are tried. */
const ALTERED = 150;
/** Pixels that the panels take. */
const ASIDE = 520;
const KINDS = { ridge: ["Ridge", "rises outwards", "M2 18 C14 18 16 4 24 4 S34 18 46 18", "R"], valley: ["Valley", "sinks inwards", "M2 4 C14 4 16 18 24 18 S34 4 46 4", "V"] };
const $ = (id) => document.getElementById(`draw-${id}`);

/** The mode of the cloth's view in which ridges and valleys are drawn on it by hand. */
export class Draw {
  constructor(cloth) {
    Object.assign(this, { cloth, lines: cloth.lines, on: false, wanted: false, kind: "ridge", height: 0.01, width: null, needs: null, span: 0.1, written: null, kept: [] });
    this.box = this.build();
    this.labels = make("div", { id: "draw-labels", ariaLive: "polite", hidden: true });
  }

  get stage() { return this.cloth.stage; }

  /** Whether lines are drawn that would be lost. */
  get unsaved() { return this.lines.open.length > 0 && this.lines.list !== this.kept; }

  build() {
    const button = (id, textContent, does, props = {}) => make("button", { type: "button", id: `draw-${id}`, textContent, onclick: does, ...props });
    const kind = (id) => {
      const [name, says, path, key] = KINDS[id], found = button(id, "", () => this.choose(id), { role: "radio", ariaChecked: String(id === "ridge"), title: `Key ${key}` });
      const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg"), line = document.createElementNS(svg.namespaceURI, "path");
      svg.setAttribute("viewBox", "0 0 48 22"); svg.setAttribute("aria-hidden", "true"); line.setAttribute("d", path); svg.append(line);
      found.append(svg, name, make("small", { textContent: says }));
      return found;
    };
    const check = (id, text) => make("label", { className: "check" }, make("input", { type: "checkbox", id: `draw-${id}` }), ` ${text}`);
    return make("div", { className: "drawing", hidden: true },
      make("section", { className: "card tools-of-lines", ariaLabel: "The line to draw" },
        make("div", { className: "kinds", role: "radiogroup", ariaLabel: "Kind of line" }, kind("ridge"), kind("valley")),
        make("label", { className: "row" }, "Height ", make("span", {}, make("input", { type: "number", id: "draw-height", min: "0.1", step: "any", inputMode: "decimal", onchange: (e) => this.setHeight(e.target.value > 0 ? e.target.value / 1000 : this.height) }), " mm")),
        make("input", { type: "range", id: "draw-slider", min: "0", max: "1", step: "0.001", ariaLabel: "Height of the line", oninput: (e) => this.setHeight(Math.max(1e-4, Number((this.span * e.target.value ** 2).toPrecision(2)))) }),
        make("label", { className: "row", title: "The rest shape is raised as far on both sides, and can be taken back; without a width triangles are split" }, "Width ",
          make("span", {}, make("input", { type: "number", id: "draw-width", min: "0.1", step: "any", inputMode: "decimal", placeholder: "none", onchange: (e) => this.setWidth(e.target.value > 0 ? e.target.value / 1000 : null) }), " mm")),
        make("label", { className: "row" }, "Smoothing ", make("span", {}, make("output", { id: "draw-passes-said", textContent: "8" }), " passes")),
        make("input", { type: "range", id: "draw-passes", min: "0", max: "40", step: "1", value: "8", ariaLabel: "Smoothing", oninput: (e) => { $("passes-said").textContent = e.target.value; } }),
        check("sharp", "Keep the line itself sharp"), check("keep", "Keep from fading"),
        make("div", { className: "triple" }, button("undo", "Undo", () => { this.lines.undo(); this.edited(); }, { title: "Ctrl Z" }),
          button("redo", "Redo", () => { this.lines.redo(); this.edited(); }, { title: "Ctrl Shift Z" }), button("clear", "Clear", () => { this.lines.clear(); this.edited(); }, { title: "Remove all lines that are not applied" }))),
      make("section", { className: "card list-of-lines", ariaLabel: "Lines" },
        make("h2", {}, "Lines ", make("span", { id: "draw-count" }), button("hide", "Hide all", () => { this.stage.veiled = !this.stage.veiled; this.changed(); }, { className: "link", title: "Key H" })),
        make("ol", { id: "draw-list" }), make("p", { id: "draw-none", textContent: "Drag on the cloth to draw a line." }),
        button("apply", "Apply to cloth", () => this.applyOrRun(), { className: "main" }),
        make("div", { className: "double" }, button("save", "Add to the text", () => this.keep(), { title: "Into operations of the scene's text" }), button("export", "Export OBJ", () => this.export(), { title: "A file of polylines" }))));
  }

  /** Enter or leave the mode, where the cloth takes lines. */
  async toggle(on = !this.on) {
    if (on && this.cloth.number) {
      const answer = await ask("draw", { does: "begin", start: this.cloth.number });
      if (!taken(answer)) return;
      this.needs = answer.needs_width ? answer : null;
    }
    this.on = on;
    this.box.hidden = this.labels.hidden = !on;
    document.getElementById("cloth-draw").setAttribute("aria-pressed", String(on));
    this.cloth.scene.large?.(on);
    this.stage.aside = on && matchMedia("(min-width: 901px)").matches ? ASIDE : 0;
    requestAnimationFrame(() => this.stage.fit());
    if (!on) return;
    this.panel ??= new Panel(this.lines, this.stage, () => this.edited(), (line) => this.takeBack(line));
    this.stage.onpaint = () => this.panel.labels();
    this.scale();
    this.choose(this.kind);
    this.changed();
    this.cloth.canvas.focus();
  }

  /** Heights that suit the cloth's size. */
  scale() {
    this.span = Number((this.stage.camera.size * 0.12).toPrecision(1));
    this.setHeight(Number((this.stage.camera.size * 0.025).toPrecision(1)));
    this.setWidth(null);
  }

  /** The width of lines; cloth that needs one has six edges of its triangles and four heights at least, unless told otherwise. */
  setWidth(metres) {
    this.width = metres ?? (this.needs ? Number(Math.max(6 * this.needs.edge, 4 * this.height).toPrecision(2)) : null);
    $("width").value = this.width ? mm(this.width) : "";
    for (const id of ["passes", "sharp"]) $(id).disabled = this.width !== null;
  }

  changed() {
    if (!this.on) return;
    this.panel.show();
    const { cloth } = this, open = this.lines.open.length, start = cloth.frame?.state === "start";
    $("apply").textContent = start ? (open ? `Run with ${count(open, "line")}` : "Run with lines") : open ? `Apply ${count(open, "line")} to cloth` : "Apply to cloth";
    $("apply").disabled = !open || (start ? !cloth.scene.text : !cloth.running);
    this.stage.dirty();
  }

  /** Lines were drawn or altered: what is wrong with them is said now, not only once they are applied. */
  edited() {
    this.changed();
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.check(), ALTERED);
  }

  async check() {
    const { lines, cloth } = this, list = lines.open, version = lines.list;
    if (cloth.frame.state !== "start" || !list.length) return;
    const answer = await this.ask("check", list, "points");
    if (lines.list !== version || cloth.frame.state !== "start") return;
    for (const line of list) lines.errors.delete(line.id);
    if (answer.ok) this.changed();
    else this.refused(answer, list);
  }

  /** Ask for something about lines, by their places on what is shown, or on the start. */
  ask(does, list, of, more = {}) {
    const { cloth } = this, start = of === "base" || cloth.frame.state === "start";
    const lines = list.map((line) => ({ points: this.lines.placesOf(line.id)[of], height: line.kind === "ridge" ? line.height : -line.height, width: line.width, closed: line.closed }));
    const settings = { passes: Number($("passes").value), hierarchical: $("sharp").checked, keep: $("keep").checked };
    return ask("draw", { does, lines, settings, ...(start ? { start: cloth.number } : { run: cloth.live, shape: this.stage.shape }), ...more });
  }

  /** Show a refusal beside the line that it is about, or else in a box. */
  refused(answer, list) {
    const which = /lines\[(\d+)\]/.exec(answer.field || ""), line = which && list[Number(which[1])];
    if (!line) { taken(answer); return; }
    const point = /(\d+)/.exec(answer.value?.startsWith("between") ? answer.value : "");
    const place = /^(between|triangle)/.test(answer.value ?? "");  // it is shown by where the words stand
    this.lines.errors.set(line.id, { ...answer, ...(place ? { value: null, limit: null } : {}), point: point ? Number(point[1]) : undefined });
    this.lines.hidden.delete(line.id);
    this.changed();
  }

  async applyOrRun() {
    $("apply").disabled = true;
    if (this.cloth.frame.state === "start") await this.run();
    else await this.apply();
    this.changed();
  }

  async apply(again = true) {
    const { lines } = this, list = lines.open;
    for (const line of list) lines.errors.delete(line.id);
    const answer = await this.ask("apply", list, "points");
    if (!answer.ok && answer.field === "shape" && again) {
      await new Promise((later) => setTimeout(later, 200));
      return this.apply(false);
    }
    const ids = (answer.applied ?? []).map((i) => list[i].id);
    if (ids.length) lines.settle(ids, answer.numbers);
    if (answer.ok) toast(ids.length === 1 ? "The line is in the cloth" : `${ids.length} lines are in the cloth`);
    else this.refused(answer, list);
    return this.changed();
  }

  /** Take a line back from the cloth of the run. */
  async takeBack(line) {
    const [object, number] = this.lines.numbers.get(line.id);
    if (!taken(await ask("draw", { does: "take_back", object, number }))) return;
    this.lines.takenBack(line.id);
    toast("The line is taken back", "The cloth returns to its shape without it.");
    this.changed();
  }

  /** The text with all lines in it: those that were added before are not in it twice. */
  async text() {
    const { scene } = this.cloth, { list } = this.lines;
    if (!scene.text) { toast("The run's scene is no file that lines could be added to", "Export the lines instead.", true); return null; }
    const own = scene.text.value === this.written?.after;
    if (list.some(({ id }) => !this.lines.placesOf(id).base)) {
      toast("The lines are on other cloth than the text's", "The run was started from another text. Export the lines instead.", true);
      return null;
    }
    const before = own ? this.written.before : scene.text.value;
    const answer = await this.ask("keep", list, "base", { scene: scene.name, text: before });
    if (!answer.ok) { this.refused(answer, list); return null; }
    return { before, answer };
  }

  /** Run the scene with the lines from its first frame. */
  async run() {
    const found = await this.text();
    if (!found || !(await this.cloth.scene.run(false, found.answer.text))) return;
    this.lines.settle(this.lines.list.map(({ id }) => id), found.answer.numbers);
  }

  /** Put the lines into the text, in the place of those that were put there before. */
  async keep() {
    const found = await this.text();
    if (!found) return;
    const { before, answer } = found;
    this.written = { before, after: answer.text };
    this.kept = this.lines.list;
    this.cloth.scene.put(answer);
    toast("The lines are in the text", "They stand in its operations. Save keeps them in the file.");
  }

  async export() {
    const answer = await this.ask("export", this.lines.list, "points");
    if (!answer.ok) { this.refused(answer, this.lines.list); return; }
    download(answer.name, answer.text);
    this.kept = this.lines.list;
    toast(`Exported ${answer.name}`, "It lies among your browser's downloads.");
  }

  choose(which) {
    this.kind = which;
    for (const one of Object.keys(KINDS)) $(one).setAttribute("aria-checked", String(one === which));
  }

  setHeight(metres) {
    this.height = metres;
    $("height").value = mm(metres);
    $("slider").value = Math.sqrt(Math.min(1, metres / this.span));
  }

  drawn(pieces) {
    if (!pieces.length) { toast("That was too short for a line", "Keep the button down and drag over the cloth."); return; }
    for (const { points, closed } of pieces) this.panel.chosen = this.lines.add(this.kind, this.height, this.width, points, this.stage.basePlaces(points), closed);
    if (pieces.length > 1) toast(`The line left the cloth: it is ${pieces.length} lines now`, "Undo takes them back, one after the other.");
    this.edited();
  }

  /** Whether a key is one of this mode's. */
  keys(e) {
    const control = e.ctrlKey || e.metaKey, key = e.key.toLowerCase();
    if (!this.on || ["TEXTAREA", "SELECT"].includes(e.target.tagName) || (e.target.tagName === "INPUT" && e.target.type !== "range" && e.target.type !== "checkbox")) return false;
    const does = control ? { z: e.shiftKey ? "redo" : "undo", y: "redo" }[key] : { r: "ridge", v: "valley", h: "hide" }[key];
    if (key === "escape") this.cloth.hand.cancel();
    if (!does) return false;
    e.preventDefault();
    $(does).click();
    return true;
  }
}
