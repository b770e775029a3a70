import { ask } from "./ask.js";
import { dock } from "./dock.js";
import { make, sentence } from "./dom.js";
import { wordsOf } from "./form.js";
import { draw } from "./plot.js";

/** As many as the server counts for each panel; pixels of a metre; room around a panel [m]. */
const EDGES = 1024, SCALE = 215, RIM = 0.012, MARK = [0.9, 0.1, 0.35, 1];

/** A box with the length of an edge, with which the scene of a recording is sewn and run again; and what shows there the edge of a panel. */
function sewing(recording) {
  const known = ask("edges", { recording }), length = make("input", { type: "number", id: "edge-length", step: "any", min: 0 }), partner = make("span", { className: "soft" }), said = make("div", { role: "status" });
  const again = make("button", { id: "sew-again", className: "main", textContent: "Sew again", title: "Run the scene anew, with this edge so long and what is sewn to it" });
  const form = make("form", { className: "sewing", hidden: true }, make("label", {}, "Length ", length, " cm"), again, partner), box = make("div", {}, form, said);
  let at = {}, was = "";
  const pick = async (panel, name, edge) => {
    const { panels, edges, why = "" } = await known, own = edges?.[panels[panel]], [cut, other] = own?.[`${name}[${edge}]`] ?? [];
    at = { panel, edge };
    was = length.value = cut ? (100 * cut).toFixed(2) : "";
    again.disabled = true;
    partner.textContent = other ? `sewn to ${other.replace("[", ", edge ").replace("]", "")}, ${(100 * own[other][0]).toFixed(2)} cm` : "sewn to no other edge";
    form.hidden = !cut;
    said.replaceChildren(cut ? "" : make("p", { className: "soft", textContent: sentence(why) }));
  };
  length.addEventListener("input", () => { again.disabled = length.value === was || !(length.valueAsNumber > 0); });
  form.addEventListener("submit", async (e) => {
    e.preventDefault();
    again.disabled = true;
    const answer = await ask("sew", { recording, ...at, length: length.valueAsNumber / 100 });
    again.disabled = false;
    said.replaceChildren(answer.ok ? make("p", { className: "soft", textContent: `Sewn again in ${answer.scene}${answer.eased.length ? `, where seams are eased: ${answer.eased.join("; ")}` : "; all seams fit as before"}.` }) : wordsOf({ words: answer.problem, ...answer }));
    if (!answer.ok) return;
    const hear = () => {
      if (dock.now.run === answer.run && dock.going) return;
      dock.hearers.delete(hear);
      if (dock.now.run === answer.run && dock.now.state === "over" && box.isConnected) location.hash = `#fit=${encodeURIComponent(answer.recording)}`;
    };
    dock.follow(answer);
    dock.hearers.add(hear);
  });
  return { box, pick };
}

/** The flat panels of the garments that a screen shows; an edge that is picked here is shown there, and may get another length. */
export function patternOf(screen, recording) {
  const { box: sewn, pick: sew } = sewing(recording), { flat, side, faces, panels = [] } = screen.frame;
  if (!panels.length) { sew(); return sewn; }
  const edges = new Map(), boxes = panels.map(() => draw("svg", { role: "group" })), points = panels.map(() => [[], []]);
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
      sew(Math.floor(number / EDGES), panels[Math.floor(number / EDGES)], number % EDGES);
    };
    path.addEventListener("click", pick);
    path.addEventListener("keydown", (e) => { if (e.key === "Enter") pick(); });
    box.append(path);
  }
  boxes.forEach((box, i) => {
    const [[x, w], [y, h]] = points[i].map((all) => { const low = all.reduce((a, b) => Math.min(a, b), Infinity); return [low - RIM, all.reduce((a, b) => Math.max(a, b), low) - low + 2 * RIM]; });
    for (const [key, value] of Object.entries({ viewBox: `${x} ${y} ${w} ${h}`, width: SCALE * w, height: SCALE * h, "aria-label": panels[i] })) box.setAttribute(key, value);
  });
  return make("div", {}, make("div", { className: "panels" }, ...boxes), said, sewn);
}
