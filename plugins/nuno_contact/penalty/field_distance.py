"""Signed distances from points to posed primitives of any kind, distance fields among them.

Where no body is a field, `fields` is None: what reads them is then not compiled. A field's normal is its interpolated
gradient at unit length. Where that vanishes, halfway between two parts of the surface that are equally near, it is a
direction that always is the same.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_contact.fields.sample import Fields, sample, sample_distance
from nuno_contact.penalty.distance import (
    BOX,
    CAPSULE,
    FIELD,
    Deepest,
    Reading,
    across,
    box_distance,
    capsule_distance,
)  # fmt: skip
from nuno_geometry.poses import Index, Vector, to_frame, turn_out
from nuno_kernels import forced_inline, kernel
from nuno_schemas.fabric import Float, Int


class Bodies(NamedTuple):
    """Posed primitives of bodies: the arrays of nuno_contact.penalty.contact.Contact of these names."""

    kind: NDArray[np.int8]
    frame: Int
    posed: Float
    frames: Float


@forced_inline
def field_reading(at: Vector, number: int, frames: Float, f: Index, fields: Fields) -> Reading:
    """Return (distance, normal x, y, z, 1 if the gradient vanishes else 0)."""
    x, y, z = to_frame(at[0], at[1], at[2], frames, f)
    distance, gx, gy, gz = sample(x, y, z, number, fields)
    size = math.sqrt(gx * gx + gy * gy + gz * gz)
    if not size > 0.0:
        nx, ny, nz = across(gx, gy, gz)
        return distance, nx, ny, nz, 1
    nx, ny, nz = turn_out((gx / size, gy / size, gz / size), frames, f)
    return distance, nx, ny, nz, 0


@forced_inline
def primitive_distance(at: Vector, p: Index, f: Index, bodies: Bodies, fields: Fields | None) -> Reading:
    """Return (distance, normal x, y, z, 1 if it has no normal else 0) of any posed primitive p, in frame f."""
    kind, posed = bodies.kind[p], bodies.posed
    if kind == CAPSULE:
        return capsule_distance(at[0], at[1], at[2], posed, p)
    if kind == BOX:
        return box_distance(at[0], at[1], at[2], posed, p, bodies.frames, f)
    if fields is not None and kind == FIELD:
        return field_reading(at, int(posed[p, 7]), bodies.frames, f, fields)
    nx, ny, nz = posed[p, 3], posed[p, 4], posed[p, 5]
    distance = (at[0] - posed[p, 0]) * nx + (at[1] - posed[p, 1]) * ny + (at[2] - posed[p, 2]) * nz
    return distance, nx, ny, nz, 0


@kernel
def lower_field(
    x: Float, low: int, high: int, posed: Float, p: int, frames: Float, f: int, fields: Fields, deepest: Deepest
) -> None:
    """Lower the distances of vertices [low, high) of x (3, n) that are in the bounds of field p to those to it."""
    number, distance, primitive = int(posed[p, 7]), deepest.distance, deepest.primitive
    for i in range(np.uint64(low), np.uint64(high)):
        px, py, pz = x[0, i], x[1, i], x[2, i]
        within = posed[p, 8] <= px <= posed[p, 11] and posed[p, 9] <= py <= posed[p, 12]
        if within and posed[p, 10] <= pz <= posed[p, 13]:
            u, v, w = to_frame(px, py, pz, frames, f)
            d = sample_distance(u, v, w, number, fields)
            if d < distance[i]:
                distance[i] = d
                primitive[i] = p
