import { ask } from "./ask.js";
import { dock } from "./dock.js";
import { make } from "./dom.js";
import { Flat } from "./flat.js";
import { mm } from "./panel.js";
import { taken, toast } from "./say.js";
import { Worn } from "./worn.js";

const TOOLS = { dye: ["Dye", "1"], paste: ["Paste", "2"], stencil: ["Stencil", "3"] };
const PASTE = "#c9963e";
/** Of a stencil's file [bytes]: a request holds 4 MB, in which it takes a third more. */
const MOST = 2.8e6;
const $ = (id) => document.getElementById(`paint-${id}`);

/** The mode of the cloth's view in which dye, paste and stencils are put on cloth to dye, which lies flat. */
export class Paint {
  constructor(cloth) {
    Object.assign(this, { cloth, on: false, tool: "dye", width: null, amount: 1, seen: null, image: null, onGarment: false });
    this.box = this.build();
    this.flat = new Flat(this.canvas, this);
  }

  build() {
    const button = (id, textContent, does, props = {}) => make("button", { type: "button", id: `paint-${id}`, textContent, onclick: does, ...props });
    const tool = ([id, [name, key]]) => button(id, name, () => this.choose(id), { role: "radio", ariaChecked: String(id === "dye"), title: `Key ${key}` });
    const of = (which, ...inside) => make("label", { className: `of ${which}` }, ...inside);
    this.canvas = make("canvas", { id: "paint", tabIndex: 0, ariaLabel: "The cloth, laid flat. Drag to paint. Arrow keys move the brush, Enter puts it down and takes it up." });
    this.said = make("p", { className: "said", id: "paint-said", role: "status" });
    this.place = make("span", { className: "figures", id: "paint-place" });
    return make("div", { className: "paint", hidden: true },
      make("div", { className: "brushes" }, make("span", { className: "tool-group", role: "radiogroup", ariaLabel: "What is put on" }, ...Object.entries(TOOLS).map(tool)),
        of("dye", make("i", { id: "paint-swatch" }), make("select", { id: "paint-which", ariaLabel: "Dye", onchange: () => this.brush() })),
        of("dye", "Amount ", make("input", { type: "range", id: "paint-amount", min: "0.05", max: "1", step: "0.05", value: "1", oninput: (e) => { this.amount = Number(e.target.value); this.brush(); } }), make("output", { id: "paint-amount-said", textContent: "100 %" })),
        of("dye paste stencil", "Width ", make("input", { type: "number", id: "paint-width", min: "0", step: "any", inputMode: "decimal", onchange: (e) => { if (e.target.value > 0) this.width = e.target.value / 1000; this.brush(); } }), " mm"),
        of("stencil", make("input", { type: "file", id: "paint-file", accept: "image/png", ariaLabel: "Stencil, a PNG", onchange: (e) => this.load(e.target.files[0]) })),
        of("stencil", make("input", { type: "checkbox", id: "paint-invert" }), " Black keeps dye out"),
        button("garment", "On the garment", () => this.hang(), { title: "Paint on the garment as it hangs, or on its cloth laid flat (key G)", hidden: true }),
        make("span", { className: "tool-group" }, button("undo", "Undo", () => this.cloth.scene.text.undo(), { title: "Ctrl Z" }), button("redo", "Redo", () => this.cloth.scene.text.redo(), { title: "Ctrl Shift Z" }),
          button("done", "Done", () => this.toggle(false), { className: "main", title: "Back to the cloth (Escape)" }))),
      this.canvas, make("div", { className: "below" }, this.said, this.place));
  }

  /** Enter or leave the mode, where the scene has cloth to dye. */
  async toggle(on = !this.on) {
    if (on && !(await this.look())) return;
    this.on = on;
    this.box.hidden = !on;
    this.cloth.box.classList.toggle("painting", on);
    document.getElementById("cloth-paint").setAttribute("aria-pressed", String(on));
    this.cloth.scene.large?.(on);
    this.hang(on && this.onGarment);
    if (!on) { this.cloth.stage.colour(); return; }
    this.choose(this.tool);
    this.canvas.focus();
  }

  /** Paint on the garment as it hangs, or on its cloth laid flat. */
  hang(on = !this.onGarment) {
    if (this.on) this.onGarment = on;
    this.cloth.box.classList.toggle("worn", on);
    $("garment").setAttribute("aria-pressed", String(on));
    if (on) requestAnimationFrame(() => this.cloth.stage.fit());  // the garment alone, as large as it can be
    this.say();
    this.cloth.update();
    this.dress();
  }

  /** What a drag on the garment draws with: nothing unless that is painted on. */
  get pen() { return this.on && this.onGarment && this.worn ? { kind: "paint", height: 0 } : null; }

  /** Print the garment with its cloth, once both are there. */
  dress() {
    const { cloth } = this, { number, stage } = cloth;
    if (!this.on || !this.onGarment || !number || !this.seen.object || !cloth.uv) return;
    if (this.start !== number) Object.assign(this, { start: number, worn: new Worn(cloth.uv, this.size, stage.base.cloth) });
    if (stage.base.cloth.faces === stage.cloth.faces) stage.wear(cloth.uv, this.picture);
  }

