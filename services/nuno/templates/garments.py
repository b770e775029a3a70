"""Garments on a body, as scenes to be run as they are and to be changed: what `nuno sew` writes."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import jinja2

from nuno import registry
from nuno.scene import yaml_lines
from nuno.scene.files import SceneFiles
from nuno_schemas.bodies import METRES, unit_of
from nuno_schemas.errors import BadInput
from nuno_schemas.pattern import Checked
from nuno_schemas.units import to_si

PERSON = "shape: person, resolution: 64"
"""The body that comes with nuno."""
COARSE = 0.02
"""Garments of shorter sides than this [m] come to rest on sides as long first."""
COLOURS = "#5b84b8", "#b8705b", "#6f9b63", "#8d6fa8", "#b89b4f"
"""In turn, the innermost first."""


class Garment(NamedTuple):
    """An object's name, its pattern's file beside the scene, and its fabric."""

    name: str
    pattern: str
    fabric: str


def name_garments(stems: Sequence[str]) -> list[str]:
    """Names of objects, or of a scene, after their files: letters, digits, - and _, none twice."""
    found: list[str] = []
    for stem in stems:
        name = re.sub("[^A-Za-z0-9_-]", "-", stem)[:48]
        name = name if re.match("[A-Za-z]", name) else f"garment-{name}"
        found.append(name if name not in found else f"{name}-{len(found) + 1}")
    return found


def unit_for(size: float, patterns: Sequence[Path]) -> str:
    """The unit of the file of a body whose longest side is `size` of them, by how tall persons are and how high
    patterns are placed. Raises BadInput where none fits.
    """
    model = registry.offering("nuno.models", "check_pattern", "reads sewing patterns")
    high = 0.0
    for pattern in patterns:
        try:
            found: Checked = model.check_pattern(SceneFiles(pattern.parent), pattern.name, float("inf"))
            high = max(high, found.high)
        except BadInput:  # as the run says
            continue
    if unit := unit_of(size, high):
        return unit
    raise BadInput(
        "the body fits no one, in whatever unit its file is", field="body", value=f"{size:.3g} units long",
        limit=f"{METRES[0]:g} to {METRES[1]:g} m, or what wears a pattern that is placed up to {high:.3g} m high",
        remedy="scale its file, so that its numbers are metres",
    )  # fmt: skip


def describe_worn(
    name: str, garments: Sequence[Garment], edge: str, body: str | None, motion: str | None = None, scale: str = ""
) -> str:
    """A scene's text: `garments`, the innermost first, their triangles' sides about `edge` long, on a `body`, a file
    beside the scene, whose unit is `scale` long where it is not the metre, or None for the mannequin; it may go by the
    file `motion`.
    """
    coarse = f", coarse: {100 * COARSE:g} cm" if _is_shorter(edge, COARSE) else ""
    of_body = f"file: {json.dumps(body)}" + (f", scale: {scale}" if scale else "") if body else PERSON
    given = {"name": name_garments([name])[0], "garments": garments, "body": of_body, "motion": motion}
    return _template().render(given, edge=edge, coarse=coarse, colours=COLOURS)


@cache
def _template() -> jinja2.Template:
    """The scene of patterns on a body that stands, or that stands for a second and sets out."""
    environment = jinja2.Environment(trim_blocks=True, keep_trailing_newline=True)
    environment.filters["quoted"] = json.dumps
    return environment.from_string(Path(__file__).with_suffix(".yaml.jinja").read_text(encoding="utf-8"))


def is_own(text: str) -> bool:
    """Whether a scene was written here, for whatever flags, and not changed since: it may go."""
    try:
        data, _ = yaml_lines.parse(text, "")
        objects, (wearer,) = data["objects"], data["bodies"]
        garments = [Garment(one["name"], one["model"]["file"], one["model"]["fabric"]) for one in objects]
        body, motion, edge = wearer["collider"], wearer.get("motion", {}).get("file"), objects[0]["model"]["edge"]
        return text == describe_worn(data["name"], garments, edge, body.get("file"), motion, body.get("scale", ""))
    except (BadInput, LookupError, TypeError, ValueError, AttributeError):
        return False


def _is_shorter(length: str, than: float) -> bool:
    """Whether it is one [m] and is; what is none, the run refuses."""
    try:
        return to_si(length, "m") < than
    except ValueError:
        return False
