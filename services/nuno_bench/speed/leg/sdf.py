"""Distance fields of a leg: how soon they are made, how fast they are asked, how exact and how large they are."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from nuno import registry
from nuno_bench.report.result import Result
from nuno_bench.speed.leg.closest import leg, points_near, rate
from nuno_bench.speed.timing import seconds, watch_compiler
from nuno_schemas.field import DistanceField

CASE = "sdf"
AROUND = 95
"""About 50,000 triangles."""
TOLERANCE = 1e-3
POINTS = 1_000_000
BUILD_BAR, RATE_BAR, MEMORY_BAR = 10.0, 20.0, 10.0
VALUE = 4
"""Bytes of a distance in a dense grid, without its gradient."""


def smallest_leaf(field: DistanceField) -> float:
    """Edge of the smallest leaf [m], by the levels of cells below the whole ones."""
    cells, level = field.child[: int(field.shape.prod())], 0
    while (inner := cells[cells >= 0]).size:
        cells, level = field.child[inner[:, None] + np.arange(8)].reshape(-1), level + 1
    return float(field.size / 2**level)


def sdf(repeats: int) -> list[Result]:
    """Time to build, samples a second, the largest error, and memory against a grid as fine throughout."""
    plugin: Any = registry.load("nuno.colliders", "sdf")
    search: Any = registry.load("nuno.colliders", "mesh")
    x, faces = leg(AROUND)
    make = partial(plugin.field, x, faces, TOLERANCE)
    with watch_compiler() as compiler:
        first = seconds(make)
    built = tuple(seconds(make) for _ in range(min(repeats, 3)))
    field = make()
    ask = plugin.sampler(field)
    near = points_near(x, faces, POINTS)
    mixed = near[np.random.default_rng(2).permutation(POINTS)]
    found = ask(near)[:, 0]
    exact = search.search(x, faces)(near).distance
    error = np.abs(found - exact) / (TOLERANCE * np.maximum(1.0, np.abs(exact) / field.band))
    edge = smallest_leaf(field)
    dense = float(np.prod(np.ceil(field.shape * field.size / edge) + 1.0)) * VALUE
    what = f"{len(faces):,} triangles, 1 mm"
    size = f"{len(field.corners):,} leaves, the smallest of {edge * 1e3:.2g} mm, {field.nbytes / 1e6:.1f} MB"
    return [
        Result(CASE, f"{what}: build", "s", built, BUILD_BAR, None, True, first, None,
               f"{size}, {compiler.number} functions compiled"),
        Result(CASE, f"{what}: in the order of the surface", "M samples/s",
               tuple(rate(partial(ask, near), POINTS) for _ in range(repeats)), RATE_BAR,
               note="distance and gradient; vertices of cloth lie in such an order"),
        Result(CASE, f"{what}: in random order", "M samples/s",
               tuple(rate(partial(ask, mixed), POINTS) for _ in range(repeats))),
        Result(CASE, f"{what}: largest error at {POINTS:,} points", "of what is allowed", (float(error.max()),), 1.0,
               None, True, note="against the exact distance"),
        Result(CASE, f"{what}: dense grid over field", "times", (dense / field.nbytes,), MEMORY_BAR,
               note="a grid of the smallest leaves with distances alone, in single precision"),
    ]  # fmt: skip
