"""Files that are dropped on the page: stored under an unused name, and summed up by kind, figures and errors."""

from __future__ import annotations

import contextlib
import filecmp
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from io import BufferedIOBase
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from PIL import Image

from nuno.exports.cloth import as_png
from nuno.plugin_contract import registry
from nuno.recording.reader import open_recording, shortcoming
from nuno.scene import yaml_lines
from nuno.scene.files import MARK, SceneFiles, read_scene
from nuno.scene.templates import build_body, import_sheet, in_units
from nuno.studio import scenes
from nuno.studio.server import describe
from nuno_schemas.bodies import LARGEST, SMALLEST, UNITS, unit_of, units_for
from nuno_schemas.colour import as_rgb
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric
from nuno_schemas.pattern import Checked
from nuno_schemas.pictures import DrawnDraft

Rows = list[tuple[str, str]]
GATHER = 1.1
"""Ratio of a seam's two edges from which on it gets a remark, as in `nuno sew --check`."""
NO_MESH = ("cannot be read", "the mesh has no triangles")
"""First words of errors for files without a mesh."""
HEIGHT, WAIST = 1.65, 0.1
"""Height of the body of `skirt-walk`, and of its waist above its hips [m]."""
MOST_PIXELS = 100_000_000
LIKE = "interlock"
"""Fabric that supplies the values missing in a laboratory's sheet."""


@dataclass(frozen=True)
class Seen:
    """Summary of a file.

    kind      kind of file, or of the content of a text file
    title     kind in words
    rows      figures, by name
    mistakes  errors for the page
    is_body, is_cloth  of a mesh: whether it can be a body, or cloth
    crosses   of a mesh: whether it intersects itself
    mend      of a mesh: whether it is a body only if mended
    scale     of a mesh: its unit, if that is probably not the metre
    low, high  (3,) of a mesh: corners of its bounding box, in metres
    longest   of a mesh: longest side of its bounding box, in the file's unit
    joint, waist  of a motion: joint that can hold a skirt, and (3,) [m] initial position of a waist on a body of HEIGHT
    fabric    of a laboratory's sheet: fields of a scene's fabric
    picture   PNG, or empty
    """

    kind: str
    title: str
    rows: Rows
    mistakes: list[dict[str, Any]] = field(default_factory=list)
    is_body: bool = False
    is_cloth: bool = False
    crosses: bool = False
    mend: bool = False
    scale: str = ""
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    longest: float = 0.0
    joint: str = ""
    waist: tuple[float, ...] = ()
    fabric: Mapping[str, str] = field(default_factory=dict)
    picture: bytes = b""


def look(path: Path) -> Seen:
    """Return the summary of a file. Raises BadInput if its content is not of the kind of its ending."""
    try:
        return KINDS[path.suffix.lower()](path)
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}", path.name) from None
    except BadInput as error:
        if error.file is not None and Path(error.file).name == path.name:
            error.file = path.name
        raise


