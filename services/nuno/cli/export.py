"""`nuno export`: meshes, arrays, tables, pictures and animations of a recording."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import ValidationError

from nuno.cli.common import warn
from nuno.cli.export_flags import MESHES, add_arguments
from nuno.cli.export_yarns import check_wish, prepare_yarns
from nuno.recording.reader import Recording, open_recording
from nuno.supervision import runs
from nuno_schemas.errors import BadInput
from nuno_schemas.look import Crop

if TYPE_CHECKING:
    from nuno.export.dyed_pictures import Changes

__all__ = ["add_arguments", "main"]


def main(args: argparse.Namespace) -> int:
    with open_recording(runs.find_recording(args.recording)) as recording:
        warn(recording)
        written = _export(recording, args)
    if not written:
        raise BadInput(
            "nothing to export was asked for", remedy="for example: nuno export RECORDING --npz out.npz --png out.png"
        )
    for path in written:
        print(path)
    return 0


def _export(recording: Recording, args: argparse.Namespace) -> list[Path]:
    from nuno.export import meshes, tables

    _check_kinds(recording, args)
    _check_wishes(recording, args)
    # What may be refused only while it is made is made before the first file is written.
    drawn = _prepare_style(recording, args) if args.png and args.style else None
    yarns = prepare_yarns(recording, args) if args.yarns else None
    written: list[Path] = []
    if args.npz:
        written.append(tables.export_npz(recording, args.npz, frame=args.frame))
    if args.forces:
        written.append(tables.export_forces(recording, args.forces, args.frame))
    if args.csv:
        written.append(tables.export_csv(recording, args.csv))
    written += [drawn()] if drawn else []
    written += _draw(recording, args)
    for suffix in MESHES:
        path = getattr(args, suffix[1:])
        if path and path.suffix.lower() == suffix:
            written.append(meshes.export_mesh(recording, path, args.frame))
        elif path:
            written += meshes.export_meshes(recording, path, suffix, _progress)
    written += [yarns()] if yarns else []
    if args.rrd:
        from nuno.viewer.convert import convert

        written.append(convert(recording, args.rrd))
    return written


def _prepare_style(recording: Recording, args: argparse.Namespace) -> Callable[[], Path]:
    """Draw a knit by rays; what writes the picture. Raises BadInput."""
    from nuno.export.target import write_png
    from nuno.export.yarns import draw_yarn_picture

    overrides = tuple(args.overrides)
    picture = draw_yarn_picture(recording, args.style, args.frame, _size(args.size), overrides, _progress)
    return partial(write_png, args.png, picture)


def _draw(recording: Recording, args: argparse.Namespace) -> list[Path]:
    """Pictures and animations."""
    from nuno.export import animations, pictures

    size, changes = _size(args.size), _changes(args)
    written: list[Path] = []
    if args.png and not args.style:
        written.append(pictures.export_picture(recording, args.png, args.frame, size, args.colour, changes))
    for path in filter(None, (args.gif, args.mp4)):
        when = args.fps, args.start, args.end
        written.append(animations.export_animation(recording, path, size, *when, _progress, args.colour, changes))
    return written


def _check_kinds(recording: Recording, args: argparse.Namespace) -> None:
    """Raises BadInput where something is asked for that a recording of its kind does not have."""
    if args.style and (recording.dyed_alone or not args.png):
        problem = "a style is for --png of a knit"
        raise BadInput(problem, str(recording.path), field="--style", value=args.style, remedy="leave it out")
    if recording.dyed_alone:
        shapes = [name for name in ("forces", *(m[1:] for m in MESHES)) if getattr(args, name)]
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


def _check_wishes(recording: Recording, args: argparse.Namespace) -> None:
    """Raises BadInput for what cannot be written as it is asked for: before the first file is."""
    from nuno.export.animations import check_animation
    from nuno.export.target import check_target
    from nuno.viewer.require import require

    size, changes, files = _size(args.size), _changes(args), (".npz", ".csv", ".png", *MESHES)
    wanted = [(getattr(args, suffix[1:]), suffix) for suffix in files] + [(args.forces, ".npz")]
    for path, suffix in wanted:
        # A mesh of every frame goes into a folder.
        if path and (suffix not in MESHES or path.suffix.lower() == suffix):
            check_target(path, suffix)
    for path in filter(None, (args.gif, args.mp4)):
        check_animation(path, args.fps, size)
    require(None, args.rrd, "--rrd")
    check_wish(recording, args)
    check = _check_dyed_pictures if recording.dyed_alone else _check_pictures
    check(recording, args, changes)


def _check_pictures(recording: Recording, args: argparse.Namespace, changes: Changes) -> None:
    from nuno.export import camera, cloth, dyed_pictures, pictures

    arrays = args.forces or (args.npz and args.frame is not None)
    if args.png or arrays or any(getattr(args, suffix[1:]) for suffix in MESHES):
        cloth.read_frame(recording, args.frame)
    if args.png:
        pictures.check_sides(_size(args.size))
    if args.gif or args.mp4:
        pictures.choose_frames(recording, args.fps, args.start, args.end)
    seen_from, of_dye = camera.of_camera(recording, changes.overrides)
    camera.read_view(recording, seen_from)
    if (args.png and not args.style) or args.gif or args.mp4:
        if args.colour == "pressure":
            pictures.require_pressure(recording)
        elif args.colour != "stretch":
            dyed_pictures.read_dyed_object(recording, replace(changes, overrides=of_dye))


def _check_dyed_pictures(recording: Recording, args: argparse.Namespace, changes: Changes) -> None:
    from nuno.export import dyed_pictures

    if args.png:
        dyed_pictures.find_amounts(recording, args.frame)
    if args.gif or args.mp4:
        dyed_pictures.choose_amounts(recording, args.start, args.end)
    if args.png or args.gif or args.mp4:
        with dyed_pictures.dyed_pictures(recording, changes):
            pass


def _changes(args: argparse.Namespace) -> Changes:
    """Of all pictures but those of a style, whose own settings are none of theirs."""
    from nuno.export.dyed_pictures import Changes

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
