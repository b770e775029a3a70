import { ask } from "./ask.js";
import { sentence } from "./dom.js";
import { Drawing } from "./drawing.js";
import { Hand } from "./hand.js";
import { Lines } from "./lines.js";
import { follow } from "./link.js";
import { Panel, mm } from "./panel.js";

const $ = (id) => document.getElementById(id);
const SAID = {
  start: "at the start", preparing: "getting ready", running: "running", paused: "paused", done: "ended", stopped: "stopped",
  lost: "no longer there", diverged: "diverged", unconverged: "not at rest", failed: "failed",
};
const ENDED = ["done", "stopped", "lost", "diverged", "unconverged", "failed"];
const lines = new Lines();
let stage, panel, about = { canStart: false, name: "" }, now = { state: "start" }, kind = "ridge", height = 0.01, span = 0.1, goOn = false;

function changed() { panel.show(); buttons(); hint(); stage.dirty(); }

/** Lines were drawn or altered: what is wrong with them is said now, not only once they are applied. */
function edited() {
  changed();
  clearTimeout(edited.timer);
  edited.timer = setTimeout(check, 150);
}

async function check() {
  const list = lines.open, version = lines.list;
  if (now.state !== "start" || !list.length) return;
  const answer = await ask("check", { shape: stage.shape, lines: sent(list, "points"), settings: settings() });
  if (lines.list !== version || now.state !== "start") return;
  for (const line of list) lines.errors.delete(line.id);
  if (answer.ok) changed();
  else refused(answer, list);
}

function buttons() {
  const open = lines.open.length, some = open === 1 ? "1 line" : `${open} lines`, { state } = now, over = ENDED.includes(state);
  document.body.dataset.state = state;
  $("state").textContent = SAID[state] ?? state;
  $("time").textContent = now.run && now.frames ? `${now.t.toFixed(2)} s · frame ${now.frame} of ${now.frames}` : "";
  $("play").textContent = state === "start" ? "Simulate" : state === "running" ? "Pause" : over ? "Simulate" : "Resume";
  $("play").disabled = state === "preparing" || (over || state === "start" ? !about.canStart : false);
  $("step").disabled = state !== "paused";
  $("back").hidden = !about.canStart;
  $("back").disabled = state === "start";
  $("apply").disabled = !open || state === "preparing" || over || (state === "start" && !about.canStart);
  $("apply").textContent = state === "start" ? (open ? `Simulate with ${some}` : "Simulate with lines") : open ? `Apply ${some} to cloth` : "Apply to cloth";
}

function hint() {
  const { state } = now;
  $("hint").textContent = state === "preparing" ? "Getting the simulation ready. The first time, this takes a minute or two."
    : lines.list.length ? "" : "Drag on the cloth to draw a line";
}

function toast(title, text = "", bad = false) {
  const box = $("toast");
  box.className = bad ? "card bad" : "card";
  box.querySelector("b").textContent = title;
  box.querySelector("p").textContent = text;
  box.hidden = false;
  clearTimeout(toast.timer);
  if (!bad) toast.timer = setTimeout(() => { box.hidden = true; }, 7000);
}

/** Show a refusal beside the line that it is about, or else in a box. */
function refused(answer, sent = []) {
  const which = /lines\[(\d+)\]/.exec(answer.field || ""), line = which && sent[Number(which[1])];
  if (!line) {
    toast(sentence(answer.problem), [answer.limit && `Allowed: ${answer.limit}.`, answer.remedy && sentence(answer.remedy)].filter(Boolean).join("\n"), true);
    return;
  }
  const point = /(\d+)/.exec(answer.value?.startsWith("between") ? answer.value : "");
  const place = /^(between|triangle)/.test(answer.value ?? "");  // it is shown by where the words stand
  lines.errors.set(line.id, { ...answer, ...(place ? { value: null, limit: null } : {}), point: point ? Number(point[1]) : undefined });
  lines.hidden.delete(line.id);
  changed();
}

const sent = (list, of) => list.map((line) => ({ points: lines.placesOf(line.id)[of], height: line.kind === "ridge" ? line.height : -line.height, closed: line.closed }));

const settings = () => ({ passes: Number($("passes").value), hierarchical: $("sharp").checked, keep: $("keep").checked });

async function apply(again = true) {
  const list = lines.open;
  if (!list.length) return true;
  for (const line of list) lines.errors.delete(line.id);
  const answer = await ask("apply", { shape: stage.shape, lines: sent(list, "points"), settings: settings() });
  if (!answer.ok && answer.field === "shape" && again) {
    await new Promise((later) => setTimeout(later, 200));
    return apply(false);
  }
  const taken = (answer.applied ?? []).map((i) => list[i].id);
  if (taken.length) lines.settle(taken);
  if (answer.ok) toast(taken.length === 1 ? "The line is in the cloth" : `${taken.length} lines are in the cloth`);
  else refused(answer, list);
  changed();
  return answer.ok;
}

async function order(action) {
  const answer = await ask(action);
  if (!answer.ok) refused(answer);
  return answer.ok;
}

async function play() {
  if (now.state === "running") return order("pause");
  if (now.state === "paused") return order("resume");
  if (ENDED.includes(now.state) && !(await order("back"))) return false;
  goOn = await order("start");
  return goOn;
}