def _mesh(path: Path) -> Seen:
    files, name = SceneFiles(path.parent), path.name
    cloth = registry.load("nuno.models", "mesh")
    mistakes, rows, glb = list[BadInput](), Rows(), path.suffix.lower() == ".glb"
    shape, fault = build_body(path)
    x, faces = (np.zeros((0, 3)), np.zeros((0, 3), np.int32)) if shape is None else (shape.vertices, shape.faces)
    if fault is None:
        title, is_cloth = "a closed mesh", not glb
    else:
        if fault.problem.startswith(NO_MESH):
            raise fault
        rows = [("as a body", f"{fault.problem}: {fault.field}")]
        try:
            fabric: Fabric = cloth.build(cloth.Config(file=name, merge=path.suffix.lower() == ".obj"), files, 0)
            x, faces, is_cloth, title = fabric.position, fabric.faces, True, "a mesh that is not closed"
        except BadInput as no_cloth:
            is_cloth, title = False, "a mesh with mistakes"
            mistakes = [] if shape else [fault] if glb else [fault, no_cloth]
    if not len(x):
        return Seen("mesh", title, rows, [_describe_error(one, name) for one in mistakes])
    longest = float(np.ptp(x, axis=0).max())
    person, fits = unit_of(longest) or "1m", units_for(longest) if longest > LARGEST else {}
    only = next(iter(fits)) if len(fits) == 1 else "1m"
    # A mesh of a plausible size in metres may be a ball as well as a person.
    unit = "1m" if SMALLEST <= longest <= LARGEST else person if person != "1m" else only
    scaled = shape if unit == "1m" else build_body(path, unit)[0] or shape  # remarks name places in metres
    notes = scaled.notes if scaled else ()
    size = np.ptp(x, axis=0) * UNITS[unit]
    low, high = (UNITS[unit] * side for side in (x.min(axis=0), x.max(axis=0)))
    rows = [
        ("triangles", f"{len(faces):,}"), ("vertices", f"{len(x):,}"), ("closed", "no" if fault else "yes"),
        ("size", " x ".join(f"{side:.3g}" for side in size) + " m (x, y, z; y is up)"), *rows,
        *(("remark", note) for note in notes),
    ]  # fmt: skip
    if unit != "1m":
        rows.append(("unit", f"taken as {unit}: in metres it would be {longest:.3g} m long"))
    elif person != "1m":
        rows.append(("unit", f"taken as metres: a person if it were in {person}, {longest * UNITS[person]:.3g} m long"))
    elif fits:
        lengths = " or ".join(f"{one} ({long:.3g} m long)" for one, long in fits.items())
        rows.append(("unit", f"taken as metres: it is likelier in {lengths}; write it as the `scale` of the scene"))
    corners = tuple(map(float, low)), tuple(map(float, high))
    return Seen("mesh", title, rows, [_describe_error(one, name) for one in mistakes], shape is not None, is_cloth,
                any("passes through itself" in note for note in notes), shape is not None and fault is not None,
                as_scale(unit), *corners, longest)  # fmt: skip


def as_scale(unit: str) -> str:
    """Return a unit as a scene writes it; empty for the metre."""
    return re.sub(r"(\d)(?=[a-z])", r"\1 ", unit) if unit != "1m" else ""


def _pattern(path: Path) -> Seen:
    model = registry.offering("nuno.models", "check_pattern", "reads sewing patterns")
    pattern: Checked = model.check_pattern(SceneFiles(path.parent), path.name, GATHER)
    errors = [one for one in pattern.remarks if one.wrong]
    mistakes = [
        BadInput(f"{one.kind}: {one.text}", path.name, one.line, one.field or one.where, remedy=one.remedy)
        for one in errors
    ]
    openings = ", ".join(f"{100 * one.length:.1f} cm" for one in pattern.openings)
    rows: Rows = [
        ("panels", f"{len(pattern.panels)}: {', '.join(one.name for one in pattern.panels)}"),
        ("seams", f"{pattern.seams}, of {pattern.length:.2f} m in all"), ("openings", openings or "none"),
        ("cloth", f"{sum(one.area for one in pattern.panels):.2f} m²"),
    ]  # fmt: skip
    rows += [("remark", f"{one.kind}, {one.where}: {one.text}") for one in pattern.remarks if not one.wrong]
    title = "a sewing pattern" if not errors else "a sewing pattern that cannot be sewn"
    return Seen("pattern", title, rows, [describe(one) for one in mistakes])


def _motion(path: Path) -> Seen:
    motion = registry.offering("nuno.motions", "describe_motion", "reads captured motion")
    facts = dict(motion.describe_motion(path))
    if "stands" not in facts:  # no person, on whom a skirt could hang
        return Seen("skeleton", "a motion", list(facts.items()))
    up = "z" if facts["stands"].startswith("along z") else "y"
    mover = motion.prepare(motion.Config(file=path.name, height=HEIGHT, up=up, travel=False), SceneFiles(path.parent))
    joint = next((one for one in mover.joints if "hip" in one.lower()), mover.joints[0])
    hips = mover.pose(0.0)[1][mover.joints.index(joint)]
    waist = tuple(round(float(x), 3) for x in hips + np.array([0.0, WAIST, 0.0]))
    return Seen("motion", "a captured motion", list(facts.items()), joint=joint, waist=waist)


def _draft(path: Path) -> Seen:
    cloth = registry.offering("nuno.dye_cloths", "draw_draft", "draws drafts")
    drawn: DrawnDraft = cloth.draw_draft(path)
    return Seen("draft", "a weaving draft", list(drawn.facts.items()), picture=as_png(drawn.picture))


