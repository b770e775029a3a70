"""Export of a recording to files, by a request with their names and settings."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from importlib import import_module
from inspect import signature
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from nuno.exports.camera import SIDES, Side
from nuno.output_files import RATE, Progress, check_folder, check_target, together
from nuno.recording.reader import Recording
from nuno.scene.validation_errors import explain
from nuno_schemas.dyeing import Crop, DyeView, Form
from nuno_schemas.errors import BadInput
from nuno_schemas.units import quantity

if TYPE_CHECKING:
    from nuno.exports.dyed_pictures import Changes
    from nuno.exports.pictures import Rendering

Time = Annotated[float, quantity("s")]
Length = str | float
"""A length with its unit, or in metres."""
MESHES = (".obj", ".ply", ".glb")
FOLDERS = (*MESHES, ".pc2", ".mdd")
"""Endings of files that may be a folder instead: of a file of every frame, or of every object."""
FILES = {
    "npz": "float64 x, v, t (dye: phi, fixed, t; knits: pressure) of the last checkpoint, or of --frame",
    "forces": "what acts on cloth in a frame, as .npz: forces by kind, accelerations, masses, springs and tensions",
    "csv": "energy, stretch, penetration, dye and step time of every frame",
    "png": "a picture of a frame",
    "gif": "an animation",
    "mp4": "an animation (needs nuno[video])",
    "obj": "the cloth in a frame; a folder: every frame",
    "ply": "the cloth in a frame; a folder: every frame",
    "glb": "the cloth and bodies in a frame; a folder: every frame",
    "usd": "the cloth and bodies over time, or in --frame, .usdz (needs nuno[usd])",
    "pc2": "the cloth's vertices over time, for a mesh written by --obj; a folder: a file of each object",
    "mdd": "the same in another format",
    "rrd": "a file for the rerun viewer",
    "foxglove": "cloth and bodies as meshes, curves and log for Foxglove or Lichtblick, .mcap, and its .layout.json",
    "ros2": "the same for RViz and ros2 bag play: a new folder, a bag of ROS 2 (needs nuno[ros])",
    "pattern": "the flat pattern of sewn garments at true size, .svg or .pdf (needs nuno[pdf])",
    "yarns": "a knit's yarns as curves, .npz or .obj, of a frame",
    "scene": "the scene as it was run, .yaml, and the files that it names",
}
"""Kinds of files, by their flags."""
WRITERS = {
    **{name: f"nuno.resimulation.frame_state:export_{name}" for name in ("npz", "forces")},
    **{name: f"nuno.exports.tables:export_{name}" for name in ("csv", "scene")},
    "yarns": "nuno.python_api.export:export_curves", "pattern": "nuno.exports.pattern:export_pattern",
    **dict.fromkeys(("obj", "ply", "glb"), "nuno.exports.meshes:export_mesh"), "usd": "nuno.exports.usd:export_usd",
    **{name: f"nuno.exports.vertex_caches:export_{name}" for name in ("pc2", "mdd")},
    "foxglove": "nuno.exports.foxglove:export_foxglove", "png": "nuno.exports.pictures:export_picture",
    **dict.fromkeys(("gif", "mp4"), "nuno.exports.animations:export_animation"),
    "ros2": "nuno.exports.ros2:export_ros2", "rrd": "nuno.viewer.file:convert",
}  # fmt: skip
"""Function that writes each kind of file; the order is that of writing."""
WHOLE = ("csv", "gif", "mp4", "pc2", "mdd", "rrd", "foxglove", "ros2", "scene")
"""Kinds of files of a whole run."""
DRAWN = ("colour", "side", "size", "view", "scale", "crop", "overrides", "renderer")
"""Settings of pictures and animations."""
SHAPED = ("forces", "yarns", "pattern", "usd", "pc2", "mdd", "foxglove", "ros2")
"""Kinds of files, besides MESHES, that need a shape, which cloth that is only dyed does not have."""
ENDINGS: dict[str, tuple[str, ...]] = {
    "npz": (".npz",), "forces": (".npz",), "csv": (".csv",), "png": (".png",), "scene": (".yaml",),
    "yarns": (".npz", ".obj"), "pattern": (".svg", ".pdf"),
}  # fmt: skip
"""Endings of the names of single files."""
YARNS = ("samples", "radius", "curl")
"""Settings of yarns as curves."""
EVERY = 5.0
"""Least time between two lines of progress [s]."""
Painted = Literal["auto", "cloth", "stretch", "pressure", "warp", "weft"]


class ExportFiles(BaseModel):
    """Requested files, by the names of FILES."""

    model_config = ConfigDict(extra="forbid")
    npz: Path | None = None
    forces: Path | None = None
    csv: Path | None = None
    png: Path | None = None
    gif: Path | None = None
    mp4: Path | None = None
    obj: Path | None = None
    ply: Path | None = None
    glb: Path | None = None
    usd: Path | None = None
    pc2: Path | None = None
    mdd: Path | None = None
    rrd: Path | None = None
    foxglove: Path | None = None
    ros2: Path | None = None
    pattern: Path | None = None
    yarns: Path | None = None
    scene: Path | None = None


class ExportRequest(ExportFiles):
    """A request of files, and its settings, with the names of the flags of `nuno export`."""

    form: Form | None = None
    samples: int | None = None
    radius: str | float | None = None
    curl: float | None = None
    colour: Painted = "auto"
    frame: int | None = None
    start: Time | None = None
    end: Time | None = None
    fps: float | None = None
    size: str | None = None
    style: str | None = None
    renderer: str | None = None
    view: DyeView | None = None
    side: Side | None = None
    turn: Annotated[float, quantity("s", gt=0.0, le=3600.0)] | None = None
    shutter: Annotated[float, Field(gt=0.0, le=1.0)] | None = None
    scale: int | None = None
    crop: tuple[Length, Length, Length, Length] | None = None
    overrides: tuple[str, ...] = ()


def ask(**fields: Any) -> ExportRequest:
    """Return a validated request. Raises BadInput for an invalid name or value, by its flag."""
    try:
        return ExportRequest(**fields)
    except ValidationError as error:
        explained = explain(error, fields, (), "export", {}, ExportRequest)
        raise replace(explained, file=None, field=f"--{explained.field}") from None


def show_progress(done: int, total: int) -> None:
    """Show progress on one line of a terminal, if there is one."""
    if sys.stderr.isatty():
        print(f"\r{done} of {total} ", end="\n" if done == total else "", file=sys.stderr, flush=True)


def progress_lines(each: bool = False) -> Progress:
    """Return a function that shows progress: on one line of a terminal, else now and then by a line, or `each` time."""
    if sys.stderr.isatty() and not each:
        return show_progress
    shown = time.monotonic()

    def tell(done: int, total: int) -> None:
        nonlocal shown
        if (now := time.monotonic()) - shown >= EVERY or each:
            shown = now
            print(f"{done} of {total}", file=sys.stderr, flush=True)

    return tell


def write(recording: Recording, asked: ExportRequest, progress: Progress = show_progress) -> list[Path]:
    """Write all requested files, or none; `progress` is called with the parts done and in all. Raises BadInput."""
    _check(recording, asked)
    with together():
        return _export(recording, asked, progress)


def _export(recording: Recording, asked: ExportRequest, progress: Progress) -> list[Path]:
    """Write the requested files, slow ones last; a writer gets the settings among its parameters. Raises BadInput."""
    from nuno.exports.animations import Shot

    settings, written = vars(asked) | {"asked": asked, "progress": progress}, list[Path]()
    shot = Shot(asked.start, asked.end, asked.turn, asked.frame, asked.shutter or 0.0)
    settings |= {"size": _size(asked.size), "changes": _changes(asked), "shot": shot, "rendering": _rendering(asked)}
    for name, writer in WRITERS.items():
        path: Path | None = getattr(asked, name)
        if path is None:
            continue
        if name == "png" and asked.style:
            writer = "nuno.exports.yarns:export_yarn_picture"
        elif (suffix := f".{name}") in MESHES and path.suffix.lower() != suffix:
            writer, settings["suffix"] = "nuno.exports.meshes:export_meshes", suffix
        write = resolve_name(writer)
        paths = write(recording, path, **{key: settings[key] for key in signature(write).parameters if key in settings})
        written += paths if isinstance(paths, list) else [paths]
    return written


def _rendering(asked: ExportRequest) -> Rendering:
    """Return by what pictures are drawn."""
    from nuno.exports.pictures import RENDERER, Rendering

    samples = None if asked.renderer is None else asked.samples
    return Rendering(asked.renderer or RENDERER, samples, partial(print, file=sys.stderr, flush=True))


def export_curves(recording: Recording, path: Path, asked: ExportRequest) -> Path:
    """Write a knit's yarns as curves, and print facts about them. Raises BadInput."""
    from nuno.exports.yarns import export_yarns

    form: Form = asked.form or "smooth"
    settings: dict[str, Any] = {name: getattr(asked, name) for name in YARNS if getattr(asked, name) is not None}
    if "," in str(settings.get("radius", "")):
        settings["radius"] = settings["radius"].split(",")
    outcome = export_yarns(recording, path, asked.frame, form, settings)
    print(tell_yarns(form, outcome.facts), file=sys.stderr)
    return path


