/** Numbers as a person reads them. */
export const seconds = (s) => (s === null || s === undefined ? "" : s >= 7200 ? `${(s / 3600).toPrecision(3)} h` : s >= 120 ? `${(s / 60).toPrecision(3)} min` : `${Number(s.toPrecision(3))} s`);
export const bytes = (n) => (n >= 1e9 ? `${(n / 1e9).toFixed(1)} GB` : n >= 1e6 ? `${(n / 1e6).toFixed(1)} MB` : `${Math.max(1, Math.round(n / 1e3))} kB`);
export const moment = (unix) => new Date(1000 * unix).toLocaleString(undefined, { dateStyle: "medium", timeStyle: "short" });
export const factor = (f) => (f === null || f === undefined ? "" : `${Number(f.toPrecision(2))} × real time`);
/** Where a mistake stands, as the command line says it before what is wrong: file, line and field. */
export const placeOf = ({ problem, words }) => words.split("\n")[0].slice(0, -problem.length).replace(/:\s*$/, "").replace(/^.*\/(?=[^/]+\.\w+)/, "");
export const count = (n, what) => `${n} ${what}${n === 1 ? "" : "s"}`;
