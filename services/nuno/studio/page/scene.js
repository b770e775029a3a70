import { ask, PAGE } from "./ask.js";
import { Cloth } from "./cloth.js";
import { download, make, sentence } from "./dom.js";
import { dock } from "./dock.js";
import { Form, wordsOf } from "./form.js";
import { Maker } from "./maker.js";
import { rowsOf } from "./rows.js";
import { confirm, taken, toast } from "./say.js";
import { Schema } from "./schema.js";
import { Text } from "./text.js";
import { count } from "./words.js";

/** Weaves that scenes are to have when they are opened next, by the scenes' names. */
export const handed = new Map();

/** How long nothing is typed [ms] until the text is checked. */
const TYPED = 300;
let schema = null;

async function known() {
  schema ??= new Schema(await (await fetch("schema")).json());
  return schema;
}

/** A scene that is open: its text and its form, in step. */
export class SceneView {
  constructor(view, name) { Object.assign(this, { view, name, version: 0, queue: Promise.resolve(), mistakes: [] }); }

  /** drawing: in the mode for lines on the cloth. */
  async open(drawing = false) {
    const [answer, read] = await Promise.all([ask("open", { scene: this.name }), known()]);
    if (!taken(answer)) return;
    Object.assign(this, { saved: answer.text, own: answer.own, file: answer.file });
    this.cloth = new Cloth(this);
    this.cloth.draw.wanted = drawing;
    this.build();
    this.text = new Text(this.view.querySelector(".editor"), () => this.typed());
    this.form = new Form(this.view.querySelector(".fields"), read, (what) => this.change(what), (path) => this.look(path));
    this.maker = new Maker(this.view.querySelector(".choices"), read, (what) => this.change(what), (path) => this.look(path));
    this.text.open(answer.text);
    if (answer.changed !== null) this.text.set(answer.changed);
    this.take(answer);
    if (this.own) this.maker.list();
    this.view.addEventListener("line", (e) => { this.side("text"); this.text.go(e.detail); });
    const weave = handed.get(this.name);
    if (!weave) return;
    handed.delete(this.name);
    await this.change({ path: ["dye", "cloth", "weave"], value: weave });
    toast(`The weave is ${weave.file} now`, "Undo brings back the one before; Save keeps it.");
  }

  build() {
    const button = (id, textContent, does, props = {}) => make("button", { type: "button", id, textContent, onclick: does, ...props });
    const side = (which, textContent) => button(`side-${which}`, textContent, () => this.side(which));
    this.box = make("div", { className: "scene" },
      make("div", { className: "head" }, make("h1", { textContent: this.name }), make("span", { id: "unsaved", className: "unsaved", role: "status" }),
        make("span", { className: "switch", role: "group", ariaLabel: "What is shown" }, side("cloth", "Cloth"), side("choices", "Choices"), side("text", "Text"), side("form", "Form")),
        make("span", { className: "group" },
          button("undo", "Undo", () => this.text.undo(), { title: "Ctrl Z" }), button("redo", "Redo", () => this.text.redo(), { title: "Ctrl Shift Z" }),
          ...(this.own ? [button("save", "Save", () => this.save(), { title: "Ctrl S" })] : []),
          button(this.own ? "save-as" : "save", "Save as …", () => this.save({ as: true }), this.own ? { title: "Under another name" } : { title: "Ctrl S" }),
          button("run", "Run", () => this.run(false), { className: "main", title: "Ctrl Enter" }))),
      make("div", { className: "sides" }, this.cloth.box,
        make("section", { className: "side maker", ariaLabel: "Garment and body" },
          make("div", { className: "choices" }),
          this.advanced = make("details", { id: "advanced", ontoggle: () => this.opened() }, make("summary", { textContent: "Advanced", title: "The scene as text, solver, step, seed and all other fields" }),
            make("div", { className: "group" },
              button("plan", "Plan", () => this.plan(), { title: "What will run, what is left out, the stable step, the cost" }),
              button("run-step", "Step", () => this.run(true), { title: "Start a run that waits after its first frame" })),
            make("div", { className: "both" },
              make("section", { className: "text", ariaLabel: "Text" },
                make("div", { className: "editor" }, make("div", { className: "gutter", ariaHidden: "true" }), make("textarea", { id: "text", spellcheck: false, wrap: "off", ariaLabel: "The scene as YAML" }))),
              make("section", { className: "form", ariaLabel: "Form" }, make("div", { className: "fields" })))),
          make("div", { className: "verdict", role: "status", id: "verdict" }))),
      make("div", { className: "panel plan", id: "planned", hidden: true }));
    this.view.replaceChildren(this.box);
    this.side("cloth");
    this.advanced.open = localStorage.getItem("advanced") === "open";
  }

