const ARRAYS = { float32: Float32Array, uint32: Uint32Array };

/** A message of the server: its head, and arrays by name. */
export function decode(buffer) {
  const size = new DataView(buffer).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
  let at = 4 + size;
  const arrays = {};
  for (const [name, type, count] of head.arrays) {
    arrays[name] = new ARRAYS[type](buffer, at, count);
    at += 4 * count;
  }
  return { ...head, ...arrays };
}

/** One frame. Throws where the server does not answer, or not with one. */
export async function frameOf(address, signal) {
  const answer = await fetch(address, { signal });
  if (!answer.ok) throw new Error(await answer.text());
  return decode(await answer.arrayBuffer());
}

const seen = () => new Promise((drawn) => requestAnimationFrame(drawn));
const shown = () => new Promise((then) => document.addEventListener("visibilitychange", then, { once: true }));

/** Ask for the newest frame, show it, and ask again, until `signal` says to stop: never more of them than the browser
  draws, and none while the page is hidden. lost(true) is called where the server does not answer, lost(false) once it
  does again. */
export async function follow(address, show, lost, signal) {
  let number = -1, shape = -1, place = -1, failed = 0;
  while (!signal?.aborted) {
    if (document.hidden) { await shown(); continue; }
    try {
      const frame = await frameOf(`${address}after=${number}&shape=${shape}&place=${place}`, signal);
      if (failed) { failed = 0; lost(false); }
      if (frame.number !== number) {
        ({ number, shape, place } = frame);
        show(frame);
        await seen();
      }
    } catch (error) {
      if (signal?.aborted) return;
      if (!(error instanceof TypeError) && !failed) console.error(error);
      if (++failed === 2) lost(true);
      await new Promise((later) => setTimeout(later, 1000));
    }
  }
}
