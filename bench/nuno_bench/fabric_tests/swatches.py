"""`nuno fabrics`: the fabrics that scenes can name; with --page as a page, with a swatch of each on the drapemeter."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import nuno
from nuno.cli import textiles
from nuno.exports.cloth import Pieces, as_url
from nuno.exports.pictures import export_picture
from nuno.recording.reader import open_recording
from nuno_bench import machine
from nuno_bench.fabric_tests.specimens import count_nodes, measure
from nuno_bench.report import page
from nuno_schemas.colour import read_rgb
from nuno_schemas.pictures import Picture
from nuno_schemas.preset import Preset

LEAD = (
    "Fabrics that scenes can name, each as a disc of 30 cm over one of 18 cm, as in Cusick's drapemeter. Each is one "
    "drape of several that such cloth has: nuno test FABRIC tells how far they differ."
)
MEASURES = "What each is made of, and what was found of the drape that is shown."
LOOK = {"duration": "4 s", "objects.0.colour": "cadetblue", "view.elevation": "30 deg", "view.size": [480, 320]}
"""Changes of the drapemeter's scene."""


class Swatch(NamedTuple):
    """A fabric's picture, and the coefficient and nodes of its drape."""

    preset: Preset
    picture: Picture
    coefficient: float
    nodes: int


def fabrics_arguments(parser: argparse.ArgumentParser) -> None:
    textiles.presets_arguments(parser)
    parser.add_argument("--page", type=Path, metavar="FILE", help="write a page: a swatch of each, its measures, and "
                        "where they come from")  # fmt: skip


def fabrics_command(args: argparse.Namespace) -> int:
    if args.page is None:
        return textiles.presets_command(args)
    others, chosen, swatches = machine.OtherLoad(), textiles.choose(args.command, args.names), list[Swatch]()
    for i, preset in enumerate(chosen):
        print(f"{preset.name}, {i + 1} of {len(chosen)}", file=sys.stderr, flush=True)
        swatches.append(hang(preset))
    report = page.Report("Fabrics", LEAD, sections(swatches), machine.about(others), {})
    report.write(args.page, None, None, "")
    return 0


def hang(preset: Preset) -> Swatch:
    """Hang it over the drapemeter's support. Raises RunFailed where the solver fails."""
    with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
        target, image = Path(folder) / "drape.mcap", Path(folder) / "drape.png"
        own = {"name": preset.name, "objects.0.model.fabric": preset.name}
        nuno.run("instruments/drapemeter", LOOK | own, record=target, progress=False)
        with open_recording(target) as recording:
            flat, *_, last = (frame.x for frame in recording.frames())
            (piece,) = Pieces(recording).at(0.0)
            coefficient, shadow = measure(flat, last, piece.faces)
            picture = read_rgb(export_picture(recording, image, colour="cloth"))
    return Swatch(preset, picture, coefficient, count_nodes(shadow))


def sections(swatches: list[Swatch]) -> page.Sections:
    """Pictures, measures with units, and the source of each measure."""
    images = [
        page.Image(as_url(one.picture), f"{one.preset.name}: {100.0 * one.coefficient:.0f} %, {one.nodes} folds")
        for one in swatches
    ]
    named = [f"{each.name} [{each.unit or '1'}]" for each in swatches[0].preset.measures]
    rows = [
        [one.preset.name, *(textiles.digits(each.given) for each in one.preset.measures),
         f"{100.0 * one.coefficient:.0f}", str(one.nodes)]
        for one in swatches
    ]  # fmt: skip
    measured = page.Table(("fabric", *named, "drape coefficient [%]", "nodes"), rows, MEASURES)
    heads, origins = ("fabric", "source", *textiles.KINDS), list[list[str]]()
    for one in swatches:
        lines = [line.partition(": ") for line in textiles.origins(one.preset.how)]
        by_kind = ("; ".join(text for kind, _, text in lines if kind == each) for each in textiles.KINDS)
        origins.append([one.preset.name, one.preset.source, *by_kind])
    return [
        ("", [page.Pictures(images)]),
        ("Measures", [measured]),
        ("Where they come from", [page.Table(heads, origins, prose=True)]),
    ]
