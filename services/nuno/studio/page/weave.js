import { ask } from "./ask.js";
import { make, sentence } from "./dom.js";
import { drawdownOf, kinds, longest, tiled, turned } from "./drawdown.js";
import { card } from "./files.js";
import { rowsOf } from "./rows.js";
import { confirm, taken, toast } from "./say.js";
import { count } from "./words.js";
import { handed } from "./scene.js";

/** As the server's; a tie-up beyond so many treadles is written as a lift plan. */
const MOST = 100, MOST_TREADLES = 32;
const STARTS = [["Plain", { plugin: "plain" }], ["Twill 2/2", { plugin: "twill" }], ["Satin 5", { plugin: "satin" }]];
/** Ends and picks of a new weave. */
const SIDE = 8;
/** Pixels: height of the grid, side of a crossing, above and left of the grid, for numbers, and beyond its end; of a yarn in the cloth. */
const HIGH = 500, CROSSING = [7, 44], RIM = 26, EDGE = 8, YARN = [2, 14];
const WARP = "#26262b", WEFT = "#f5f2eb", LINE = "#b4bac1", MARK = "#e0701b";
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const $ = (id) => document.getElementById(`weave-${id}`);

/** A grid of crossings that a weave is drawn in by mouse or keys, and the cloth that repeats it. */
export class WeaveView {
  /** name: a draft to draw in, or a scene whose cloth is to have the weave; or none. */
  constructor(view, name) {
    const draft = name.toLowerCase().endsWith(".wif");
    Object.assign(this, { view, what: "weave", draft: draft ? name : "", scene: draft ? "" : name, file: "", kept: null, past: [], future: [], at: [0, 0], stroke: null, from: "" });
  }

  async open() {
    const answer = await ask("files");
    if (!taken(answer)) return;
    await this.begin();
    this.rows ??= tiled(drawdownOf({}), SIDE, SIDE);
    this.saved = String(this.rows);
    this.build(answer.files.filter((file) => file.toLowerCase().endsWith(".wif")));
    this.show();
    this.grid.focus({ preventScroll: true });
  }

  /** The weave to begin with: that of the draft, or of the scene. */
  async begin() {
    let file = this.draft;
    if (this.scene) {
      const answer = await ask("open", { scene: this.scene }), weave = answer.data?.dye?.cloth?.weave ?? {};
      if (!taken(answer)) return;
      this.from = `Saved as a draft, it can be put into ${this.scene}.`;
      file = weave.plugin === "wif" ? weave.file : "";
      const rows = file ? null : drawdownOf(weave);
      if (rows && [rows, ...rows].every(({ length }) => length >= 1 && length <= MOST)) this.rows = tiled(rows, rows.length, rows[0].length);
    }
    const opened = file && (await this.drawdown(file));
    if (!opened) return;
    this.rows = opened.rows;
    if (this.draft && opened.text) Object.assign(this, { file, kept: opened.text });
    else if (this.draft) this.from = `The weave of ${file}. Colours, spacing and what else it holds are not drawn here, so that this is saved under another name.`;
  }

  async drawdown(file) {
    const answer = await ask("drawdown", { file });
    return taken(answer) ? { rows: answer.rows.map((row) => Array.from(row, Number)), text: answer.text } : null;
  }

