import { make } from "./dom.js";

/** The browser's own choice of a colour beside one that is written; a name of CSS is shown as the colour that it is. */
export function colourOf(input, label, changed) {
  const canvas = document.createElement("canvas").getContext("2d");
  const hex = () => { canvas.fillStyle = "#808080"; canvas.fillStyle = input.value || input.placeholder || "#808080"; return canvas.fillStyle; };
  const box = make("input", { type: "color", className: "colour", value: hex(), sent: hex(), ariaLabel: `${label}, chosen`, id: `choose:${input.id}` });
  box.addEventListener("input", () => { input.value = box.value; changed(); });
  input.addEventListener("input", () => { box.value = box.sent = hex(); });
  return box;
}
