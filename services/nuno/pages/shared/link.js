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

/** Ask for the newest frame, show it, and ask again: never more of them than the browser draws. */
export async function follow(show, lost) {
  let number = -1, shape = -1, place = -1, failed = 0;
  for (;;) {
    try {
      const answer = await fetch(`frame?after=${number}&shape=${shape}&place=${place}`);
      if (!answer.ok) throw new Error(await answer.text());
      const frame = decode(await answer.arrayBuffer());
      if (failed) { failed = 0; lost(false); }
      if (frame.number !== number) {
        ({ number, shape, place } = frame);
        show(frame);
        await new Promise((drawn) => (document.hidden ? setTimeout(drawn, 500) : requestAnimationFrame(drawn)));
      }
    } catch (error) {
      if (!(error instanceof TypeError) && !failed) console.error(error);
      if (++failed === 2) lost(true);
      await new Promise((later) => setTimeout(later, 1000));
    }
  }
}
