import { make } from "./dom.js";
import { Entry } from "./entry.js";
import { dotted, shown } from "./schema.js";
import { placeOf } from "./words.js";

const SECTIONS = ["group", "choice", "preset"];

/** The form of a scene's text: built anew from what the text says, with the cursor where it was. */
export class Form {
  /** change({path, value | written | drop}) asks for a change of the text; look(path) is told which field is at hand. */
  constructor(box, schema, change, look) {
    Object.assign(this, { box, schema, change, look, prefix: "", whole: new Set(), folded: new Set(), data: {}, mistakes: [] });
    box.addEventListener("focusin", (e) => { const row = e.target.closest("[data-path]"); if (row) look(row.dataset.path); });
  }

  /** `keep`: the cursor's field goes on as it was typed, which says the same or is not in the text yet. */
  show(data, mistakes, keep = false) {
    if (data) this.data = data;
    this.mistakes = mistakes;
    this.box.classList.toggle("stale", !data);
    const held = this.hold(keep);
    const fields = this.fields(this.schema.root, this.data, []);
    this.box.replaceChildren(...fields);
    this.place();
    this.release(held);
  }

  hold(keep) {
    const at = document.activeElement;
    if (!this.box.contains(at) || !at.id) return null;
    // What is typed, or chosen by a slider, and not in the text yet is kept in any case; what only shows the text is not.
    const typed = at instanceof HTMLInputElement && at.sent !== undefined && (keep || at.value !== at.sent) ? { value: at.value, sent: at.sent, start: at.selectionStart, end: at.selectionEnd } : null;
    if (typed) clearTimeout(at.timer);
    return { id: at.id, typed, top: at.getBoundingClientRect().top };
  }

  release(held) {
    const at = held && document.getElementById(held.id);
    if (!at) return;
    at.focus({ preventScroll: true });
    if (held.typed && at instanceof HTMLInputElement) {
      Object.assign(at, { value: held.typed.value, sent: held.typed.sent });
      if (held.typed.start !== null) at.setSelectionRange(held.typed.start, held.typed.end);
      if (at.value !== at.sent) at.dispatchEvent(new Event("input"));
    }
    this.box.parentElement.scrollTop += at.getBoundingClientRect().top - held.top;
  }

  /** The fields of a mapping: those that are written or must be, and the others where they are asked for. */
  fields(node, value, path, hidden = []) {
    const known = Object.entries(node.properties).filter(([name]) => !hidden.includes(name) && !(name === "nuno" && !path.length));
    const required = node.required ?? [], key = dotted(path), all = this.whole.has(key);
    const needed = ([name]) => name in (value ?? {}) || required.includes(name);
    const rows = known.filter((one) => all || needed(one)).map(([name, one]) => this.field(name, one, value?.[name], [...path, name], required.includes(name)));
    // First, for what is missing below may be what was meant.
    rows.unshift(...Object.keys(value ?? {}).filter((name) => !(name in node.properties)).map((name) => this.unknown(name, value[name], [...path, name])));
    const rest = known.filter((one) => !needed(one)).length;
    if (rest) rows.push(make("button", {
      type: "button", id: `all:${key}`, className: "link all", ariaExpanded: String(all), textContent: all ? "Only what is written" : `${rest} more field${rest === 1 ? "" : "s"}`,
      onclick: () => { if (all) this.whole.delete(key); else this.whole.add(key); this.again(); },
    }));
    return rows;
  }

  again() { this.show(this.box.classList.contains("stale") ? null : this.data, this.mistakes); }

  field(name, node, value, path, required, label = name) {
    const found = this.schema.field(node), written = value !== undefined;
    const mapping = value !== null && typeof value === "object" && !Array.isArray(value);
    // What is written where a list or a mapping belongs stands there as it is, to be mended.
    const amiss = (found.kind === "list" && written && !Array.isArray(value)) || (found.kind === "group" && written && !mapping);
    const field = amiss ? { ...found, kind: "yaml" } : found;
    if (field.kind === "list") return this.list(label, field, value ?? [], path);
    const entry = new Entry(this, field, value, path, required, label);
    if (!SECTIONS.includes(field.kind) || (!mapping && field.kind !== "group")) return entry.row;
    if (!mapping && !written) return entry.row;
    return this.section(entry, field, value, path, label);
  }

  /** A mapping's own fields, below the row that says which mapping it is. */
  section(entry, field, value, path, label) {
    const branch = field.kind === "choice" ? this.schema.chosen(field, value) : this.schema.branch(field.branches, value);
    const key = dotted(path), inside = make("div", { className: "inside" }, entry.row);
    if (branch) inside.append(...this.fields(branch, value, path, field.kind === "choice" ? [field.key] : []));
    const box = this.fold(key, label, inside, shown(value?.name ?? value?.[field.key] ?? "")), reset = entry.apart && entry.reset();
    if (field.kind === "choice") box.dataset.path = key;
    if (reset) { reset.classList.add("remove"); box.firstElementChild.append(reset); }
    return box;
  }

