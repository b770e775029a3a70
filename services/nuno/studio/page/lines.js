/** The lines drawn, what can be undone, and what was said of each.

  A line is { id, kind, height, width, closed }; width is null for one that splits triangles, and closed is one that ends where it began. Of its places, points are places [face, u, v] on the cloth as it is shown; base the same
  on the cloth as the scene begins, which is what its text is about, or null where there is no such. Places belong to an id and are shared by
  all states that can be gone back to; kind and height are each state's own.
*/
export class Lines {
  constructor() {
    Object.assign(this, { list: [], past: [], future: [], places: new Map(), hidden: new Set(), applied: new Set(), errors: new Map(), numbers: new Map(), next: 1 });
  }

  /** Lines still to be applied, in their order. */
  get open() { return this.list.filter((line) => !this.applied.has(line.id)); }

  placesOf(id) { return this.places.get(id); }

  change(list) {
    this.past.push(this.list);
    this.future = [];
    this.list = list;
  }

  add(kind, height, width, points, base, closed = false) {
    const id = this.next++;
    this.places.set(id, { points, base });
    this.change([...this.list, { id, kind, height, width, closed }]);
    return id;
  }

  alter(id, fields) {
    this.errors.delete(id);
    this.change(this.list.map((line) => (line.id === id ? { ...line, ...fields } : line)));
  }

  remove(id) { this.change(this.list.filter((line) => line.id !== id)); }

  clear() { if (this.open.length) this.change(this.list.filter((line) => this.applied.has(line.id))); }

  undo() { if (this.past.length) { this.future.push(this.list); this.list = this.past.pop(); } }
  redo() { if (this.future.length) { this.past.push(this.list); this.list = this.future.pop(); } }

  /** What is in the cloth cannot be undone there, but taken back by its object and number in the run. */
  settle(ids, numbers) {
    ids.forEach((id, i) => { this.applied.add(id); this.errors.delete(id); this.numbers.set(id, numbers[i]); });
    this.past = []; this.future = [];
  }

  /** A line is no longer in the cloth. */
  takenBack(id) {
    this.list = this.list.filter((line) => line.id !== id);
    this.past = []; this.future = [];
  }

  /** Back at the start nothing is applied, and every line lies on the cloth as the scene begins. */
  restart() {
    this.applied.clear(); this.errors.clear();
    for (const place of this.places.values()) place.points = place.base ?? place.points;
  }

  /** Give every place on the start anew, by a function. */
  rebase(move) { for (const place of this.places.values()) place.base = place.base?.map(move) ?? null; }

  /** Give every place anew, by a function. */
  carry(move) { for (const place of this.places.values()) place.points = place.points.map(move); }
}

/** The points of a polyline [{ p, ... }] that keep it within a distance of itself (Douglas and Peucker). */
export function thin(points, distance) {
  const keep = new Uint8Array(points.length), stack = [[0, points.length - 1]];
  keep[0] = keep[points.length - 1] = 1;
  while (stack.length) {
    const [i, j] = stack.pop(), a = points[i].p, b = points[j].p;
    const d = [b[0] - a[0], b[1] - a[1], b[2] - a[2]], l = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
    let worst = distance * distance, at = -1;
    for (let k = i + 1; k < j; k++) {
      const e = [0, 1, 2].map((c) => points[k].p[c] - a[c]);
      const s = l > 0 ? Math.max(0, Math.min(1, (e[0] * d[0] + e[1] * d[1] + e[2] * d[2]) / l)) : 0;
      const far = [0, 1, 2].reduce((sum, c) => sum + (e[c] - s * d[c]) ** 2, 0);
      if (far > worst) { worst = far; at = k; }
    }
    if (at > 0) { keep[at] = 1; stack.push([i, at], [at, j]); }
  }
  return points.filter((_, k) => keep[k]);
}
