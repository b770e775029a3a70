import { ask } from "./ask.js";
import { make } from "./dom.js";

const SVG = "http://www.w3.org/2000/svg", GRAVITY = 9.81;
/** How far a strip hangs out over an edge in its picture [m]. */
const OVERHANG = 0.04;
/** What presets look like, asked for once; `known` once it has been answered, so that a form made anew has them at once. */
let asked = null, known = null;
const swatches = () => (asked ??= ask("swatches").then((answer) => (known = answer.ok ? answer : { dyes: {}, fabrics: {} })));

/**
 * Angle from the level to the tip of a strip that hangs out over an edge [rad], by Peirce's law of the cantilever test
 * (ASTM D1388): B / w = L^3 cos(a / 2) / (8 tan a), of a bending rigidity B [N m] and a weight w [N/m^2].
 */
export function droop(bend, density) {
  const wanted = (density * GRAVITY * OVERHANG ** 3) / (8 * bend);
  let low = 0, high = Math.PI / 2;
  for (let i = 0; i < 50; i++) { const a = (low + high) / 2; if (Math.tan(a) / Math.cos(a / 2) < wanted) low = a; else high = a; }
  return low;
}

function strip({ density, bend }) {
  const a = droop(1e-6 * bend, 1e-3 * density), x = 16 + 26 * Math.cos(a), y = 8 + 26 * Math.sin(a);
  const svg = document.createElementNS(SVG, "svg"), put = (name, props) => { const one = document.createElementNS(SVG, name); for (const [key, value] of Object.entries(props)) one.setAttribute(key, value); svg.append(one); };
  svg.setAttribute("viewBox", "0 0 46 38");
  svg.setAttribute("aria-hidden", "true");
  put("path", { d: "M1 10h15v27H1z", class: "edge" });
  // Level at the edge, and steepest at the tip: tangents meet above the middle of the chord.
  put("path", { d: `M1 8H16Q${16 + 13 / Math.max(0.5, Math.cos(a / 2))} 8 ${x.toFixed(1)} ${y.toFixed(1)}`, class: "cloth", "stroke-width": (1.4 + density / 250).toFixed(2) });
  return svg;
}

const bands = (colours) => make("span", { className: "bands" }, ...colours.map((colour) => { const band = make("i"); band.style.background = colour; return band; }));

/** Buttons for presets by what they look like; none for those that nobody has a look of. */
export function swatchesOf(id, names, now, label, chosen) {
  const box = make("div", { className: "swatches", role: "group", ariaLabel: label });
  const fill = ({ dyes, fabrics }) => {
    if (!names.every((name) => name in dyes || name in fabrics)) return;
    box.append(...names.map((name) => make("button", { type: "button", id: `swatch:${id}:${name}`, ariaPressed: String(name === now), title: name in fabrics ? `${Math.round(fabrics[name].density)} g/m², bending rigidity ${Number(fabrics[name].bend.toPrecision(2))} µN·m; so 4 cm of it hang down` : name, onclick: () => chosen(name) },
      name in fabrics ? strip(fabrics[name]) : bands(dyes[name]), make("span", { textContent: name }))));
  };
  if (known) fill(known);
  else swatches().then(fill);
  return box;
}
