import { sentence } from "./dom.js";
import { placeOf } from "./words.js";

const $ = (id) => document.getElementById(id);

/** Say something in a box; what went wrong stays there until it is closed. */
export function toast(title, text = "", bad = false) {
  const box = $("toast");
  box.className = bad ? "bad" : "";
  box.querySelector("b").textContent = title;
  box.querySelector("p").textContent = text;
  box.hidden = false;
  clearTimeout(toast.timer);
  if (!bad) toast.timer = setTimeout(() => { box.hidden = true; }, 7000);
}

/** What went wrong in another place of the page stays there. */
export function quiet() { if ($("toast").className === "bad") $("toast").hidden = true; }

/** Say why the server refused something, in the words of the command line; whether it did not. */
export function taken(answer) {
  if (answer.ok) return true;
  const more = answer.words ? [placeOf(answer), ...answer.words.split("\n").slice(1)] : [answer.remedy];
  toast(sentence(answer.problem), more.filter(Boolean).join("\n"), true);
  return false;
}

/** Gives what was asked last its answer. */
let settle = () => {};

/** Ask a person; what they typed where `label` names something to type, and else whether they agreed. */
export function confirm({ title, text, yes, label = "", value = "" }) {
  const box = $("asked"), input = $("asked-input");
  settle();  // the box was closed, and its event is still to come
  $("asked-title").textContent = title;
  $("asked-text").textContent = text;
  $("asked-yes").textContent = yes;
  $("asked-label").hidden = !label;
  $("asked-label").querySelector("span").textContent = label;
  input.value = value;
  box.returnValue = "no";
  box.showModal();
  (label ? input : $("asked-no")).focus();
  return new Promise((done) => {
    settle = () => { settle = () => {}; done(box.returnValue === "yes" && (!label || input.value.trim())); };
  });
}

$("asked").addEventListener("close", () => { if (!$("asked").open) settle(); });
$("toast").querySelector("button").addEventListener("click", () => { $("toast").hidden = true; });
// Enter in the input means yes, not the first button of the form.
$("asked-input").addEventListener("keydown", (e) => { if (e.key === "Enter") { e.preventDefault(); $("asked-yes").click(); } });
