"""Lengths of a fabric's yarns, for its report."""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno_schemas.fabric import Fabric, Float


def measure_yarns(fabric: Fabric) -> dict[str, dict[str, float]]:
    """Rest lengths [m] by name of yarn: of all of that name, and of the longest, which in a knit is a course."""
    if fabric.yarns is None or fabric.springs is None:
        return {}
    lengths = fabric.yarns.lengths(fabric.springs)
    found: dict[str, dict[str, float]] = {}
    for index, name in enumerate(fabric.yarns.names):
        own = lengths[fabric.yarns.kind == index]
        found[name] = {"length": float(own.sum()), "longest": float(own.max(initial=0.0))}
    return found


def measure_courses(fabric: Fabric, x: Float) -> dict[str, Any]:
    """How long each yarn of at least two links is at x (n, 3) [m], as a ratio of its rest length.

    `min`, `mean` and `max` with the number of the yarn, counted from 0, that is the shortest and the longest; in a
    knit these are courses from the bottom. `rest` and `present` [m] hold all. Nothing where there is no such yarn.
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