def _picture(path: Path) -> Seen:
    try:
        with Image.open(path, formats=("PNG", "JPEG")) as picture:
            width, height = picture.size
            if width * height > MOST_PIXELS:
                raise BadInput("too large a picture", path.name, value=f"{width} x {height} pixels",
                               limit=f"{MOST_PIXELS} pixels")  # fmt: skip
            kind = f"{picture.format}, {picture.mode}"
            upright = Image.fromarray(as_rgb(picture))
            rows: Rows = [("size", f"{upright.width} x {upright.height} pixels"), ("kind", kind)]
            upright.thumbnail((640, 640))
            small = as_png(np.asarray(upright))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        remedy = "scale it down" if "pixels" in str(error) else "save it as PNG or JPEG"
        raise BadInput(f"cannot be read as a picture: {error}", path.name, remedy=remedy) from None
    return Seen("picture", "a picture", rows, picture=small)


def _net(path: Path) -> Seen:
    model = registry.load("nuno.models", "net")
    fabric: Fabric = model.build(model.Config(file=path.name), SceneFiles(path.parent), 0)
    springs = len(fabric.springs.k) if fabric.springs is not None else 0
    rows: Rows = [
        ("masses", f"{len(fabric.mass):,}, of {fabric.mass.sum():.4g} kg in all"), ("springs", f"{springs:,}"),
        ("held", f"{int(fabric.pinned.sum()):,}"),
        ("size", " x ".join(f"{side:.3g}" for side in np.ptp(fabric.position, axis=0)) + " m"),
    ]  # fmt: skip
    return Seen("net", "a net of masses and springs", rows)


def _sheet(path: Path) -> Seen:
    imported, head = import_sheet(path, LIKE)
    fabric = in_units(imported, imported.fabric)
    rows: Rows = [("from", line) for line in head]
    rows += [(name, f"{text}  ({imported.how[name]})") for name, text in fabric.items()]
    return Seen("sheet", "a laboratory's sheet of a fabric", rows, fabric=fabric)


def _text(path: Path) -> Seen:
    """Summarise a scene, a pattern or a laboratory's sheet."""
    text = read_scene(path).removeprefix(MARK)
    if scenes.IS_SCENE.search(text):
        result = scenes.check(text, path)
        data = result["data"] or {}
        rows: Rows = [(name, str(data[name])) for name in ("name", "description", "duration") if data.get(name)]
        return Seen("scene", "a scene", rows, result["mistakes"])
    data, _ = yaml_lines.parse(text, path.name)
    if "instrument" in map(str.lower, map(str, data)):
        return _sheet(path)
    if "pattern" in data:
        return _pattern(path)
    limit = "nuno: 1 in a scene, pattern: in a sewing pattern, instrument: in a laboratory's sheet"
    raise BadInput("neither a scene nor a pattern nor a laboratory's sheet", path.name, limit=limit)


def _recording(path: Path) -> Seen:
    with open_recording(path) as recording:
        lacks = shortcoming(recording)
        rows: Rows = [("scene", str(recording.scene.get("name", ""))), ("lasts", f"{recording.span[1]:.4g} s")]
    return Seen("recording", "a recording", rows + ([("lacks", lacks)] if lacks else []))


def _describe_error(error: BadInput, name: str) -> dict[str, Any]:
    error.file = name if error.file is None or Path(error.file).name == name else error.file
    return describe(error)


KINDS: Mapping[str, Callable[[Path], Seen]] = {
    **dict.fromkeys((".obj", ".ply", ".stl", ".glb"), _mesh),
    **dict.fromkeys((".yaml", ".yml"), _text),
    **dict.fromkeys((".png", ".jpg", ".jpeg"), _picture),
    ".json": _pattern,
    ".bvh": _motion,
    ".wif": _draft,
    ".npz": _net,
    ".csv": _sheet,
    ".mcap": _recording,
}
"""Functions that summarise a file, by its ending."""


def files_of(folder: Path, kinds: Sequence[str]) -> list[Path]:
    """Return the files of a folder with these endings, newest first."""
    files = []
    for path in folder.glob("*"):
        if path.suffix.lower() in kinds and path.is_file():
            with contextlib.suppress(OSError):  # it was removed meanwhile
                files.append((-path.stat().st_mtime_ns, path.name, path))
    return [path for *_, path in sorted(files)]