async function applyOrStart() {
  $("apply").disabled = true;
  if (now.state === "start") await play();
  else await apply();
  buttons();
}

/** A run that was started here waits before its first frame, for the lines that are to act from there on. */
async function ready() {
  goOn = false;
  if (await apply()) await order("resume");
}

async function keep(action) {
  const answer = await ask(action, { shape: stage.shape, lines: sent(lines.list, action === "save" ? "base" : "points"), settings: settings() });
  if (!answer.ok) { refused(answer, lines.list); return; }
  if (action === "save") { toast(`Saved to ${answer.file}`, answer.text); return; }
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(new Blob([answer.text])), download: answer.name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  toast(`Exported ${answer.name}`, "It lies among your browser's downloads.");
}

function choose(which) {
  kind = which;
  for (const one of ["ridge", "valley"]) $(one).setAttribute("aria-checked", String(one === which));
}

function setHeight(metres) {
  height = metres;
  $("height").value = mm(metres);
  $("slider").value = Math.sqrt(Math.min(1, metres / span));
}

function drawn(pieces) {
  if (!pieces.length) { toast("That was too short for a line", "Keep the button down and drag over the cloth."); return; }
  for (const { points, closed } of pieces) panel.chosen = lines.add(kind, height, points, stage.basePlaces(points), closed);
  if (pieces.length > 1) toast(`The line left the cloth: it is ${pieces.length} lines now`, "Undo takes them back, one after the other.");
  edited();
}

function show(frame) {
  const before = now.state;
  now = { ...frame, x: null, body: null };
  const { first } = stage.show(frame);
  if (first) {
    span = Number((stage.camera.size * 0.12).toPrecision(1));
    setHeight(Number((stage.camera.size * 0.025).toPrecision(1)));
  }
  if (frame.message && frame.state === "start" && before === "preparing") { goOn = false; toast("The simulation did not start", frame.message, true); }
  if (before !== frame.state && ENDED.includes(frame.state))
    toast(frame.state === "done" ? "The run is over" : `The run: ${SAID[frame.state]}`, about.canStart ? "Back to start keeps your lines, to be changed and tried again." : frame.message);
  if (goOn && frame.state === "paused" && before !== "paused") ready();
  if (before !== frame.state || frame.faces) changed();
  buttons();
}

function keys(e) {
  if (e.target.tagName === "INPUT" && e.target.type === "number") return;
  const control = e.ctrlKey || e.metaKey, key = e.key.toLowerCase();
  const does = control ? { z: e.shiftKey ? "redo" : "undo", y: "redo" }[key] : { r: "ridge", v: "valley", f: "fit", m: "mesh", h: "hide", " ": "play" }[key];
  if (key === "escape") hand.cancel();
  if (!does || (key === " " && e.target.tagName === "BUTTON")) return;
  e.preventDefault();
  $(does).click();
}

let hand;
function begin() {
  try { stage = new Drawing($("view"), lines); } catch (error) {
    toast("This browser cannot show the cloth", `${error.message}. Open the address in a browser with WebGL 2: a present Firefox, Chrome, Edge or Safari.`, true);
    return;
  }
  panel = new Panel(lines, stage, edited);
  stage.onpaint = () => panel.labels();
  hand = new Hand(stage, () => ({ kind, height }), drawn);
  const on = (id, does) => $(id).addEventListener("click", does);
  on("ridge", () => choose("ridge"));
  on("valley", () => choose("valley"));
  on("undo", () => { lines.undo(); edited(); });
  on("redo", () => { lines.redo(); edited(); });
  on("clear", () => { lines.clear(); edited(); });
  on("fit", () => stage.fit());
  on("mesh", () => { stage.wires = !stage.wires; $("mesh").setAttribute("aria-pressed", String(stage.wires)); stage.dirty(); });
  on("hide", () => { stage.veiled = !stage.veiled; changed(); });
  on("play", play);
  on("step", () => order("step"));
  on("back", () => order("back"));
  on("apply", applyOrStart);
  on("save", () => keep("save"));
  on("export", () => keep("export"));
  $("passes").addEventListener("input", (e) => { $("passesSaid").textContent = e.target.value; });
  $("toast").querySelector("button").addEventListener("click", () => { $("toast").hidden = true; });
  $("height").addEventListener("change", (e) => setHeight(e.target.value > 0 ? e.target.value / 1000 : height));
  $("slider").addEventListener("input", (e) => setHeight(Math.max(1e-4, Number((span * e.target.value ** 2).toPrecision(2)))));
  document.addEventListener("keydown", keys);
  window.addEventListener("beforeunload", (e) => { if (lines.open.length) e.preventDefault(); });
  ask("about").then((answer) => {
    if (answer.ok) about = answer;
    $("name").textContent = about.name;
    $("save").title = about.target ? `Adds the lines to ${about.target}` : "The run's scene is no file that lines could be added to";
    document.title = `${about.name} · nuno draw`;
    changed();
  });
  follow("frame?", show, (gone) => { if (gone) toast("nuno does not answer", "Is it still running in its terminal? Your lines stay here.", true); else $("toast").hidden = true; });
}

begin();
/** For whoever wants to look into the page from its console, or test it. */
window.nuno = { lines, get stage() { return stage; }, get state() { return now.state; }, get frame() { return now.frame; } };
