import { ask } from "./ask.js";
import { make } from "./dom.js";
import { taken } from "./say.js";

/** Headings of nuno's own scenes, by their folders. */
const FOLDERS = { "": "Cloth on bodies and alone", contact: "Cloth that meets cloth", dye: "Dye", extreme: "Extreme scenes, as tests", instruments: "Instruments of a laboratory", knit: "Knits and stockings", sewn: "Sewn from patterns" };
export const pictureOf = (recording) => `picture?recording=${encodeURIComponent(recording)}`;

const card = ({ name, description, picture, drawn }) => {
  const link = make("a", { href: `#scene=${encodeURIComponent(name)}` });
  const [src, title] = picture ? [pictureOf(picture), `The last frame of ${picture}`] : [drawn ? `drawn?name=${encodeURIComponent(name)}` : "icon.svg", ""];
  link.append(make("img", { src, title, alt: "", loading: "lazy", className: picture || drawn ? "" : "blank" }));
  link.append(make("div", {}, make("b", { textContent: name }), make("p", { textContent: description })));
  const item = make("li", {}, link);
  item.dataset.words = `${name} ${description}`.toLowerCase();
  return item;
};

/** All scenes that can be opened. */
export async function gallery(view) {
  const answer = await ask("scenes");
  if (!taken(answer)) return;
  document.getElementById("folder").textContent = answer.folder;
  const search = make("input", { type: "search", id: "search", placeholder: "Find a scene", ariaLabel: "Find a scene" });
  view.replaceChildren(make("div", { className: "head" }, make("h1", { textContent: "Scenes" }), search));
  const own = answer.scenes.filter((one) => one.own), shipped = answer.scenes.filter((one) => !one.own);
  const folders = new Map();
  for (const one of shipped) {
    const folder = one.name.includes("/") ? one.name.split("/")[0] : "";
    folders.set(folder, [...(folders.get(folder) ?? []), one]);
  }
  const sections = [["In this folder", own], ...[...folders].map(([folder, list]) => [FOLDERS[folder] ?? folder, list])];
  for (const [title, list] of sections) {
    if (list.length) view.append(make("section", { ariaLabel: title }, make("h2", { textContent: title }, make("span", { className: "soft", textContent: String(list.length) })), make("ul", { className: "cards" }, ...list.map(card))));
  }
  const nothing = make("p", { className: "none", textContent: "No scene has these words.", hidden: true });
  view.append(nothing);
  search.addEventListener("input", () => {
    const words = search.value.toLowerCase().split(/\s+/);
    for (const item of view.querySelectorAll("li")) item.hidden = !words.every((word) => item.dataset.words.includes(word));
    for (const section of view.querySelectorAll("section")) {
      const found = section.querySelectorAll("li:not([hidden])").length;
      section.hidden = !found;
      section.querySelector("h2 span").textContent = String(found);
    }
    nothing.hidden = Boolean(view.querySelector("li:not([hidden])"));
  });
}
