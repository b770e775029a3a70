import { ask } from "./ask.js";
import { make, sentence } from "./dom.js";
import { Camera } from "./math.js";
import { Player } from "./player.js";
import { Plot, figure } from "./plot.js";
import { Reel } from "./reel.js";
import { taken } from "./say.js";
import { Bar, press, Screen } from "./screen.js";

/** How often it is asked how far two runs are apart, while that is measured [ms]. */
const OFTEN = 300;
const mm = (metres) => (metres === null || metres === undefined ? null : 1000 * metres);
/** Of these plots, of both runs, no other line than this where there are several. */
const SOLE = { energy: "total", penetration: "largest" };

export const addressOf = (names) => `#compare=${names.map(encodeURIComponent).join(",")}`;

/** Two recordings side by side on one clock, seen by one camera: how far apart they are on the cloth, and over time. */
export class Compare {
  constructor(view, names) { Object.assign(this, { view, names, drawn: [], screens: [] }); }

  async open() {
    const { view, names } = this;
    const films = await Promise.all(names.map((recording) => ask("replay", { recording })));
    const heading = make("div", { className: "head" }, make("h1", { textContent: "Two runs" }), make("span", { className: "group" }, make("a", { href: "#runs", textContent: "All runs" })));
    this.said = make("div", { id: "film-said", role: "status" });
    view.replaceChildren(heading, make("p", { className: "soft" }, ...names.flatMap((name, i) => [i ? " and " : "", make("a", { href: `#run=${encodeURIComponent(name)}`, textContent: name })])), this.said);
    if (!films.every(taken)) return;
    this.films = films.map((one) => one.film);
    const answer = await this.ask();
    if (!answer) return;
    films.forEach(({ says }, i) => says.forEach((text) => this.say(`${"AB"[i]}: ${text}`)));
    this.tell(answer);
    try { this.see(answer); } catch (error) {
      this.say(`This browser cannot show the cloth: ${error.message}. A present Firefox, Chrome, Edge or Safari can.`);
      return;
    }
    await this.player.go(0);
    await this.plot(answer);
    this.measure(answer);
  }

  async ask() {
    const answer = await ask("compare", { first: this.films[0], second: this.films[1] });
    if (answer.ok) return answer;
    this.say(answer.words ?? answer.problem);
    return null;
  }

  say(text) { this.said.append(make("p", { className: "soft", textContent: sentence(text) })); }

  /** What of the two is compared, and how. */
  tell({ times, spans, exact, differs }) {
    const part = (text) => text || "not given";
    if (differs.length) this.said.append(make("p", { id: "differs" }, ...differs.flatMap(([field, a, b], i) => [i ? " · " : "", make("b", { textContent: field }), ` ${part(a)} in A, ${part(b)} in B`])));
    else this.say("A and B are runs of the same scene");
    const both = exact.filter(Boolean).length, end = times.at(-1);
    this.times = times;
    /** At which frames a distance has no error of an interpolation in it: at all, where both never have one. */
    this.plain = both > 1 ? exact : times.map(() => true);
    spans.forEach(([, last], i) => { if (last > end + 1e-9) this.say(`${"AB"[i]} goes on until ${figure(last)} s; both have frames until ${figure(end)} s`); });
    if (both < times.length) this.say(`At ${times.length - both} of ${times.length} frames only one of the two has a frame: the other's positions are interpolated linearly between its nearest two. ${both > 1 ? "The plot of distances has those of the other frames alone" : "Distances have the error of that in them"}`);
  }

