"""What `nuno export` is asked by: its arguments."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import get_args

from nuno.cli.common import add_flags, add_set
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


COLOURS = ["auto", "cloth", "stretch", "pressure"]


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
    painted = "pictures and animations: cloth in its own texture or colour, by its stretch, or by a knit's pressure "
    own = "(default: its own where the scene gives one)"
    which.add_argument("--colour", choices=COLOURS, default="auto", help=painted + own)
    add_flags(which, {
        "--frame": ("N", "frame for --npz, --forces, --png, meshes and yarns (default: the last)", int),
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
