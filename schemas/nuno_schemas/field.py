"""A sampled signed distance field: cells of many sizes, with the distance and its gradient at their corners."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.fabric import Float, Int
from nuno_schemas.layout import Bounds


@dataclass(frozen=True)
class DistanceField:
    """Signed distance from a closed surface, negative inside, interpolated trilinearly in the cell of a point.

    low       (3,) [m]      lowest corner of a box of whole cells
    size      [m]           edge of a whole cell
    shape     (3,) int32    whole cells along x, y and z
    tolerance [m]           largest error within `band` [m] of the surface; farther away it grows with the distance
    band      [m]
    child     (c,) int32    an octree: first the whole cells, z fastest, then the eight children of each divided cell,
                            z fastest. The index of a cell's first child, or -1 - (number of a leaf)
    corners   (l, 32) float32  distance [m] and gradient x, y, z at the eight corners of each leaf, z fastest
    """

    low: Annotated[Float, 3]
    size: Annotated[float, Bounds(above=0.0)]
    shape: Annotated[Int, 3, Bounds(1)]
    tolerance: Annotated[float, Bounds(above=0.0)]
    band: float
    child: Annotated[Int, "c"]
    corners: Annotated[NDArray[np.float32], "l", 32]

    @property
    def nbytes(self) -> int:
        """Memory of its arrays [bytes]."""
        return self.child.nbytes + self.corners.nbytes
