import { ask } from "./ask.js";
import { make, sentence } from "./dom.js";
import { wordsOf } from "./form.js";
import { pictureOf } from "./gallery.js";
import { rowsOf } from "./rows.js";
import { taken } from "./say.js";
import { factor, seconds } from "./words.js";

/** After how long a preparation is explained, and how long the first of a kind of scene usually takes on two cores [s]. */
const SLOW = 6, USUAL = 120;
/** What a run says that lets coarser cloth settle first. */
const SETTLES = "comes to rest on coarser triangles";
/** How often a run is asked about [ms]; the server knows, and does not ask the run. */
const OFTEN = 250;
const SAID = { preparing: "getting ready", running: "running", paused: "paused", ending: "ending", over: "over", failed: "failed", refused: "refused", stopped: "stopped", none: "" };
const GOING = ["preparing", "running", "paused", "ending"];
/** A time [s] in steps of 5 s. */
const about = (s) => seconds(s < 10 ? Math.ceil(s) : 5 * Math.round(s / 5));
const $ = (id) => document.getElementById(id);

/** The run that was started here: how far it is, what it says, and at its end its report and picture. */
class Dock {
  constructor() {
    this.now = { state: "none" };
    /** Called each time that something is heard of the run. */
    this.hearers = new Set();
    $("pause").addEventListener("click", () => this.order(this.now.state === "paused" ? "resume" : "pause"));
    $("step").addEventListener("click", () => this.order("step"));
    $("stop").addEventListener("click", () => this.order("stop"));
    $("set").addEventListener("submit", (e) => { e.preventDefault(); this.set($("set-item").value.trim()); });
    $("set-item").addEventListener("input", () => $("set-said").replaceChildren());
    $("more").addEventListener("click", () => this.fold($("run-said").hidden));
    $("dismiss").addEventListener("click", () => { $("dock").hidden = true; });
  }

  get going() { return GOING.includes(this.now.state); }

  /** Show a run from now on, until it has ended. */
  follow(now) {
    if (now.run !== this.now.run) { this.ended = null; $("set-said").replaceChildren(); $("run-ends").replaceChildren(); $("run-said").replaceChildren(make("pre")); this.fold(false); }
    $("dock").hidden = now.state === "none";
    this.show(now);
    for (const hear of this.hearers) hear();
    clearTimeout(this.timer);
    if (this.going) this.timer = setTimeout(() => this.look(), OFTEN);
    else if (now.state !== "none" && this.ended !== now.run) this.end(now);
  }

  async look() {
    const answer = await ask("now");
    if (answer.ok) this.follow(answer);
    else if (answer.gone) { $("run-time").textContent = "nuno does not answer"; this.timer = setTimeout(() => this.look(), 4 * OFTEN); }
  }

  async order(action) {
    const answer = await ask("control", { action });
    if (taken(answer)) this.follow(answer);
  }

  /** Change a field of the run that goes on; what it held and holds now, or why not, in the words of the command line. */
  async set(item) {
    const answer = await ask("control", { action: "set", item }), said = $("set-said");
    if (!answer.ok) { said.replaceChildren(answer.words ? wordsOf(answer) : answer.problem); return; }
    const { field, old, new: now, frame } = answer.changed, text = (value) => (value === null ? "nothing" : JSON.stringify(value));
    said.textContent = `${field} ${text(old)} → ${text(now)} at frame ${frame}`;
    this.follow(answer);
  }

