import { ask } from "./ask.js";
import { make, sentence } from "./dom.js";
import { Fit } from "./fit.js";
import { add } from "./math.js";
import { Player } from "./player.js";
import { Plot } from "./plot.js";
import { Reel } from "./reel.js";
import { DECADES } from "./scale.js";
import { Bar, Picture, press, Screen, sides } from "./screen.js";

/** One recording: its cloth and bodies at any frame, and its series over time. */
export class Replay {
  /** fits: only its last frame, and how garments fit there. */
  constructor(name, fits = false) {
    Object.assign(this, { name, fits });
    this.said = make("div", { id: "film-said", role: "status" });
    this.theater = make("div", { className: "panel theater", hidden: true });
    this.plots = make("div", { className: "plots", id: "plots" });
    this.box = make("section", { ariaLabel: "Replay" }, this.said, this.theater, this.plots);
    this.drawn = [];
  }

  say(text) { if (text) this.said.append(make("p", { className: "soft", textContent: sentence(text) })); }

  async open() {
    const answer = await ask("replay", { recording: this.name });
    if (!answer.ok) { this.say(answer.words ?? answer.problem); return; }
    for (const text of answer.says) this.say(text);
    if (!answer.times.length || this.closed) return;
    this.film = answer;
    try { if (answer.moves) this.see(answer); } catch (error) {
      this.say(`This browser cannot show the cloth: ${error.message}. A present Firefox, Chrome, Edge or Safari can.`);
    }
    if (answer.dyed) { this.screen = new Picture(answer.film); this.theater.append(this.screen.box); }
    this.player ??= new Player(answer.times, [], (i) => this.show(i));
    this.player.onlost = (text) => this.say(text);
    this.theater.hidden = false;
    if (this.fits) {
      await this.player.go(answer.times.length - 1);
      if (!this.screen?.stage) { this.say("There is no cloth that moves, and so nothing that fits"); return; }
      this.fit = new Fit(this.name, this.screen);
      this.theater.classList.add("fitting");
      this.theater.append(this.fit.box);
      for (const one of [this.bar.box, document.getElementById("film-stretch")]) one.remove();
      await this.fit.open();
      return;
    }
    this.theater.append(this.player.box);
    await this.player.go(0);
    this.plot(answer.film);
  }

  see({ film, times }) {
    const reel = new Reel(film, times.length);
    this.screen = new Screen(reel);
    this.player = new Player(times, [reel], (i) => this.show(i));
    this.bar = new Bar("stretch-scale", "stretch", "", DECADES);
    const { stage, canvas } = this.screen;
    this.screen.box.append(make("div", { className: "tools" }, press("film-fit", "Whole", "The whole cloth (key F)", () => stage.fit()), ...sides(() => stage),
      press("film-mesh", "Triangles", "Key M", (e) => { stage.wires = !stage.wires; e.currentTarget.setAttribute("aria-pressed", String(stage.wires)); stage.dirty(); }),
      press("film-stretch", "Stretch", "Colour the cloth by how far its threads are stretched (key S)", (e) => this.stretch(e.currentTarget))), this.bar.box);
    this.theater.append(this.screen.box);
    canvas.addEventListener("keydown", (e) => {
      const id = !e.ctrlKey && !e.metaKey && !e.altKey && { f: "film-fit", m: "film-mesh", s: "film-stretch" }[e.key.toLowerCase()];
      if (id) { e.preventDefault(); document.getElementById(id)?.click(); }
    });
  }

  stretch(button) {
    const on = this.bar.box.hidden;
    this.bar.box.hidden = !on;
    button.setAttribute("aria-pressed", String(on));
    this.screen.colour(on ? "stretch" : "");
  }

  /** The camera as nuno export takes it, and of a picture the frame. */
  seen(kind) {
    const { camera, origin } = this.screen.stage, { azimuth, elevation, distance } = camera;
    return { camera: { azimuth, elevation, distance, target: add(camera.target, origin) }, ...(kind === "png" ? { frame: this.film.numbers[this.player.index] } : {}) };
  }

  show(i) {
    this.screen?.show(i);
    for (const plot of this.drawn) plot.point(this.film.times[i]);
  }

  async plot(film) {
    const answer = await ask("plots", { film });
    if (!answer.ok) { this.say(answer.words ?? answer.problem); return; }
    if (this.closed) return;
    for (const { title, unit, lines } of answer.plots) {
      const plot = new Plot({ title, unit, lines: Object.entries(lines).map(([name, values]) => ({ name, t: answer.t, values })) }, (t) => this.player.seek(t));
      this.drawn.push(plot);
      this.plots.append(plot.box);
    }
    this.show(this.player.index);
  }

  keys(e) { this.player?.keys(e); }

  close() {
    this.closed = true;
    this.player?.close();
    this.screen?.close();
    for (const plot of this.drawn) plot.close();
  }
}
