"""`nuno export`: meshes, arrays, tables, pictures and animations of a recording."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import get_args

from nuno.api.export import FILES, ExportRequest, Painted, ask, show_progress, write
from nuno.cli.common import add_flags, add_set, warn
from nuno.exports.camera import Side
from nuno.recording.reader import open_recording
from nuno.runtime import runs
from nuno_schemas.dyeing import DyeView, Form


def export_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", type=Path, metavar="RECORDING", help="a file, or last")
    what = parser.add_argument_group("what to write (any number of these)")
    add_flags(what, {f"--{name}": ("FILE", text, Path) for name, text in FILES.items()})
    _add_yarns(parser.add_argument_group("yarns as curves"))
    _add_parts(parser.add_argument_group("which part"))
    progress_help = "say how far it is, a line each time, also where there is no terminal"
    parser.add_argument("--progress", action="store_true", help=progress_help)
    _add_drawn(parser.add_argument_group("how pictures and animations are drawn (default: as the scene says)"))


def _add_yarns(yarns: argparse._ArgumentGroup) -> None:
    text = "smooth: loops that hook into each other; straight: links, repaired where they would cut through a body "
    yarns.add_argument("--form", choices=get_args(Form), help=f"{text}(default: smooth)")
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
    default_text = "(default: its own where the scene gives one)"
    which.add_argument("--colour", choices=get_args(Painted), default="auto", help=painted + default_text)
    add_flags(which, {
        "--frame": ("N", "frame for --npz, --forces, --png, --pattern, meshes, yarns (default: last), --usd", int),
        "--start": ("SECONDS", "animations: from here", float),
        "--end": ("SECONDS", "animations: to here", float),
        "--turn": ("SECONDS", "animations: the camera goes once round --frame, in so long", float),
        "--fps": ("N", "animations: pictures a second (default: 25; of dye alone, so that all takes 5 s)", float),
        "--size": ("WxH", "of pictures of moving cloth, e.g. 960x720"),
        "--style": ("NAME", "--png of a knit by rays: yarns, lines (straight links), density (of stitches) or map (of "
                    "pressure on skin); --set view.yarns.KEY=VALUE changes how, and view.KEY=VALUE the camera"),
    })  # fmt: skip


def _add_drawn(drawn: argparse._ArgumentGroup) -> None:
    dyed = "dyed cloth: all dye, what fibre has fixed of it, or what is mobile"
    side = "moving cloth: the side of a body that is seen, which faces +z; close: the cloth alone fills the picture"
    drawn.add_argument("--side", choices=get_args(Side), help=side)
    drawn.add_argument("--view", choices=get_args(DyeView), help=dyed)
    add_flags(drawn, {"--scale": ("N", "dyed cloth: pixels a cell", int)})
    sides, part = ("LEFT", "TOP", "RIGHT", "BOTTOM"), "dyed cloth by itself: a part of it, e.g. 2mm 2mm 4mm 3mm"
    drawn.add_argument("--crop", nargs=4, metavar=sides, help=part)
    camera = "change from where moving cloth is looked at, e.g. view.azimuth=90deg (also elevation, target, distance, "
    dye = "size); how dye is drawn, e.g. dye.dyes.0.colour.full=0.1, dye.picture.ground=#f0ead8; with --style how "
    add_set(drawn, camera + dye + "yarns are, e.g. view.yarns.radius=0.1mm")


def export_command(args: argparse.Namespace) -> int:
    with open_recording(runs.find_recording(args.recording)) as recording:
        warn(recording)
        request = ask(**{name: getattr(args, name) for name in ExportRequest.model_fields})
        for path in write(recording, request, _tell if args.progress else show_progress):
            print(path)
    return 0


def _tell(done: int, total: int) -> None:
    print(f"{done} of {total}", file=sys.stderr, flush=True)
