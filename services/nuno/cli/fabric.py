"""`nuno fabric import`: a fabric from a laboratory's sheet, as a scene takes it, and what virtual tests find of it."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from nuno import registry
from nuno.cli.presets import origins
from nuno.cli.top import align
from nuno.exports.target import writing
from nuno.scene import yaml_lines
from nuno_schemas.errors import BadInput
from nuno_schemas.preset import Imported

TITLE = ("name", "source")
"""What a sheet says of itself, in words."""
KINDS = (".csv", ".yaml", ".yml")


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
    given, lines = read_values(args.sheet)
    # In one line, as a comment holds them.
    title = {name: " ".join(str(given.pop(name)).split()) for name in TITLE if name in given}
    try:
        importer = registry.offering("nuno.models", "import_fabric", "reads a laboratory's sheet")
        found: Imported = importer.import_fabric(given, args.like, args.sheet.parent)
    except BadInput as error:
        if error.field is None or error.field.startswith("--"):
            raise
        raise replace(error, file=str(args.sheet), line=lines.get(error.field)) from None
    head = [f"{title.get('name', args.sheet.stem)}: {given['instrument']}, {args.sheet.name}"]
    text = as_yaml(found, head + ([f"source: {title['source']}"] if "source" in title else []))
    print("\n".join([table(found), "", *origins(left_out(found))]))
    if found.unused:
        print(f"\nnot used, for no force here has it: {', '.join(found.unused)}")
    print(f"\n{text}", end="")
    if args.out is not None:
        with writing(args.out, args.out.suffix) as new:
            new.write_text(text, encoding="utf-8")
    return 0


def read_values(path: Path) -> tuple[dict[str, Any], dict[str, int]]:
    """What a sheet gives by name, and the line of each. Raises BadInput."""
    if path.suffix.lower() not in KINDS:
        problem = "a sheet is YAML, or CSV of lines such as B, 0.12, 0.08"
        raise BadInput(problem, str(path), limit=f"one of {', '.join(KINDS)}", remedy="save it as one of these")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise BadInput(
            f"the sheet cannot be read: {reason}", str(path), remedy="is it text, and yours to read?"
        ) from None
    if path.suffix.lower() != ".csv":
        values, lines = yaml_lines.parse(text, str(path))
        return values, {str(place[0]): line for place, line in lines.items() if len(place) == 1}
    given, where = dict[str, Any](), dict[str, int]()
    for line, cells in enumerate(csv.reader(text.splitlines()), 1):
        row = [cell.strip() for cell in cells if cell.strip()]
        if not row or row[0].startswith("#"):
            continue
        name, *parts = row
        if name in given or not parts:
            problem = "the value is given twice" if name in given else "a name without a value"
            raise BadInput(problem, str(path), line, name, remedy="write name, warp, weft, one a line")
        given[name], where[name] = (", ".join(parts) if name in ("instrument", *TITLE) else _numbers(parts)), line
    return given, where


def _numbers(parts: list[str]) -> list[object]:
    """Cells as numbers; one at the end that is none is their unit."""
    *values, last = parts
    if values and not _is_number(last):
        return [f"{value} {last}" for value in values]
    return [float(part) if _is_number(part) else part for part in parts]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


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
    texts = {name: f"{value:.6g} {found.units[name]}".strip() for name, value in values.items()}
    return [f"  {name}: {text}  # {found.how[name]}" for name, text in texts.items()]
