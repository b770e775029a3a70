import { make } from "./dom.js";
import { draw } from "./plot.js";

/** As many as the server counts for each panel; pixels of a metre; room around a panel [m]. */
const EDGES = 1024, SCALE = 215, RIM = 0.012, MARK = [0.9, 0.1, 0.35, 1];

/** The flat panels of the garments that a screen shows; an edge that is picked here is shown there. */
export function patternOf(screen) {
  const { flat, side, faces, panels } = screen.frame, edges = new Map(), boxes = panels.map(() => draw("svg", { role: "group" })), points = panels.map(() => [[], []]);
  const said = make("p", { className: "soft", role: "status", textContent: "Pick an edge to see it on the garment." }), at = (v) => [...screen.stage.cloth.x.slice(3 * v, 3 * v + 3)];
  side.forEach((number, k) => {
    if (number !== number) return;
    const next = k % 3 === 2 ? k - 2 : k + 1, line = [k, next].map((c) => [flat[2 * c], -flat[2 * c + 1]]), edge = edges.get(number) ?? { d: "", pairs: [], cut: 0 };
    edges.set(number, edge);
    edge.d += `M${line[0]}L${line[1]}`;
    edge.pairs.push([faces[k], faces[next]]);
    edge.cut += Math.hypot(line[1][0] - line[0][0], line[1][1] - line[0][1]);
    for (const axis of [0, 1]) points[Math.floor(number / EDGES)][axis].push(line[0][axis], line[1][axis]);
  });
  for (const [number, { d, pairs, cut }] of edges) {
    const box = boxes[Math.floor(number / EDGES)], name = `${panels[Math.floor(number / EDGES)]}, edge ${number % EDGES}`, path = draw("path", { d, tabindex: 0, role: "button", "aria-label": name });
    const pick = () => {
      const worn = pairs.reduce((sum, [a, b]) => sum + Math.hypot(...at(a).map((p, i) => p - at(b)[i])), 0);
      for (const one of boxes) one.querySelector(".picked")?.classList.remove("picked");
      path.classList.add("picked");
      said.textContent = `${name}: cut ${(100 * cut).toFixed(1)} cm, worn ${(100 * worn).toFixed(1)} cm`;
      screen.stage.painter.setLines(pairs.flatMap(([a, b]) => [...at(a), ...at(b), ...MARK]), []);
      screen.stage.dirty();
    };
    path.addEventListener("click", pick);
    path.addEventListener("keydown", (e) => { if (e.key === "Enter") pick(); });
    box.append(path);
  }
  boxes.forEach((box, i) => {
    const [[x, w], [y, h]] = points[i].map((all) => { const low = all.reduce((a, b) => Math.min(a, b), Infinity); return [low - RIM, all.reduce((a, b) => Math.max(a, b), low) - low + 2 * RIM]; });
    for (const [key, value] of Object.entries({ viewBox: `${x} ${y} ${w} ${h}`, width: SCALE * w, height: SCALE * h, "aria-label": panels[i] })) box.setAttribute(key, value);
  });
  return make("div", {}, make("div", { className: "panels" }, ...boxes), said);
}
