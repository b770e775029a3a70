import { colourOf } from "./colour.js";
import { make } from "./dom.js";
import { dotted, shown } from "./schema.js";
import { slider } from "./slider.js";
import { swatchesOf } from "./swatches.js";

/** How long nothing is typed [ms] until what was typed goes into the text. */
const TYPED = 350;
/** Numbers alone, for which the unit beside the field stands. */
const BARE = /^[\s\d.,+\-eE[\]]*$/;
const OWN = "\u0000own";

/** One field: its name, what is written there, what it means, and what may be written. */
export class Entry {
  constructor(form, field, value, path, required, label) {
    Object.assign(this, { form, field, value, path, required, label, id: `${form.prefix}field:${dotted(path)}` });
    this.row = make("div", { className: value === undefined && !required ? "field unwritten" : "field" });
    this.row.dataset.path = dotted(this.mapping && field.kind === "choice" ? [...path, field.key] : path);
    const control = this.control(), parts = (this.apart ? [] : [control, this.unit(), this.reset()]).filter(Boolean);
    // A mapping's name stands above its fields; what is chosen here is its kind.
    const name = this.mapping && field.kind === "choice" ? field.key : label;
    if (parts.length) this.row.append(make("label", { htmlFor: this.id, textContent: name }), make("span", { className: "control" }, ...parts));
    if (control?.slide) control.after(control.slide);
    if (control?.swatches) this.row.append(control.swatches);
    if (!this.help) return;
    this.row.append(make("p", { className: "help", id: `help:${this.id}`, textContent: this.help }));
    if (parts.length) control?.setAttribute("aria-describedby", `help:${this.id}`);
  }

  /** Whether the value is a mapping, whose fields stand below. */
  get mapping() { return this.value !== null && typeof this.value === "object" && !Array.isArray(this.value); }

  /** Whether there is nothing to choose here: its fields stand below, and it is taken out where its name stands. */
  get apart() { return this.mapping && this.field.kind === "group"; }

  get help() {
    const { description, limits, kind } = this.field, simple = !["group", "choice"].includes(kind), given = this.field.default;
    const standard = simple && !this.required && given !== undefined && given !== null && given !== "" ? `default ${shown(given)}` : "";
    return [description, [standard, limits].filter(Boolean).join(", ")].filter(Boolean).join(" · ");
  }

  unit() {
    const { unit } = this.field;
    return unit && !this.mapping ? make("span", { className: "unit", textContent: unit, title: `a number is in ${unit}; or write another unit behind it`, hidden: !BARE.test(shown(this.value ?? this.field.default)) }) : null;
  }

  reset() {
    if (this.required || this.value === undefined) return null;
    return make("button", { type: "button", id: `${this.form.prefix}drop:${dotted(this.path)}`, className: "reset", textContent: "✕", title: "Take it out of the text", ariaLabel: `Take ${this.label} out of the text`,
      onclick: () => this.form.change({ path: this.path, drop: true }) });
  }

  control() {
    const { kind, names } = this.field;
    if (kind === "choice") return this.choice();
    if (kind === "preset") return this.preset();
    if (kind === "group") return this.value === undefined ? make("button", { type: "button", id: this.id, className: "add", textContent: "Add", onclick: () => this.put({}) }) : null;
    if (kind === "flag") return this.select(["true", "false"], this.value === undefined ? undefined : String(this.value), (name) => this.put(name === "true"));
    if (kind === "select") return this.select(names, this.value, (name) => this.put(name));
    return this.input();
  }

  /** A mapping that goes on from the preset that was chosen, where it can. */
  own() {
    const from = this.field.branches.find((one) => "preset" in one.properties);
    return from && typeof (this.value ?? this.field.default) === "string" ? { preset: this.value ?? this.field.default } : {};
  }

  /** A name of those that are known, by name or by what it looks like, or own values. */
  preset() {
    const { names } = this.field, now = this.mapping ? OWN : this.value;
    const select = this.select([...names, [OWN, "own values"]], now, (name) => this.put(name === OWN ? this.own() : name));
    if (!this.mapping) select.swatches = swatchesOf(this.id, names, now ?? this.field.default, `${this.label}, by what it looks like`, (name) => this.put(name));
    return select;
  }

  put(value) { this.form.change({ path: this.path, value }); }

  choice() {
    const { key, branches, names } = this.field, alone = names.filter((name) => !(name in branches));
    const now = this.mapping ? this.value[key] : this.value;
    return this.select([...Object.keys(branches), ...alone], now, (name) => {
      if (this.mapping && name in branches) this.form.change({ path: [...this.path, key], value: name });
      else this.put(names.includes(name) && (typeof this.value === "string" || !(name in branches)) ? name : { [key]: name });
    });
  }

  select(names, now, chosen) {
    const none = this.required ? "choose …" : `not given${typeof this.field.default === "string" || typeof this.field.default === "boolean" ? `: ${this.field.default}` : ""}`;
    const options = names.map((one) => (Array.isArray(one) ? one : [one, one]));
    const known = now === undefined || now === null || options.some(([value]) => value === now);
    const select = make("select", { id: this.id }, ...(now === undefined || now === null ? [make("option", { value: "", textContent: none })] : []),
      ...(known ? [] : [make("option", { value: String(now), textContent: String(now) })]), ...options.map(([value, text]) => make("option", { value, textContent: text })));
    select.value = now === undefined || now === null ? "" : String(now);
    select.addEventListener("change", () => { if (select.value) chosen(select.value); });
    return select;
  }

  input() {
    const { names, kind, plain } = this.field, before = shown(this.value);
    const input = make("input", { id: this.id, value: before, placeholder: shown(this.field.default), spellcheck: false, autocomplete: "off", sent: before });
    if (names.length && kind !== "yaml") {
      input.setAttribute("list", `names:${this.id}`);
      this.row.append(make("datalist", { id: `names:${this.id}` }, ...names.map((name) => make("option", { value: name }))));
    }
    const send = () => {
      clearTimeout(input.timer);
      if (input.slide) input.slide.sent = input.slide.value;
      if (input.value.trim() === "" || input.value === input.sent) return;
      input.sent = input.value;
      this.form.change({ path: this.path, ...(plain ? { value: input.value } : { written: input.value }) });
    };
    const later = () => { clearTimeout(input.timer); input.timer = setTimeout(send, TYPED); };
    input.slide = this.field.colour ? colourOf(input, this.label, later) : kind === "text" ? slider(this.field, input, this.label, later) : null;
    input.addEventListener("input", () => { const unit = input.parentElement.querySelector(".unit"); if (unit) unit.hidden = !BARE.test(input.value || input.placeholder); later(); });
    input.addEventListener("change", () => {
      if (input.value.trim() !== "") send();
      else if (this.value === undefined || this.required) {
        input.value = before;
        if (this.required) this.form.refuse(this.path, { problem: "a value is needed here" });
      }
      else this.form.change({ path: this.path, drop: true });
    });
    return input;
  }
}
