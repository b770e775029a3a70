import { ask } from "./ask.js";
import { make, sentence } from "./dom.js";
import { wordsOf } from "./form.js";
import { rowsOf } from "./rows.js";
import { reason, taken, toast } from "./say.js";
import { bytes } from "./words.js";

/** What was dropped here since the page was opened, the newest first, by the names it has in the folder. */
const dropped = new Map();
/** Grows with all that a person does on the page. */
let touched = 0;
for (const kind of ["pointerdown", "keydown", "wheel"]) document.addEventListener(kind, () => { touched++; }, { capture: true, passive: true });
/** Pictures that were asked for: a browser would show an earlier one of the same address, though its file has changed. */
let looks = 0;
const $ = (id) => document.getElementById(id);
const TOLD = "A mesh (OBJ, PLY, STL, GLB), a motion (BVH), a draft (WIF), a stencil (PNG, JPG), a sewing pattern (JSON), a net (NPZ), a laboratory's sheet of a fabric (CSV, YAML), a scene (YAML) or a recording (MCAP).";

/** All files of the folder that something can be made of; those that were dropped are open. */
export async function files(view) {
  const answer = await ask("files");
  if (!taken(answer)) return;
  // What can be done with one has the others to choose from.
  await Promise.all([...dropped.keys()].map(async (file) => { const told = await ask("about", { file }); if (told.ok) dropped.set(file, told); }));
  const list = make("div", { id: "files" });
  view.replaceChildren(
    make("div", { className: "head" }, make("h1", { textContent: "Files" })),
    make("div", { className: "panel hint" }, make("p", { textContent: "Drop files anywhere on this page. They are copied into the folder, and nothing there is written over." }), make("p", { className: "soft", textContent: TOLD }),
      make("div", { className: "group" }, make("button", { type: "button", className: "main", textContent: "Choose files …", onclick: () => $("chosen").click() }),
        make("button", { type: "button", id: "draw-weave", textContent: "Draw a weave …", title: "A draft by mouse or keys", onclick: () => { location.hash = "#weave"; } }))), list);
  const others = answer.files.filter((name) => !dropped.has(name));
  list.append(...[...dropped.values()].reverse().map((told) => card(told.file, told)), ...others.map((name) => card(name)));
}

/** One file: its name, and once it is opened what it is and what can be done with it. */
export function card(name, told) {
  const inside = make("div", { className: "inside" }), title = make("span", { textContent: told ? told.title : "" });
  const box = make("details", { className: "section file", open: Boolean(told) }, make("summary", {}, make("b", { textContent: name }), title), inside);
  box.dataset.file = name;
  if (told) fill(inside, told);
  box.addEventListener("toggle", async () => {
    if (!box.open || inside.childElementCount) return;
    inside.replaceChildren(make("p", { className: "soft", textContent: "Looking at it …" }));
    const answer = await ask("about", { file: name });
    title.textContent = answer.ok ? answer.title : "cannot be read";
    if (answer.ok) fill(inside, answer);
    else inside.replaceChildren(answer.words ? wordsOf(answer) : sentence(answer.problem));
  });
  return box;
}

function fill(inside, told) {
  const about = make("div", {}, rowsOf(told.rows), ...told.mistakes.map(wordsOf), ...told.offers.map((one, i) => offer(told, one, i === 0)));
  if (told.kind === "scene") about.append(opener("Open this scene", `#scene=${encodeURIComponent(told.file)}`));
  if (told.kind === "draft" && location.hash === "#files") about.append(opener("Draw in it", `#weave=${encodeURIComponent(told.file)}`, ""));
  if (told.kind === "recording") about.append(opener("Open this recording", `#run=${encodeURIComponent(told.file)}`));
  const picture = told.pictured ? [make("img", { src: `shown?file=${encodeURIComponent(told.file)}&look=${looks++}`, alt: `${told.file}, drawn` })] : [];
  inside.replaceChildren(make("div", { className: picture.length ? "told pictured" : "told" }, ...picture, about));
}

const opener = (text, place, className = "main") => make("div", { className: "offer" }, make("button", { type: "button", className, textContent: text, onclick: () => { location.hash = place; } }));

