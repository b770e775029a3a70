import { ask } from "./ask.js";
import { make, sentence } from "./dom.js";
import { Entry } from "./entry.js";
import { Form } from "./form.js";

const MESHES = /\.(obj|ply|stl|glb)$/i, PATTERNS = /\.json$/i;

/** What a maker chooses: of each piece of cloth its garment, fabric and colour, and the body. All else is in the form. */
export class Maker extends Form {
  constructor(...parts) { super(...parts); Object.assign(this, { prefix: "maker:", files: [] }); }

  /** Take the files of the folder as choices. */
  async list() {
    const answer = await ask("files");
    if (answer.ok) { this.files = answer.files; this.again(); }
  }

  /** Mistakes stand here while the form is not seen. */
  place() { this.placed = new Set(); if (!document.getElementById("advanced").open) super.place(); }

  /** The schema's node of a path, as the data has it. */
  node(path) {
    let node = this.schema.root, value = this.data;
    for (const part of path) {
      const found = this.schema.field(node);
      node = typeof part === "number" ? found.items : (found.kind === "choice" ? this.schema.chosen(found, value) : this.schema.branch(found.branches, value))?.properties[part];
      if (!node) return null;
      value = value?.[part];
    }
    return { field: this.schema.field(node), value };
  }

  fields() {
    const { objects, bodies } = this.data, lists = [objects, bodies].map((one) => (Array.isArray(one) ? one : []));
    const rows = lists[0].flatMap((one, i) => this.garment(one ?? {}, ["objects", i], lists[0].length > 1));
    rows.push(...lists[1].flatMap((one, i) => one?.collider?.plugin === "plane" ? [] : this.file("Body", MESHES, ["bodies", i, "collider", "file"]) ?? this.plain("Body", [one?.name, one?.motion && `moved by ${one.motion.plugin ?? one.motion}`].filter(Boolean).join(", "))));
    return rows.length ? rows : [make("p", { className: "soft", textContent: "This scene has no garment and no body: what it has is behind Advanced." })];
  }

  garment({ name, model }, path, several) {
    const entry = (label, ...more) => { const found = this.node([...path, ...more]); return found && ["preset", "text", "select"].includes(found.field.kind) ? [new Entry(this, found.field, found.value, [...path, ...more], found.value !== undefined, label).row] : []; };
    // Lengths that are written, but for that of triangles: those of a garment without a pattern.
    const lengths = Object.entries(model ?? {}).filter(([key, value]) => key !== "edge" && typeof value === "string" && this.node([...path, "model", key])?.field.unit === "m");
    return [...(several ? [make("h2", { textContent: name ?? "" })] : []), this.file("Garment", PATTERNS, [...path, "model", "file"]) ?? this.plain("Garment", typeof model === "string" ? model : model?.plugin ?? ""),
      ...lengths.flatMap(([key]) => entry(sentence(key.replaceAll("_", " ")).slice(0, -1), "model", key)), ...entry("Fabric", "model", "fabric"), ...entry("Colour", "colour")];
  }

  plain(label, text) { return make("div", { className: "field" }, make("label", { textContent: label }), make("span", { textContent: text })); }

  /** A file that is named, to be chosen from those of its kind beside the scene; null where none is named. */
  file(label, kind, path) {
    const value = this.node(path)?.value;
    if (typeof value !== "string") return null;
    return new Entry(this, { kind: "select", names: [...new Set([value, ...this.files.filter((name) => kind.test(name))])], description: "" }, value, path, true, label).row;
  }
}
