"""Scenes of garments sewn from patterns: run, drawn from all sides, and measured on their bodies."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from nuno.exports.dyed_pictures import Changes
from nuno.exports.pictures import export_picture
from nuno.python_api.fit import read_fits, wearer
from nuno.recording.reader import Recording
from nuno.scene.recorded_scene import restored_scene
from nuno.scene.scene_file import Loaded
from nuno_bench.gallery.contact import CROSSED, SECONDS, SIZE, VERTICES
from nuno_bench.gallery.contact import measure as measure_run
from nuno_bench.gallery.kind import Gallery, ShownScene, find_scenes, show_scene
from nuno_bench.piles import Oracle
from nuno_bench.report.page import Table, number
from nuno_schemas.colour import read_rgb
from nuno_schemas.pictures import Picture

SIDES = {"from the front": 20, "from the side": 110, "from behind": 200}
"""Azimuths that are drawn [deg]."""
BUST, WAIST = "bust [cm]", "waist [cm]"
WARP, WEFT = "warp [%]", "weft [%]"
PRESSURE = "pressure [Pa]"
WORN, IPCTK, RESTED, ALL = "worn", "by ipctk", "at rest after [s]", "in all [s]"
MEASURES = (VERTICES, WORN, CROSSED, IPCTK, BUST, WAIST, WARP, WEFT, PRESSURE, RESTED, SECONDS, ALL)
TOLD = (
    "Each scene at its end. Worn: 0 where nothing touches the body, or an opening has slipped (nuno fit names it). By "
    "ipctk: 1 where an edge of cloth or body goes through the other, or through cloth. Bust, waist: ease. Warp, weft: "
    "95 % of the cloth is strained by less. Pressure: where cloth presses. Of several garments ease and pressure are "
    "of the innermost, strain is the largest. At rest: -, where the scene ended before. In all: of the run with all "
    "its services. docs/how-to/sewing.md says how fit is measured."
)


def look(loaded: Loaded, recording: Recording, folder: Path) -> tuple[list[tuple[str, Picture]], dict[str, float]]:
    """Draw its end from all sides, by way of a file in a folder, and measure it."""
    found = []
    for label, azimuth in SIDES.items():
        changes = Changes(overrides=(f"view.azimuth={azimuth} deg",))
        picture = export_picture(recording, folder / "picture.png", None, SIZE, "cloth", changes)
        found.append((label, read_rgb(picture)))
    return found, measure(recording)


def measure(recording: Recording) -> dict[str, float]:
    """From a run's report and its last frame; nothing of a run that did not end by itself."""
    report = recording.report()
    found = {name: value for name, value in measure_run(report).items() if name in MEASURES}
    if not found:
        return {}
    with restored_scene(recording) as loaded:
        rested = report["frames"]["sent"] <= loaded.scene.frames
        judged = importlib.util.find_spec("ipctk") is not None
        found[IPCTK] = float(_crosses(recording, loaded)) if judged else math.nan
    found[RESTED] = report["simulated_seconds"] if rested else math.nan
    found[ALL] = report["prepare_seconds"] + report["wall_seconds"]
    fits = read_fits(recording)
    # Of several garments, the innermost first, the one that is next to the body there.
    ease = {one.name: 100.0 * one.ease for fit in reversed(fits) for one in fit.girths if one.ease is not None}
    for name, yarns in ((WARP, "warp"), (WEFT, "weft")):
        found[name] = 100.0 * max(fit.strains[yarns].high for fit in fits)
    if pressed := [fit.pressed.mean for fit in fits if fit.pressed is not None]:
        found[PRESSURE] = pressed[0]
    found[WORN] = float(all(fit.on for fit in fits))
    return found | {BUST: ease.get("bust", math.nan), WAIST: ease.get("waist", math.nan)}


def _crosses(recording: Recording, loaded: Loaded) -> bool:
    """Whether an edge of cloth goes through cloth or through the body at the end, or one of the body through cloth."""
    frame = list(recording.frames())[-1]
    (body, faces), _, _ = wearer(loaded, None, frame.t, str(recording.path))
    x = np.concatenate([np.asarray(frame.x, np.float64), body])
    cloth = recording.fabric()[0]["faces"]
    return Oracle(x, np.concatenate([cloth, faces + len(x) - len(body)]).astype(np.int32), len(body)).crossed(x)


def table(shown: Sequence[ShownScene]) -> Table:
    """A row a scene."""
    rows = [
        [one.name, *("-" if math.isnan(one.measured[name]) else number(one.measured[name]) for name in MEASURES)]
        for one in shown if one.measured
    ]  # fmt: skip
    return Table(("scene", *MEASURES), rows)


KIND = Gallery(
    title="Sewn from patterns",
    lead="Garments that come with nuno as sewing patterns, sewn and put on the mannequin.",
    scenes=partial(find_scenes, "sewn"),
    run_scene=partial(show_scene, look=look),
    alike=True,
    measures=TOLD,
    table=table,
)
