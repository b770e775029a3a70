/** Keys that are pressed sooner after each other [ms] are undone together. */
const APART = 700;

/** The scene's text, with numbers of its lines, those with mistakes marked; and what it was before, to be undone. */
export class Text {
  /** changed() is called when a person has changed it. */
  constructor(box, changed) {
    Object.assign(this, { box, area: box.querySelector("textarea"), gutter: box.querySelector(".gutter"), changed, past: [], future: [], at: 0, wrong: new Set(), here: 0 });
    this.area.addEventListener("input", () => this.typed());
    this.area.addEventListener("scroll", () => { this.gutter.scrollTop = this.area.scrollTop; });
  }

  get value() { return this.area.value; }

  /** A text that was opened: nothing to be undone. */
  open(text) { Object.assign(this, { past: [], future: [], last: text }); this.area.value = text; this.number(); }

  typed() {
    const now = performance.now();
    if (now - this.at > APART) this.past.push(this.last);
    Object.assign(this, { at: now, future: [], last: this.value });
    this.number();
    this.changed();
  }

  /** A change by the form. */
  set(text) {
    if (text === this.value) return;
    this.past.push(this.last);
    Object.assign(this, { at: 0, future: [] });
    this.put(text);
  }

  put(text) {
    const { selectionStart, scrollTop } = this.area;
    this.area.value = this.last = text;
    this.area.setSelectionRange(selectionStart, selectionStart);
    this.area.scrollTop = scrollTop;
    this.number();
  }

  undo() { this.move(this.past, this.future); }
  redo() { this.move(this.future, this.past); }

  move(from, to) {
    if (!from.length) return;
    to.push(this.value);
    this.at = 0;
    this.put(from.pop());
    this.changed();
  }

  mark(lines) { this.wrong = new Set(lines); this.number(); }

  /** The line of the field that is at hand. */
  point(line) { this.here = line ?? 0; this.number(); }

  number() {
    const rows = this.value.split("\n").length;
    this.gutter.replaceChildren(...Array.from({ length: rows }, (_, i) => {
      const row = document.createElement("span");
      row.textContent = String(i + 1);
      row.className = [this.wrong.has(i + 1) && "wrong", this.here === i + 1 && "here"].filter(Boolean).join(" ");
      return row;
    }));
    this.gutter.scrollTop = this.area.scrollTop;
  }

  /** Put the cursor on a line. */
  go(line) {
    const rows = this.value.split("\n"), start = rows.slice(0, line - 1).reduce((sum, row) => sum + row.length + 1, 0);
    this.area.focus();
    this.area.setSelectionRange(start, start + (rows[line - 1] ?? "").length);
    const height = parseFloat(getComputedStyle(this.area).lineHeight);
    this.area.scrollTop = Math.max(0, (line - 4) * height);
  }
}
