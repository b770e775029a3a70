"""Cusick's drapemeter: a disc of 30 cm over one of 18 cm, its shadow, its folds and the drape coefficient."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nuno_bench.instruments.rig import mount
from nuno_schemas.fabric import Float, Int

RADIUS, SUPPORT = 0.15, 0.09
"""Of specimen and support [m]."""
DOT = 2.5e-4
"""Side of the shadow's dots [m]."""
RAYS, SMOOTH, PEAK = 720, 24, 1e-3
"""Directions in which the outline is read, harmonics that are kept of it, and how far a node stands out of what is
beside it [m]."""


@dataclass(frozen=True)
class Drape:
    """coefficient: the share of the overhanging ring that the shadow covers; nodes: its folds; shadow: (side, side)
    dots that are dark, the middle of the disc in their middle; x (n, 3) where it rests [m].
    """

    coefficient: float
    nodes: int
    shadow: NDArray[np.bool_]
    x: Float


def drape(fabric: object, edge: float, seed: int, **model: object) -> Drape:
    """A disc of triangles with edges of this length [m], hung from a start that is rough by a seed of its own."""
    rig = mount("drapemeter", fabric, edge=edge, **model)
    free = ~rig.fabric.pinned
    rig.state.x[free, 1] += 2e-4 * np.random.default_rng(seed).standard_normal(int(free.sum()))
    whole = cast_shadow(rig.fabric.position, rig.fabric.faces)
    x = rig.run(rig.problem.frames).copy()
    shadow = cast_shadow(x, rig.fabric.faces)
    support = np.pi * SUPPORT**2
    dark, most = (float(each.sum()) * DOT**2 for each in (shadow, whole))
    return Drape((dark - support) / (most - support), count_nodes(shadow), shadow, x)


def cast_shadow(x: Float, faces: Int) -> NDArray[np.bool_]:
    """(side, side) what triangles at x (n, 3) [m] cover as seen from above."""
    from PIL import Image, ImageDraw

    side = round(2.2 * RADIUS / DOT)
    image = Image.new("1", (side, side))
    drawn, places = ImageDraw.Draw(image), x[:, [0, 2]] / DOT + 0.5 * side
    for face in faces:
        drawn.polygon([(float(a), float(b)) for a, b in places[face]], fill=1)
    return np.asarray(image)


def count_nodes(shadow: NDArray[np.bool_]) -> int:
    """How many folds stand out of its outline."""
    side, angles = len(shadow), 2.0 * np.pi * np.arange(RAYS) / RAYS
    far = np.arange(round(0.5 * side))
    rows = np.clip(np.rint(0.5 * side + np.outer(np.sin(angles), far)).astype(int), 0, side - 1)
    columns = np.clip(np.rint(0.5 * side + np.outer(np.cos(angles), far)).astype(int), 0, side - 1)
    reached = DOT * (shadow[rows, columns] * far).max(axis=1)
    waves = np.fft.rfft(reached)
    waves[SMOOTH + 1 :] = 0.0
    outline = np.fft.irfft(waves, RAYS)
    high = np.flatnonzero((outline > np.roll(outline, 1)) & (outline >= np.roll(outline, -1)))
    if len(high) < 2:
        return len(high)
    low = [
        outline[np.arange(a, b if b > a else b + RAYS) % RAYS].min()
        for a, b in zip(high, np.roll(high, -1), strict=True)
    ]
    before = np.roll(low, 1)
    return int((outline[high] - np.maximum(low, before) > PEAK).sum())
