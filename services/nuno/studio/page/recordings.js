import { ask } from "./ask.js";
import { make } from "./dom.js";
import { addressOf } from "./compare.js";
import { dock, showPicture } from "./dock.js";
import { exporter } from "./exports.js";
import { rowsOf } from "./rows.js";
import { confirm, taken, toast } from "./say.js";
import { bytes, moment, seconds } from "./words.js";

/** How often a comparison is asked about [ms]. */
const OFTEN = 300;

const cell = (content, className = "") => make("td", { className }, content ?? "");

/** All recordings of the folder. */
export async function recordings(view) {
  const answer = await ask("recordings");
  if (!taken(answer)) return;
  const button = make("button", { type: "button", id: "compare", textContent: "Compare two", title: "Choose two runs by their boxes", disabled: true });
  const boxes = answer.recordings.map(({ name }) => make("input", { type: "checkbox", value: name, ariaLabel: `Compare ${name}` }));
  const chosen = () => boxes.filter((box) => box.checked).map((box) => box.value);
  const choose = () => {
    button.disabled = chosen().length !== 2;
    for (const box of boxes) box.disabled = !box.checked && chosen().length >= 2;
  };
  for (const box of boxes) box.addEventListener("change", choose);
  button.addEventListener("click", () => { location.hash = addressOf(chosen()); });
  const rows = answer.recordings.map((one, i) => make("tr", {},
    cell(boxes[i], "choose"), cell(make("a", { href: `#run=${encodeURIComponent(one.name)}`, textContent: one.name })), cell(one.scene, "spare"), cell(one.solver, "spare"), cell(one.state), cell(seconds(one.seconds), "number"), cell(bytes(one.bytes), "number"), cell(moment(one.when), "spare")));
  view.replaceChildren(make("div", { className: "head" }, make("h1", { textContent: "Runs" }), make("span", { className: "group", hidden: rows.length < 2 }, button)));
  if (!rows.length) { view.append(make("p", { className: "none", textContent: "No run has been recorded in this folder. Open a scene and press Run." })); return; }
  const heads = [["", "choose"], ["recording"], ["scene", "spare"], ["solver", "spare"], ["state"], ["simulated"], ["size"], ["recorded", "spare"]];
  view.append(make("div", { className: "panel wide" }, make("table", {},
    make("thead", {}, make("tr", {}, ...heads.map(([textContent, className = ""]) => make("th", { textContent, className, scope: "col" })))), make("tbody", {}, ...rows))));
}

/** One recording: its replay, its report, its last frame, and what can be done with it. */
export async function recording(view, name, replay) {
  const answer = await ask("recording", { recording: name });
  if (!answer.ok) {
    view.replaceChildren(make("div", { className: "head" }, make("h1", { textContent: name }), make("span", { className: "group" }, remover(name))), make("pre", { className: "panel", textContent: answer.words ?? answer.problem }), replay.box);
    await replay.open();
    return;
  }
  const picture = make("div"), verdict = make("pre", { id: "verdict", role: "status" });
  const verify = make("button", { type: "button", id: "verify", textContent: "Verify", title: "Simulate it again, and compare each frame to the last bit", onclick: () => compare(name, verify, verdict, "verify") });
  view.replaceChildren(
    make("div", { className: "head" }, make("h1", { textContent: name }), tabs(name, replay.fits), make("span", { className: "group" }, goingOn(name), verify, remover(name))),
    make("p", { className: "soft", textContent: [answer.scene, answer.state, seconds(answer.seconds), bytes(answer.bytes), moment(answer.when)].filter(Boolean).join(" · ") }),
    ...(replay.fits ? [replay.box] : [exporter(name, answer.dyed, replay), verdict, replay.box, make("div", { className: "panel shown" }, picture, make("div", {}, rowsOf(answer.rows)))]));
  if (replay.fits) { await replay.open(); return; }
  compare(name, verify, verdict, "verdict");
  await Promise.all([replay.open(), showPicture(picture, name)]);
}

const tabs = (name, fits) => make("nav", { ariaLabel: "What is shown of it" }, ...[["run", "Replay"], ["fit", "Fit"]].map(([what, textContent]) => make("a", { href: `#${what}=${encodeURIComponent(name)}`, textContent, ...((what === "fit") === fits ? { ariaCurrent: "page" } : {}) })));

/** Go on from the last checkpoint, as a run of its own. */
function goingOn(name) {
  return make("button", { type: "button", id: "go-on", textContent: "Resume", title: "Go on from its last checkpoint, as a new run", onclick: async () => {
    const { at, end, ...answer } = await ask("resumable", { recording: name });
    if (!taken(answer)) return;
    const until = at < end ? end : 2 * at;
    let now;
    await confirm({ title: "Go on with this run?", text: `It goes on from its last checkpoint, at ${seconds(at)}, and is recorded anew with what this one holds.`, yes: "Resume", label: "Duration of the whole run", value: `${Number(until.toPrecision(6))} s`, does: async (duration) => (now = await ask("resume", { recording: name, duration })) });
    if (now?.ok) dock.follow(now);
  } });
}

async function compare(name, button, verdict, action) {
  for (let asked = action; ; asked = "verdict") {
    const answer = await ask(asked, { recording: name });
    if (!taken(answer)) return;
    if (!answer.verifying && answer.equal === null) return;
    button.disabled = answer.verifying;
    verdict.className = answer.verifying ? "panel" : `panel ${answer.equal ? "good" : "bad"}`;
    verdict.textContent = answer.verifying ? answer.words || "Simulating it again …" : answer.equal ? answer.words.split("\n").at(-1) : answer.words;
    if (!answer.verifying || !verdict.isConnected) return;
    await new Promise((later) => setTimeout(later, OFTEN));
  }
}

function remover(name) {
  return make("button", { type: "button", id: "delete", className: "bad", textContent: "Delete", onclick: async () => {
    if (!(await confirm({ title: "Delete this recording?", text: `${name}, its picture and its log are removed from the disk. This cannot be undone.`, yes: "Delete" }))) return;
    if (!taken(await ask("delete", { recording: name }))) return;
    toast(`${name} is deleted`);
    location.hash = "#runs";
  } });
}
