"""Shipped scenes of garments sewn from patterns: run, drawn from all sides, and measured on their bodies."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from nuno.export.dyed_pictures import Changes
from nuno.export.pictures import export_picture
from nuno.fit.read import read_fits
from nuno.recording.reader import Recording
from nuno_bench.gallery.contact import CROSSED, SECONDS, SIZE, VERTICES
from nuno_bench.gallery.contact import measure as measure_run
from nuno_bench.gallery.kind import Kind, Shown, read_picture, shipped, show_scene
from nuno_bench.report.page import Table
from nuno_bench.report.result import number
from nuno_schemas.dye_picture import Picture

SIDES = {"from the front": 20, "from the side": 110, "from behind": 200}
"""Azimuths that are drawn [deg]."""
BUST, WAIST = "ease at the bust [cm]", "ease at the waist [cm]"
WARP, WEFT = "warp is strained by less than, of 95 % of it [%]", "weft [%]"
PRESSURE = "pressure where it presses [Pa]"
MEASURES = (VERTICES, CROSSED, BUST, WAIST, WARP, WEFT, PRESSURE, SECONDS)


def look(recording: Recording, folder: Path) -> tuple[list[tuple[str, Picture]], dict[str, float]]:
    """See show_scene."""
    return draw(recording, folder), measure(recording)


def draw(recording: Recording, folder: Path) -> list[tuple[str, Picture]]:
    """Its end from all sides, by way of a file in a folder."""
    found = []
    for label, azimuth in SIDES.items():
        changes = Changes(overrides=(f"view.azimuth={azimuth} deg",))
        picture = export_picture(recording, folder / "picture.png", None, SIZE, "cloth", changes)
        found.append((label, read_picture(picture)))
    return found


def measure(recording: Recording) -> dict[str, float]:
    """From a run's report and its last frame; nothing of a run that did not end by itself."""
    found = {name: value for name, value in measure_run(recording.report()).items() if name in MEASURES}
    if not found:
        return {}
    (fit,) = read_fits(recording)
    ease = {one.name: 100.0 * one.ease for one in fit.girths if one.ease is not None}
    strains = {WARP: 100.0 * fit.strains["warp"].high, WEFT: 100.0 * fit.strains["weft"].high}
    pressed = {} if fit.pressed is None else {PRESSURE: fit.pressed.mean}
    nan = float("nan")
    return found | {BUST: ease.get("bust", nan), WAIST: ease.get("waist", nan)} | strains | pressed


def table(shown: Sequence[Shown]) -> Table:
    """A row a scene."""
    rows = [[one.name, *(number(one.measured[name]) for name in MEASURES)] for one in shown if one.measured]
    return Table(("scene", *MEASURES), rows)


KIND = Kind(
    title="Sewn from patterns",
    lead="Garments that come with nuno as sewing patterns, sewn and put on the mannequin.",
    scenes=partial(shipped, "sewn"),
    run_scene=partial(show_scene, look=look),
    differences=(),
    measures="Each scene as it is shipped, at its end: docs/sewing.md says how fit is measured.",
    table=table,
)