def tell_yarns(form: str, facts: Mapping[str, float]) -> str:
    """Return the facts of an operation on yarns in words."""
    count = {name: f"{int(value):,}" for name, value in facts.items()}
    text = f"{form} yarns: {count['links']} links, {count['points']} points"
    if "deepest" not in facts:
        return f"{text}; no body is a mesh, so nothing is in their way"
    text += f"; {count['repaired']} links cut through the body and were repaired, by {count['inserted']} points"
    if facts["lost"]:
        text += f"; {count['lost']} could not be"
    return f"{text}; deepest of {count['samples']} samples: {1e6 * facts['deepest']:.3g} um"


def _check(recording: Recording, asked: ExportRequest) -> None:
    """Raise BadInput for settings that do not fit together, or do not fit the recording."""
    from nuno.exports.animations import check_animation
    from nuno.viewer.live import require

    pictured = bool(asked.png or asked.gif or asked.mp4)
    _check_files(recording, asked)
    for path in filter(None, (asked.gif, asked.mp4)):
        check_animation(path, asked.fps, _size(asked.size))
    for name in ("usd", "foxglove", "ros2"):
        if path := getattr(asked, name):
            getattr(import_module(f"nuno.exports.{name}"), f"check_{name}")(path)
    require(None, asked.rrd, "--rrd")
    for name in () if asked.yarns else ("form", *YARNS):
        if getattr(asked, name) is not None and not (name == "samples" and asked.renderer and pictured):
            remedy = f"add --yarns out.npz{', or --renderer paths --png out.png' if name == 'samples' else ''}"
            raise BadInput("for yarns as curves", field=f"--{name}", remedy=remedy)
    if not any(getattr(asked, name) for name in FILES):
        remedy = "for example --npz out.npz --png out.png"
        raise BadInput("nothing to export was asked for", remedy=remedy)
    _check_dye(recording, asked)
    if asked.style and asked.renderer:
        remedy = "leave it out, or leave --style out: paths draws a knit's yarns by itself"
        raise BadInput("a style is drawn by rays", field="--renderer", value=asked.renderer, remedy=remedy)
    if asked.renderer is not None:
        _rendering(asked).load()
    if asked.side and asked.style:
        raise BadInput("for pictures of no style", field="--side", value=asked.side, remedy="leave it out")
    drawn = () if pictured else DRAWN[bool(asked.pattern or asked.rrd) :]
    for name in (*(() if asked.gif or asked.mp4 else ("turn", "start", "end", "fps", "shutter")), *drawn):
        if (value := getattr(asked, name)) not in (None, "auto", ()):
            problem, file = ("for pictures and animations", "png") if name in DRAWN else ("for animations", "mp4")
            flag, value = ("--set", value[0]) if name == "overrides" else (f"--{name}", value)
            remedy = f"add --{file} out.{file}, or leave it out"
            if name in ("start", "end") and (whole := next((one for one in WHOLE if getattr(asked, one)), "")):
                remedy = f"leave it out: --{whole} has all frames"
            raise BadInput(problem, field=flag, value=value, remedy=remedy)
    if asked.turn and asked.shutter:
        remedy = "leave one of them out"
        raise BadInput("in a turn nothing moves", field="--shutter", value=asked.shutter, remedy=remedy)
    if asked.turn and (asked.start is not None or asked.end is not None):
        problem, remedy = "a turn is round one frame", "name it: --frame N"
        raise BadInput(problem, field="--turn", value=asked.turn, remedy=remedy)
    others = [name for name in FILES if name not in WHOLE and getattr(asked, name) is not None]
    if asked.frame is not None and asked.turn is None and not others:
        raise BadInput("what is to be written has all frames", field="--frame", value=asked.frame,
                       remedy="--start and --end give a part of an animation, --turn goes round one")  # fmt: skip
    for name in ("obj", "ply", "glb") if asked.frame is not None else ():
        if (path := getattr(asked, name)) is not None and path.suffix.lower() != f".{name}":
            raise BadInput("a folder takes every frame", field="--frame", value=asked.frame, limit=f"--{name} {path}",
                           remedy=f"--{name} {path}.{name}")  # fmt: skip
    shown, threads = pictured or bool(asked.rrd), asked.colour in ("warp", "weft")
    if (asked.colour == "pressure" and (asked.pattern or asked.rrd)) or (threads and (shown or not asked.pattern)):
        problem = "for --pattern alone" if threads else "pressure is for pictures"
        raise BadInput(problem, field="--colour", value=asked.colour, remedy="leave it out, or write the two by turns")
    if asked.style and (recording.dyed_alone or not asked.png):
        problem = "a style is for --png of a knit"
        raise BadInput(problem, str(recording.path), field="--style", value=asked.style, remedy="leave it out")
    _check_frames(recording, asked)