  see({ times }) {
    const camera = new Camera(), both = this.films.map((film, i) => new Reel(film, times.length, this.films[1 - i]));
    this.screens = both.map((reel, i) => new Screen(reel, { name: `${"AB"[i]}  ${this.names[i]}`, camera, id: `film-${i}` }));
    this.player = new Player(times, both, (i) => this.show(i));
    this.player.onlost = (text) => this.say(text);
    this.bar = new Bar("far-scale", "0 mm", "");
    this.bar.box.hidden = false;
    this.now = make("output", { id: "far-said" });
    const tint = press("film-far", "Difference", "Colour both by how far each vertex is from the same one of the other", (e) => this.tint(e.currentTarget));
    tint.setAttribute("aria-pressed", "true");
    this.view.append(make("section", { className: "panel theater", ariaLabel: "Both" }, make("div", { className: "pair" }, ...this.screens.map((one) => one.box)),
      make("div", { className: "below" }, press("film-fit", "Whole", "The whole cloth", () => this.screens[0].stage.fit()), tint, this.bar.box, this.now), this.player.box));
    for (const screen of this.screens) screen.colour("far", 0);
  }

  tint(button) {
    const on = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(on));
    this.bar.box.hidden = !on;
    for (const screen of this.screens) screen.colour(on ? "far" : "");
  }

  show(i) {
    for (const screen of this.screens) screen.show(i);
    for (const plot of this.drawn) plot.point(this.times[i]);
    this.point();
  }

  /** How far apart the two are at the frame that is shown. */
  point() {
    const i = this.player.index, largest = mm(this.far?.largest[i]), rms = mm(this.far?.rms[i]), between = this.screens.some(({ frame }) => frame?.between);
    const other = this.screens.every(({ frame }) => frame) && !this.screens[0].frame.far;
    this.now.textContent = other ? "Here their triangles are not the same: positions cannot be compared vertex by vertex."
      : largest === null ? "" : `largest ${figure(largest)} mm, RMS ${figure(rms)} mm${between ? ", interpolated" : ""}`;
  }

  lines() {
    const plain = (values) => values.filter((_, i) => this.plain[i]), t = plain(this.times.slice(0, this.far.largest.length));
    return [["largest", this.far.largest], ["RMS", this.far.rms]].map(([name, values]) => ({ name, t, values: plain(values).map(mm) }));
  }

  async plot(answer) {
    this.far = answer;
    const sheets = await Promise.all(this.films.map((film) => ask("plots", { film })));
    if (this.closed) return;
    const box = make("div", { className: "plots", id: "plots" }), seek = (t) => this.player.seek(t);
    this.apart = new Plot({ title: "Distance of the same vertices", unit: "mm", lines: this.lines() }, seek);
    this.drawn.push(this.apart);
    for (const one of sheets.flatMap((sheet) => sheet.plots ?? []).filter((plot, i, all) => all.findIndex(({ name }) => name === plot.name) === i)) {
      const lines = sheets.flatMap((sheet, i) => Object.entries(sheet.plots?.find(({ name }) => name === one.name)?.lines ?? {})
        .filter(([name], _, all) => all.length === 1 || !SOLE[one.name] || name === SOLE[one.name])
        .map(([name, values], k) => ({ name: `${"AB"[i]}${name && ` ${name}`}`, t: sheet.t, values, dash: i === 1, colour: 2 * k + i })));
      this.drawn.push(new Plot({ title: one.title, unit: one.unit, lines }, seek));
    }
    box.append(...this.drawn.map((plot) => plot.box));
    this.view.append(box);
  }

  /** Take what is measured, until that is all. */
  async measure(answer) {
    for (let now = answer; now && !this.closed; now = await this.ask()) {
      this.far = now;
      const most = now.largest.reduce((a, b, i) => Math.max(a, this.plain[i] ? (b ?? 0) : 0), 0);
      this.bar.high.textContent = `${figure(mm(most))} mm`;
      this.apart.box.hidden = now.measured && now.largest.every((value) => value === null);
      this.apart.renew(this.lines());
      for (const screen of this.screens) screen.colour(screen.by, most);
      this.show(this.player.index);
      if (now.measured) { if (now.problem) this.say(now.problem); this.done = true; return; }
      await new Promise((later) => setTimeout(later, OFTEN));
    }
  }

  keys(e) { this.player?.keys(e); }

  close() {
    this.closed = true;
    this.player?.close();
    for (const one of [...this.screens, ...this.drawn]) one.close();
  }
}
