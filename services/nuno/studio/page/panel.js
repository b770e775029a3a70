import { make, sentence } from "./dom.js";

export const mm = (metres) => String(Number((1000 * metres).toPrecision(3)));

/** The list of lines, and what was said of them beside the list and on the cloth. */
export class Panel {
  constructor(lines, stage, changed, takeBack) { Object.assign(this, { lines, stage, changed, takeBack, chosen: 0 }); }

  show() {
    const { lines } = this, open = lines.open.length;
    const part = (id) => document.getElementById(`draw-${id}`);
    part("list").replaceChildren(...lines.list.map((line, i) => this.row(line, i + 1)));
    part("none").hidden = lines.list.length > 0;
    part("count").textContent = lines.list.length ? `${lines.list.length}` : "";
    for (const [id, off] of [["undo", !lines.past.length], ["redo", !lines.future.length], ["clear", !open], ["save", !lines.list.length], ["export", !lines.list.length], ["hide", !lines.list.length]])
      part(id).disabled = off;
    part("hide").textContent = this.stage.veiled ? "Show all" : "Hide all";
    this.labels();
  }

  row(line, number) {
    const { lines } = this, applied = lines.applied.has(line.id), off = lines.hidden.has(line.id), error = lines.errors.get(line.id);
    const name = `${line.kind === "ridge" ? "Ridge" : "Valley"} ${number}`;
    const height = applied
      ? make("span", { textContent: `${mm(line.height)} mm` })
      : make("span", {}, make("input", {
        type: "number", min: "0.1", step: "any", value: mm(line.height), ariaLabel: `Height of ${name} in millimetres`,
        onchange: (e) => { if (e.target.value > 0) { lines.alter(line.id, { height: e.target.value / 1000 }); this.changed(); } else this.show(); },
      }), " mm");
    const head = make("div", { className: `line ${line.kind} ${off ? "off" : ""}` },
      make("i"), make("span", { className: "what", textContent: name }), height,
      make("button", { title: off ? "Show" : "Hide", ariaLabel: `${off ? "Show" : "Hide"} ${name}`, textContent: off ? "○" : "●",
        onclick: () => { if (off) lines.hidden.delete(line.id); else lines.hidden.add(line.id); this.changed(); } }),
      applied
        ? line.width
          ? make("button", { className: "link", title: "The cloth returns to its shape without it", ariaLabel: `Take back ${name}`, textContent: "take back", onclick: () => this.takeBack(line) })
          : make("span", { className: "applied", textContent: "applied" })
        : make("button", { title: "Remove", ariaLabel: `Remove ${name}`, textContent: "✕", onclick: () => { lines.remove(line.id); this.changed(); } }));
    const row = make("li", { className: line.id === this.chosen ? "chosen" : "" }, head);
    if (error) row.append(this.error(error));
    return row;
  }

  error({ problem, limit, value, remedy }) {
    const more = [value && `Found: ${value}.`, limit && `Allowed: ${limit}.`].filter(Boolean).join(" ");
    const box = make("p", { className: "error", role: "alert" }, sentence(problem));
    if (more) box.append(make("span", { textContent: more }));
    if (remedy) box.append(make("span", { textContent: sentence(remedy) }));
    return box;
  }

  /** What is wrong with lines, on the cloth beside where it is. */
  labels() {
    const { lines, stage } = this, box = document.getElementById("draw-labels");
    box.replaceChildren();
    for (const line of stage.veiled ? [] : lines.list) {
      const error = lines.errors.get(line.id);
      if (!error || lines.hidden.has(line.id)) continue;
      const { points } = lines.placesOf(line.id), at = Math.min(error.point ?? Math.floor(points.length / 2), points.length - 1);
      const seen = stage.camera.project(stage.cloth.at(points[at]));
      if (!seen) continue;
      const label = make("div", { textContent: sentence(error.problem) });
      if (error.remedy) label.append(make("span", { textContent: sentence(error.remedy) }));
      box.append(label);
      label.style.transform = `translate(${Math.round(seen.x - 22)}px, calc(${Math.round(Math.max(seen.y, 175) - 12)}px - 100%))`;
    }
  }
}
