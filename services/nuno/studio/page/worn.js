import { add, length } from "./math.js";

/** How many times as far as it went on the garment a stroke may go on the flat cloth: more is across a seam. */
const SEAM = 3;

/** Where a garment's triangles lie on the flat cloth that it is dyed as. */
export class Worn {
  /** uv: six shares of the flat cloth's size [m] of each triangle's three corners, NaN for triangles of other cloth;
    surface: the triangles as they hang. */
  constructor(uv, size, surface) {
    const corner = (face) => (uv[6 * face] === uv[6 * face] ? Array.from(uv.subarray(6 * face, 6 * face + 6), (share, k) => share * size[k % 2]) : null);
    Object.assign(this, { corners: Array.from({ length: surface.count }, (_, face) => corner(face)), surface });
  }

  /** The place [m] on the flat cloth of a place [face, u, v]; null on other cloth. */
  flat([face, u, v]) {
    const [a, b, c] = [0, 2, 4].map((k) => this.corners[face]?.slice(k, k + 2));
    return a ? a.map((_, i) => (1 - u - v) * a[i] + u * b[i] + v * c[i]) : null;
  }

  /** How many metres of flat cloth a metre of a triangle is, along its most drawn out edge. */
  ratio(face) {
    const flat = [0, 2, 4].map((k) => this.corners[face].slice(k, k + 2)), x = [[face, 0, 0], [face, 1, 0], [face, 0, 1]].map((place) => this.surface.at(place));
    return Math.max(...[[0, 1], [1, 2], [2, 0]].map(([i, j]) => Math.hypot(flat[i][0] - flat[j][0], flat[i][1] - flat[j][1]) / (length(add(x[i], x[j], -1)) || Infinity)));
  }

  /** Lines of places [m] on the flat cloth: what a drag over the garment is there, parted where it leaves the cloth or crosses a seam. */
  lines(places) {
    const lines = [[]];
    let last = null;
    for (const place of places) {
      const p = place && this.flat(place);
      if (last && (!p || this.parted(last, { place, p }))) { lines.push([]); last = null; }
      if (!p) continue;
      lines[lines.length - 1].push(p);
      last = { place, p };
    }
    return lines.filter((line) => line.length);
  }

  parted(from, to) {
    const way = length(add(this.surface.at(from.place), this.surface.at(to.place), -1));
    return Math.hypot(to.p[0] - from.p[0], to.p[1] - from.p[1]) > SEAM * way * Math.max(this.ratio(from.place[0]), this.ratio(to.place[0])) + 1e-9;
  }
}
