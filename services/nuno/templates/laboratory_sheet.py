"""A laboratory's sheet of a fabric, read; and what was made of it, as YAML for scenes."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping
from dataclasses import replace
from itertools import dropwhile
from operator import not_
from pathlib import Path
from typing import Any

from nuno import registry
from nuno.scene import yaml_lines
from nuno.scene.files import read_text
from nuno_schemas.errors import BadInput
from nuno_schemas.preset import Imported
from nuno_schemas.units import decimal_point

TITLE = ("name", "source")
"""What a sheet says of itself, in words."""
WORDS = ("instrument", *TITLE)
_NUMBER = re.compile(r"[+-]?[.]?\d")
_CUT = re.compile(r"(?<![\w.])[+-]?\d+,\d+(?![\d.])")
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}(?!\d)")
KINDS = (".csv", ".yaml", ".yml")


def import_sheet(path: Path, like: str | None) -> tuple[Imported, list[str]]:
    """The fabric of a sheet, where what that does not tell is as of the preset `like`; and what it says of itself, in
    lines. Raises BadInput with the sheet's line.
    """
    given, lines = read_values(path)
    # In one line, as a comment holds them.
    title = {name: " ".join(str(given.pop(name)).split()) for name in TITLE if name in given}
    try:
        importer = registry.offering("nuno.models", "import_fabric", "reads a laboratory's sheet")
        found: Imported = importer.import_fabric(given, like, path.parent)
    except BadInput as error:
        if error.field is None or error.field.startswith("--"):
            raise
        raise replace(error, file=str(path), line=lines.get(error.field)) from None
    head = [f"{title.get('name', path.stem)}: {given['instrument']}, {path.name}"]
    return found, head + ([f"source: {title['source']}"] if "source" in title else [])


def read_values(path: Path) -> tuple[dict[str, Any], dict[str, int]]:
    """What a sheet gives by name, and the line of each. Raises BadInput."""
    if path.suffix.lower() not in KINDS:
        problem = "a sheet is YAML, or CSV of lines such as B, 0.12, 0.08"
        raise BadInput(problem, str(path), limit=f"one of {', '.join(KINDS)}", remedy="save it as one of these")
    text = read_text(path, "the sheet", "save it as text in UTF-8, and look whether it is yours to read")
    if path.suffix.lower() != ".csv":
        values, lines = yaml_lines.parse(text, str(path))
        return values, {str(place[0]): line for place, line in lines.items() if len(place) == 1}
    given, where = dict[str, Any](), dict[str, int]()
    for line, (name, *parts) in _read_rows(text, str(path)):
        if name in given or not any(parts):
            problem = "the value is given twice" if name in given else "a name without a value"
            raise BadInput(problem, str(path), line, name, remedy="write name, warp, weft, one a line")
        given[name], where[name] = (", ".join(filter(None, parts)) if name in WORDS else _with_unit(parts)), line
    return given, where


def _read_rows(text: str, file: str) -> list[tuple[int, list[str]]]:
    """Cells of the lines of a CSV, whose separator is that behind `instrument`; decimal commas become points. An empty
    cell is kept where other lines have their first or second number: there a measurement is missing.

    Raises BadInput where a comma may part numbers as well, or thousands.
    """
    lines = text.splitlines()
    separator = re.search(r'(?im)^"?instrument"? *([;\t])', text)
    reader = csv.reader(lines, delimiter=separator[1] if separator else ",", skipinitialspace=True)
    cells = (list(dropwhile(not_, map(str.strip, row))) for row in reader)
    rows = [(reader.line_num, row) for row in cells if row and not row[0].startswith("#")]
    columns = {k for _, row in rows if row[0] not in WORDS for k in (1, 2) if _NUMBER.match("".join(row[k : k + 1]))}
    rows = [(line, [cell for k, cell in enumerate(row) if cell or k in columns]) for line, row in rows]
    numbers = [(line, row[0], cell) for line, row in rows if row[0] not in WORDS for cell in row[1:]]
    for line, name, _ in numbers if not separator else ():
        if cut := _CUT.search(re.sub(r'"[^"]*"', "", lines[line - 1])):
            remedy = f"{decimal_point(cut[0])}, or {cut[0].replace(',', '.0, ')}.0 for warp and weft"
            raise BadInput("one number with a decimal comma, or two", file, line, name, cut[0], remedy=remedy)
    points = next((cell for *_, cell in numbers if re.match(r"[+-]?\d*\.\d", cell)), None)
    commas = [number for number in numbers if decimal_point(number[2])]
    if commas and (points or all(_THOUSANDS.match(cell) for *_, cell in commas)):
        line, name, cell = commas[0]
        problem = f"a comma, where {points} has a point" if points else "a comma before decimals, or before thousands"
        raise BadInput(problem, file, line, name, cell, remedy=decimal_point(cell))
    return [(n, [cell.replace(",", ".") if decimal_point(cell) else cell for cell in row]) for n, row in rows]


def _with_unit(parts: list[str]) -> list[str]:
    """Numbers, each with the unit that may stand in the last cell."""
    *values, last = parts
    if not values or not last or _NUMBER.match(last):
        return parts
    return [f"{value} {last}" if value else "" for value in values]


def in_units(found: Imported, values: Mapping[str, float]) -> dict[str, str]:
    """Values by name, each with its unit, as scenes take them."""
    return {name: f"{value:.6g} {found.units[name]}".strip() for name, value in values.items()}
