"""Yarns as curves: made from a knit's links, drawn in pictures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.fabric import Float


@dataclass(frozen=True)
class YarnCurves:
    """Yarns as polylines of round cross section, on skin or free.

    points (n, 3)     float64  points along each yarn, yarn by yarn [m]; a ring ends where it began
    ptr    (y + 1,)   int64    yarn y is points[ptr[y]:ptr[y + 1]]
    radius (y,)       float64  [m], 0 for a line
    kind   (y,)       int32    index into `names`
    names                      e.g. ("nylon", "support")
    normal (n, 3)     float64  unit normal of the skin below each point, outwards; 0 without skin
    """

    points: Float
    ptr: NDArray[np.int64]
    radius: Float
    kind: NDArray[np.int32]
    names: tuple[str, ...]
    normal: Float

    @property
    def number(self) -> int:
        """Number of yarns."""
        return int(self.radius.shape[0])

    def segments(self) -> NDArray[np.int64]:
        """Return the first point of every segment, shape (s,)."""
        last = np.zeros(len(self.points), bool)
        last[self.ptr[1:][np.diff(self.ptr) > 0] - 1] = True
        return np.flatnonzero(~last)

    def yarn(self) -> NDArray[np.int64]:
        """Return the yarn of each point, shape (n,)."""
        return np.repeat(np.arange(self.number), np.diff(self.ptr))
