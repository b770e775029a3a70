import { make } from "./dom.js";

/** Units that a value may be written in, by those of the schema, and how many of these they are. */
const UNITS = {
  m: { m: 1, cm: 0.01, mm: 0.001, um: 1e-6 }, s: { s: 1, ms: 0.001, min: 60, h: 3600 }, rad: { rad: 1, deg: Math.PI / 180 },
};
const STEPS = 1000;
/** A range beyond this says what can be computed, not what is sensible. */
const WIDEST = 1e5;

/** A number and its unit as they are written; null for what is no plain number in a unit that is known. */
export function read(text, unit) {
  const found = /^\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)\s*(\S*)\s*$/i.exec(String(text ?? "")), units = UNITS[unit] ?? { [unit ?? ""]: 1 };
  if (!found || !(found[2] === "" || found[2] in units)) return null;
  return { number: Number(found[1]), unit: found[2], factor: units[found[2]] ?? 1 };
}

/** What is written for a number [of the schema's unit], in the unit that was written before: three digits, and not beyond the limits. */
const write = (number, { unit, factor }, { low, high, whole }) => {
  const own = number / factor, digit = own ? 10 ** (Math.floor(Math.log10(Math.abs(own))) - 2) : 1;
  let near = whole ? Math.round(own) : Number(own.toPrecision(3));
  if (near * factor > high) near = Number((near - digit).toPrecision(3));
  if (near * factor < low) near = Number((near + digit).toPrecision(3));
  return unit ? `${near} ${unit}` : String(near);
};

/**
 * A slider between the two limits of a field; null where it has not two, or they say too little. The middle is where the
 * default is, or what is written: limits are often far beyond what is usual.
 */
export function slider(field, input, label, moved) {
  const { low, high, whole, openLow, openHigh } = field.range ?? {};
  if (low === undefined || high === undefined || high - low > WIDEST) return null;
  const given = read(input.value || input.placeholder, field.unit), usual = read(field.default, field.unit);
  if (!given) return null;
  const middle = ((usual ?? given).number * (usual ?? given).factor - low) / (high - low);
  const power = middle > 0 && middle < 0.5 ? Math.log(middle) / Math.log(0.5) : 1;
  const at = (value) => Math.round(STEPS * Math.min(1, Math.max(0, (value - low) / (high - low))) ** (1 / power));
  const value = (place) => low + (high - low) * (Math.min(openHigh ? STEPS - 1 : STEPS, Math.max(openLow ? 1 : 0, place)) / STEPS) ** power;
  const range = make("input", { type: "range", min: 0, max: STEPS, step: 1, value: at(given.number * given.factor), ariaLabel: `${label}, slider`, className: "slider", id: `slide:${input.id}` });
  const told = () => { range.ariaValueText = input.value || input.placeholder; };
  range.addEventListener("input", () => { input.value = write(value(Number(range.value)), given, field.range); told(); moved(); });
  // Of whole numbers in a narrow range each is one step of the keyboard.
  range.addEventListener("keydown", (e) => {
    const way = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[e.key];
    if (!way || !whole) return;
    e.preventDefault();
    const next = Math.min(high, Math.max(low, Math.round(read(input.value || input.placeholder, field.unit)?.number ?? low) + way));
    input.value = String(next);
    range.value = at(next);
    range.sent = range.value;
    told();
    moved();
  });
  input.addEventListener("input", () => { const now = read(input.value, field.unit); if (now) { range.value = at(now.number * now.factor); range.sent = range.value; } told(); });
  told();
  range.sent = range.value;
  return range;
}