  fold(key, label, inside, title = "") {
    const summary = make("summary", { id: `fold:${key}` }, make("b", { textContent: label }), make("span", { textContent: title }));
    const box = make("details", { open: !this.folded.has(key), className: "section" }, summary, inside);
    box.addEventListener("toggle", () => { if (box.open) this.folded.delete(key); else this.folded.add(key); });
    return box;
  }

  list(label, field, value, path) {
    const key = dotted(path), inside = make("div", { className: "inside" }), one = this.schema.field(field.items);
    const single = label.replace(/ies$/, "y").replace(/s$/, "");
    inside.dataset.path = key;
    inside.append(make("p", { className: "help", textContent: field.description }));
    value.forEach((item, i) => {
      const at = [...path, i], part = this.field(String(i), field.items, item, at, true, `${single} ${i + 1}`);
      inside.append(part);
      const remove = make("button", { type: "button", id: `remove:${dotted(at)}`, className: "remove", textContent: "Remove", ariaLabel: `Remove ${single} ${i + 1}`, onclick: () => this.change({ path: at, drop: true }) });
      (part.querySelector(":scope > summary") ?? part.querySelector(".control") ?? part).append(remove);
    });
    inside.append(this.adder(single, one, value, path));
    return this.fold(key, label, inside, value.length ? String(value.length) : "none");
  }

  /** What adds an item: a mapping of the chosen kind, or one with a name that no other has. */
  adder(single, one, value, path) {
    const at = [...path, value.length], id = `add:${dotted(path)}`;
    const names = one.kind === "choice" ? Object.keys(one.branches) : one.names;
    if (names.length) {
      const select = make("select", { id, ariaLabel: `Add ${single}` }, make("option", { value: "", textContent: `Add ${single} …` }), ...names.map((name) => make("option", { value: name, textContent: name })));
      select.addEventListener("change", () => { if (select.value) this.change({ path: at, value: one.kind === "choice" ? { [one.key]: select.value } : select.value }); });
      return select;
    }
    const taken = new Set(value.map((item) => item?.name));
    const fresh = () => { let n = 1; while (taken.has(`${single}-${n}`)) n++; return `${single}-${n}`; };
    return make("button", { type: "button", id, className: "add", textContent: `Add ${single}`, onclick: () => this.change({ path: at, value: "name" in one.branches[0].properties ? { name: fresh() } : {} }) });
  }

  unknown(name, value, path) {
    const row = make("div", { className: "field unknown" }, make("label", { textContent: name }), make("span", { className: "control" }, make("code", { textContent: shown(value) }),
      make("button", { type: "button", id: `drop:${dotted(path)}`, textContent: "Remove", ariaLabel: `Remove ${name}`, onclick: () => this.change({ path, drop: true }) })));
    row.dataset.path = dotted(path);
    return row;
  }

  /** Say at a field why what was typed there is not in the text; whether there is such a field. */
  refuse(path, answer) {
    const row = this.box.querySelector(`[data-path="${CSS.escape(dotted(path ?? []))}"]`);
    row?.querySelector(":scope > .refused")?.remove();
    const words = wordsOf({ words: answer.problem, ...answer });
    words.classList.add("refused");
    row?.append(words);
    row?.classList.add("wrong");
    return Boolean(row);
  }

  /** Bring a mistake into sight. */
  reveal(mistake) { this.box.querySelector(`#${CSS.escape(`mistake:${[...this.placed].indexOf(mistake)}`)}`)?.scrollIntoView({ block: "center" }); }

  /** Show each mistake at its field, or at the nearest one about it; `placed` are those that have one. */
  place() {
    this.placed = new Set();
    const rows = new Map([...this.box.querySelectorAll("[data-path]")].map((row) => [row.dataset.path, row]));
    for (const mistake of this.mistakes) {
      let path = mistake.field;
      while (path && !rows.has(path)) path = path.replace(/(^|\.)[^.[\]]*$|\[\d+\]$/, "");
      const row = path && rows.get(path);
      if (!row) continue;
      const words = wordsOf(mistake), control = row.querySelector("input, select");
      words.id = `${this.prefix}mistake:${this.placed.size}`;
      control?.setAttribute("aria-describedby", [words.id, control.getAttribute("aria-describedby")].filter(Boolean).join(" "));
      row.append(words);
      this.placed.add(mistake);
      row.classList.add("wrong");
      control?.setAttribute("aria-invalid", "true");
      for (let box = row.closest(".section"); box; box = box.parentElement.closest(".section")) box.open = true;
    }
  }
}

/** A mistake in the words of the command line: where, what is wrong, and lines of value, limit and remedy. */
export function wordsOf({ problem, line, words }) {
  const rest = words.split("\n").slice(1), where = placeOf({ problem, words });
  const box = make("div", { className: "mistake", role: "alert" }, make("p", { textContent: problem }));
  for (const text of rest) box.append(make("p", { className: "more", textContent: text.trim() }));
  if (where) box.append(make("p", { className: "place" }, line ? make("button", { type: "button", className: "link", textContent: where, title: "Go to this line of the text", onclick: () => box.dispatchEvent(new CustomEvent("line", { bubbles: true, detail: line })) }) : where));
  return box;
}
