import { sentence } from "./dom.js";
import { wordsOf } from "./form.js";
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
  toast(sentence(answer.problem), reason(answer), true);
  return false;
}

/** Where and why, below what the problem is; or all of it, of one of several things. */
export function reason(answer, name = "") {
  const more = answer.words ? [placeOf(answer), ...answer.words.split("\n").slice(1)] : [answer.remedy];
  return [name && `${name}: ${answer.problem}`, ...(name ? more.slice(1) : more)].filter(Boolean).join("\n");
}

/** Gives what was asked last its answer. */
let settle = () => {};

/** Does what was agreed to while the box is open. */
let act = null;

/**
 * Ask a person; what they typed where `label` names something to type, and else whether they agreed: by `yes`, or by
 * `other`, which is returned. Where there is `does`, it is done with what was typed, and the box stays with the reason
 * until that has been taken.
 */
export function confirm({ title, text, yes = "", other = "", label = "", value = "", does = null }) {
  const box = $("asked"), input = $("asked-input");
  act = does;
  $("asked-said").replaceChildren();
  settle();  // the box was closed, and its event is still to come
  $("asked-title").textContent = title;
  $("asked-text").textContent = text;
  for (const [id, words] of [["asked-yes", yes], ["asked-other", other]]) Object.assign($(id), { textContent: words, hidden: !words });
  $("asked-label").hidden = !label;
  $("asked-label").querySelector("span").textContent = label;
  input.value = value;
  box.returnValue = "no";
  box.showModal();
  (label ? input : $("asked-no")).focus();
  return new Promise((done) => {
    settle = () => { settle = () => {}; done(box.returnValue === "other" ? other : box.returnValue === "yes" && (!label || input.value.trim())); };
  });
}

$("asked-yes").addEventListener("click", async (e) => {
  if (!act) return;
  e.preventDefault();
  $("asked-yes").disabled = true;
  const answer = await act($("asked-input").value.trim());
  $("asked-yes").disabled = false;
  if (answer.ok) $("asked").close("yes");
  else $("asked-said").replaceChildren(wordsOf({ words: answer.problem, ...answer }));
});
$("asked").addEventListener("close", () => { if (!$("asked").open) settle(); });
$("toast").querySelector("button").addEventListener("click", () => { $("toast").hidden = true; });
// Enter in the input means yes, not the first button of the form.
$("asked-input").addEventListener("keydown", (e) => { if (e.key === "Enter") { e.preventDefault(); $("asked-yes").click(); } });