  build(files) {
    const button = (id, textContent, does, props = {}) => make("button", { type: "button", id: `weave-${id}`, textContent, onclick: does, ...props });
    const number = (id, text, set) => make("label", {}, `${text} `, make("input", { type: "number", id: `weave-${id}`, min: 1, max: MOST, step: 1, onchange: (e) => set(Math.min(MOST, Math.max(1, Math.round(Number(e.target.value)) || 1))) }));
    const start = make("select", { id: "weave-start", onchange: () => this.start() }, make("option", { value: "", textContent: "choose …" }), ...STARTS.map(([name], i) => make("option", { value: i, textContent: name })),
      ...(files.length ? [make("optgroup", { label: "Drafts of the folder" }, ...files.map((file) => make("option", { value: file, textContent: file })))] : []));
    this.grid = make("canvas", { id: "weave-grid", tabIndex: 0, ariaLabel: "One repeat: ends across, picks down. Click or drag sets crossings. Arrow keys move, Space turns a crossing over, Shift and arrows carry it on." });
    this.pattern = make("canvas", { id: "weave-cloth", ariaLabel: "The repeat, many times, as cloth" });
    this.hold = make("div", { className: "hold" }, this.grid);
    const key = (className, text) => make("span", { className: "key" }, make("i", { className }), text);
    this.view.replaceChildren(make("div", { className: "weave" },
      make("div", { className: "head" }, make("h1", { textContent: this.scene ? `Draw a weave for ${this.scene}` : this.draft ? `Draw in ${this.draft}` : "Draw a weave" }), make("span", { id: "weave-unsaved", className: "unsaved", role: "status" }),
        make("span", { className: "group" }, button("undo", "Undo", () => this.undo(), { title: "Ctrl Z" }), button("redo", "Redo", () => this.redo(), { title: "Ctrl Shift Z" }),
          button("save-as", "Save as …", () => this.save({ as: true }), { title: "Under another name" }), button("save", "Save", () => this.save(), { className: "main", title: "Ctrl S" }))),
      make("p", { id: "weave-from", className: "soft", textContent: this.from }),
      make("div", { className: "panel options" }, make("label", {}, "Start from ", start), number("ends", "Ends", (n) => this.put(tiled(this.rows, this.rows.length, n))), number("picks", "Picks", (n) => this.put(tiled(this.rows, n, this.rows[0].length))),
        make("span", { className: "soft", textContent: `1 to ${MOST} of each. Where there are more of them, the weave goes on as it repeats.` })),
      make("div", { className: "two" },
        make("section", { className: "panel", ariaLabel: "One repeat" }, make("h2", {}, "One repeat", make("span", { className: "soft", textContent: "click or drag" })), this.hold,
          make("p", { className: "keys" }, key("warp", "warp above"), key("weft", "weft above"), make("span", { id: "weave-place", className: "soft", role: "status" })),
          make("p", { className: "soft", textContent: "Keys: arrows move, Space turns a crossing over, Shift and arrows carry it on. End 1 is at the left, pick 1 at the top, as in pictures of cloth." })),
        make("section", { className: "panel", ariaLabel: "The cloth" }, make("h2", {}, "The cloth", make("span", { className: "soft", textContent: "one repeat is outlined" })), this.pattern, make("div", { id: "weave-facts" }))),
      make("div", { id: "weave-saved" })));
    const { grid } = this;
    grid.addEventListener("pointerdown", (e) => { if (e.button === 0) { grid.setPointerCapture(e.pointerId); this.press(this.crossing(e)); } });
    grid.addEventListener("pointermove", (e) => { for (const one of this.stroke ? [...(e.getCoalescedEvents?.() ?? []), e] : [e]) this.move(this.crossing(one)); });
    for (const kind of ["pointerup", "pointercancel"]) grid.addEventListener(kind, () => this.lift());
    grid.addEventListener("keydown", (e) => this.key(e));
    for (const box of [this.hold, this.pattern]) new ResizeObserver(() => this.draw()).observe(box);
  }

  get unsaved() { return Boolean(this.rows) && String(this.rows) !== this.saved; }

  /** Fill the grid with a start: as large as it was, or more, so that all repeats are whole; or with a draft. */
  async start() {
    const { value } = $("start"), opened = value in STARTS ? { rows: drawdownOf(STARTS[value][1]) } : await this.drawdown(value);
    $("start").value = "";
    if (!opened) return;
    const n = opened.rows.length, whole = (now) => n * Math.ceil(now / n);
    this.put(value in STARTS ? tiled(opened.rows, whole(this.rows.length), whole(this.rows[0].length)) : opened.rows);
  }

  /** Take other rows in place of the present ones, which can be brought back. */
  put(rows) {
    if (String(rows) !== String(this.rows)) { this.past.push(this.rows); this.future = []; this.rows = rows; }
    this.show();
  }

  undo() { this.back(this.past, this.future); }
  redo() { this.back(this.future, this.past); }

  back(from, to) {
    if (!from.length || this.stroke) return;
    to.push(this.rows);
    this.rows = from.pop();
    this.show();
  }

  /** The crossing [end, pick] at a place of the mouse, which may be beside the grid. */
  crossing(e) { return [e.offsetX, e.offsetY].map((x) => Math.floor((x - RIM) / this.side)); }

  inside([end, pick]) { return pick >= 0 && pick < this.rows.length && end >= 0 && end < this.rows[0].length; }

  press(at) {
    if (!this.inside(at)) return;
    this.stroke = { value: 1 - this.rows[at[1]][at[0]], before: this.rows };
    this.rows = this.rows.map((row) => [...row]);
    this.at = at;
    this.move(at);
  }

