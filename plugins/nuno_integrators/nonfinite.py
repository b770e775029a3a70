"""Reports of a state that is not finite: in which step it became so, and at which vertices first."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from nuno_schemas.fabric import Bool, Fabric, Float, State

Go = Callable[[int, int], None]
"""Advances the rows x, v (3, n) in place, which have taken so many steps, by so many more."""


def find_nonfinite(x: Float, v: Float) -> Bool:
    """Return whether the position or velocity of each vertex, x and v (3, n), is not finite, shape (n,)."""
    nonfinite: Bool = np.logical_not(np.isfinite(x).all(axis=0) & np.isfinite(v).all(axis=0))
    return nonfinite


def describe_nonfinite(fabric: Fabric, before: State, nonfinite: Bool, first: Bool, step: str) -> str:
    """Describe the non-finite vertices (n,), "" if there are none; `first` became so first, in a step, in words, or ""
    if that is not known.

    The one named is the free one that was fastest in the state before: non-finite vertices take their neighbours along,
    pinned ones too, on which an infinite force times no mobility is NaN.
    """
    if not nonfinite.any():
        return ""
    first = first if step else nonfinite
    summary = f"{int(nonfinite.sum())} of {fabric.number} vertices have no finite position or velocity; "
    speed = np.where(first, np.where(fabric.pinned, 0.0, np.abs(before.v).max(axis=1)), -1.0)
    vertex = int(np.argmax(np.where(np.isfinite(speed), speed, np.inf)))
    named = f"vertex {fabric.told(vertex)}, at {math.hypot(*before.v[vertex]):.3g} m/s before"
    if step and first.sum() == 1:
        return f"{summary}the first was {named}, {step}"
    if step:
        return f"{summary}the first were {int(first.sum())}, {step}, the fastest free one of them {named}"
    return f"{summary}the fastest free one of them was {named}"


def find_first(before: State, x: Float, v: Float, go: Go, steps: int) -> tuple[Bool, int]:
    """Return which vertices (n,) become non-finite first on the way from a state over so many steps, and the number of
    that step, from 1 on, or 0 if none does so again. Leaves x and v (3, n) unchanged.

    Steps are repeated by bisection: a non-finite vertex stays so.
    """
    end, taken, left = (x.copy(), v.copy()), 0, steps
    start = before.x.T.copy(), before.v.T.copy()
    while left:
        half = max(1, left // 2)
        x[...], v[...] = start
        go(taken, half)
        first = find_nonfinite(x, v)
        if first.any():
            if half == 1:
                break
            left = half
        else:
            taken, left, start = taken + half, left - half, (x.copy(), v.copy())
    x[...], v[...] = end
    return first, taken + 1 if first.any() else 0