/** A button that makes a scene, and beside it what is chosen for it. */
function offer(told, { name, text, choices }, first) {
  const id = (choice) => `choose:${told.file}:${name}:${choice}`;
  const selects = choices.map(({ name: choice, options }) => make("select", { id: id(choice), name: choice }, ...options.map(([value, words]) => make("option", { value, textContent: words }))));
  const button = make("button", { type: "submit", className: first ? "main" : "", textContent: text });
  const form = make("form", { className: "offer" }, button, ...choices.map(({ name: choice, label }, i) => make("label", { htmlFor: id(choice) }, make("span", { textContent: label }), selects[i])));
  form.dataset.offer = name;
  form.addEventListener("submit", async (e) => {
    e.preventDefault();
    button.disabled = true;
    const answer = await ask("make", { file: told.file, offer: name, chosen: Object.fromEntries(selects.map((one) => [one.name, one.value])) });
    button.disabled = false;
    if (!taken(answer)) return;
    toast(`Written: ${answer.scene}`, "Change it, or run it as it is.");
    location.hash = `#scene=${encodeURIComponent(answer.scene)}`;
  });
  return form;
}

/** Send files to the server, one after the other, and show what they are: at once where nobody does anything else by then. */
async function send(list) {
  const before = touched, added = [], refused = [];
  for (const [i, file] of list.entries()) {
    let answer = await ask("expect", { name: file.name, bytes: file.size });
    if (answer.ok) answer = await upload(file, list.length > 1 ? `${i + 1} of ${list.length}: ` : "");
    $("sending").hidden = true;
    if (!answer.ok) { refused.push([file.name, answer]); continue; }
    dropped.delete(answer.file);
    dropped.set(answer.file, answer);
    added.push(answer.file);
  }
  if (added.length && touched === before && !window.nuno.scene?.unsaved) {
    if (location.hash === "#files") await files($("view"));
    else { location.hash = "#files"; await new Promise((then) => window.addEventListener("hashchange", then, { once: true })); }
  } else {
    if (location.hash === "#files") for (const name of added) { document.querySelector(`[data-file="${CSS.escape(name)}"]`)?.remove(); $("files").prepend(card(name, dropped.get(name))); }
    if (added.length && !refused.length) toast(`Added: ${added.join(", ")}`, "What can be done with it stands under Files.");
  }
  if (added.length) window.nuno.scene?.maker?.list();
  if (refused.length) toast(refused.length === 1 ? sentence(refused[0][1].problem) : `${refused.length} files were not taken`, refused.map(([name, answer]) => reason(answer, name)).join("\n"), true);
}

/** Send one file; `which` of several it is. */
function upload(file, which) {
  return new Promise((done) => {
    const request = new XMLHttpRequest();
    const show = (text, share) => { $("sending").hidden = false; $("sending-name").textContent = which + text; if (share === null) $("sending-share").removeAttribute("value"); else $("sending-share").value = share; };
    request.open("POST", `file?name=${encodeURIComponent(file.name)}`);
    request.setRequestHeader("Content-Type", "application/octet-stream");
    request.responseType = "json";
    request.upload.addEventListener("progress", (e) => show(`${file.name}, ${bytes(file.size)}`, e.loaded / e.total));
    let timer = 0;
    const end = (answer) => { clearInterval(timer); done(answer); };
    request.upload.addEventListener("load", () => {
      const start = performance.now(), look = () => show(`Looking at ${file.name}, ${bytes(file.size)} … ${Math.round((performance.now() - start) / 1000)} s`, null);
      look();
      timer = setInterval(look, 1000);
    });
    request.addEventListener("load", () => end(request.response ?? { ok: false, problem: "nuno did not take the file" }));
    request.addEventListener("error", () => end({ ok: false, problem: "nuno does not answer", remedy: "Is it still running in its terminal?" }));
    show(file.name, 0);
    request.send(file);
  });
}

/** Files are taken wherever they are dropped on the page, and from the button for those who have no mouse. */
export function takeFiles() {
  const carries = (e) => e.dataTransfer?.types.includes("Files");
  let inside = 0;
  document.addEventListener("dragenter", (e) => { if (carries(e)) { inside++; $("drop").hidden = false; } });
  document.addEventListener("dragleave", (e) => { if (carries(e) && --inside <= 0) { inside = 0; $("drop").hidden = true; } });
  document.addEventListener("dragover", (e) => { if (carries(e)) { e.preventDefault(); e.dataTransfer.dropEffect = "copy"; } });
  document.addEventListener("drop", (e) => {
    if (!carries(e)) return;
    e.preventDefault();
    inside = 0;
    $("drop").hidden = true;
    send([...e.dataTransfer.files]);
  });
  $("add-file").addEventListener("click", () => $("chosen").click());
  $("chosen").addEventListener("change", async () => { const list = [...$("chosen").files]; $("chosen").value = ""; await send(list); });
}
