import { make } from "./dom.js";

const HEIGHT = 132, LEFT = 52, RIGHT = 10, TOP = 8, BOTTOM = 34;
const SVG = "http://www.w3.org/2000/svg";

export const draw = (tag, props, ...children) => {
  const node = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(props)) node.setAttribute(name, value);
  node.append(...children);
  return node;
};

/** Numbers between two that a person reads easily, about as many as are wanted. */
export function ticks(low, high, wanted) {
  const raw = (high - low) / wanted, power = 10 ** Math.floor(Math.log10(raw)), step = [1, 2, 5, 10].map((s) => s * power).find((s) => s >= raw * 0.7);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return found;
}

export const figure = (value) => (value === null || value === undefined || Number.isNaN(value) ? "–" : value === 0 ? "0" : Math.abs(value) >= 1e5 || Math.abs(value) < 1e-3 ? value.toExponential(2) : String(Number(value.toPrecision(4))));

/** Lines over time with axes and units, and a cursor at the time that is shown. */
export class Plot {
  /** lines: [{ name, t, values, dash }], values null where there is none; seek(t) is called where a person points. */
  constructor({ title, unit, lines }, seek) {
    Object.assign(this, { unit, lines, seek, t: null });
    this.svg = draw("svg", { role: "img", "aria-label": `${title}, over time` });
    this.legend = make("figcaption", {}, make("b", { textContent: title }), make("span", { className: "soft", textContent: ` [${unit}]` }));
    this.values = lines.map((line, i) => {
      const value = make("output", {}), key = draw("svg", { width: 18, height: 8, "aria-hidden": "true" }, draw("path", { d: "M0 4H18", class: this.class(i) }));
      this.legend.append(make("span", { className: "key" }, key, line.name ? ` ${line.name} ` : " ", value));
      return value;
    });
    this.box = make("figure", { className: "plot" }, this.legend, this.svg);
    this.sizes = new ResizeObserver(() => this.paint());
    this.sizes.observe(this.box);
    const point = (e) => { if (e.buttons & 1) this.seek(this.time(e.clientX - this.svg.getBoundingClientRect().left)); };
    this.svg.addEventListener("pointerdown", (e) => { this.svg.setPointerCapture(e.pointerId); point(e); });
    this.svg.addEventListener("pointermove", point);
  }

  class(i) { const { colour = i, dash } = this.lines[i]; return `line line${colour % 6}${dash ? " dash" : ""}`; }

  time(px) { return this.t0 + ((px - LEFT) / (this.width - LEFT - RIGHT)) * (this.t1 - this.t0); }

  /** Take other values of the lines. */
  renew(lines) { lines.forEach((line, i) => Object.assign(this.lines[i], line)); this.paint(); }

  paint() {
    this.width = this.box.clientWidth;
    if (this.width < LEFT + RIGHT + 20) return;
    const all = this.lines.flatMap(({ values }) => values.filter((v) => v !== null)), times = this.lines.flatMap(({ t }) => [t[0], t.at(-1)]).filter((t) => t !== undefined);
    if (!all.length || !times.length) return;
    let low = all.reduce((a, b) => Math.min(a, b)), high = all.reduce((a, b) => Math.max(a, b));
    if (low > 0 && low < 0.5 * high) low = 0;
    if (high === low) { const pad = Math.abs(high) * 0.1 || 1; high += pad; low -= pad; }
    Object.assign(this, { t0: Math.min(...times), t1: Math.max(...times) });
    if (this.t1 === this.t0) this.t1 += 1;
    const w = this.width - LEFT - RIGHT, h = HEIGHT - TOP - BOTTOM;
    this.x = (t) => LEFT + (w * (t - this.t0)) / (this.t1 - this.t0);
    this.y = (v) => TOP + h * (1 - (v - low) / (high - low));
    const label = (x, y, text, anchor) => draw("text", { x, y, "text-anchor": anchor }, text);
    const grid = ticks(low, high, 4).flatMap((v) => [draw("path", { class: "grid", d: `M${LEFT} ${this.y(v)}H${LEFT + w}` }), label(LEFT - 6, this.y(v) + 4, figure(v), "end")]);
    const below = ticks(this.t0, this.t1, Math.max(2, Math.min(8, w / 70))).map((t) => label(this.x(t), TOP + h + 15, figure(t), "middle"));
    this.cursor = draw("path", { class: "cursor" });
    this.svg.setAttribute("viewBox", `0 0 ${this.width} ${HEIGHT}`);
    this.svg.setAttribute("height", HEIGHT);
    this.svg.replaceChildren(...grid, draw("path", { class: "axis", d: `M${LEFT} ${TOP}V${TOP + h}H${LEFT + w}` }), ...below, label(LEFT + w, HEIGHT - 4, "t [s]", "end"),
      ...this.lines.map((line, i) => draw("path", { class: this.class(i), d: this.path(line, w) })), this.cursor);
    this.point(this.t);
  }

  /** A line through the values; of more of them than pixels, the lowest and the highest of each pixel. */
  path({ t, values }, w) {
    const every = Math.max(1, Math.ceil(values.length / w)), parts = [];
    let on = false;
    const go = (i) => {
      if (values[i] === null) { on = false; return; }
      parts.push(`${on ? "L" : "M"}${this.x(t[i]).toFixed(1)} ${this.y(values[i]).toFixed(1)}`);
      on = true;
    };
    for (let i = 0; i < values.length; i += every) {
      if (every === 1) { go(i); continue; }
      const known = [...Array(Math.min(every, values.length - i)).keys()].map((k) => i + k).filter((k) => values[k] !== null);
      if (!known.length) { on = false; continue; }
      const least = known.reduce((a, b) => (values[b] < values[a] ? b : a)), most = known.reduce((a, b) => (values[b] > values[a] ? b : a));
      for (const k of least < most ? [least, most] : [most, least]) go(k);
    }
    return parts.join("");
  }

  /** Where the time is that is shown [s], and the values of its frame. */
  point(t) {
    this.t = t;
    if (t === null) return;
    this.lines.forEach((line, i) => {
      const at = line.t.findLastIndex((one) => one <= t + 1e-9);
      this.values[i].textContent = figure(line.values[at]);
    });
    this.cursor?.setAttribute("d", t <= this.t1 && t >= this.t0 ? `M${this.x(t)} ${TOP}V${HEIGHT - BOTTOM}` : "");
  }

  close() { this.sizes.disconnect(); }
}
