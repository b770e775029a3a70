"""`nuno export`: meshes, arrays, tables, pictures and animations of a recording."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from nuno.recording.reader import Recording, open_recording
from nuno_schemas.errors import BadInput

MESHES = (".obj", ".ply", ".glb")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", type=Path, metavar="RECORDING")
    what = parser.add_argument_group("what to write (any number of these)")
    what.add_argument(
        "--npz", type=Path, metavar="FILE", help="float64 x, v, t (dye: phi, fixed, t) of the last checkpoint"
    )
    what.add_argument(
        "--csv", type=Path, metavar="FILE", help="energy, stretch, penetration, dye and step time of every frame"
    )
    what.add_argument("--png", type=Path, metavar="FILE", help="a picture of a frame")
    what.add_argument("--gif", type=Path, metavar="FILE", help="an animation")
    what.add_argument("--mp4", type=Path, metavar="FILE", help="an animation (needs nuno[video])")
    for suffix in MESHES:
        text = "; a folder: every frame"
        what.add_argument(
            f"--{suffix[1:]}",
            type=Path,
            metavar="FILE",
            help=f"the cloth{' and bodies' if suffix == '.glb' else ''} in a frame{text}",
        )
    what.add_argument("--rrd", type=Path, metavar="FILE", help="a file for the rerun viewer (needs nuno[view])")
    which = parser.add_argument_group("which part")
    which.add_argument("--frame", type=int, metavar="N", help="frame for --png and meshes (default: the last)")
    which.add_argument("--start", type=float, metavar="SECONDS", help="animations: from here")
    which.add_argument("--end", type=float, metavar="SECONDS", help="animations: to here")
    which.add_argument(
        "--fps", type=float, default=25.0, metavar="N", help="animations: pictures a second (default: %(default)g)"
    )
    which.add_argument("--size", metavar="WxH", help="of pictures, e.g. 960x720")
    which.add_argument(
        "--colour",
        choices=["auto", "cloth", "stretch"],
        default="auto",
        help="pictures and animations: cloth in its own texture or colour, or by its stretch "
        "(default: its own where the scene gives one)",
    )


def main(args: argparse.Namespace) -> int:
    with open_recording(args.recording) as recording:
        written = _export(recording, args)
    if not written:
        raise BadInput(
            "nothing to export was asked for", remedy="for example: nuno export RECORDING --npz out.npz --png out.png"
        )
    for path in written:
        print(path)
    return 0


def _export(recording: Recording, args: argparse.Namespace) -> list[Path]:
    from nuno.export import animations, meshes, pictures, tables

    size = _size(args.size)
    _check_kinds(recording, args)
    written: list[Path] = []
    if args.npz:
        written.append(tables.export_npz(recording, args.npz))
    if args.csv:
        written.append(tables.export_csv(recording, args.csv))
    if args.png:
        written.append(pictures.export_picture(recording, args.png, args.frame, size, args.colour))
    for path in (args.gif, args.mp4):
        if path:
            written.append(
                animations.export_animation(
                    recording, path, size, args.fps, args.start, args.end, _progress, args.colour
                )
            )
    for suffix in MESHES:
        path = getattr(args, suffix[1:])
        if path and path.suffix.lower() == suffix:
            written.append(meshes.export_mesh(recording, path, args.frame))
        elif path:
            written += meshes.export_meshes(recording, path, suffix, _progress)
    if args.rrd:
        from nuno.viewer.convert import convert
        from nuno.viewer.require import require

        require(None, args.rrd)
        written.append(convert(recording, args.rrd))
    return written


def _check_kinds(recording: Recording, args: argparse.Namespace) -> None:
    """Raises BadInput where pictures or meshes of a cloth are asked for that has no place in space."""
    asked = [name for name in ("png", "gif", "mp4", "rrd", *(m[1:] for m in MESHES)) if getattr(args, name)]
    if asked and recording.scene.get("dye"):
        problem, remedy = "a recording of dye holds no cloth to draw", "use --npz and --csv"
        raise BadInput(problem, str(recording.path), field=f"--{asked[0]}", remedy=remedy)


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
