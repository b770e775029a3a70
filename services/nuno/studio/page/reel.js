import { frameOf } from "./link.js";

/** Frames that are asked for at once, and how many of these the page holds at most [bytes]. */
const CHUNK = 16, MOST = 256e6;

/** A recording's frames, fetched some at a time, those that come next before they are wanted. */
export class Reel {
  /** film: what the server calls it; count: of its frames; beside: another film, where frames are those of the clock of both. */
  constructor(film, count, beside = "") {
    Object.assign(this, { film, count, beside, chunks: new Map(), shapes: new Map(), over: new AbortController(), end: Infinity, problem: "" });
  }

  /** A frame that is there already, with what its cloth consists of; else undefined. */
  at(i) {
    const chunk = this.chunks.get(Math.floor(i / CHUNK));
    const frame = chunk?.frames?.[i % CHUNK], shape = frame && this.shapes.get(frame.shape)?.value;
    return shape && { ...shape, ...frame };
  }

  /** A frame, once it is there; null where it cannot be read. */
  async need(i) {
    const chunk = await this.load(Math.floor(i / CHUNK));
    const frame = chunk?.[i % CHUNK];
    if (!frame) return null;
    return (await this.shape(frame.shape)) ? this.at(i) : null;
  }

  /** Fetch what follows on a frame, ahead of time. */
  ahead(i) {
    const k = Math.floor(i / CHUNK);
    for (const next of [k, k + 1, k + 2]) if (next * CHUNK < this.count) this.load(next);
    this.forget(k);
  }

  load(k) {
    if (!this.chunks.has(k)) {
      const chunk = { bytes: 0 };
      this.chunks.set(k, chunk);
      chunk.coming = this.fetch(k, chunk);
    }
    return this.chunks.get(k).coming;
  }

  async fetch(k, chunk) {
    const more = this.beside ? `&beside=${encodeURIComponent(this.beside)}` : "";
    const found = await this.ask(`frames?film=${encodeURIComponent(this.film)}${more}&first=${k * CHUNK}&count=${Math.min(CHUNK, this.count - k * CHUNK)}`);
    if (!found) { this.chunks.delete(k); return null; }
    let body = null;
    const frames = found.frames.map((head, i) => {
      body = found[`body${i}`] ?? body;
      return { ...head, origin: found.origin, x: found[`x${i}`], body, far: found[`far${i}`] };
    });
    chunk.bytes = frames.reduce((sum, { x, far }) => sum + x.byteLength + (far?.byteLength ?? 0), 0);
    await Promise.all([...new Set(frames.map((frame) => frame.shape))].map((shape) => this.shape(shape)));
    chunk.frames = frames;
    return frames;
  }

  shape(number) {
    if (!this.shapes.has(number)) {
      const one = {};
      this.shapes.set(number, one);
      one.coming = this.ask(`shape?film=${encodeURIComponent(this.film)}&shape=${number}`).then((value) => (one.value = value));
    }
    return this.shapes.get(number).coming;
  }

  async ask(address) {
    try {
      return await frameOf(address, this.over.signal);
    } catch (error) {
      if (!this.over.signal.aborted) this.problem = error.message.replace(/^\d+: /, "").trim();
      return null;
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
