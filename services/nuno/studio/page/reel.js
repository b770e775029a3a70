import { frameOf } from "./link.js";

/** Frames that are asked for at once, and how many of these the page holds at most [bytes]. */
const CHUNK = 16, MOST = 256e6;
/** How long what could not be read is not asked for again [ms], unless it is wanted. */
const AGAIN = 3000;

/** A recording's frames, fetched some at a time, those that come next before they are wanted. */
export class Reel {
  /** film: what the server calls it; count: of its frames; beside: another film, where frames are those of the clock of both. */
  constructor(film, count, beside = "") {
    Object.assign(this, { film, count, beside, chunks: new Map(), shapes: new Map(), over: new AbortController() });
  }

  /** A frame that is there already, with what its cloth consists of; else undefined. */
  at(i) {
    const chunk = this.chunks.get(Math.floor(i / CHUNK));
    const frame = chunk?.frames?.[i % CHUNK], shape = frame && this.shapes.get(frame.shape)?.value;
    return shape && { ...shape, ...frame };
  }

  /** A frame, once it is there; null where it cannot be read. */
  async need(i) {
    const k = Math.floor(i / CHUNK);
    if (this.chunks.get(k)?.failed) this.chunks.delete(k);
    const chunk = await this.load(k);
    const frame = chunk?.[i % CHUNK];
    if (!frame) return null;
    return this.at(i) ?? null;
  }

  /** Fetch what follows on a frame, ahead of time. */
  ahead(i) {
    const k = Math.floor(i / CHUNK);
    for (const next of [k, k + 1, k + 2]) if (next * CHUNK < this.count) this.load(next);
    this.forget(k);
  }

  /** Why a frame cannot be read; empty where it can, or is not known yet. */
  problem(i) { return this.chunks.get(Math.floor(i / CHUNK))?.problem ?? ""; }

  load(k) {
    const before = this.chunks.get(k);
    if (!before || (before.failed && performance.now() - before.failed > AGAIN)) {
      const chunk = { bytes: 0 };
      this.chunks.set(k, chunk);
      chunk.coming = this.fetch(k, chunk);
    }
    return this.chunks.get(k).coming;
  }

  async fetch(k, chunk) {
    const more = this.beside ? `&beside=${encodeURIComponent(this.beside)}` : "";
    const found = await this.ask(`frames?film=${encodeURIComponent(this.film)}${more}&first=${k * CHUNK}&count=${Math.min(CHUNK, this.count - k * CHUNK)}`);
    if (typeof found === "string") { Object.assign(chunk, { failed: performance.now(), problem: found }); return null; }
    let body = null;
    const frames = found.frames.map((head, i) => {
      body = found[`body${i}`] ?? body;
      return { ...head, origin: found.origin, x: found[`x${i}`], body, far: found[`far${i}`] };
    });
    chunk.bytes = frames.reduce((sum, { x, far }, i) => sum + x.byteLength + (far?.byteLength ?? 0) + (found[`body${i}`]?.byteLength ?? 0), 0);
    const shapes = await Promise.all([...new Set(frames.map((frame) => frame.shape))].map((shape) => this.shape(shape)));
    const wrong = shapes.find((shape) => typeof shape === "string");
    if (wrong !== undefined) { Object.assign(chunk, { failed: performance.now(), problem: wrong }); return null; }
    chunk.frames = frames;
    return frames;
  }

  shape(number) {
    if (!this.shapes.has(number)) {
      const one = {};
      this.shapes.set(number, one);
      one.coming = this.ask(`shape?film=${encodeURIComponent(this.film)}&shape=${number}`).then((value) => {
        if (typeof value === "string") this.shapes.delete(number);
        else one.value = value;
        return value;
      });
    }
    return this.shapes.get(number).coming;
  }

  /** What is there, or why it is not, in words. */
  async ask(address) {
    try {
      return await frameOf(address, this.over.signal);
    } catch (error) {
      return error.message.replace(/^\d+: /, "").trim() || "nuno does not answer";
    }
  }

  /** Let go what is farthest from a chunk, where there is too much. */
  forget(k) {
    const far = [...this.chunks.keys()].sort((a, b) => Math.abs(a - k) - Math.abs(b - k));
    let sum = 0;
    for (const one of far) {
      sum += this.chunks.get(one).bytes;
      if (sum > MOST && Math.abs(one - k) > 2) this.chunks.delete(one);
    }
  }

  close() { this.over.abort(); }
}
