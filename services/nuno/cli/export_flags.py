"""What `nuno export` is asked by: its arguments."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import get_args

from nuno.cli.export_yarns import add_yarns
from nuno_schemas.look import DyeView

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
    "rrd": "a file for the rerun viewer",
    "yarns": "a knit's yarns as curves, .npz or .obj, of a frame",
}
"""What can be written, by its flag."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", type=Path, metavar="RECORDING", help="a file, or last")
    what = parser.add_argument_group("what to write (any number of these)")
    for name, text in FILES.items():
        what.add_argument(f"--{name}", type=Path, metavar="FILE", help=text)
    add_yarns(parser)
    _add_parts(parser.add_argument_group("which part"))
    _add_drawn(parser.add_argument_group("how pictures and animations are drawn (default: as the scene says)"))


def _add_parts(which: argparse._ArgumentGroup) -> None:
    which.add_argument(
        "--frame", type=int, metavar="N", help="frame for --npz, --forces, --png, meshes and yarns (default: the last)"
    )
    which.add_argument("--start", type=float, metavar="SECONDS", help="animations: from here")
    which.add_argument("--end", type=float, metavar="SECONDS", help="animations: to here")
    which.add_argument(
        "--fps", type=float, default=25.0, metavar="N", help="animations: pictures a second (default: %(default)g)"
    )
    which.add_argument("--size", metavar="WxH", help="of pictures of moving cloth, e.g. 960x720")
    which.add_argument(
        "--colour",
        choices=["auto", "cloth", "stretch", "pressure"],
        default="auto",
        help="pictures and animations: cloth in its own texture or colour, by its stretch, or by a knit's pressure "
        "(default: its own where the scene gives one)",
    )
    which.add_argument(
        "--style",
        metavar="NAME",
        help="--png of a knit by rays: yarns, lines (straight links), density (of stitches) or map (of pressure "
        "on skin); --set view.yarns.KEY=VALUE changes how, and view.KEY=VALUE the camera",
    )


def _add_drawn(drawn: argparse._ArgumentGroup) -> None:
    drawn.add_argument(
        "--view", choices=get_args(DyeView), help="dyed cloth: all dye, what fibre has fixed of it, or what is mobile"
    )
    drawn.add_argument("--scale", type=int, metavar="N", help="dyed cloth: pixels a cell")
    drawn.add_argument(
        "--crop",
        nargs=4,
        metavar=("LEFT", "TOP", "RIGHT", "BOTTOM"),
        help="dyed cloth by itself: a part of it, e.g. 2mm 2mm 4mm 3mm",
    )
    drawn.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="overrides",
        help="change from where moving cloth is looked at, e.g. view.azimuth=90deg (also elevation, target, distance, "
        "size); how dye is drawn, e.g. dye.dyes.0.colour.full=0.1, dye.picture.ground=#f0ead8; with --style how yarns "
        "are, e.g. view.yarns.radius=0.1mm",
    )
