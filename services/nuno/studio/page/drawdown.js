/** Drawdowns: picks from the top, each a row of ends from the left, 1 where the warp is above. */

const drawn = (picks, ends, up) => Array.from({ length: picks }, (_, p) => Array.from({ length: ends }, (_, e) => Number(up(p, e))));

/** One repeat of a weave as scenes describe it; null of a draft, which is a file. */
export function drawdownOf({ plugin = "plain", over = 2, under = 2, direction = "right", ends = 5, step = 2, face = "warp", rows }) {
  const n = over + under;
  if (plugin === "twill") return drawn(n, n, (p, e) => ((direction === "right" ? p + e : p - e + n) % n) < over);
  if (plugin === "satin") return drawn(ends, ends, (p, e) => ((step * p) % ends === e) !== (face === "warp"));
  if (plugin === "matrix") return rows.map((row) => Array.from(row, Number));
  return plugin === "plain" ? drawn(2, 2, (p, e) => p === e) : null;
}

/** A drawdown repeated, or cut off, to so many picks and ends. */
export const tiled = (rows, picks, ends) => drawn(picks, ends, (p, e) => rows[p % rows.length][e % rows[0].length]);

export const turned = (rows) => rows[0].map((_, e) => rows.map((row) => row[e]));

/** The longest run of a value in any line, which goes on from its end to its start; Infinity where a line has no other. */
export function longest(lines, value) {
  let most = 0;
  for (const line of lines) {
    if (line.every((one) => one === value)) return Infinity;
    let run = 0;
    for (const one of [...line, ...line]) { run = one === value ? run + 1 : 0; most = Math.max(most, run); }
  }
  return most;
}

/** How many lines differ: shafts of ends, treadles of picks. */
export const kinds = (lines) => new Set(lines.map(String)).size;
