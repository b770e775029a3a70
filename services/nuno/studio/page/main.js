import { ask } from "./ask.js";
import { Cloth } from "./cloth.js";
import { dock } from "./dock.js";
import { make } from "./dom.js";
import { files, takeFiles } from "./files.js";
import { gallery } from "./gallery.js";
import { confirm, quiet } from "./say.js";
import { SceneView } from "./scene.js";

const view = document.getElementById("view");
let scene = null, run = null, shown = "";
/** Where in the browser's history the page is, to go back there; and whether it is asked whether to leave it. */
let at = 0, asking = false;

/** A run of a scene that the page cannot open: its cloth alone. */
class RunView {
  constructor(view) {
    Object.assign(this, { name: "", text: null, good: false });
    this.cloth = new Cloth(this);
    this.cloth.draw.wanted = true;
    view.replaceChildren(make("div", { className: "scene" }, make("div", { className: "sides alone" }, this.cloth.box)));
  }

  get unsaved() { return this.cloth.draw.unsaved; }

  keys(e) { this.cloth.draw.keys(e); }

  close() { this.cloth.close(); }
}

/** Whether a scene, or a weave, may be left: it has been saved, or is given up. */
async function leaves(scene) {
  const lines = scene.cloth?.draw.unsaved, yes = scene.save && !lines ? "Save" : "", other = "Leave without saving";
  const what = scene.what ?? "scene", changed = scene.what ? "It was drawn on, and is not saved." : "Its text was changed, and is not saved.";
  const said = await confirm({ title: `Leave this ${what}?`, text: lines ? "Lines that were drawn on its cloth are not in the text, and would be lost." : changed, yes, other });
  return said === other || (said === true && scene.save({ leaving: true }));
}

/** Where the address points: scenes, scene=NAME, draw=NAME for lines on its cloth, runs, run=NAME, fit=NAME, compare=NAME,NAME, files, weave=NAME of a draft or of the scene that it is for. */
async function route() {
  if (asking || (location.hash || "#scenes") === shown) return;
  if (scene?.unsaved) {
    asking = true;
    const left = await leaves(scene);
    asking = false;
    if (!left) { history.go(at - (history.state?.at ?? at + 1)); return; }
  }
  const hash = location.hash || "#scenes";
  if (history.state?.at === undefined) history.replaceState({ at: at + 1 }, "");
  at = history.state.at;
  shown = hash;
  quiet();
  dock.rest();
  const [what, text = ""] = hash.slice(1).split("="), name = decodeURIComponent(text);
  scene?.close();
  run?.close();
  scene = run = null;
  for (const [id, own] of [["to-scenes", ["scenes", "scene", "draw"]], ["to-runs", ["runs", "run", "fit", "compare"]], ["to-files", ["files", "weave"]]]) {
    if (own.includes(what)) document.getElementById(id).setAttribute("aria-current", "page");
    else document.getElementById(id).removeAttribute("aria-current");
  }
  document.title = `${name || { runs: "Runs", files: "Files", weave: "Draw a weave" }[what] || "Scenes"} · nuno studio`;
  view.replaceChildren();
  if (what === "draw" && !name) scene = new RunView(view);
  else if (what === "scene" || what === "draw") { scene = new SceneView(view, name); await scene.open(what === "draw"); }
  else if (what === "weave") {
    const { WeaveView } = await import("./weave.js");  // few draw weaves: nobody else loads it
    if (shown !== hash) return;
    scene = new WeaveView(view, name);
    await scene.open();
  }
  else if (what === "files") await files(view);
  else if (["runs", "run", "fit", "compare"].includes(what)) {
    const [{ recording, recordings }, { Replay }, { Compare }] = await Promise.all([import("./recordings.js"), import("./replay.js"), import("./compare.js")]);
    if (shown !== hash) return;
    if (what === "runs") await recordings(view);
    else if (what === "compare") { run = new Compare(view, text.split(",").map(decodeURIComponent)); await run.open(); }
    else { run = new Replay(name, what === "fit"); await recording(view, name, run); }
  }
  else await gallery(view);
  if (shown !== hash) return;
  view.dataset.shown = hash;
  if (document.activeElement === document.body) view.focus({ preventScroll: true });  // what had the focus is gone
}

window.addEventListener("hashchange", route);
window.addEventListener("beforeunload", (e) => { if (scene?.unsaved) e.preventDefault(); });
document.addEventListener("keydown", (e) => (scene ?? run)?.keys(e));
takeFiles();
route();
ask("now").then((answer) => { if (answer.ok) dock.follow(answer); });
/** For whoever wants to look into the page from its console, or test it. */
window.nuno = { get scene() { return scene; }, get run() { return run; }, dock };
