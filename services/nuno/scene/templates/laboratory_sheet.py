"""Import of a laboratory's sheet of a fabric, and its values as YAML for scenes."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping
from dataclasses import replace
from itertools import dropwhile
from operator import not_
from pathlib import Path
from typing import Any

from nuno.plugin_contract import registry
from nuno.scene import yaml_lines
from nuno.scene.files import read_text
from nuno_schemas.errors import BadInput
from nuno_schemas.preset import Imported
from nuno_schemas.units import decimal_point

TITLE = ("name", "source")
"""Texts of a sheet about itself."""
WORDS = ("instrument", *TITLE)
_NUMBER = re.compile(r"[+-]?[.]?\d")
_CUT = re.compile(r"(?<![\w.])[+-]?\d+,\d+(?![\d.])")
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}(?!\d)")
KINDS = (".csv", ".yaml", ".yml")


def import_sheet(path: Path, like: str | None) -> tuple[Imported, list[str]]:
    """Import the fabric of a sheet, with other values from the preset `like`; return it, and the sheet's title in
    lines. Raises BadInput with the sheet's line.
    """
    values, lines = read_values(path)
    # In one line, for a comment.
    title = {name: " ".join(str(values.pop(name)).split()) for name in TITLE if name in values}
    try:
        importer = registry.offering("nuno.models", "import_fabric", "reads a laboratory's sheet")
        fabric: Imported = importer.import_fabric(values, like, path.parent)
    except BadInput as error:
        if error.field is None or error.field.startswith("--"):
            raise
        raise replace(error, file=str(path), line=lines.get(error.field)) from None
    head = [f"{title.get('name', path.stem)}: {values['instrument']}, {path.name}"]
    return fabric, head + ([f"source: {title['source']}"] if "source" in title else [])


def read_values(path: Path) -> tuple[dict[str, Any], dict[str, int]]:
    """Read the values of a sheet by name, and the line of each. Raises BadInput."""
    if path.suffix.lower() not in KINDS:
        problem = "a sheet is YAML, or CSV of lines such as B, 0.12, 0.08"
        raise BadInput(problem, str(path), limit=f"one of {', '.join(KINDS)}", remedy="save it as one of these")
    text = read_text(path, "the sheet", "save it as text in UTF-8, and look whether it is yours to read")
    if path.suffix.lower() != ".csv":
        values, lines = yaml_lines.parse(text, str(path))
        lines_by_name = {_word(place[0]): line for place, line in lines.items() if len(place) == 1}
        return {_word(name): value for name, value in values.items()}, lines_by_name
    values_by_name, where = dict[str, Any](), dict[str, int]()
    for line, (name, *parts) in _read_rows(text, str(path)):
        if name in values_by_name or not any(parts):
            problem = "the value is given twice" if name in values_by_name else "a name without a value"
            raise BadInput(problem, str(path), line, name, remedy="write name, warp, weft, one a line")
        values_by_name[name] = ", ".join(filter(None, parts)) if name in WORDS else _with_unit(parts)
        where[name] = line
    return values_by_name, where


def _read_rows(text: str, file: str) -> list[tuple[int, list[str]]]:
    """Read the cells of the lines of a CSV, whose separator is that after `instrument`; decimal commas become points.
    An empty cell is kept where other lines have their first or second number: there a measurement is missing.

    Raises BadInput where a comma may separate numbers as well, or thousands.
    """
    lines = text.splitlines()
    separator = re.search(r'(?im)^"?instrument"? *([;\t])', text)
    reader = csv.reader(lines, delimiter=separator[1] if separator else ",", skipinitialspace=True)
    cells = ([re.sub(r"(?i)^\s*n/?a\s*$", "", cell).strip() for cell in row] for row in reader)
    found, order = list[tuple[int, list[str]]](), list[int]()
    for row in cells:
        lower = [cell.lower() for cell in row]
        if {"warp", "weft"} <= set(lower):  # a heading: the unit comes last from here on, as _with_unit has it
            numbered = [lower.index(each) for each in ("warp", "weft", "unit", "units") if each in lower]
            order = [max(0, min(numbered) - 1), *numbered]
        elif rest := [row[k] for k in order if k < len(row)] if order else list(dropwhile(not_, row)):
            found.append((reader.line_num, rest))
    rows = [(line, [_word(row[0]), *row[1:]]) for line, row in found if row[0] and not row[0].startswith("#")]
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


def _word(name: object) -> str:
    """Return a name of a sheet's line, those of WORDS in lower case, as a sheet may have Instrument."""
    return str(name).lower() if str(name).lower() in WORDS else str(name)


def _with_unit(parts: list[str]) -> list[str]:
    """Return numbers, each with the unit that may be in the last cell."""
    *values, last = parts
    if last in ("-", "–", "—"):
        return values
    if not values or not last or _NUMBER.match(last):
        return parts
    return [f"{value} {last}" if value else "" for value in values]


def in_units(fabric: Imported, values: Mapping[str, float]) -> dict[str, str]:
    """Return values by name, each with its unit, as scenes take them."""
    return {name: f"{value:.6g} {fabric.units[name]}".strip() for name, value in values.items()}
