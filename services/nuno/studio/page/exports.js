import { ask } from "./ask.js";
import { make } from "./dom.js";
import { bytes } from "./words.js";

/** How often a file that is being made is asked about [ms]. */
const OFTEN = 300;
const KINDS = [
  ["png", "Picture", "This frame from where it is seen here, PNG"], ["mp4", "Film", "All frames from where they are seen here, MP4"], ["glb", "Mesh", "Cloth and bodies in the last frame, GLB"],
  ["csv", "Table", "Energy, stretch and more of every frame, CSV"], ["scene", "Scene", "As it was run, YAML"],
];

/** Buttons for what can be had of a recording as a file, but of cloth that is dyed alone its shape; each is made by `nuno export`, and goes to the browser's downloads. */
export function exporter(recording, dyed, replay) {
  const size = make("input", { id: "export-size", value: "1920x1080", size: 11, ariaLabel: "Width and height of picture and film in pixels" });
  size.setAttribute("list", "export-sizes");
  const sizes = make("datalist", { id: "export-sizes" }, ...["960x720", "1280x720", "1920x1080", "3840x2160"].map((value) => make("option", { value })));
  const status = make("div", { id: "exported", role: "status" });
  const buttons = KINDS.filter(([kind]) => !dyed || kind !== "glb").map(([kind, text, title]) => make("button", { type: "button", id: `export-${kind}`, textContent: text, title, onclick: (e) => save(recording, kind, e.currentTarget, status, ["png", "mp4"].includes(kind) && replay.screen?.stage && replay.screen.frame ? { ...replay.seen(kind), size: size.value.trim() } : {}) }));
  return make("section", { className: "panel exports", ariaLabel: "Save as a file" }, make("span", { className: "soft", textContent: "Save as" }), make("span", { className: "group" }, ...buttons), ...(dyed ? [] : [make("label", { className: "soft" }, "of ", size, " pixels"), sizes]), status);
}

async function save(recording, kind, button, status, how) {
  const line = status.querySelector(`[data-kind="${kind}"]`) ?? make("p", { className: "soft" });
  line.dataset.kind = kind;
  status.append(line);
  button.disabled = true;
  for (let again = true; ; again = false) {
    const answer = await ask("export", { recording, kind, again, ...how });
    if (!answer.ok || answer.problem) { line.replaceChildren(make("pre", { className: "bad", textContent: answer.words ?? answer.problem })); break; }
    if (!answer.making) { finish(recording, kind, answer, line); break; }
    line.replaceChildren(`${answer.name} `, make("progress", { max: 1, ...(answer.share === null ? {} : { value: answer.share }), ariaLabel: `${answer.name}, made` }));
    await new Promise((later) => setTimeout(later, OFTEN));
    if (!line.isConnected) return;
  }
  button.disabled = false;
}

function finish(recording, kind, { name, bytes: size }, line) {
  const link = make("a", { href: `exported?recording=${encodeURIComponent(recording)}&kind=${kind}`, download: name, textContent: name });
  line.replaceChildren(link, ` ${bytes(size)}`);
  link.click();
}
