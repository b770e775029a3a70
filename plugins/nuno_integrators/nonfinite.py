"""What is said of a state that is not finite: in which step it became so, and at which vertices first."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from nuno_schemas.fabric import Bool, Fabric, Float, State

Go = Callable[[int, int], None]
"""Advances the rows x, v (3, n) in place, which have taken so many steps, by so many more."""


def find_lost(x: Float, v: Float) -> Bool:
    """(n,) whether the position or the velocity of a vertex, x and v (3, n), is not finite."""
    lost: Bool = np.logical_not(np.isfinite(x).all(axis=0) & np.isfinite(v).all(axis=0))
    return lost


def say_lost(fabric: Fabric, before: State, lost: Bool, first: Bool, step: str) -> str:
    """What is said of `lost` vertices (n,), "" where there are none; `first` were so first, in a step, in words, or ""
    where that is not known.

    Of several the free one is named that was fastest in the state before: lost vertices take their neighbours along,
    pinned ones too, on which an infinite force times no mobility is NaN.
    """
    if not lost.any():
        return ""
    first = first if step else lost
    said = f"{int(lost.sum())} of {fabric.number} vertices have no finite position or velocity; "
    speed = np.where(first, np.where(fabric.pinned, 0.0, np.abs(before.v).max(axis=1)), -1.0)
    vertex = int(np.argmax(np.where(np.isfinite(speed), speed, np.inf)))
    named = f"vertex {fabric.told(vertex)}, at {math.hypot(*before.v[vertex]):.3g} m/s before"
    if step and first.sum() == 1:
        return f"{said}the first was {named}, {step}"
    if step:
        return f"{said}the first were {int(first.sum())}, {step}, the fastest free one of them {named}"
    return f"{said}the fastest free one of them was {named}"


def find_first(before: State, x: Float, v: Float, go: Go, steps: int) -> tuple[Bool, int]:
    """(n,) which vertices are lost first on the way from a state over so many steps, and the number of that step, from
    1 on, or 0 where none is lost on the way again. Leaves x and v (3, n) as they are.

    Steps are taken again, by halves: what is lost stays lost.
    """
    end, taken, left = (x.copy(), v.copy()), 0, steps
    start = before.x.T.copy(), before.v.T.copy()
    while left:
        half = max(1, left // 2)
        x[...], v[...] = start
        go(taken, half)
        first = find_lost(x, v)
        if first.any():
            if half == 1:
                break
            left = half
        else:
            taken, left, start = taken + half, left - half, (x.copy(), v.copy())
    x[...], v[...] = end
    return first, taken + 1 if first.any() else 0
