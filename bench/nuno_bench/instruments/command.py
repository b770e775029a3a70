"""`nuno test FABRIC`: a fabric's sheet as a textile laboratory would fill it in, from virtual instruments."""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import nuno
from nuno.exports.pictures import export_picture
from nuno.recording.reader import open_recording
from nuno.scene import yaml_lines
from nuno.scene.files import read_text
from nuno_bench import machine, options
from nuno_bench.gallery.kind import embed, read_picture
from nuno_bench.instruments import sheet
from nuno_bench.instruments.drape import DOT
from nuno_bench.report import page, plots
from nuno_bench.report.plots import Curve, Panel
from nuno_bench.report.result import number
from nuno_bench.sweep import places
from nuno_cloth.fabrics.drapes import read_drape
from nuno_schemas.errors import BadInput

LEAD = (
    "What a laboratory would measure of this fabric, on virtual specimens: each standard's test as it is simulated, "
    "beside what the fabric's own measures say by the theory of plates and of the elastica, or what a laboratory "
    "measured of its drape. Nothing is tuned to a test."
)
HEADS = ("test", "standard", "found", "unit", "expected", "off", "least to greatest")
SIZE = (640, 400)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("fabric", metavar="FABRIC", help="a preset (nuno fabrics), a YAML file with a `fabric`, as "
                        "nuno fabric import writes one, with what was `measured` of its drape; or a fabric as a scene "
                        "has it")  # fmt: skip
    parser.add_argument("--only", metavar="A,B", help=f"of the tests {', '.join(sheet.TESTS)} (default: all)")
    parser.add_argument("--quick", action="store_true", help="coarser specimens, one mesh, two drapes")
    options.add_shared(parser, "--json", "--html", "--docs")
    parser.add_argument("--section", metavar="NAME", help="of the Markdown page (default: test)")
    places.add_arguments(parser)


def main(args: argparse.Namespace) -> int:
    name, fabric, measured = find_fabric(args.fabric)
    wanted = options.names_of(args.only) or list(sheet.TESTS)
    options.require_known(wanted, sheet.TESTS, "test", "--only")
    section = args.section or "test"
    page.check_section(args.docs, section)
    if args.html is not None:
        plots.require_matplotlib()
    others, given = machine.Others(), sheet.measures(fabric)
    with places.opened(args) as where:
        how = sheet.How(args.quick, where, lambda text: print(text, file=sys.stderr, flush=True))
        found = sheet.test(fabric, wanted, how, measured)
    table = page.Table(HEADS, [cells(row) for row in found.rows], f"{name}: {given['source']}.")
    print(f"{table.caption}\n\n{table.text()}")
    parts = figures(found) if args.html is not None else []
    drawn = pictures(fabric, found) if args.html is not None and found.drapes else []
    sections: page.Sections = [("", [table]), ("Bending", parts), ("Drape", drawn)]
    data = {"fabric": dict(given), "measured": measured, "rows": found.rows}
    report = page.Report(f"{name}, tested", LEAD, sections, machine.about(others), data, [table])
    report.write(args.html, args.json, args.docs, section)
    return 0


def find_fabric(given: str) -> tuple[str, object, Mapping[str, float]]:
    """A name, the fabric as a scene has it, and what a file says was measured of its drape. Raises BadInput."""
    path = Path(given)
    if path.suffix.lower() in (".yaml", ".yml"):
        held, lines = yaml_lines.parse(read_text(path, "the fabric", "name a YAML file in UTF-8"), given)
        if not isinstance(held, Mapping) or "fabric" not in held:
            remedy = "nuno fabric import SHEET --out FILE writes one"
            raise BadInput("the file holds no `fabric`", given, field="fabric", remedy=remedy)
        return path.stem, held["fabric"], _find_drape(held.get("measured", {}), path, lines)
    value = yaml_lines.parse_value(given)
    if isinstance(value, Mapping):
        return f"{value.get('preset', 'a fabric')}, changed" if "preset" in value else "a fabric", dict(value), {}
    return given, given, {}


def _find_drape(given: object, path: Path, lines: Mapping[yaml_lines.Path, int]) -> Mapping[str, float]:
    if not isinstance(given, Mapping):
        remedy = "write for example measured: {drape_coefficient: 65 %, nodes: 7}"
        raise BadInput("what was measured are values by name", str(path), field="measured", value=given, remedy=remedy)
    try:
        return read_drape(given, path.parent)[0]
    except BadInput as error:
        line = lines.get(("measured", str(error.field)))
        raise replace(error, file=str(path), line=line, field=f"measured.{error.field}") from None


def cells(row: sheet.Row) -> list[str]:
    expected, off = "", ""
    if not math.isnan(row.expected):
        expected = number(row.expected) + (", measured" if row.measured else "")
    if row.unit == "%" and expected:
        off = f"{row.value - row.expected:+.1f} points"
    elif not math.isnan(row.off):
        off = f"{100.0 * row.off:+.2f} %".replace("-0.00", "0.00").replace("+0.00", "0.00")
    spread = "" if row.spread is None else f"{number(row.spread[0])} to {number(row.spread[1])}"
    return [row.what, row.standard, number(row.value), row.unit, expected, off, spread]


def figures(found: sheet.Sheet) -> list[page.Part]:
    """The loops of moment over curvature."""
    curves = [
        Curve(name, 1e-2 * loop.curvature, 1e3 * loop.moment, i) for i, (name, loop) in enumerate(found.loops.items())
    ]
    if not curves:
        return []
    panel = Panel("moment per width [mN]", curves, "curvature [1/cm]")
    return [page.Figure(plots.draw([panel], 1), "Bent to 2.5 1/cm, back to -2.5 1/cm and again, as KES-FB2 does.")]


def pictures(fabric: object, found: sheet.Sheet) -> list[page.Part]:
    """The specimen on its support, and the shadows."""
    import json

    import numpy as np

    images = []
    with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
        target = Path(folder) / "drape.mcap"
        radius, support = found.radii()
        model = {"fabric": json.dumps(fabric), "radius": radius, "hold": support}
        changes = [f"objects.0.model.{key}={value}" for key, value in model.items()]
        nuno.run("instruments/drapemeter", *changes, record=target)
        with open_recording(target) as recording:
            picture = read_picture(export_picture(recording, Path(folder) / "drape.png", None, SIZE, "cloth"))
        images.append(page.Image(embed(picture), f"On its support of {200.0 * support:g} cm, edges of 10 mm."))
    for start, one in found.drapes.items():
        dark = np.where(one.shadow[::2, ::2, None], np.uint8(60), np.uint8(245)).repeat(3, axis=2)
        begun = f", started in {start.folds} folds" if start.folds else ""
        says = f"Shadow with edges of {1e3 * start.edge:g} mm, seed {start.seed}{begun}: "
        says += f"{100.0 * one.coefficient:.1f} %, {one.nodes} nodes, {1e6 * one.energy:.0f} uJ."
        images.append(page.Image(embed(dark), says))
    return [page.Pictures(images), f"A shadow's picture is {100.0 * DOT * len(one.shadow):.0f} cm wide."]