  /** All crossings on the way of a drag, which may have been faster than its events. */
  move(at) {
    if (this.stroke) {
      const way = at.map((x, i) => x - this.at[i]), steps = Math.max(1, ...way.map(Math.abs));
      for (let k = 0; k <= steps; k++) {
        const one = this.at.map((x, i) => Math.round(x + (way[i] * k) / steps));
        if (this.inside(one)) this.rows[one[1]][one[0]] = this.stroke.value;
      }
      this.at = at;
      this.show();
    } else if (this.inside(at)) { this.at = at; this.draw(); }
  }

  lift() {
    if (!this.stroke) return;
    const { rows } = this;
    this.rows = this.stroke.before;
    this.stroke = null;
    this.put(rows);
  }

  key(e) {
    if (e.ctrlKey || e.metaKey || e.altKey || this.stroke) return;
    const way = ARROWS[e.key], [end, pick] = this.at, next = way ? [end + way[0], pick + way[1]] : this.at;
    const turns = e.key === " " || e.key === "Enter";
    if (!way && !turns) return;
    e.preventDefault();
    if (!this.inside(next)) return;
    Object.assign(this, { at: next, led: true });
    if (turns || e.shiftKey) this.put(this.rows.map((row, p) => row.map((up, n) => (p === next[1] && n === next[0] ? (turns ? 1 - up : this.rows[pick][end]) : up))));
    else this.draw();
  }

  keys(e) {
    const key = e.key.toLowerCase();
    if (!(e.ctrlKey || e.metaKey) || !this.rows) return;
    const does = { z: () => (e.shiftKey ? this.redo() : this.undo()), y: () => this.redo(), s: () => this.save() }[key];
    if (!does) return;
    e.preventDefault();
    does();
  }

  show() {
    const { rows } = this, ends = turned(rows), treadles = kinds(rows);
    if (!this.stroke) this.at = [ends.length, rows.length].map((n, i) => Math.min(n - 1, Math.max(0, this.at[i])));
    $("ends").value = ends.length;
    $("picks").value = rows.length;
    $("unsaved").textContent = this.unsaved ? "not saved" : "";
    $("undo").disabled = !this.past.length;
    $("redo").disabled = !this.future.length;
    $("save").disabled = Boolean(this.file) && !this.unsaved;
    $("save").textContent = this.file ? "Save" : "Save as …";
    $("save-as").hidden = !this.file;
    const float = (lines, value, what) => { const n = longest(lines, value); return n === Infinity ? `all ${what}s` : count(n, what); };
    const never = (lines, what) => { const n = lines.filter((line) => kinds(line) === 1).length; return n ? [["WARNING", `${count(n, what)} interlace${n === 1 ? "s" : ""} with nothing, and would lie loose`]] : []; };
    $("facts").replaceChildren(rowsOf([["shafts", String(kinds(ends))], ["treadles", treadles > MOST_TREADLES ? `a lift plan: there would be ${treadles}` : String(treadles)],
      ["longest warp float", `over ${float(ends, 1, "pick")}, under ${float(ends, 0, "pick")}`], ["longest weft float", `over ${float(rows, 0, "end")}, under ${float(rows, 1, "end")}`],
      ...never(ends, "end"), ...never(rows, "pick")]));
    this.draw();
  }

  draw() {
    if (!this.rows || this.asked) return;
    this.asked = requestAnimationFrame(() => { this.asked = 0; if (this.pattern.isConnected) { this.drawGrid(); this.drawCloth(); } });
  }

  /** Size of a crossing [pixels]. */
  get side() { return Math.min(CROSSING[1], Math.max(CROSSING[0], Math.floor(Math.min((this.hold.clientWidth - RIM - EDGE) / this.rows[0].length, HIGH / this.rows.length)))); }

  drawGrid() {
    const { rows, side, at } = this, wide = RIM + side * rows[0].length + EDGE, high = RIM + side * rows.length + EDGE, pen = sized(this.grid, wide, high);
    if (this.led) this.reveal();
    const every = side >= 18 ? 1 : 5, soft = getComputedStyle(this.grid).color;
    Object.assign(pen, { fillStyle: soft, font: "11px system-ui, sans-serif", textAlign: "center", textBaseline: "middle" });
    for (const [n, place] of [[rows[0].length, (x) => [x, RIM / 2]], [rows.length, (x) => [RIM / 2, x]]])
      for (let i = 1; i <= n; i++) if (i === 1 || i % every === 0) pen.fillText(String(i), ...place(RIM + side * (i - 0.5)));
    rows.forEach((row, p) => row.forEach((up, e) => {
      pen.fillStyle = up ? WARP : WEFT;
      pen.fillRect(RIM + side * e, RIM + side * p, side, side);
    }));
    pen.fillStyle = LINE;
    for (let e = 0; e <= rows[0].length; e++) pen.fillRect(RIM + side * e, RIM, 1, side * rows.length + 1);
    for (let p = 0; p <= rows.length; p++) pen.fillRect(RIM, RIM + side * p, side * rows[0].length + 1, 1);
    if (!this.inside(at)) return;
    Object.assign(pen, { strokeStyle: MARK, lineWidth: 2 });
    pen.strokeRect(RIM + side * at[0] + 0.5, RIM + side * at[1] + 0.5, side, side);
    $("place").textContent = `end ${at[0] + 1}, pick ${at[1] + 1}: ${rows[at[1]][at[0]] ? "warp" : "weft"} above`;
  }