def _check_files(recording: Recording, asked: ExportRequest) -> None:
    """Raise BadInput for a file that could not be written, and for two of one name."""
    from nuno.exports.pictures import check_sides
    from nuno.exports.tables import scene_files

    check_sides(_size(asked.size))
    beside = [] if asked.scene is None else scene_files(recording, asked.scene)
    places = {path.absolute(): "a file that the scene names" for path in beside}
    for name in (name for name in FILES if getattr(asked, name) is not None):
        path: Path = getattr(asked, name)
        ending = path.suffix.lower()
        if (other := places.setdefault(path.absolute(), f"--{name}")) != f"--{name}":
            remedy = "give each a name of its own"
            raise BadInput(f"{other} is to be written there, too", field=f"--{name}", value=str(path), remedy=remedy)
        if name in ENDINGS and ending not in ENDINGS[name]:
            problem = f"the name must end in {' or '.join(ENDINGS[name])}"
            remedy = f"{path.stem or 'out'}{ENDINGS[name][0]}"
            raise BadInput(problem, field=f"--{name}", value=str(path), remedy=remedy)
        if name in ENDINGS or ending == f".{name}":
            check_target(path, ending)
        elif f".{name}" in FOLDERS and not path.is_dir():
            if re.fullmatch(r"\.[a-z]+\d?", ending):  # out.gltf is meant as a file, run.01 may be a folder
                each = "frame" if f".{name}" in MESHES else "object"
                remedy = f"{path.stem}.{name}, or a folder for every {each}: {path.stem}"
                raise BadInput(f"the name must end in .{name}", field=f"--{name}", value=str(path), remedy=remedy)
            check_folder(path)


