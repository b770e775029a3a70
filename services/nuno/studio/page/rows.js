import { make } from "./dom.js";

/** Headings and texts, as the command line prints them. */
export function rowsOf(rows) {
  const list = make("dl", { className: "rows" });
  for (const [name, text] of rows) {
    const warned = name === "WARNING" ? "warned" : "";
    list.append(make("dt", { textContent: name, className: warned }), make("dd", { textContent: text, className: warned }));
  }
  return list;
}