  /** Where the grid is larger than its box, show the crossing that keys have led to. */
  reveal() {
    this.led = false;
    for (const [i, start, size] of [[0, "scrollLeft", "clientWidth"], [1, "scrollTop", "clientHeight"]]) {
      const before = this.side * this.at[i], beyond = RIM + before + this.side + EDGE - this.hold[size];
      this.hold[start] = Math.min(before, Math.max(this.hold[start], beyond));
    }
  }

  drawCloth() {
    const { rows, pattern } = this, wide = pattern.clientWidth, high = pattern.clientHeight, ends = rows[0].length, picks = rows.length;
    const side = Math.min(YARN[1], Math.max(YARN[0], Math.floor(Math.min(wide / ends, high / picks) / 2))), ratio = devicePixelRatio;
    const one = make("canvas"), yarn = sized(one, side * ends, side * picks), pen = sized(pattern, wide, high);
    // A yarn is darker at its rims, where there is room to see that.
    const shade = (up, x, y) => {
      const rim = side >= 5 ? Math.max(1, side / 8) : 0, band = (from, width) => (up ? yarn.fillRect(x + from, y, width, side) : yarn.fillRect(x, y + from, side, width));
      yarn.fillStyle = up ? WARP : WEFT;
      band(0, side);
      yarn.fillStyle = up ? "#000" : "#b9b4a6";
      band(0, rim);
      band(side - rim, rim);
      yarn.fillStyle = up ? "#55555f" : "#fff";
      if (rim) band(0.4 * side, 0.2 * side);
    };
    rows.forEach((row, p) => row.forEach((up, e) => shade(up, side * e, side * p)));
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.fillStyle = pen.createPattern(one, "repeat");
    pen.fillRect(0, 0, pattern.width, pattern.height);
    Object.assign(pen, { strokeStyle: MARK, lineWidth: 2 * ratio });
    pen.strokeRect(ratio, ratio, one.width - ratio, one.height - ratio);
  }

  /** Save the draft: over the one that was saved before, or under a name that is asked for; whether that was done. */
  async save({ as = !this.file, leaving = false } = {}) {
    if (this.stroke) return false;
    const rows = this.rows.map((row) => row.join("")), saved = String(this.rows);
    let answer = {};
    const does = async (name) => (answer = await ask("save_draft", { rows, name, ...([name, `${name}.wif`].includes(this.file) ? { before: this.kept } : {}) }));
    if (!as) await does(this.file);
    else if (!(await confirm({ title: "Save the weave", text: "A draft (WIF) goes into the folder that the studio was started in.", yes: "Save", label: "Name of the file", value: this.file || "weave.wif", does }))) return false;
    if (!taken(answer)) return false;
    toast(`Saved as ${answer.file}`, leaving ? "It stands under Files." : "What can be made of it stands below.");
    Object.assign(this, { saved, file: answer.file, kept: answer.text });
    if (leaving) return true;
    $("from").textContent = "";
    const into = make("div", { className: "offer" }, make("button", { type: "button", id: "weave-into", className: "main", textContent: `Put it into ${this.scene}`, onclick: () => {
      handed.set(this.scene, { plugin: "wif", file: this.file });
      location.hash = `#scene=${encodeURIComponent(this.scene)}`;
    } }));
    $("saved").replaceChildren(...(this.scene ? [into] : []), card(answer.file, answer));
    this.show();
    return true;
  }

  close() {}
}

/** A canvas made as large as this [CSS pixels], and what draws on it. */
function sized(canvas, wide, high) {
  const pen = canvas.getContext("2d"), ratio = devicePixelRatio;
  Object.assign(canvas, { width: Math.round(wide * ratio), height: Math.round(high * ratio) });
  if (canvas.id === "weave-grid") Object.assign(canvas.style, { width: `${wide}px`, height: `${high}px` });
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  return pen;
}
