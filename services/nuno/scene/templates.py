"""Scenes to start from: garments on a body, a laboratory's fabric, commented copies of shipped scenes."""

from __future__ import annotations

import contextlib
import csv
import hashlib
import json
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import dropwhile
from operator import not_
from pathlib import Path
from typing import Any, NamedTuple

import jinja2

from nuno.output_files import replacing
from nuno.plugin_contract import registry
from nuno.scene import scene_file, shipped, yaml_lines
from nuno.scene.edit import comment
from nuno.scene.files import SceneFiles, read_text
from nuno.scene.override import apply_override, as_override
from nuno.scene.provenance import assets
from nuno.scene.scene_file import Loaded
from nuno.scene.validation_errors import UNNUMBERED
from nuno_schemas.bodies import METRES, unit_of
from nuno_schemas.errors import BadInput
from nuno_schemas.pattern import Checked
from nuno_schemas.plugin import BodyShape
from nuno_schemas.preset import Imported
from nuno_schemas.units import decimal_point, to_si

PERSON = "shape: person, resolution: 64"
"""The body that comes with nuno."""
COARSE = 0.02
"""Sides of triangles of the coarse start [m], for garments with shorter ones."""
COLOURS = "#5b84b8", "#b8705b", "#6f9b63", "#8d6fa8", "#b89b4f"
"""Colours of garments in turn, the innermost first."""


MARK = "# nuno sew replaces this scene only if nothing in it has been changed: "
"""Begins the last line of a scene of patterns on a body; its digest follows."""


class Garment(NamedTuple):
    """An object's name, its pattern's file in the scene's folder, and its fabric."""

    name: str
    pattern: str
    fabric: str


def name_garments(stems: Sequence[str]) -> list[str]:
    """Return names of objects, or of a scene, from their files: letters, digits, - and _, each unique."""
    names: list[str] = []
    for stem in stems:
        name = re.sub("[^A-Za-z0-9_-]", "-", stem)[:48]
        name = name if re.match("[A-Za-z]", name) else f"garment-{name}"
        names.append(name if name not in names else f"{name}-{len(names) + 1}")
    return names


def build_body(path: Path, scale: str = "1 m") -> tuple[BodyShape | None, BadInput | None]:
    """Return the body of a mesh's file in this unit, and the fault for which it must be mended; no body if that is not
    enough.
    """
    mesh, files = registry.load("nuno.colliders", "mesh"), SceneFiles(path.parent)
    try:
        return mesh.build(mesh.Config(file=path.name, scale=scale), None, files), None
    except BadInput as fault:
        with contextlib.suppress(BadInput):
            return mesh.build(mesh.Config(file=path.name, scale=scale, mend=True), None, files), fault
        return None, fault


def unit_for(size: float, patterns: Sequence[Path]) -> str:
    """Return the unit of a body's file, in which its longest side is `size`, by the height of persons and of the
    patterns. Raises BadInput where none fits.
    """
    model = registry.offering("nuno.models", "check_pattern", "reads sewing patterns")
    height = 0.0
    for pattern in patterns:
        try:
            checked: Checked = model.check_pattern(SceneFiles(pattern.parent), pattern.name, float("inf"))
            height = max(height, checked.high)
        except BadInput:  # the run reports it
            continue
    if unit := unit_of(size, height):
        return unit
    raise BadInput(
        "the body fits no one, in whatever unit its file is", field="body", value=f"{size:.3g} units long",
        limit=f"{METRES[0]:g} to {METRES[1]:g} m, or what wears a pattern that is placed up to {height:.3g} m high",
        remedy="scale its file, so that its numbers are metres",
    )  # fmt: skip


