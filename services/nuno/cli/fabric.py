"""`nuno fabric import`: a fabric from a laboratory's sheet, as a scene takes it, and what virtual tests find of it."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

from nuno.cli.presets import origins
from nuno.cli.top import align
from nuno.output_files import writing
from nuno.scene.templates.laboratory_sheet import import_sheet, in_units
from nuno_schemas.preset import Imported


def fabric_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("action", choices=["import"], help="read a laboratory's sheet")
    parser.add_argument(
        "sheet", type=Path, metavar="FILE",
        help="values of KES-F, FAST or a cantilever, .yaml or .csv: instrument, then each by the instrument's own "
        "name, one number or warp and weft, in its units; and a drape to hold nuno test against: drape coefficient and "
        "nodes, or a photograph of the shadow",
    )  # fmt: skip
    parser.add_argument("--like", metavar="PRESET", help="what the sheet does not tell is as of this fabric")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the fabric as YAML, for a scene")


def fabric_command(args: argparse.Namespace) -> int:
    fabric, head = import_sheet(args.sheet, args.like)
    text = as_yaml(fabric, head)
    print("\n".join([table(fabric), "", *origins(left_out(fabric))]))
    if fabric.unused:
        print(f"\nnot used, for no force here has it: {', '.join(fabric.unused)}")
    print(f"\n{text}", end="")
    if args.out is not None:
        with writing(args.out, args.out.suffix) as new:
            new.write_text(text, encoding="utf-8")
    return 0


def table(fabric: Imported) -> str:
    """Return a table of the measures, their origins, and the results of virtual tests."""
    rows = [["", "value", "", "virtual test", "off", "how"]]
    for name, value in {**fabric.fabric, **fabric.drape}.items():
        tested = fabric.measured.get(name)
        off = "" if tested is None else f"{100.0 * (tested / value - 1.0):+.2f} %"
        seen = "" if tested is None else f"{tested:.4g}"
        rows.append([name, f"{value:.4g}", fabric.units[name], seen, off, fabric.how[name]])
    return align(rows, left=(0, 2, 5))


def as_yaml(fabric: Imported, head: list[str]) -> str:
    """Return the `fabric` of a scene after comments, and its measured drape as `measured`."""
    lines = [*(f"# {line}" for line in head), "fabric:", *_entries(fabric, fabric.fabric)]
    lines += [f"  # {line}" for line in origins(left_out(fabric))]
    if fabric.drape:
        note = "of its drape, for nuno test to be held against; no part of the fabric"
        lines += [f"measured:  # {note}", *_entries(fabric, fabric.drape)]
    return "\n".join(lines) + "\n"


def left_out(fabric: Imported) -> dict[str, str]:
    """Return the origins of a fabric's values that are not in the sheet."""
    return {name: how for name, how in fabric.how.items() if name not in {*fabric.fabric, *fabric.drape}}


def _entries(fabric: Imported, values: Mapping[str, float]) -> list[str]:
    """Return values with their units and origins."""
    return [f"  {name}: {text}  # {fabric.how[name]}" for name, text in in_units(fabric, values).items()]
