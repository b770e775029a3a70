"""A fabric's yarns and springs for output: lengths for the report, edges for display."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.fabric import Fabric, Float


def measure_yarns(fabric: Fabric) -> dict[str, dict[str, float]]:
    """Return rest lengths [m] by name of yarn: of all with that name, and of the longest, a course in a knit."""
    if fabric.yarns is None or fabric.springs is None:
        return {}
    lengths = fabric.yarns.lengths(fabric.springs)
    measures: dict[str, dict[str, float]] = {}
    for index, name in enumerate(fabric.yarns.names):
        selected = lengths[fabric.yarns.kind == index]
        measures[name] = {"length": float(selected.sum()), "longest": float(selected.max(initial=0.0))}
    return measures


def measure_courses(fabric: Fabric, x: Float) -> dict[str, Any]:
    """Return the length of each yarn of at least two links at x (n, 3) [m], as a ratio of its rest length.

    `min`, `mean` and `max`, with the numbers, from 0, of the shortest and the longest yarn; in a knit these are courses
    from the bottom. `rest` and `present` [m] hold all. Empty if there is no such yarn.
    """
    if fabric.yarns is None or fabric.springs is None:
        return {}
    several = np.diff(fabric.yarns.ptr) > 1
    if not several.any() or not np.isfinite(x).all():
        return {}
    pairs = fabric.springs.pairs()
    now = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1)
    rest, present = (fabric.yarns.lengths(fabric.springs, each)[several] for each in (None, now))
    ratio = present / rest
    return {
        "min": float(ratio.min()),
        "mean": float(present.sum() / rest.sum()),
        "max": float(ratio.max()),
        "shortest": int(ratio.argmin()),
        "longest": int(ratio.argmax()),
        "rest": rest.tolist(),
        "present": present.tolist(),
    }


def edge_yarns(fabric: Fabric) -> NDArray[np.int8] | None:
    """Return the index (e,) of the yarn's name of each of `structural_edges`, -1 for none; None without yarns."""
    springs, yarns = fabric.springs, fabric.yarns
    if springs is None or yarns is None:
        return None
    kind = np.full(springs.number, -1, np.int8)
    kind[yarns.links] = np.repeat(yarns.kind, np.diff(yarns.ptr))
    structural = springs.of_kind(0)
    return append_sides(fabric, kind[structural] if structural.any() else kind, -1)


def structural_edges(fabric: Fabric) -> tuple[np.ndarray, Float]:
    """Return pairs and rest lengths of the structural springs (all springs if none is structural), and of the sides of
    a membrane's triangles, for display.
    """
    springs, membrane = fabric.springs, fabric.membrane
    pairs, rest = np.zeros((0, 2), np.int32), np.zeros(0)
    if springs is not None:
        shown = springs.of_kind(0)
        if membrane is None and not shown.any():
            shown[:] = True
        pairs, rest = springs.pairs()[shown], springs.per_spring(springs.rest)[shown]
    if membrane is not None:
        sides, long = membrane.edges()
        pairs, rest = np.concatenate([pairs, sides]), np.append(rest, long)
    return pairs, rest


def append_sides(fabric: Fabric, values: NDArray[Any], fill: float) -> NDArray[Any]:
    """Append `fill` for sides of a membrane's triangles to values (s, ...) of springs, as in `structural_edges`."""
    if fabric.membrane is None:
        return values
    more = np.full((len(fabric.membrane.edges()[0]), *values.shape[1:]), fill, values.dtype)
    return np.concatenate([values, more])