def describe_worn(
    name: str, garments: Sequence[Garment], edge: str, body: str | None, motion: str | None = None,
    flags: tuple[str, bool] = ("", False)
) -> str:  # fmt: skip
    """Return a scene's text: `garments`, the innermost first, with sides of triangles about `edge` long, on a `body`, a
    file in the scene's folder, or None for the mannequin; `motion` is the file of its motion, `flags` the length of
    the body's unit, empty for the metre, and whether it is to be mended.
    """
    coarse = f", coarse: {100 * COARSE:g} cm" if _is_shorter(edge, COARSE) else ""
    scale, mend = f", scale: {flags[0]}" if flags[0] else "", ", mend: true" if flags[1] else ""
    of_body = f"file: {json.dumps(body)}{scale}{mend}" if body else PERSON
    values = {"name": name_garments([name])[0], "garments": garments, "body": of_body, "motion": motion}
    text = _template().render(values, edge=edge, coarse=coarse, colours=COLOURS)
    return f"{text}{MARK}{_digest(text)}\n"


@cache
def _template() -> jinja2.Template:
    """Load the template of patterns on a body that stands, or that stands for a second and then moves."""
    environment = jinja2.Environment(trim_blocks=True, keep_trailing_newline=True)
    environment.filters["quoted"] = json.dumps
    return environment.from_string(Path(__file__).with_suffix(".yaml.jinja").read_text(encoding="utf-8"))


def is_own(text: str, name: str) -> bool:
    """Return whether a scene of this name is as `describe_worn` wrote it, for any arguments: it may be replaced."""
    written, _, digest = text.rpartition(MARK)
    return digest == f"{_digest(written)}\n" and f"\nname: {json.dumps(name)}\n" in written


def _digest(text: str) -> str:
    """Return a digest of a scene but for its name, which differs where the studio writes the same scene."""
    unnamed = re.sub("(?m)^name: .*$", "", text, count=1)
    return hashlib.blake2b(unnamed.encode(), digest_size=8).hexdigest()


def _is_shorter(length: str, than: float) -> bool:
    """Return whether a text is a length below `than` [m]; the run refuses invalid ones."""
    try:
        return to_si(length, "m") < than
    except ValueError:
        return False


# Import of a laboratory's sheet of a fabric, and its values as YAML for scenes.

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


# Commented copies of shipped scenes.


def write_after(name: str, file: Path, overrides: Sequence[str] = ()) -> list[Path]:
    """Write a commented copy of a shipped scene, and the files that it needs into its folder; return their paths, the
    scene last.

    `overrides` (`key=value`) change it; the files that they name are in the folder of `file`. Raises BadInput for an
    invalid scene, and where another file of the same name exists: nothing is overwritten.
    """
    loaded = load_after(name, file, overrides)
    files = {file.parent / name_in_scene: source for name_in_scene, source in assets(loaded).items()}
    missing = {path: source for path, source in files.items()
               if not (path.is_file() and path.read_bytes() == source.read_bytes())}  # fmt: skip
    for path in (file, *missing):
        if path.exists():
            raise BadInput("it is there already, and is not written over", value=str(path),
                           remedy=f"name another: nuno new {name} FILE.yaml")  # fmt: skip
    try:
        for path, source in missing.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as new:
                shutil.copyfile(source, new)
        with replacing(file) as new:
            new.write_text(comment(loaded), encoding="utf-8")
    except OSError as error:
        raise BadInput(f"cannot write there: {error.strerror}", value=str(file)) from None
    return [*missing, file]


def load_after(name: str, file: Path, overrides: Sequence[str]) -> Loaded:
    """Load the scene that `write_after` writes. Raises BadInput."""
    path = shipped.scenes()[name]
    titled = [as_override("name", name_garments([file.stem])[0]), *overrides]
    if not overrides:
        return scene_file.read(path, titled)
    data, lines = yaml_lines.parse(path.read_text(encoding="utf-8"), str(path))
    for item in titled:
        apply_override(data, item)
    # Of two files with one name, that in the new scene's folder counts, which may have been put there for it.
    shipped_files = scene_file.files_of(path)
    files = SceneFiles(file.parent, (shipped_files.folder, *shipped_files.roots))
    return replace(scene_file.load(data, dict.fromkeys(lines, UNNUMBERED), file.name, files), path=path)
