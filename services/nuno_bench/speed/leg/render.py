"""Pictures of yarns by rays: seconds for a stocking of 300 x 300 points on a leg, and rays a second."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from nuno import registry
from nuno.scene.files import SceneFiles
from nuno_bench.report.result import Result
from nuno_bench.speed.leg.closest import leg
from nuno_bench.speed.timing import measure
from nuno_schemas.camera import frame
from nuno_schemas.drawing import Mesh
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.operation import Surface
from nuno_schemas.yarn_picture import Worn

AROUND = 96
"""Vertices round the leg."""
POINTS = 300
"""Of the stocking, along and round the leg."""
CURVE = 4
"""Pieces of a curve to a link."""
SIDE, SAMPLES = 1024, 4
BAR = 10.0
"""Seconds, on two cores."""
CUT = 0.06
"""Share of the leg's rings that the stocking leaves free at either end."""
RADIUS = 1.5e-4
"""Of its yarns [m]."""


def over_leg(x: Float, rows: int, columns: int) -> Float:
    """(rows columns, 3) points of a net on the leg: its rings, drawn finer. Such a stocking is worn, not fitted."""
    rings = x[: (len(x) - 2) // AROUND * AROUND].reshape(-1, AROUND, 3)[::-1]
    row = np.linspace(CUT, 1.0 - CUT, rows) * (len(rings) - 1)
    column = np.arange(columns) * AROUND / columns
    i, j = row.astype(int), column.astype(int)
    s, t = (row - i)[:, None, None], (column - j)[None, :, None]
    after = (j + 1) % AROUND
    low = rings[i][:, j] * (1.0 - t) + rings[i][:, after] * t
    high = rings[i + 1][:, j] * (1.0 - t) + rings[i + 1][:, after] * t
    return np.asarray((low * (1.0 - s) + high * s).reshape(-1, 3))


def stocking(points: int = POINTS) -> tuple[Worn, int]:
    """A stocking of plain knit on the leg, z up, as curves; and how many links it has."""
    knit = registry.load("nuno.models", "knit")
    config = knit.Config.model_validate({"form": "tube", "wales": points // 2, "courses": points - 1})
    fabric: Fabric = knit.build(config, SceneFiles(Path(), ()), 0)
    x, faces = leg(AROUND)
    x = np.ascontiguousarray(x[:, [0, 2, 1]] * np.array([1.0, -1.0, 1.0]))
    on = over_leg(x, points, points)
    smooth: Any = registry.load("nuno.operations", "smooth")
    options = smooth.Config.model_validate({"radius": RADIUS, "samples": CURVE})
    curves = smooth.apply(options, fabric, State(on, np.zeros_like(on)), Surface(x, faces)).curves
    assert fabric.springs is not None
    return Worn((Mesh(x, faces, two_sided=False),), on, fabric.springs.pairs(), curves), fabric.springs.number


def render(repeats: int) -> list[Result]:
    """A picture with shadows and occlusion, and how many rays from the eye that is a second."""
    worn, links = stocking()
    plugin = registry.load("nuno.yarn_pictures", "yarns")
    config = plugin.Config.model_validate({"samples": SAMPLES})
    draw = partial(plugin.draw, config, worn, frame(worn.points, size=(SIDE, SIDE)))
    assert worn.yarns is not None
    note = f"{len(worn.yarns.segments()):,} capsules, shadows and occlusion, the tree made each time"
    what = f"{SIDE} x {SIDE}, {SAMPLES} samples a pixel, {links:,} links"
    taken = measure("render", what, "s", draw, repeats, bar=BAR, at_most=True, note=note)
    rates = tuple(1e-6 * SAMPLES * SIDE * SIDE / seconds for seconds in taken.samples)
    return [taken, Result("render", "rays from the eye", "M rays/s", rates, note="each with what it sends on")]
