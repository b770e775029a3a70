const BOUNDS = [["exclusiveMinimum", "more than"], ["minimum", "at least"], ["exclusiveMaximum", "less than"], ["maximum", "at most"]];
const short = (number) => (Math.abs(number) >= 1e6 ? String(Number(number.toPrecision(3)).toExponential()).replace("+", "") : String(number));

/** What a field may hold, read from the JSON Schema of scenes. */
export class Schema {
  constructor(root) { this.root = root; }

  /** A node itself in the place of a reference to it; what stands beside the reference counts. */
  at(node) {
    const { $ref, ...beside } = node;
    if ($ref === undefined) return node;
    const found = $ref.replace(/^#\//, "").split("/").reduce((inside, key) => inside[key.replaceAll("~1", "/").replaceAll("~0", "~")], this.root);
    return { ...this.at(found), ...beside };
  }

  /** All that a node may be, each with a type of its own; null, which is nothing that is written, left out. What a mapping
   *  requires in several ways is one. */
  alternatives(node) {
    const whole = this.at(node), several = whole.properties ? null : whole.oneOf ?? whole.anyOf;
    if (!several) return whole.type === "null" ? [] : [whole];
    return several.flatMap((one) => this.alternatives(one)).map((one) => ({ unit: whole.unit, ...one }));
  }

  /**
   * How a field is shown: kind is one of
   *   choice  one of several mappings, told apart by the field `key`: branches by name, and names that stand alone
   *   preset  a name, or one of the mappings `branches`
   *   group   a mapping of the fields of `branches`
   *   list    of `items`
   *   flag, select (of `names`), text, or yaml (anything, on one line)
   */
  field(node) {
    const whole = this.at(node), all = this.alternatives(node);
    const names = all.flatMap((one) => one.enum ?? (typeof one.const === "string" ? [one.const] : []));
    const mappings = all.filter((one) => one.properties), lists = all.filter((one) => one.type === "array");
    const scalars = all.filter((one) => !one.enum && one.const === undefined && ["number", "integer", "string"].includes(one.type));
    const told = { description: whole.description ?? "", default: whole.default, unit: whole.unit || all.find((one) => one.unit)?.unit || "", limits: this.limits(whole, all), range: this.range(whole, all), colour: all.some((one) => one.pattern?.startsWith("^#")), names };
    const key = mappings.length > 1 ? this.key(mappings) : "";
    if (key || mappings.some((one) => one.properties.plugin?.const)) {
      const by = key || "plugin", branches = Object.fromEntries(mappings.map((one) => [one.properties[by].const, one]));
      return { ...told, kind: "choice", key: by, branches };
    }
    if (mappings.length && names.length && !scalars.length && !lists.length) return { ...told, kind: "preset", branches: mappings };
    if (mappings.length && !names.length && !scalars.length && !lists.length) return { ...told, kind: "group", branches: mappings };
    if (mappings.length || (lists.length && (scalars.length || names.length || lists.length > 1))) return { ...told, kind: "yaml" };
    if (lists.length) return this.list(told, lists[0]);
    if (all.length && all.every((one) => one.type === "boolean")) return { ...told, kind: "flag" };
    if (names.length && !scalars.length) return { ...told, kind: "select" };
    if (scalars.length) return { ...told, kind: "text", plain: scalars.every((one) => one.type === "string") };
    return { ...told, kind: "yaml" };
  }

  list(told, list) {
    const inside = list.items && this.field(list.items);
    if (inside && ["choice", "group", "preset"].includes(inside.kind)) return { ...told, kind: "list", items: list.items };
    const parts = (list.prefixItems ?? (list.items ? [list.items] : [])).map((one) => this.field(one));
    return { ...told, kind: "yaml", unit: told.unit || parts[0]?.unit || "", names: parts[0]?.names ?? [],
      limits: [list.prefixItems ? `${list.prefixItems.length} items` : "", parts[0]?.limits ?? ""].filter(Boolean).join(", each ") };
  }

  /** The field that has another fixed value in each of several mappings. */
  key(mappings) {
    const fixed = (one) => Object.keys(one.properties).filter((name) => one.properties[name].const !== undefined);
    return fixed(mappings[0]).find((name) => new Set(mappings.map((one) => one.properties[name]?.const)).size === mappings.length) ?? "";
  }

  /** Of several mappings the one that has most of the fields that are written. */
  branch(branches, value) {
    const written = Object.keys(value ?? {}), known = (one) => written.filter((name) => name in one.properties).length;
    return branches.reduce((best, one) => (known(one) > known(best) ? one : best));
  }

  /** Of a choice the mapping that is named; where none is, the one that need not be. */
  chosen({ key, branches }, value) {
    const name = value?.[key];
    return name === undefined ? Object.values(branches).find((one) => !(one.required ?? []).includes(key)) : branches[name];
  }

  /** The two limits of one number: low, high, whether they are left out, and whether it is whole. */
  range(whole, all) {
    const numbers = [whole, ...all].filter((one) => ["number", "integer"].includes(one.type));
    const one = numbers.find((own) => (own.minimum ?? own.exclusiveMinimum) !== undefined && (own.maximum ?? own.exclusiveMaximum) !== undefined);
    return one && { low: one.minimum ?? one.exclusiveMinimum, high: one.maximum ?? one.exclusiveMaximum, whole: one.type === "integer", openLow: one.minimum === undefined, openHigh: one.maximum === undefined };
  }

  limits(whole, all) {
    const said = [];
    for (const one of [whole, ...all]) {
      for (const [bound, words] of BOUNDS) if (one[bound] !== undefined) said.push(`${words} ${short(one[bound])}`);
      if (one.type === "integer" && one.const === undefined) said.push("whole");
    }
    return [...new Set(said)].join(", ");
  }
}

/** A path as errors and the lines of fields have it: objects[0].model.size */
export const dotted = (path) => path.reduce((text, part) => (typeof part === "number" ? `${text}[${part}]` : text ? `${text}.${part}` : part), "");

/** A value as it is written in YAML on one line, for showing. */
export const shown = (value) => {
  if (value === undefined || value === null) return "";
  if (Array.isArray(value)) return `[${value.map(shown).join(", ")}]`;
  if (typeof value === "object") return `{${Object.entries(value).map(([key, one]) => `${key}: ${shown(one)}`).join(", ")}}`;
  return String(value);
};
