"""Cusick's drapemeter: a disc over a smaller one, its shadow, its folds and the drape coefficient."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_bench.instruments.rig import mount
from nuno_cloth.fabrics import shadow as shadows
from nuno_schemas.fabric import Float, Int

RADIUS, SUPPORT = 0.15, 0.09
"""Of specimen and support, unless others were measured [m]."""
DOT = 2.5e-4
"""Side of the shadow's dots [m]."""
ROUGH, WAVE = 2e-4, 1e-2
"""Standard deviation of the heights at the start, and height of the folds at the rim where it begins in folds [m]."""


@dataclass(frozen=True)
class Drape:
    """coefficient: the share of the overhanging ring that the shadow covers; nodes: its folds; energy [J] where it
    rests, gravitational and elastic, about 0 of a flat disc; shadow: (side, side) dots that are dark, the middle of the
    disc in their middle; x (n, 3) where it rests [m].
    """

    coefficient: float
    nodes: int
    energy: float
    shadow: NDArray[np.bool_]
    x: Float


def drape(
    fabric: object,
    edge: float,
    seed: int,
    folds: int = 0,
    radius: float = RADIUS,
    support: float = SUPPORT,
    **model: Any,
) -> Drape:
    """A disc of triangles with edges of this length [m], hung from a start that is rough by a seed of its own; radii of
    the disc and of what it lies on [m].

    With `folds` the free ring starts in so many waves round it, too, whose crests are where the seed says: the disc
    then finds the drape with as many folds, if there is one, of the several that cloth has. Raises BadInput for what is
    no fabric, RunFailed where the solver fails.
    """
    rig = mount("drapemeter", fabric, edge=edge, radius=radius, hold=support, **model)
    free, random = ~rig.fabric.pinned, np.random.default_rng(seed)
    rig.state.x[free, 1] += ROUGH * random.standard_normal(int(free.sum()))
    if folds:
        east, _, north = rig.fabric.position[free].T
        out = (np.hypot(east, north) - support) / (radius - support)
        waves = np.cos(folds * np.arctan2(north, east) + random.uniform(0.0, 2.0 * np.pi))
        rig.state.x[free, 1] += WAVE * out * waves
    x = rig.run(rig.problem.frames).copy()
    coefficient, shadow = measure(rig.fabric.position, x, rig.fabric.faces, radius, support)
    return Drape(coefficient, count_nodes(shadow), rig.energy(), shadow, x)


def measure(
    flat: Float, x: Float, faces: Int, radius: float = RADIUS, support: float = SUPPORT
) -> tuple[float, NDArray[np.bool_]]:
    """The drape coefficient and the shadow of a disc that lay at `flat` (n, 3) and hangs at x (n, 3) [m]."""
    whole, shadow = (cast_shadow(each, faces, radius) for each in (flat, x))
    held = np.pi * support**2
    dark, most = (float(each.sum()) * DOT**2 for each in (shadow, whole))
    return (dark - held) / (most - held), shadow


def cast_shadow(x: Float, faces: Int, radius: float = RADIUS) -> NDArray[np.bool_]:
    """(side, side) what triangles at x (n, 3) [m] within a radius cover as seen from above."""
    from PIL import Image, ImageDraw

    side = round(2.2 * radius / DOT)
    image = Image.new("1", (side, side))
    drawn, places = ImageDraw.Draw(image), x[:, [0, 2]] / DOT + 0.5 * side
    for face in faces:
        drawn.polygon([(float(a), float(b)) for a, b in places[face]], fill=1)
    return np.asarray(image)


def count_nodes(shadow: NDArray[np.bool_]) -> int:
    """How many folds stand out of its outline."""
    return shadows.count_nodes(shadow, DOT, (0.5 * len(shadow), 0.5 * len(shadow)))
