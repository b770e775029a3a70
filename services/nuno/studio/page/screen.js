import { make } from "./dom.js";
import { Orbit } from "./orbit.js";
import { colours, gradient, stretched } from "./scale.js";
import { Stage } from "./stage.js";

/** A text as a switch that a button is. */
export const press = (id, textContent, title, does) => make("button", { type: "button", id, textContent, title, onclick: does });

/** Buttons to look from a side. */
export const sides = (stage) => [["Front", 0], ["Side", Math.PI / 2], ["Back", Math.PI]].map(([text, azimuth]) => press(`from-${text.toLowerCase()}`, text, `From ${text === "Side" ? "the body's left" : `the ${text.toLowerCase()}`}`, () => stage().from(azimuth)));

/** Frames of a reel in 3-D, in the scene's own colours or by what is measured on each vertex. */
export class Screen {
  /** name: beside it, of one of several; camera: that several share. */
  constructor(reel, { name = "", camera, id = "film" } = {}) {
    Object.assign(this, { reel, by: "", most: 0, index: -1 });
    this.canvas = make("canvas", { id, className: "film", tabIndex: 0, ariaLabel: `The cloth${name && ` of ${name}`}. Drag or arrow keys turn it, with Shift they move it, the wheel or + and - come nearer.` });
    this.box = make("div", { className: "screen" }, this.canvas, ...(name ? [make("span", { className: "tag", textContent: name })] : []));
    this.stage = new Stage(this.canvas, camera ? { camera } : {});
    new Orbit(this.stage);
  }

  show(index) {
    const frame = this.reel.at(index);
    if (!frame) return;
    this.index = index;
    this.frame = frame;
    const { stage } = this, same = stage.shape === frame.shape, { far, uv, ...known } = frame;
    if (same) { delete known.faces; delete known.bodyFaces; delete known.edges; }
    if (same && frame.body === this.placed) delete known.body;
    this.placed = frame.body;
    stage.show(known);
    if (this.by || this.mapped || !same) this.paint();
    this.dress();
  }

  /** Print on the cloth what is printed or dyed there at this frame: the newest that is wanted, once one has come. */
  async dress() {
    const { uv, shape, dyed } = this.frame, key = dyed ? this.index : -1 - shape;
    if (!uv || this.dressed === key || this.dressing) return;
    Object.assign(this, { dressed: key, dressing: true });
    const image = make("img", { src: `dyed?film=${encodeURIComponent(this.reel.film)}&frame=${this.index}` }), good = await image.decode().then(() => true, () => false);
    this.dressing = false;
    if (this.stage.closed) return;
    if (good && this.frame.shape === shape) this.stage.wear(uv, image);
    this.dress();
  }

  /** Colour by "stretch", "far" or, with "", as the scene has it. */
  colour(by, most = this.most) { this.by = by; this.most = most; if (this.frame) this.paint(); }

  /** Colour by values of vertices from 0 to 1, NaN for none; null for the scene's own colours. */
  map(values) { this.mapped = values; if (this.frame) this.paint(); }

  paint() {
    const { frame } = this;
    let found = this.mapped ? colours(this.mapped) : undefined;
    if (this.by === "stretch") found = colours(stretched(frame));
    if (this.by === "far" && frame.far) found = colours(frame.far.map((value) => value / (this.most || 1)));
    this.stage.colour(found);
  }

  close() { this.stage.close(); }
}

/** Pictures of cloth that is dyed and does not move, one after the other: the newest that is wanted, once one has come. */
export class Picture {
  constructor(film) {
    Object.assign(this, { film, index: -1, wanted: -1, busy: false });
    this.image = make("img", { id: "dyed", alt: "The dyed cloth" });
    const then = (words) => () => { this.said.textContent = words; this.busy = false; this.load(); };
    Object.assign(this.image, { onload: then(""), onerror: then("This picture cannot be drawn.") });
    this.said = make("span", { className: "soft", textContent: "Drawing the cloth …" });
    this.box = make("div", { className: "screen dyed" }, this.said, this.image);
  }

  show(index) { this.wanted = index; if (!this.busy) this.load(); }

  load() {
    if (this.index === this.wanted) return;
    Object.assign(this, { busy: true, index: this.wanted });
    this.image.src = `dyed?film=${encodeURIComponent(this.film)}&frame=${this.index}`;
  }

  close() { this.wanted = this.index; }
}

/** A bar with the scale's colours between what its ends stand for, and below it numbers at their shares of it. */
export class Bar {
  constructor(id, low, high, ticks = []) {
    this.low = make("span", { textContent: low });
    this.high = make("span", { textContent: high });
    const bar = make("i", { className: ticks.length ? "ticked" : "" }, ...ticks.map(([at, textContent]) => make("b", { textContent, style: `left: ${100 * at}%` })));
    bar.style.background = gradient;
    this.box = make("div", { className: "scale", id, hidden: true }, this.low, bar, this.high);
  }
}
