"""Scenes of garments on a body, which `nuno sew` writes."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import jinja2

from nuno.plugin_contract import registry
from nuno.scene import yaml_lines
from nuno.scene.files import SceneFiles
from nuno_schemas.bodies import METRES, unit_of
from nuno_schemas.errors import BadInput
from nuno_schemas.pattern import Checked
from nuno_schemas.plugin import BodyShape
from nuno_schemas.units import to_si

PERSON = "shape: person, resolution: 64"
"""The body that comes with nuno."""
COARSE = 0.02
"""Sides of triangles of the coarse start [m], for garments with shorter ones."""
COLOURS = "#5b84b8", "#b8705b", "#6f9b63", "#8d6fa8", "#b89b4f"
"""Colours of garments in turn, the innermost first."""


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


def build_body(path: Path) -> tuple[BodyShape | None, BadInput | None]:
    """Return the body of a mesh's file, and the fault for which it must be mended; no body if that is not enough."""
    mesh, files = registry.load("nuno.colliders", "mesh"), SceneFiles(path.parent)
    try:
        return mesh.build(mesh.Config(file=path.name), None, files), None
    except BadInput as fault:
        with contextlib.suppress(BadInput):
            return mesh.build(mesh.Config(file=path.name, mend=True), None, files), fault
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
    return _template().render(values, edge=edge, coarse=coarse, colours=COLOURS)


@cache
def _template() -> jinja2.Template:
    """Load the template of patterns on a body that stands, or that stands for a second and then moves."""
    environment = jinja2.Environment(trim_blocks=True, keep_trailing_newline=True)
    environment.filters["quoted"] = json.dumps
    return environment.from_string(Path(__file__).with_suffix(".yaml.jinja").read_text(encoding="utf-8"))


def is_own(text: str) -> bool:
    """Return whether a scene was written by this module, with any flags, and is unchanged: it may be replaced."""
    try:
        data, _ = yaml_lines.parse(text, "")
        objects, (wearer,) = data["objects"], data["bodies"]
        garments = [Garment(item["name"], item["model"]["file"], item["model"]["fabric"]) for item in objects]
        body, motion, edge = wearer["collider"], wearer.get("motion", {}).get("file"), objects[0]["model"]["edge"]
        flags = body.get("scale", ""), body.get("mend", False)
        return text == describe_worn(data["name"], garments, edge, body.get("file"), motion, flags)
    except (BadInput, LookupError, TypeError, ValueError, AttributeError):
        return False


def _is_shorter(length: str, than: float) -> bool:
    """Return whether a text is a length below `than` [m]; the run refuses invalid ones."""
    try:
        return to_si(length, "m") < than
    except ValueError:
        return False
