"""Files of the studio's folder: dropped on the page or drawn there, described, and turned into scenes by offers."""

from __future__ import annotations

import contextlib
import io
import math
import re
import shutil
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from io import BufferedIOBase
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from nuno.dye.run import build_cloth
from nuno.plugin_contract import registry
from nuno.scene import shipped
from nuno.scene.files import stamp_of
from nuno.scene.override import as_override as _as
from nuno.scene.templates import Garment, describe_worn, load_after, name_garments, unit_for, write_after
from nuno.studio.dropped_files import KINDS, MOST, Arrivals, Seen, as_scale, files_of, look, reserve
from nuno.studio.scenes import check_target, write_whole
from nuno.studio.server import NOT_FOUND, Refused
from nuno_schemas.colour import upright
from nuno_schemas.dye import Cells
from nuno_schemas.errors import BadInput, nearest

LISTED = tuple(kind for kind in KINDS if kind not in (".yaml", ".yml", ".mcap"))
"""Endings of listed files: those of scenes and recordings have lists of their own."""


class Files:
    """The files of a folder; dropped recordings go into another folder."""

    def __init__(self, folder: Path, recordings: Path) -> None:
        self.folder = folder
        self._arrivals = Arrivals(folder, {".mcap": recordings})
        self._seen: dict[Path, tuple[tuple[int, int], Seen]] = {}
        self._looking = threading.Lock()

    def take(self, name: str, stream: BufferedIOBase, length: int) -> dict[str, Any]:
        """Take a file that is dropped on the page, and describe it with its offers. Raises BadInput."""
        path, seen = self._arrivals.receive(name, stream, length, self._look_alone)
        if seen.kind != "scene":  # a scene names files next to its final place
            self._seen[path] = (stamp_of(path), seen)
        return self._describe(path)

    def files(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return the names of the listed files, newest first, and the endings and size of files that may be dropped."""
        names = [path.name for path in files_of(self.folder, LISTED)]
        return {"files": names, "kinds": sorted(KINDS), "most": MOST}

    def expect(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return the name that a file will get, before it is sent. Raises BadInput if it would be refused."""
        return {"name": self._arrivals.expect(request.get("name"), request.get("bytes"))}

    def about(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Describe a file of the folder with its offers. Raises BadInput."""
        return self._describe(self._find(request.get("file")))

    def make(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Carry out an offer for a file, and return the name of the new scene. Raises BadInput."""
        chosen = request.get("chosen")
        path = self._find(request.get("file"))
        scene = make(path, self._look, request.get("offer"), chosen if isinstance(chosen, dict) else {})
        return {"scene": scene.name}

    def drawdown(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return a draft's rows of 0 and 1, and its text if that says no more and may be replaced. Raises BadInput."""
        path = self._find(request.get("file"))
        drawdown = registry.offering("nuno.dye_cloths", "draw_draft", "draws drafts").draw_draft(path).drawdown
        rows = [bytes(row).decode() for row in drawdown + np.uint8(ord("0"))]
        text = as_wif(rows)
        return {"rows": rows, "text": text if path.read_bytes() == text.encode() else None}

    def save_draft(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Save a drawn weave; return its text, and describe the draft with its offers. Raises BadInput."""
        name, text = request.get("name"), as_wif(request.get("rows"))
        name = f"{name}.wif" if isinstance(name, str) and name and "." not in name else name
        if not NEW_DRAFT.fullmatch(str(name)):
            limit = "letters, digits, - _ ., and at its end .wif or nothing"
            raise BadInput("not the name of a draft's file", field="name", value=name, limit=limit)
        path = self.folder / str(name)
        check_target(path, request.get("before"))
        write_whole(path, text)
        return {"text": text} | self._describe(path)

    def picture(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        """Return the picture of a file. Raises Refused."""
        try:
            picture = self._look(self._find(query.get("file", [""])[0])).picture
        except BadInput:
            picture = b""
        if not picture:
            raise Refused(NOT_FOUND, "there is no such picture")
        return "image/png", picture

    def _find(self, name: object) -> Path:
        path = next((one for one in files_of(self.folder, tuple(KINDS)) if one.name == name), None)
        if path is None:
            raise BadInput("no such file here", value=name, remedy="load the list again")
        return path

    def _look_alone(self, path: Path) -> Seen:
        """Read a file, one at a time because files may be large."""
        with self._looking:
            return look(path)

    def _look(self, path: Path) -> Seen:
        """Read a file once until it changes: a mesh takes seconds."""
        with self._looking:
            stamp = stamp_of(path)
            if self._seen.get(path, (None,))[0] != stamp:
                self._seen[path] = (stamp, look(path))
            return self._seen[path][1]

    def _describe(self, path: Path) -> dict[str, Any]:
        seen = self._look(path)
        return {
            "file": path.name, "kind": seen.kind, "title": seen.title, "rows": seen.rows, "mistakes": seen.mistakes,
            "pictured": bool(seen.picture), "offers": describe(offers_for(seen), path.parent),
        }  # fmt: skip


# Weaves drawn on the page.

NEW_DRAFT, MOST_YARNS = re.compile(r"[A-Za-z0-9][\w.-]{0,100}\.wif", re.ASCII), 100
"""Allowed names of a drawn draft, and its most ends, and picks."""


def as_wif(rows: object) -> str:
    """Return the WIF file of a weave drawn as rows of 0 and 1. Raises BadInput for what is no weave, or too large."""
    drawn = rows if isinstance(rows, list) and all(isinstance(row, str) for row in rows) else []
    sizes = [len(drawn), *map(len, drawn)]
    if not 1 <= min(sizes) <= max(sizes) <= MOST_YARNS:
        shape = f"{len(drawn)} picks x {max(sizes[1:], default=0)} ends"
        raise BadInput("no weave that can be drawn", field="rows", value=shape, limit=f"1 to {MOST_YARNS} of each")
    return str(registry.offering("nuno.dye_cloths", "write_draft", "writes drafts").write_draft(drawn))


# Offers for a file: each writes a scene next to it, as `nuno sew` and `nuno new` do, ready to run.

AFTER = "dye/draft"
FEWEST_CELLS, MOST_CELLS = 320, 600
"""Cells along a side: smaller drafts are repeated, larger cloth gets larger cells, as far as its yarns allow."""
BATH = 0.85
"""Diameter of the bath over the shorter side of the cloth."""


def weave(scene: Path, draft: str, stencil: str) -> Path:
    """Write a scene with a whole draft, or a twill; a stencil, if given, keeps dye out. Raises BadInput."""
    text = f"Cloth woven after {draft or 'a twill'}, dyed with indigo{f' around {stencil}' if stencil else ''}."
    image = {"kind": "image", "file": stencil and _grey(scene.parent, stencil), "fit": "stretch"}
    changes = [_as("description", text), _as("dye.cloth.resist", [image] if stencil else [])]
    if draft:
        changes.append(_as("dye.cloth.weave.file", draft))
        try:
            cells = _woven(scene, [*changes, _as("dye.cloth.cells", None)])
        except BadInput as error:
            if not str(error.field).endswith("Spacing"):
                raise
            # The file has no spacing of its yarns: use that of other weaves.
            changes.append(_as("dye.cloth.weave.measured", False))
            cells = _woven(scene, [*changes, _as("dye.cloth.cells", None)])
        nx, ny = (n * math.ceil(FEWEST_CELLS / n) for n in cells.fibre.shape[:0:-1])
        changes.append(_as("dye.cloth.cells", [nx, ny]))
        for times in range(math.ceil(max(nx, ny) / MOST_CELLS), 1, -1):
            coarser = [*changes, _as("dye.cloth.coarser", times)]
            with contextlib.suppress(BadInput):  # a yarn, or a gap, would be narrower than a cell
                _woven(scene, coarser)
                changes = coarser
                break
        width, height = nx * cells.size, ny * cells.size
        middle = [round(0.5 * side, 5) for side in (width, height)]
        region = {"shape": "disc", "centre": middle, "diameter": round(BATH * min(width, height), 5)}
        changes.append(_as("dye.cloth.supply", [{"kind": "bath", "region": region, "amount": 0.9}]))
    return write_after(AFTER, scene, changes)[-1]


def _woven(scene: Path, changes: Sequence[str]) -> Cells:
    """Build the cloth of a scene before it is dyed. Raises BadInput if it cannot be woven."""
    return build_cloth(load_after(AFTER, scene, [*changes, _as("dye.cloth.supply", [])]))[0]


def _grey(folder: Path, stencil: str) -> str:
    """Return the name of a stencil as a grey PNG: the file itself, or a converted copy next to it."""
    with Image.open(folder / stencil) as picture:
        if picture.format == "PNG" and picture.mode in ("1", "L", "LA", "I", "I;16"):
            return stencil
        grey = io.BytesIO()
        upright(picture).convert("LA" if "A" in picture.getbands() else "L").save(grey, "PNG")
    with tempfile.NamedTemporaryFile() as file:
        file.write(grey.getvalue())
        file.flush()
        target = reserve(folder, f"{Path(stencil).stem}-grey.png", Path(file.name))
    target.write_bytes(grey.getvalue())
    return target.name


# Choices for a new scene: other files of the folder, and files shipped with nuno.

NONE, OWN = "", "nuno:"
"""The choice of nothing, and the prefix of names of files shipped with nuno."""
GARMENTS = {
    "shirt-on-mannequin": "a T-shirt cut to it", "circle-skirt": "a circle skirt",
    "skirt-on-mannequin": "a fitted skirt", "poncho": "a poncho",
}  # fmt: skip
"""Scenes of garments that are cut to a body, which they call `mannequin`."""
MESHES, PATTERNS, PICTURES = (".obj", ".ply", ".stl", ".glb"), (".json",), (".png", ".jpg", ".jpeg")
Option = tuple[str, str]


@dataclass(frozen=True)
class Choice:
    """A choice in an offer: its name, its heading, and options of value and text; the first is the default."""

    name: str
    label: str
    options: Sequence[Option]


def _named(folder: Path, kinds: Sequence[str]) -> list[Option]:
    return [(path.name, path.name) for path in files_of(folder, kinds)]


def bodies(folder: Path) -> Choice:
    return Choice("body", "body", [*_named(folder, MESHES), (NONE, "the mannequin that comes with nuno")])


def patterns(folder: Path) -> Choice:
    with_nuno = [(f"{OWN}{path.name}", f"{path.stem}, with nuno") for path in sorted(sewn().glob("*.yaml"))]
    return Choice("pattern", "pattern", [*_named(folder, PATTERNS), *with_nuno])


def motions(folder: Path) -> Choice:
    options = [(path.name, f"moved by {path.name}") for path in files_of(folder, (".bvh",))]
    return Choice("motion", "it", [(NONE, "stands"), *options, (f"{OWN}walk.bvh", "walks, with nuno")])


def fabrics(_: Path) -> Choice:
    model = registry.offering("nuno.models", "check_pattern", "reads sewing patterns")
    schema = model.Config.model_json_schema()["properties"]["fabric"]
    names = next(one["enum"] for one in schema["oneOf"] if "enum" in one)
    return Choice(
        "fabric", "fabric", [(name, name) for name in sorted(names, key=lambda name: name != schema["default"])]
    )


def garments(_: Path) -> Choice:
    return Choice("garment", "garment", list(GARMENTS.items()))


def stencils(folder: Path) -> Choice:
    return Choice("stencil", "with", [(NONE, "no stencil"), *_named(folder, PICTURES)])


def drafts(folder: Path) -> Choice:
    return Choice("draft", "draft", [*_named(folder, (".wif",)), (NONE, "a twill that comes with nuno")])


def below(folder: Path) -> Choice:
    return Choice("body", "on", [(NONE, "a ball"), *_named(folder, MESHES)])


def sewn() -> Path:
    return shipped.folder() / "sewn" / "patterns"


EDGE = "2 cm"
"""Edge length of a pattern's triangles, as in `nuno sew`."""
GAP = 0.05
"""Gap between a body and a cloth above it at the start [m]."""
BALL = 0.7
"""Height of the top of the ball of `drape-over-sphere` [m]."""


@dataclass(frozen=True)
class Task:
    """A file, its summary, the values of the choices by name, and the function that summarises other files."""

    path: Path
    seen: Seen
    chosen: Mapping[str, str]
    see: Callable[[Path], Seen]

    @property
    def folder(self) -> Path:
        return self.path.parent

    def new(self, *parts: str) -> Path:
        """Return the path of a new scene, named after its parts."""
        (name,) = name_garments(["-".join(Path(part).stem for part in parts)])
        path = reserve(self.folder, f"{name}.yaml")
        path.unlink()
        return path

    def write(self, after: str, scene: Path, description: str, *changes: str) -> Path:
        """Write a scene after one of nuno's, with changes (`key=value`)."""
        return write_after(after, scene, [_as("description", description), *changes])[-1]

    def collider(self, body: str) -> dict[str, Any]:
        """Return the collider of a body from a mesh of the folder."""
        seen = self.see(self.folder / body)
        flags = ({"scale": seen.scale} if seen.scale else {}) | ({"mend": True} if seen.mend else {})
        return {"plugin": "mesh", "file": body} | flags


@dataclass(frozen=True)
class Offer:
    """An offer: its description and choices; `make` writes the scene and returns its path."""

    name: str
    text: str
    make: Callable[[Task], Path]
    choices: tuple[Callable[[Path], Choice], ...] = ()


def offers_for(seen: Seen) -> list[Offer]:
    """Return the offers for a file, the likeliest first."""
    if seen.kind == "mesh":
        as_body, as_cloth = [WEAR, DRESS, COVER, STOCKING] * seen.is_body, [FALL] * seen.is_cloth
        return as_cloth + as_body if seen.mend else as_body + as_cloth
    return [] if seen.mistakes else BY_KIND.get(seen.kind, [])


def describe(offers: Sequence[Offer], folder: Path) -> list[dict[str, Any]]:
    """Return offers as JSON for the page."""
    return [
        {"name": one.name, "text": one.text, "choices": [asdict(find(folder)) for find in one.choices]}
        for one in offers
    ]


def make(path: Path, see: Callable[[Path], Seen], name: object, chosen: Mapping[str, object]) -> Path:
    """Carry out an offer for a file, and return the new scene. Raises BadInput for an invalid choice."""
    seen = see(path)
    offers = {one.name: one for one in offers_for(seen)}
    if not isinstance(name, str) or name not in offers:
        raise BadInput("this cannot be done with it", path.name, value=name, remedy=nearest(str(name), offers))
    offer, picked = offers[name], dict[str, str]()
    for choice in (find(path.parent) for find in offer.choices):
        values = [value for value, _ in choice.options]
        value = chosen.get(choice.name, values[0])
        if value not in values:
            raise BadInput("no such choice", field=choice.name, value=value, remedy=nearest(str(value), values))
        picked[choice.name] = str(value)
    return offer.make(Task(path, seen, picked, see))


def _copy_shipped(folder: Path, chosen: str, shipped_folder: Path) -> str:
    """Return the name of a chosen file in a folder, after copying a shipped file into it."""
    if not chosen.startswith(OWN):
        return chosen
    source = shipped_folder / chosen.removeprefix(OWN)
    target = reserve(folder, source.name, source)
    if not target.stat().st_size:
        shutil.copyfile(source, target)
    return target.name


def _wear(task: Task, body: str = NONE, pattern: str = NONE, motion: str = NONE) -> Path:
    """Write a scene as `nuno sew PATTERN --body BODY --motion BVH` does; omitted arguments are the user's choices."""
    chosen = {"body": body, "pattern": pattern, "motion": motion}
    body, pattern, motion = (chosen[what] or task.chosen.get(what, NONE) for what in chosen)
    pattern = _copy_shipped(task.folder, pattern, sewn())
    worn_by = task.see(task.folder / body) if body else None
    unit = as_scale(unit_for(worn_by.longest, [task.folder / pattern])) if worn_by else ""
    motion = _copy_shipped(task.folder, motion, shipped.folder())
    scene = task.new(pattern, "worn")
    (name,) = name_garments([Path(pattern).stem])
    worn = [Garment(name, pattern, task.chosen["fabric"])]
    flags = unit, worn_by is not None and worn_by.mend
    text = describe_worn(scene.stem, worn, EDGE, body or None, motion or None, flags)
    scene.write_text(text, encoding="utf-8")
    return scene


def _dress(task: Task) -> Path:
    garment = task.chosen["garment"]
    scene = task.new(garment.replace("-on-mannequin", ""), task.path.stem)
    changes = [_as("bodies.mannequin.collider", task.collider(task.path.name))]
    if task.seen.crosses:  # like scanned bodies at the mouth: vertices cannot slide on it, but cloth contact works
        changes += [_as("contact", {"plugin": "penalty"}), _as("cloth_contact", _meets("mannequin"))]
    return task.write(garment, scene, f"{GARMENTS[garment].capitalize()}: {task.path.name}.", *changes)


def _meets(body: str) -> dict[str, Any]:
    """Return a cloth contact that treats a body as cloth."""
    return {"plugin": "offset", "thickness": "2 mm", "bodies": [body]}


def _cover(task: Task) -> Path:
    """Write a scene with a square of cloth, 1.5 times as wide as the body, above the body."""
    low, high = task.seen.low, task.seen.high
    side = round(1.5 * max(high[0] - low[0], high[2] - low[2]) + 0.2, 2)
    body = {"name": "body", "collider": task.collider(task.path.name), "friction": 0.4}
    return task.write("drape-over-sphere", task.new("cover", task.path.stem), f"A cloth falls over {task.path.name}.",
        _as("objects.cloth.model.size", [side, side]),
        _as("objects.cloth.model.centre", [_middle(low, high, 0), round(high[1] + GAP, 4), _middle(low, high, 2)]),
        _as("objects.cloth.model.fabric", task.chosen["fabric"]),
        _as("bodies.floor.collider.point", [0.0, round(min(0.0, low[1]), 4), 0.0]),
        _as("bodies.ball", body), _as("cloth_contact", _meets("body")),
    )  # fmt: skip


def _middle(low: Sequence[float], high: Sequence[float], axis: int) -> float:
    return round(0.5 * (low[axis] + high[axis]), 4)


def _stocking(task: Task) -> Path:
    body = _as("bodies.leg.collider", task.collider(task.path.name))
    scene = task.new("stocking", task.path.stem)
    return task.write("knit/stocking-leg", scene, f"A stocking is drawn over {task.path.name}.", body)


def _fall(task: Task) -> Path:
    """Write a scene with the mesh as cloth, just above a ball, or on a body at the positions of its file."""
    low, high = task.seen.low, task.seen.high
    model: dict[str, Any] = {"plugin": "mesh", "file": task.path.name, "fabric": task.chosen["fabric"]}
    model |= {"scale": task.seen.scale} if task.seen.scale else {}
    model |= {"merge": True} if task.path.suffix.lower() == ".obj" else {}
    if task.chosen["body"]:
        description = f"{task.path.name}, as cloth, on {task.chosen['body']}."
        return task.write("sewn/shirt", task.new(task.path.stem, "worn"), description,
            _as("objects.shirt", {"name": "cloth", "colour": "#5b84b8", "model": model}),
            _as("bodies.mannequin.collider", task.collider(task.chosen["body"])),
        )  # fmt: skip
    model["centre"] = [-_middle(low, high, 0), round(BALL + GAP - low[1], 4), -_middle(low, high, 2)]
    scene = task.new(task.path.stem, "falls")
    description = f"{task.path.name} falls, as cloth, on a ball."
    return task.write("drape-over-sphere", scene, description, _as("objects.cloth.model", model))


def _dance(task: Task) -> Path:
    description = f"A skirt on a skeleton that goes by {task.path.name}."
    return task.write("skirt-walk", task.new("skirt", task.path.stem), description,
        _as("bodies.walker.motion.file", task.path.name), _as("objects.skirt.model.attach.frame", task.seen.joint),
        _as("objects.skirt.model.centre", list(task.seen.waist)),
    )  # fmt: skip


def _weave(task: Task, draft: str, stencil: str, what: str) -> Path:
    return weave(task.new(task.path.stem, what), draft, stencil)


def _change(scene: str, field: str, description: str, parts: tuple[str, str] | None = None) -> Callable[[Task], Path]:
    """Return a function that writes a scene of nuno's with the file in one of its fields."""

    def write(task: Task) -> Path:
        names = [part or task.path.stem for part in parts or (NONE, scene)]
        value = dict(task.seen.fabric) or task.path.name
        return task.write(scene, task.new(*names), description.format(task.path.name), _as(field, value))

    return write


NET, PRINTED, DRAPED = (
    "The masses and springs of {}.",
    "A skirt printed with {}.",
    "The fabric of {} falls over a ball.",
)
WEAR = Offer("wear", "Put a sewing pattern on it", lambda task: _wear(task, body=task.path.name),
             (patterns, fabrics, motions))  # fmt: skip
DRESS = Offer("dress", "Cut a garment to it", _dress, (garments,))
COVER = Offer("cover", "Let a cloth fall over it", _cover, (fabrics,))
STOCKING = Offer("stocking", "Draw a stocking over it, a leg", _stocking)
FALL = Offer("fall", "Let it fall, as cloth", _fall, (below, fabrics))
BY_KIND = {
    "pattern": [Offer("wear", "Put it on a body", lambda task: _wear(task, pattern=task.path.name),
                      (bodies, fabrics, motions))],
    "motion": [
        Offer("wear", "A body goes by it, in a garment", lambda task: _wear(task, motion=task.path.name),
              (bodies, patterns, fabrics)),
        Offer("dance", "A skirt swings on its skeleton", _dance),
    ],
    "draft": [Offer("weave", "Weave it, and dye it",
                    lambda task: _weave(task, task.path.name, task.chosen["stencil"], "woven"), (stencils,))],
    "picture": [
        Offer("resist", "Keep dye out with it, as a stencil",
              lambda task: _weave(task, task.chosen["draft"], task.path.name, "resist"), (drafts,)),
        Offer("print", "Print it on a skirt",
              _change("skirt-walk", "objects.skirt.model.texture", PRINTED, ("skirt", NONE))),
    ],
    "net": [Offer("net", "Let it swing", _change("net", "objects.chain.model.file", NET))],
    "sheet": [Offer("drape", "Drape this fabric over a ball",
                    _change("drape-over-sphere", "objects.cloth.model.fabric", DRAPED, (NONE, "drape")))],
}  # fmt: skip
"""Offers for each kind of file except meshes."""