  /** Text and form, which a browser shows again to whoever has left them open. */
  opened() {
    localStorage.setItem("advanced", this.advanced.open ? "open" : "");
    this.maker?.again();
    if (["text", "form"].includes(this.box.dataset.side) !== this.advanced.open && this.box.dataset.side !== "cloth") this.side(this.advanced.open ? "text" : "choices");
  }

  /** In a narrow window, which side is shown. */
  side(which) {
    this.box.dataset.side = which;
    if (which !== "cloth") this.advanced.open = which !== "choices";
    for (const one of ["cloth", "choices", "text", "form"]) document.getElementById(`side-${one}`).setAttribute("aria-pressed", String(one === which));
  }

  /** Only the cloth, or text and form beside it. */
  large(large = this.box.dataset.large !== "true") {
    this.box.dataset.large = String(large);
    const button = document.getElementById("cloth-large");
    Object.assign(button, { textContent: large ? "Smaller" : "Larger", title: large ? "What is chosen beside it (key L)" : "Hide what is chosen (key L)" });
  }

  close() { this.cloth?.close(); this.unplan(); }

  /** End a plan that goes on. */
  unplan() { if (this.planning) ask("leave", { page: PAGE, plan: true }); }

  typed() {
    this.version++;
    this.state();
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.check(), TYPED);
  }

  async check() {
    const version = this.version, answer = await ask("check", { scene: this.name, text: this.text.value });
    if (version === this.version && taken(answer)) this.take(answer);
  }

  /** A change by form or brush: one after the other, each of the text that the one before has made. */
  change(what, does = "change") {
    this.queue = this.queue.then(async () => {
      const version = this.version, answer = await ask(does, { scene: this.name, text: this.text.value, ...what });
      if (version !== this.version || (!answer.ok && !answer.gone && this.form.refuse(what.path, answer))) return;
      if (taken(answer)) this.put(answer);
    });
    return this.queue;
  }

  /** What the server says of the text. */
  take({ data, lines, mistakes }, keep = false) {
    Object.assign(this, { data, lines, mistakes, checked: this.text.value });
    this.text.mark(mistakes.map(({ line }) => line).filter(Boolean));
    this.form.show(data, mistakes, keep);
    this.maker.show(data, mistakes, keep);
    const verdict = document.getElementById("verdict"), first = mistakes.find(({ line }) => line);
    verdict.replaceChildren(make("span", { className: mistakes.length ? "bad" : "good", textContent: mistakes.length ? count(mistakes.length, "mistake") : "No mistakes" }));
    if (first) verdict.append(make("button", { type: "button", className: "link", id: "first", textContent: `Go to line ${first.line}`, onclick: () => { this.text.go(first.line); this.form.reveal(first); } }));
    if (first && this.form.placed.has(first)) verdict.append(make("span", { className: "soft", id: "first-said", textContent: [first.field, first.problem, first.remedy?.split(" known: ")[0]].filter(Boolean).join(": ") }));
    // What is wrong with the whole of the text has no field.
    this.cloth.update();
    verdict.append(...mistakes.filter((one) => !this.form.placed.has(one)).map(wordsOf));
    this.state();
  }

  state() {
    const changed = this.text.value !== this.saved;
    document.getElementById("unsaved").textContent = changed ? "not saved" : "";
    document.getElementById("undo").disabled = !this.text.past.length;
    document.getElementById("redo").disabled = !this.text.future.length;
    document.getElementById("save").disabled = this.own && !changed;
  }

  /** Whether the text as it stands has been found to have no mistakes. */
  get good() { return !this.mistakes.length && this.text?.value === this.checked; }

  get unsaved() { return Boolean(this.text) && (this.text.value !== this.saved || this.cloth.draw.unsaved); }

  look(path) { this.text.point(this.lines[path]); }

  async plan() {
    const box = document.getElementById("planned"), button = document.getElementById("plan");
    const close = make("button", { type: "button", className: "close", textContent: "✕", ariaLabel: "Close the plan", onclick: () => { box.hidden = true; this.unplan(); } });
    box.hidden = false;
    this.planning = true;
    box.replaceChildren(make("span", { className: "soft", textContent: "Planning: the first frame is tried. The first time, this takes a minute or two." }), close);
    button.disabled = true;
    const answer = await ask("plan", { scene: this.name, text: this.text.value, page: PAGE });
    this.planning = button.disabled = false;
    if (answer.ok) box.replaceChildren(rowsOf(answer.rows), close);
    else box.replaceChildren(answer.words ? wordsOf(answer) : answer.problem, close);
    box.scrollIntoView({ block: "nearest" });
  }

  /** Run the text, or another in its place; whether it has begun. */
  async run(paused, text = this.text.value) {
    document.getElementById("planned").hidden = true;
    const answer = await ask("run", { scene: this.name, text, paused });
    if (taken(answer)) dock.follow(answer);
    return answer.ok;
  }

  /** Take a text that the server has made of this one. */
  put(answer) {
    this.version++;
    this.text.set(answer.text);
    this.take(answer, true);
  }

  /** Save under the scene's own name or, where it has none or `as`, under one that is asked for; whether that was done. */
  async save({ as = !this.own, leaving = false } = {}) {
    const text = this.text.value;
    let answer = {};
    const does = async (name) => (answer = await ask("save", { scene: this.name, text, before: this.saved, name }));
    if (!as) await does(this.file);
    else if (!(await confirm({ title: "Save the scene", text: "It goes into the folder that the studio was started in.", yes: "Save", label: "Name of the file", value: this.file, does })) && !answer.gone) return false;
    if (answer.gone) return this.keep(answer, text);
    if (!taken(answer)) return false;
    toast(`Saved as ${answer.name}`, answer.text);
    if (leaving) return true;
    this.saved = text;
    if (answer.name === this.file && this.own) this.state();
    else location.hash = `#scene=${encodeURIComponent(answer.name)}`;
    return true;
  }

  /** Where the server has gone, its page cannot save, but the browser can: whether the text was kept so. */
  async keep({ problem }, text) {
    const more = "A nuno studio that was started anew has another address. Keep the text among your browser's downloads, and drop it on the new page.";
    if (!(await confirm({ title: sentence(problem), text: more, yes: "Keep the text" }))) return false;
    download(`${this.file.replace(/\.ya?ml$/, "")}.yaml`, text);
    return true;
  }

  keys(e) {
    const key = e.key.toLowerCase();
    if (this.cloth?.draw.keys(e) || this.cloth?.paint.keys(e)) return;
    if (!(e.ctrlKey || e.metaKey) || !this.text) return;
    const does = { z: () => (e.shiftKey ? this.text.redo() : this.text.undo()), y: () => this.text.redo(), s: () => this.save(), enter: () => this.run(false) }[key];
    if (!does) return;
    e.preventDefault();
    does();
  }
}