  /** A drag over the garment: the lines that it is on the flat cloth, one after the other. */
  async drawn(places) {
    const there = places.filter(Boolean), base = this.cloth.stage.basePlaces(there);
    if (!base) { toast("The run is of other cloth than the text", "Paint on its cloth laid flat.", true); return; }
    const found = new Map(there.map((place, i) => [place, base[i]])), lines = this.worn.lines(places.map((place) => place && found.get(place)));
    if (this.tool === "stencil") { if (lines.length) await this.put(lines.at(-1)); return; }
    for (const line of lines) await this.put(line);
  }

  /** Draw the cloth of the text as it begins; whether it could be. */
  async look() {
    const { scene } = this.cloth, { value } = scene.text, answer = await ask("dyed", { scene: scene.name, text: value });
    if (scene.text.value !== value) return false;
    if (!answer.ok && this.on) { this.said.textContent = answer.problem; return false; }
    if (!taken(answer)) return false;
    const image = new Image();
    image.src = `flat?number=${answer.number}`;
    await image.decode();
    Object.assign(this, { seen: answer, shown: value, picture: image });
    $("garment").hidden = !answer.object;
    this.width ??= Number((0.05 * Math.max(...this.size)).toPrecision(1));
    if (document.getElementById("paint-which").length !== answer.dyes.length) $("which").replaceChildren(...answer.dyes.map(({ name }) => make("option", { value: name, textContent: name })));
    this.flat.show(image, this.size);
    this.say();
    this.dress();
    return true;
  }

  /** Of the cloth, across and down [m]. */
  get size() { return this.seen.cells.map((n) => n * this.seen.cell); }

  /** Whether strokes go into the run that goes on. */
  get live() { return this.cloth.running; }

  /** The text has changed, or a run has begun or ended. */
  update() {
    if (!this.on || !this.cloth.scene.good) return;
    if (this.shown !== this.cloth.scene.text.value) this.look();
    this.say();
    $("undo").disabled = !this.cloth.scene.text.past.length;
    $("redo").disabled = !this.cloth.scene.text.future.length;
  }

  say() {
    const [wide, high] = this.size, of = this.seen.object ? `The cloth of ${this.seen.object}${this.onGarment ? "" : ", laid flat"}` : "The cloth";
    const where = this.live ? "What you paint goes into the run that goes on; the picture stays that of its start." : "What you paint stands in the text.";
    this.said.textContent = `${of}: ${mm(wide)} mm × ${mm(high)} mm, cells of ${mm(this.seen.cell)} mm. ${where}`;
  }

  choose(tool) {
    this.tool = tool;
    for (const id of Object.keys(TOOLS)) $(id).setAttribute("aria-checked", String(id === tool));
    for (const label of this.box.querySelectorAll(".of")) label.hidden = !label.classList.contains(tool);
    this.brush();
  }

  /** Show what the brush is now. */
  brush() {
    if (!this.seen) return;
    $("width").value = mm(this.width);
    $("amount-said").textContent = `${Math.round(100 * this.amount)} %`;
    $("swatch").style.background = this.dye.colour;
    this.flat.paint();
  }

  get dye() { return this.seen.dyes.find(({ name }) => name === $("which").value) ?? this.seen.dyes[0]; }

  /** How strokes are drawn until the cloth has them. */
  get look_of_brush() { return this.tool === "dye" ? { colour: this.dye.colour, opacity: 0.25 + 0.6 * this.amount } : { colour: PASTE, opacity: 0.8 }; }

  /** A stencil's file. */
  async load(file) {
    this.image = null;
    if (!file) return;
    if (file.size > MOST) { toast("This stencil is too large", `A PNG of at most ${MOST / 1e6} MB: one pixel a cell of the cloth is enough.`, true); return; }
    let shown;
    try {
      shown = await createImageBitmap(file);
    } catch {
      toast("This is no picture that a stencil could be", "Take a PNG: white keeps dye out, or black where that is ticked.", true);
      return;
    }
    const bytes = new Uint8Array(await file.arrayBuffer());
    let text = "";
    for (let i = 0; i < bytes.length; i += 32768) text += String.fromCharCode(...bytes.subarray(i, i + 32768));
    this.image = { data: btoa(text), ratio: shown.height / shown.width, shown };
    this.flat.paint();
  }

  /** A stroke over places [m], or a stencil at the last of them. Whether the cloth, or the run, has it. */
  async put(points) {
    const { tool, width } = this, { scene } = this.cloth;
    if (tool === "stencil" && !this.image) { toast("Choose a stencil first", "A PNG from your disk."); return; }
    const what = tool === "stencil" ? { image: this.image.data, invert: $("invert").checked, place: points.at(-1) } : { points, dye: this.dye.name, amount: this.amount };
    const said = { tool, width, ...what };
    if (!this.live) { await scene.change(said, "paint"); await this.look(); return; }
    const answer = await ask("paint", { scene: scene.name, text: scene.text.value, live: true, ...said });
    if (!taken(answer)) return;
    dock.follow(answer);
    toast("The run has it", `${answer.changed.field}, at frame ${answer.changed.frame}. The scene's text stays as it is.`);
  }

  /** Whether a key is one of this mode's. */
  keys(e) {
    if (!this.on || e.ctrlKey || e.metaKey || e.altKey || ["TEXTAREA", "SELECT", "INPUT"].includes(e.target.tagName)) return false;
    const found = Object.entries(TOOLS).find(([, [, key]]) => key === e.key);
    if (found) this.choose(found[0]);
    else if (e.key.toLowerCase() === "g" && this.seen.object) this.hang();
    else if (e.key === "Escape") { if (!this.flat.cancel()) this.toggle(false); }
    else return false;
    e.preventDefault();
    return true;
  }
}
