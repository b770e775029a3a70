"""`nuno export`: meshes, arrays, tables, pictures and animations of a recording."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from pydantic import ValidationError

from nuno.cli.common import add_flags, add_set, warn
from nuno.recording.reader import Recording, open_recording
from nuno.supervision import runs
from nuno_schemas.errors import BadInput
from nuno_schemas.look import Crop, DyeView

if TYPE_CHECKING:
    from nuno.exports.dyed_pictures import Changes

MESHES = (".obj", ".ply", ".glb")
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
    "rrd": "a file for the rerun viewer",
    "pattern": "the flat pattern of sewn garments at true size, .svg or .pdf (needs nuno[pdf])",
    "yarns": "a knit's yarns as curves, .npz or .obj, of a frame",
}
"""What can be written, by its flag."""
YARNS = ("samples", "radius", "curl")
"""Settings of yarns as curves."""
COLOURS = ["auto", "cloth", "stretch", "pressure", "warp", "weft"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", type=Path, metavar="RECORDING", help="a file, or last")
    what = parser.add_argument_group("what to write (any number of these)")
    add_flags(what, {f"--{name}": ("FILE", text, Path) for name, text in FILES.items()})
    _add_yarns(parser.add_argument_group("yarns as curves"))
    _add_parts(parser.add_argument_group("which part"))
    _add_drawn(parser.add_argument_group("how pictures and animations are drawn (default: as the scene says)"))


def _add_yarns(yarns: argparse._ArgumentGroup) -> None:
    text = "smooth: loops that hook into each other; straight: links, repaired where they would cut through a body "
    yarns.add_argument("--form", choices=["smooth", "straight"], help=f"{text}(default: smooth)")
    add_flags(yarns, {
        "--samples": ("N", "smooth: points a link (default: 8)", int),
        "--radius": ("LENGTH", "of the yarns, e.g. 30um, or of each kind, e.g. 20um,35um (default: 0.04 of the mean "
                     "link, thicker for yarns of a higher linear density)"),
        "--curl": ("SHARE", "smooth: how far loops reach beyond each other, of the shortest link", float),
    })  # fmt: skip


def _add_parts(which: argparse._ArgumentGroup) -> None:
    painted = (
        "pictures and animations: cloth in its own texture or colour, by its stretch, or by a knit's pressure; "
        "--pattern: outlines, the print (cloth), or triangles by their strain, the largest, or along warp or weft "
    )
    own = "(default: its own where the scene gives one)"
    which.add_argument("--colour", choices=COLOURS, default="auto", help=painted + own)
    add_flags(which, {
        "--frame": ("N", "frame for --npz, --forces, --png, --pattern, meshes, yarns (default: last), --usd", int),
        "--start": ("SECONDS", "animations: from here", float),
        "--end": ("SECONDS", "animations: to here", float),
        "--fps": ("N", "animations: pictures a second (default: 25)", float),
        "--size": ("WxH", "of pictures of moving cloth, e.g. 960x720"),
        "--style": ("NAME", "--png of a knit by rays: yarns, lines (straight links), density (of stitches) or map (of "
                    "pressure on skin); --set view.yarns.KEY=VALUE changes how, and view.KEY=VALUE the camera"),
    })  # fmt: skip
    which.set_defaults(fps=25.0)


def _add_drawn(drawn: argparse._ArgumentGroup) -> None:
    dyed = "dyed cloth: all dye, what fibre has fixed of it, or what is mobile"
    drawn.add_argument("--view", choices=get_args(DyeView), help=dyed)
    add_flags(drawn, {"--scale": ("N", "dyed cloth: pixels a cell", int)})
    sides, part = ("LEFT", "TOP", "RIGHT", "BOTTOM"), "dyed cloth by itself: a part of it, e.g. 2mm 2mm 4mm 3mm"
    drawn.add_argument("--crop", nargs=4, metavar=sides, help=part)
    camera = "change from where moving cloth is looked at, e.g. view.azimuth=90deg (also elevation, target, distance, "
    dye = "size); how dye is drawn, e.g. dye.dyes.0.colour.full=0.1, dye.picture.ground=#f0ead8; with --style how "
    add_set(drawn, camera + dye + "yarns are, e.g. view.yarns.radius=0.1mm")


def main(args: argparse.Namespace) -> int:
    with open_recording(runs.find_recording(args.recording)) as recording:
        warn(recording)
        for path in write(recording, args):
            print(path)
    return 0


def write(recording: Recording, args: argparse.Namespace) -> list[Path]:
    """All that is asked for, or nothing. Raises BadInput."""
    from nuno.exports.target import together

    _check(recording, args)
    with together():
        return _export(recording, args)


def _export(recording: Recording, args: argparse.Namespace) -> list[Path]:
    """Write what is asked for, what takes long last. Raises BadInput."""
    from nuno.exports import animations, meshes, pictures, tables

    size, changes, written = _size(args.size), _changes(args), list[Path]()
    if args.npz:
        written.append(tables.export_npz(recording, args.npz, frame=args.frame))
    if args.forces:
        written.append(tables.export_forces(recording, args.forces, args.frame))
    if args.csv:
        written.append(tables.export_csv(recording, args.csv))
    if args.yarns:
        written.append(_export_yarns(recording, args))
    if args.pattern:
        from nuno.exports.pattern import export_pattern

        written.append(export_pattern(recording, args.pattern, args.frame, args.colour))
    for suffix in MESHES:
        path = getattr(args, suffix[1:])
        if path and path.suffix.lower() == suffix:
            written.append(meshes.export_mesh(recording, path, args.frame))
        elif path:
            written += meshes.export_meshes(recording, path, suffix, _progress)
    if args.usd:
        from nuno.exports.usd import export_usd

        written.append(export_usd(recording, args.usd, args.frame, _progress))
    if args.png and args.style:
        from nuno.exports.yarns import export_yarn_picture

        asked = args.style, args.frame, size, tuple(args.overrides)
        written.append(export_yarn_picture(recording, args.png, *asked, _progress))
    elif args.png:
        written.append(pictures.export_picture(recording, args.png, args.frame, size, args.colour, changes))
    for path in filter(None, (args.gif, args.mp4)):
        when = args.fps, args.start, args.end
        written.append(animations.export_animation(recording, path, size, *when, _progress, args.colour, changes))
    if args.rrd:
        from nuno.viewer.file import convert

        written.append(convert(recording, args.rrd))
    return written


def _export_yarns(recording: Recording, args: argparse.Namespace) -> Path:
    from nuno.exports.curves import Form, export_yarns

    form: Form = args.form or "smooth"
    given = {name: getattr(args, name) for name in YARNS if getattr(args, name) is not None}
    if "," in given.get("radius", ""):
        given["radius"] = given["radius"].split(",")
    made = export_yarns(recording, args.yarns, args.frame, form, given)
    print(tell_yarns(form, made.facts), file=sys.stderr)
    path: Path = args.yarns
    return path


def tell_yarns(form: str, facts: Mapping[str, float]) -> str:
    """What an operation did, in words."""
    count = {name: f"{int(value):,}" for name, value in facts.items()}
    text = f"{form} yarns: {count['links']} links, {count['points']} points"
    if "deepest" not in facts:
        return f"{text}; no body is a mesh, so nothing is in their way"
    text += f"; {count['repaired']} links cut through the body and were repaired, by {count['inserted']} points"
    if facts["lost"]:
        text += f"; {count['lost']} could not be"
    return f"{text}; deepest of {count['samples']} samples: {1e6 * facts['deepest']:.3g} um"


def _check(recording: Recording, args: argparse.Namespace) -> None:
    """Raises BadInput where what is asked for does not go together, or is not what such a recording has."""
    from nuno.exports.animations import check_animation
    from nuno.viewer.require import require

    for path in filter(None, (args.gif, args.mp4)):
        check_animation(path, args.fps, _size(args.size))
    if args.usd:
        from nuno.exports.usd import check_usd

        check_usd(args.usd)
    require(None, args.rrd, "--rrd")
    for name in () if args.yarns else ("form", *YARNS):
        if getattr(args, name) is not None:
            raise BadInput("for yarns as curves", field=f"--{name}", remedy="add --yarns out.npz")
    if not any(getattr(args, name) for name in FILES):
        remedy = "for example: nuno export RECORDING --npz out.npz --png out.png"
        raise BadInput("nothing to export was asked for", remedy=remedy)
    if args.overrides and not (args.png or args.gif or args.mp4):
        raise BadInput(
            "for pictures and animations", field="--set", value=args.overrides[0], remedy="add --png out.png"
        )
    only = {True: ("pressure",), False: ("warp", "weft")}[bool(args.pattern)]
    if args.colour in only or (args.colour in ("warp", "weft") and (args.png or args.gif or args.mp4)):
        problem = "pressure is for pictures" if args.pattern and args.colour == "pressure" else "for --pattern alone"
        raise BadInput(problem, field="--colour", value=args.colour, remedy="leave it out, or write the two by turns")
    if args.style and (recording.dyed_alone or not args.png):
        problem = "a style is for --png of a knit"
        raise BadInput(problem, str(recording.path), field="--style", value=args.style, remedy="leave it out")
    if recording.dyed_alone:
        shapes = [
            name for name in ("forces", "yarns", "pattern", "usd", *(m[1:] for m in MESHES)) if getattr(args, name)
        ]
        if shapes:
            problem, remedy = "a recording of dye holds a cloth without a shape", "draw it: --png, --gif, --mp4"
            raise BadInput(problem, str(recording.path), field=f"--{shapes[0]}", remedy=remedy)
        for name, remedy in (("size", "--scale N gives pixels a cell"), ("colour", "--view says which dye is shown")):
            if getattr(args, name) not in (None, "auto"):
                problem = "for pictures of moving cloth; the recording is of dye"
                raise BadInput(problem, str(recording.path), field=f"--{name}", remedy=remedy)
        return
    dyed = recording.scene.get("dye") is not None
    for name in ("crop",) if dyed else ("view", "scale", "crop"):
        if getattr(args, name) is not None:
            problem = "for pictures of dyed cloth; the recording is of cloth that moves"
            raise BadInput(problem, str(recording.path), field=f"--{name}", remedy="leave it out")


def _changes(args: argparse.Namespace) -> Changes:
    """Of all pictures but those of a style, whose own settings are none of theirs."""
    from nuno.exports.dyed_pictures import Changes

    overrides = (item for item in args.overrides if not (args.style and item.startswith("view.yarns")))
    return Changes(args.view, args.scale, _crop(args.crop), tuple(overrides))


def _crop(sides: list[str] | None) -> Crop | None:
    if sides is None:
        return None
    left, top, right, bottom = sides
    try:
        return Crop.model_validate({"low": (left, top), "high": (right, bottom)})
    except ValidationError as error:
        problem = str(error.errors()[0]["msg"]).removeprefix("Value error, ")
        remedy = "left, top, right and bottom, for example --crop 2mm 2mm 4mm 3mm"
        raise BadInput(problem, field="--crop", value=" ".join(sides), remedy=remedy) from None


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    width, cross, height = text.lower().partition("x")
    if not (cross and width.isdigit() and height.isdigit()):
        raise BadInput(
            "a size is written WIDTHxHEIGHT", field="--size", value=text, remedy="for example --size 960x720"
        )
    return int(width), int(height)


def _progress(done: int, total: int) -> None:
    if sys.stderr.isatty():
        print(f"\r{done} of {total} ", end="\n" if done == total else "", file=sys.stderr, flush=True)