  show(now) {
    this.now = now;
    $("dock").dataset.state = now.state;
    $("run-state").textContent = SAID[now.state] ?? now.state;
    $("run-name").textContent = now.run ?? "";
    const over = now.state === "over";  // at rest, it may be before its frames are all taken
    $("run-progress").value = over ? 1 : now.frames ? Math.max(0, now.frame) / now.frames : 0;
    const far = now.frame < 0 ? "" : over ? `${seconds(now.t)} in ${now.frame} frames` : `${seconds(now.t)}${now.end ? ` of ${seconds(now.end)}` : ""} · frame ${now.frame} of ${now.frames}`;
    const left = now.factor && now.state === "running" ? (now.end - now.t) / now.factor : 0;
    $("run-time").textContent = now.state === "preparing" ? "" : [far, left ? `${about(left)} left at most` : "", factor(now.factor)].filter(Boolean).join(" · ");
    const first = now.state === "preparing" && now.waited > SLOW;
    $("run-first").hidden = !first;
    if (first) $("run-first").textContent = `${(now.said ?? "").includes(SETTLES) ? "The cloth comes to rest on coarser triangles first." : "The first run of a kind of scene translates its solver into machine code (compiles), once on this computer; the next one starts within seconds."} It takes about two minutes, so far ${about(now.waited)}${now.waited < USUAL ? `; some ${about(USUAL - now.waited)} are left` : ""}. Then the cloth moves.`;
    if (now.state === "preparing") $("run-progress").removeAttribute("value");
    $("pause").textContent = now.state === "paused" ? "Resume" : "Pause";
    $("pause").disabled = !["running", "paused"].includes(now.state);
    for (const part of $("set").elements) part.disabled = $("pause").disabled;
    $("step").disabled = now.state !== "paused";
    $("stop").disabled = !this.going || now.state === "ending";
    $("pause").hidden = $("step").hidden = $("stop").hidden = $("set").hidden = !this.going;
    $("dismiss").hidden = this.going;
    const lines = (now.said ?? "").split("\n"), warned = lines.filter((line) => /\bWARNING\b/.test(line));
    $("run-warned").replaceChildren(...warned.map((line) => make("div", { textContent: line })));
    const pre = $("run-said").querySelector("pre");
    if (pre && pre.textContent !== now.said) pre.textContent = now.said;
  }

  /** The report of a run that is over makes room for what is opened next. */
  rest() { if (!this.going) this.fold(false); }

  fold(open) {
    $("run-said").hidden = !open;
    $("more").textContent = open ? "Show less" : "Show more";
    $("more").setAttribute("aria-expanded", String(open));
  }

  /** What a maker asks first: whether it fits, whether anything crosses, how long it took. All else is behind Show more. */
  async tell(recording, ends) {
    const fits = make("dd", { textContent: "measuring it on the body …" }), more = make("button", { type: "button", id: "to-fit", className: "main", textContent: "Fit", title: "Ease, pressure and stretch of the garment as it is worn", onclick: () => { $("dock").hidden = true; location.hash = `#fit=${encodeURIComponent(recording)}`; } });
    $("run-ends").replaceChildren(make("dl", { className: "rows" }, make("dt", { textContent: "Fits" }), fits, ...ends.flatMap(([name, text]) => [make("dt", { textContent: name }), make("dd", { textContent: text })])), more);
    const answer = await ask("fit", { recording });
    more.hidden = !answer.ok;
    fits.replaceChildren(answer.ok ? answer.garments.map(({ name, verdict }) => `${name}: ${verdict}`).join("; ") : sentence(answer.problem));
    fits.className = answer.ok && answer.garments.every(({ on }) => on) ? "" : "warned";
    if (!answer.ok) fits.className = "soft";
  }

  /** The report's lines and the last frame, in the place of what was printed; that stays where there is no recording. */
  async end({ run, recording }) {
    this.ended = run;
    const answer = await ask("recording", { recording });
    if (this.now.run !== run) return;
    this.fold(!answer.ok);
    if (!answer.ok) return;
    this.tell(recording, answer.ends);
    const picture = make("div"), link = make("a", { href: `#run=${encodeURIComponent(recording)}`, textContent: "Open the recording" });
    $("run-said").replaceChildren(make("div", { className: "shown" }, picture, make("div", {}, rowsOf(answer.rows), make("p", {}, link))));
    await showPicture(picture, recording);
  }
}

/** The picture of a recording's last frame, which is drawn where there is none yet. */
export async function showPicture(box, recording) {
  box.replaceChildren(make("span", { className: "soft", textContent: "Drawing the last frame …" }));
  for (;;) {
    const answer = await ask("picture", { recording });
    if (!answer.ok || answer.problem) { box.replaceChildren(make("span", { className: "soft", textContent: answer.problem })); return; }
    if (!answer.drawing) break;
    await new Promise((later) => setTimeout(later, OFTEN));
    if (!box.isConnected) return;
  }
  box.replaceChildren(make("img", { src: pictureOf(recording), alt: "The last frame" }));
}

export const dock = new Dock();