def _check_frames(recording: Recording, asked: ExportRequest) -> None:
    """Raise BadInput for frames and times that are not in the recording, and for pressure without a knit."""
    from nuno.exports.dyed_pictures import choose_amounts
    from nuno.exports.pictures import choose_frames, require_pressure

    if asked.frame is not None and asked.frame not in (known := {number for number, _ in recording.marks().values()}):
        raise recording.no_frame(asked.frame, known)
    if (asked.gif or asked.mp4) and recording.dyed_alone:
        choose_amounts(recording, asked.start, asked.end)
    elif (asked.gif or asked.mp4) and asked.turn is None:
        choose_frames(recording, asked.fps or RATE, asked.start, asked.end)
    if asked.colour == "pressure" and "edge_yarn" not in recording.fabric()[0]:
        require_pressure(recording)


def _check_dye(recording: Recording, asked: ExportRequest) -> None:
    """Raise BadInput for files of moving cloth from a recording of dye, and the other way round."""
    if recording.dyed_alone:
        shapes = [name for name in (*SHAPED, *(m[1:] for m in MESHES)) if getattr(asked, name)]
        if shapes:
            problem, remedy = "a recording of dye holds a cloth without a shape", "draw it: --png, --gif, --mp4"
            raise BadInput(problem, str(recording.path), field=f"--{shapes[0]}", remedy=remedy)
        flat = "leave it out: a cloth that is dyed alone lies flat, and its picture is an image of its cells"
        for name, remedy in (("size", "--scale N gives pixels a cell"), ("colour", "--view says which dye is shown"),
                             ("side", flat), ("turn", flat), ("shutter", flat), ("renderer", flat)):  # fmt: skip
            if getattr(asked, name) not in (None, "auto"):
                problem = "for pictures of moving cloth; the recording is of dye"
                raise BadInput(problem, str(recording.path), field=f"--{name}", remedy=remedy)
        return
    dyed = recording.scene.get("dye") is not None
    for name in ("crop",) if dyed else ("view", "scale", "crop"):
        if getattr(asked, name) is not None:
            problem = "for pictures of dyed cloth; the recording is of cloth that moves"
            raise BadInput(problem, str(recording.path), field=f"--{name}", remedy="leave it out")


def _changes(asked: ExportRequest) -> Changes:
    """Return the changes for pictures; settings of a style are only for its own pictures."""
    from nuno.exports.dyed_pictures import Changes

    overrides = (item for item in asked.overrides if not (asked.style and item.startswith("view.yarns")))
    side = () if asked.side is None else (SIDES[asked.side],)
    return Changes(asked.view, asked.scale, _crop(asked.crop), (*side, *overrides))


def _crop(sides: tuple[Length, Length, Length, Length] | None) -> Crop | None:
    if sides is None:
        return None
    left, top, right, bottom = sides
    try:
        return Crop.model_validate({"low": (left, top), "high": (right, bottom)})
    except ValidationError as error:
        problem = str(error.errors()[0]["msg"]).removeprefix("Value error, ")
        remedy = "left, top, right and bottom, for example --crop 2mm 2mm 4mm 3mm"
        raise BadInput(problem, field="--crop", value=" ".join(map(str, sides)), remedy=remedy) from None


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    width, cross, height = text.lower().partition("x")
    if not (cross and width.isdigit() and height.isdigit()):
        raise BadInput(
            "a size is written WIDTHxHEIGHT", field="--size", value=text, remedy="for example --size 960x720"
        )
    return int(width), int(height)
