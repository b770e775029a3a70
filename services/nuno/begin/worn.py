"""Garments on a body, as scenes to be run as they are and to be changed: what `nuno sew` writes."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from nuno import registry
from nuno.scene.files import SceneFiles
from nuno_schemas.bodies import METRES, unit_of
from nuno_schemas.errors import BadInput
from nuno_schemas.pattern import Checked
from nuno_schemas.units import to_si

WORN = """\
nuno: 1
name: {name}
description: What is sewn from patterns is drawn on a body, and comes to rest there.
duration: 6 s
until: rest
rest_speed: 2 mm/s
frame_rate: 60 Hz
solver: {{plugin: respa, dt: auto}}
damping: {{first: 400, over: 50 ms, last: 4}}
objects:
{garments}bodies:
  - name: wearer
    collider: {{plugin: mesh, {body}}}
    friction: 0.4
cloth_contact: {{plugin: offset, thickness: 1.5 mm, bodies: [wearer]}}
operations:
  - {{plugin: untangle}}
view: {{azimuth: 20 deg, elevation: 5 deg}}
"""
"""The scene of patterns on a body: the guarantee of cloth contact begins once `untangle` is done."""
WALKED = WORN
for _standing, _walking in (
    ("and comes to rest there", "comes to rest there, and goes along as the body moves"),
    ("duration: 6 s\nuntil: rest\nrest_speed: 2 mm/s\n", "duration: 4 s\n"),
    ("last: 4", "last: 1"),
    ("thickness: 1.5 mm", "thickness: 2 mm"),
    ("{{plugin: mesh, {body}}}", "{{plugin: skin, {body}, stand: 1 s, blend: 1 s}}\n"
     "    motion: {{plugin: bvh, file: {motion}}}"),
):  # fmt: skip
    assert _standing in WALKED
    WALKED = WALKED.replace(_standing, _walking)
"""The same on a body that stands for a second and sets out: what moves is held back less than what is to rest, and has
more room to be stopped in."""
GARMENT = """\
  - name: {name}
    colour: {colour}
    model: {{plugin: pattern, file: {pattern}, edge: {edge}{coarse}, fabric: {fabric}, over: {{body: wearer}}}}
"""
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
    each = [
        GARMENT.format(name=one.name, colour=_quoted(COLOURS[i % len(COLOURS)]), pattern=_quoted(one.pattern),
                       edge=_quoted(edge), coarse=coarse, fabric=_quoted(one.fabric))
        for i, one in enumerate(garments)
    ]  # fmt: skip
    given = {
        "name": _quoted(name_garments([name])[0]),
        "body": f"file: {_quoted(body)}" + (f", scale: {scale}" if scale else "") if body else PERSON,
        "motion": _quoted(motion),
    }
    return (WALKED if motion else WORN).format(garments="".join(each), **given)


def is_own(text: str) -> bool:
    """Whether a scene was written here, for whatever flags, and not changed since: it may go."""
    of_garment, of_scene = ("name", "colour", "pattern", "edge", "coarse", "fabric"), ("name", "body", "motion")
    garments = f"(?:{_pattern_of(GARMENT, dict.fromkeys(of_garment, '.*'))})+"
    values = dict.fromkeys(of_scene, ".*") | {"garments": garments}
    return any(re.fullmatch(_pattern_of(one, values), text) for one in (WORN, WALKED))


def _pattern_of(template: str, values: dict[str, str]) -> str:
    """The regular expression of a template's texts, of one for each of its fields."""
    marks = {name: f"\0{i}\0" for i, name in enumerate(values)}
    text = re.escape(template.format(**marks))
    for name, mark in marks.items():
        text = text.replace(re.escape(mark), values[name])
    return text


def _is_shorter(length: str, than: float) -> bool:
    """Whether it is one [m] and is; what is none, the run refuses."""
    try:
        return to_si(length, "m") < than
    except ValueError:
        return False


def _quoted(value: str | None) -> str:
    return json.dumps(value)
