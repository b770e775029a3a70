"""`nuno fabric import`: a fabric from a laboratory's sheet, as a scene takes it, and what virtual tests find of it."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

from nuno.cli.presets import origins
from nuno.cli.top import align
from nuno.exports.target import writing
from nuno.templates.laboratory_sheet import import_sheet, in_units
from nuno_schemas.preset import Imported


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("action", choices=["import"], help="read a laboratory's sheet")
    parser.add_argument(
        "sheet", type=Path, metavar="FILE",
        help="values of KES-F, FAST or a cantilever, .yaml or .csv: instrument, then each by the instrument's own "
        "name, one number or warp and weft, in its units; and a drape to hold nuno test against: drape coefficient and "
        "nodes, or a photograph of the shadow",
    )  # fmt: skip
    parser.add_argument("--like", metavar="PRESET", help="what the sheet does not tell is as of this fabric")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the fabric as YAML, for a scene")


def main(args: argparse.Namespace) -> int:
    found, head = import_sheet(args.sheet, args.like)
    text = as_yaml(found, head)
    print("\n".join([table(found), "", *origins(left_out(found))]))
    if found.unused:
        print(f"\nnot used, for no force here has it: {', '.join(found.unused)}")
    print(f"\n{text}", end="")
    if args.out is not None:
        with writing(args.out, args.out.suffix) as new:
            new.write_text(text, encoding="utf-8")
    return 0


def table(found: Imported) -> str:
    """Each measure, how it was had, and what a virtual test of it finds."""
    rows = [["", "value", "", "virtual test", "off", "how"]]
    for name, value in {**found.fabric, **found.drape}.items():
        tested = found.measured.get(name)
        off = "" if tested is None else f"{100.0 * (tested / value - 1.0):+.2f} %"
        seen = "" if tested is None else f"{tested:.4g}"
        rows.append([name, f"{value:.4g}", found.units[name], seen, off, found.how[name]])
    return align(rows, left=(0, 2, 5))


def as_yaml(found: Imported, head: list[str]) -> str:
    """The `fabric` of a scene below comments of a line each, and beside it what was `measured` of its drape."""
    lines = [*(f"# {line}" for line in head), "fabric:", *_entries(found, found.fabric)]
    lines += [f"  # {line}" for line in origins(left_out(found))]
    if found.drape:
        note = "of its drape, for nuno test to be held against; no part of the fabric"
        lines += [f"measured:  # {note}", *_entries(found, found.drape)]
    return "\n".join(lines) + "\n"


def left_out(found: Imported) -> dict[str, str]:
    """How those values are had that a fabric has and the sheet does not tell."""
    return {name: how for name, how in found.how.items() if name not in {*found.fabric, *found.drape}}


def _entries(found: Imported, values: Mapping[str, float]) -> list[str]:
    """Values with their units, and how each was had."""
    return [f"  {name}: {text}  # {found.how[name]}" for name, text in in_units(found, values).items()]
