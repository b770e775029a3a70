// Equally spaced points of the colour map, as nuno_schemas.colour has them.
const CONTROL = ["#f6f1e6", "#fdcc91", "#fca55d", "#f67949", "#e64f35", "#cb2527", "#a50026"];
const MISSING = [0.604, 0.604, 0.604], STEPS = 256;
/** Ends of the scale of stretch, logarithmic: those of pictures and of the viewer. */
export const STRETCH = [0.001, 1];
/** Where on that scale whole powers of ten are. */
export const DECADES = ["0.1 %", "1 %", "10 %", "100 %"].map((text, i) => [i / 3, text]);

export const rgb = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255);

const TABLE = new Float32Array(3 * STEPS);
for (let i = 0; i < STEPS; i++) {
  const at = (i / (STEPS - 1)) * (CONTROL.length - 1), k = Math.min(Math.floor(at), CONTROL.length - 2);
  const a = rgb(CONTROL[k]), b = rgb(CONTROL[k + 1]);
  for (let c = 0; c < 3; c++) TABLE[3 * i + c] = a[c] + (at - k) * (b[c] - a[c]);
}

/** Colours, three numbers for each value, on a scale from 0 to 1; grey for what is no number. */
export function colours(values) {
  const found = new Float32Array(3 * values.length);
  values.forEach((value, i) => {
    const at = 3 * Math.round(Math.max(0, Math.min(1, value)) * (STEPS - 1));
    for (let c = 0; c < 3; c++) found[3 * i + c] = value === value ? TABLE[at + c] : MISSING[c];
  });
  return found;
}

/** The scale from left to right, as CSS. */
export const gradient = `linear-gradient(to right, ${CONTROL.join(", ")})`;

/** Where on the scale the largest stretch of each vertex's edges is, for 3 n positions. */
export function stretched({ x, edges, rest }) {
  const most = new Float32Array(x.length / 3).fill(-1), [low, high] = STRETCH.map(Math.log10);
  for (let e = 0; e < rest.length; e++) {
    const a = edges[2 * e], b = edges[2 * e + 1];
    const long = Math.hypot(x[3 * a] - x[3 * b], x[3 * a + 1] - x[3 * b + 1], x[3 * a + 2] - x[3 * b + 2]) / rest[e] - 1;
    most[a] = Math.max(most[a], long);
    most[b] = Math.max(most[b], long);
  }
  return most.map((value) => (Math.log10(Math.max(value, STRETCH[0])) - low) / (high - low));
}