# Files that are dropped on the page: stored in the folder under an unused name, or refused.

MOST = 2_000_000_000
"""Largest file [bytes]."""
PIECE = 1 << 20
SPARE = 200_000_000
"""Space that must stay free on the disk [bytes]."""
STEM = 60
"""Largest number of characters of a name, without its ending."""
Made = TypeVar("Made")


class Arrivals:
    """Stores files in a folder; those with an ending in `elsewhere` in the folder given there."""

    def __init__(self, folder: Path, elsewhere: dict[str, Path]) -> None:
        self.folder, self.elsewhere = folder, elsewhere

    def expect(self, name: object, size: object) -> str:
        """Return the name that a file will get. Raises BadInput for a file that will be refused."""
        if not isinstance(name, str) or not isinstance(size, int):
            raise BadInput("a file has a name and a size", field="name")
        stem, ending = os.path.splitext(name.replace("\\", "/").rpartition("/")[2])
        if ending.lower() not in KINDS:
            kinds = ", ".join(sorted(KINDS))
            raise BadInput("nuno reads no files of this kind", value=name[:100], limit=kinds)
        if not 0 < size <= MOST:
            raise BadInput("empty, or too large", name[:100], value=f"{size} bytes", limit=f"1 to {MOST} bytes")
        free = shutil.disk_usage(self.folder).free
        if size > free - SPARE:
            raise BadInput("there is no room for it on the disk", name[:100], value=f"{size} bytes",
                           limit=f"{max(0, free - SPARE)} bytes")  # fmt: skip
        # Letters of any script; not the first characters of a path, a hidden file or a flag.
        stem = re.sub(r"[^\w. ()+-]", "-", stem)[:STEM].strip(" .-") or "file"
        return stem + ending.lower()

    def receive(
        self, name: str, stream: BufferedIOBase, length: int, look: Callable[[Path], Made]
    ) -> tuple[Path, Made]:
        """Store a file from a stream, and return its path and the result of `look`, which may refuse it.

        A file that exists already, with the same name and bytes, is not stored again. Raises BadInput.
        """
        name = self.expect(name, length)
        folder = self.elsewhere.get(Path(name).suffix, self.folder)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            # In the same folder, so that the move is atomic; under its own name, which errors mention.
            with tempfile.TemporaryDirectory(dir=folder, prefix=".nuno-") as temporary:
                path = Path(temporary) / name
                _copy(stream, path, length)
                result = _look_at(look, path)
                target = reserve(folder, name, path)
                if not target.stat().st_size:
                    path.replace(target)
                return target, result
        except OSError as error:
            raise BadInput(f"cannot be written: {error.strerror}", name) from None


def _look_at(look: Callable[[Path], Made], path: Path) -> Made:
    """Return `look(path)`; errors name the file without its temporary folder."""
    try:
        return look(path)
    except BadInput as error:
        values = {one.name: getattr(error, one.name) for one in fields(error)}
        for place in (str(path.resolve()), str(path)):
            values = {
                key: text.replace(place, path.name) if isinstance(text, str) else text for key, text in values.items()
            }
        raise BadInput(**values) from None


def _copy(stream: BufferedIOBase, path: Path, length: int) -> None:
    """Copy `length` bytes of a stream to a file. Raises BadInput if the stream ends before."""
    with path.open("xb") as file:
        while length:
            piece = stream.read(min(PIECE, length))
            if not piece:
                raise BadInput("it broke off on its way", path.name, remedy="drop it again")
            file.write(piece)
            length -= len(piece)


def reserve(folder: Path, name: str, like: Path | None = None) -> Path:
    """Create an empty file of an unused name, if necessary with a number after its stem; or return an existing file of
    such a name with the same bytes as `like`. Raises OSError.
    """
    stem, ending = os.path.splitext(name)
    number = 1
    while True:
        path = folder / (name if number == 1 else f"{stem}-{number}{ending}")
        try:
            path.open("xb").close()
            return path
        except FileExistsError:
            if like is not None and path.is_file() and filecmp.cmp(path, like, shallow=False):
                return path
            number += 1
