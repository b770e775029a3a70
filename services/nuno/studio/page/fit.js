import { ask } from "./ask.js";
import { make, sentence } from "./dom.js";
import { patternOf } from "./pattern.js";
import { figure, ticks } from "./plot.js";
import { rowsOf } from "./rows.js";
import { Bar } from "./screen.js";

const MAPS = { stretch: ["Stretch", "stretch, the larger of warp and weft", "%"], pressure: ["Pressure", "pressure on the body", "Pa"], "": ["Neither", "", ""] };
/** Share of the vertices beyond which a map's colours end: single corners of seams have far more. */
const ENDS = 0.01;

const table = ([heads, ...rows]) => {
  const cells = (tag, texts) => make("tr", {}, ...texts.map((textContent, k) => make(tag, { textContent, className: /cm|%|N\/m/.test(heads[k]) ? "number" : "" })));
  return make("table", {}, make("thead", {}, cells("th", heads)), make("tbody", {}, ...rows.map((row) => cells("td", row))));
};

/** How the garments of a recording fit at its last frame, in which they are worn: the tables of nuno fit, and maps on the cloth. */
export class Fit {
  constructor(recording, screen) {
    Object.assign(this, { recording, screen, by: "stretch" });
    this.box = make("aside", { className: "fit", ariaLabel: "Fit", id: "fit" }, make("p", { className: "soft", textContent: "Measuring the garment on the body, at the last frame. This takes seconds to a minute: the frame is simulated again for its forces." }));
    this.here = make("output", { className: "below-mouse", hidden: true });
    this.maps = make("div", { className: "tools maps", hidden: true }, ...Object.entries(MAPS).map(([by, [textContent]]) => make("button", { type: "button", id: `map-${by}`, textContent, onclick: () => this.colour(by) })));
    screen.box.append(this.maps, this.here);
    screen.canvas.addEventListener("pointermove", (e) => this.point(e));
    screen.canvas.addEventListener("pointerleave", () => { this.here.hidden = true; });
  }

  async open(body) {
    const answer = await ask("fit", { recording: this.recording, body });
    if (answer.ok) this.show(answer);
    else this.box.replaceChildren(make("p", { textContent: sentence(answer.problem) }), ...(answer.field === "--body" && answer.limit ? answer.limit.split(", ").map((name) => make("button", { type: "button", textContent: name, onclick: () => this.open(name) })) : [make("p", { className: "soft", textContent: sentence(answer.remedy ?? "") })]));
  }

  show({ garments }) {
    this.box.replaceChildren(...garments.flatMap(({ name, on, verdict, tables, remarks }) => [make("h2", { textContent: name }), make("p", { className: on ? "good" : "bad", textContent: sentence(verdict) }), ...tables.map(table), rowsOf(remarks)]));
    this.box.querySelector("table").after(patternOf(this.screen, this.recording));
    this.values = Object.fromEntries(["stretch", "pressure"].map((by) => {
      const all = new Float32Array(this.screen.frame.x.length / 3).fill(NaN);
      for (const one of garments) all.set(one[by].map((value) => value ?? NaN), one.start);
      return [by, all];
    }));
    this.maps.hidden = false;
    this.screen.stage.fit();
    this.colour(this.by);
  }

  colour(by) {
    this.by = by;
    for (const button of this.maps.children) button.setAttribute("aria-pressed", String(button.id === `map-${by}`));
    this.bar?.box.remove();
    if (!by) { this.screen.map(null); return; }
    const sorted = this.values[by].filter((value) => value === value).sort(), at = (share) => sorted[Math.round(share * (sorted.length - 1))] ?? 0;
    const low = Math.min(0, at(ENDS)), high = Math.max(at(1 - ENDS), low + 1e-9), [, title, unit] = MAPS[by];
    this.screen.map(this.values[by].map((value) => (value - low) / (high - low)));
    this.bar = new Bar("map-scale", `${title} [${unit}]`, "", ticks(low, high, 5).map((value) => [(value - low) / (high - low), figure(value)]));
    this.bar.box.hidden = false;
    this.screen.box.append(this.bar.box);
  }

  /** Tell the value below the mouse. */
  point(e) {
    const { stage } = this.screen, hit = this.by && this.values && !e.buttons && stage.pick(e.offsetX, e.offsetY), value = hit ? stage.cloth.mean(hit, this.values[this.by]) : NaN;
    this.here.hidden = !(value === value);
    if (this.here.hidden) return;
    this.here.textContent = `${Number(value.toPrecision(3))} ${MAPS[this.by][2]}`;
    this.here.style.translate = `${e.offsetX + 14}px ${e.offsetY + 8}px`;
  }
}
