"""A laboratory's sheet of a fabric, read; and what was made of it, as YAML for scenes."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from nuno import registry
from nuno.scene import yaml_lines
from nuno.scene.files import read_text
from nuno_schemas.errors import BadInput
from nuno_schemas.preset import Imported

TITLE = ("name", "source")
"""What a sheet says of itself, in words."""
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
    text = read_text(path, "the sheet", "is it text, and yours to read?")
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


def in_units(found: Imported, values: Mapping[str, float]) -> dict[str, str]:
    """Values by name, each with its unit, as scenes take them."""
    return {name: f"{value:.6g} {found.units[name]}".strip() for name, value in values.items()}
