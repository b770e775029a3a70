"""Signed distances from points to posed primitives of any kind, distance fields among them.

`head`, `cells` and `corners` are the arrays of nuno_contact.fields.sample.Fields, or None where no body is a field:
what reads them is then not compiled. A field's normal is its interpolated gradient at unit length. Where that
vanishes, halfway between two parts of the surface that are equally near, it is a direction that always is the same.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_contact.fields.sample import sample, sample_distance
from nuno_contact.penalty.distance import BOX, CAPSULE, FIELD, Reading, across, box_distance, capsule_distance
from nuno_kernels import forced_inline, kernel
from nuno_kernels.bodies.poses import Index, to_frame, turn_out
from nuno_schemas.fabric import Float


@forced_inline
def field_reading(
    px: float, py: float, pz: float, number: int, frames: Any, f: Index, head: Any, cells: Any, corners: Any
) -> Reading:
    """(distance, normal x, y, z, 1 where the gradient vanishes else 0)."""
    x, y, z = to_frame(px, py, pz, frames, f)
    distance, gx, gy, gz = sample(x, y, z, number, head, cells, corners)
    size = math.sqrt(gx * gx + gy * gy + gz * gz)
    if not size > 0.0:
        nx, ny, nz = across(gx, gy, gz)
        return distance, nx, ny, nz, 1
    nx, ny, nz = turn_out((gx / size, gy / size, gz / size), frames, f)
    return distance, nx, ny, nz, 0


@forced_inline
def primitive_distance(
    px: float, py: float, pz: float, kind: int, posed: Float, p: Index, frames: Float, f: Index, head: Any, cells: Any,
    corners: Any,
) -> Reading:  # fmt: skip
    """(distance, normal x, y, z, mark where there is none of its own) of any posed primitive."""
    if kind == CAPSULE:
        return capsule_distance(px, py, pz, posed, p)
    if kind == BOX:
        return box_distance(px, py, pz, posed, p, frames, f)
    if head is not None and kind == FIELD:
        return field_reading(px, py, pz, int(posed[p, 7]), frames, f, head, cells, corners)
    nx, ny, nz = posed[p, 3], posed[p, 4], posed[p, 5]
    distance = (px - posed[p, 0]) * nx + (py - posed[p, 1]) * ny + (pz - posed[p, 2]) * nz
    return distance, nx, ny, nz, 0


@kernel
def lower_field(
    x: Float, low: int, high: int, posed: Float, p: int, frames: Float, f: int, head: Any, cells: Any, corners: Any,
    distance: Float, deepest: NDArray[np.int64], body: int,
) -> None:  # fmt: skip
    """As lower_capsule, for a field, of vertices within its surface's bounds."""
    number = int(posed[p, 7])
    for i in range(np.uint64(low), np.uint64(high)):
        px, py, pz = x[0, i], x[1, i], x[2, i]
        within = posed[p, 8] <= px <= posed[p, 11] and posed[p, 9] <= py <= posed[p, 12]
        if within and posed[p, 10] <= pz <= posed[p, 13]:
            u, v, w = to_frame(px, py, pz, frames, f)
            d = sample_distance(u, v, w, number, head, cells, corners)
            if d < distance[i]:
                distance[i] = d
                deepest[body, i] = p
