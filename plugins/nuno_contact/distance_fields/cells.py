"""The data of a cell of a distance field: exact distances at its 27 lattice points, and its interpolation error.

The lattice of a cell are the corners of its eight parts. Of the interpolation from the eight corners the error is
measured at the other 19 points. Where the distance has a kink (at edges, and halfway between two parts of the surface)
that error halves with the cell, so that between the lattice's points it is at most about twice what is found
there; where the distance is smooth it falls by four.
"""

from __future__ import annotations

import math

import numpy as np
from numba import prange
from numpy.typing import NDArray

from nuno_contact.distance_fields.winding import Dipoles, make_dipoles, winding
from nuno_geometry.closest_point import closest
from nuno_geometry.poses import Vector
from nuno_geometry.tree import Room, Tree, make_room
from nuno_kernels import forced_inline, kernel, parallel_kernel
from nuno_kernels.step.blocks import Long
from nuno_schemas.fabric import Float

Single = NDArray[np.float32]

BLOCK = 256
"""points handled together"""
LATTICE = 27
ON_SURFACE = 1e-9
"""A point nearer to the surface than this share of its coordinates has no direction of its own."""


@kernel
def exact(p: Vector, start: int, tree: Tree, dipoles: Dipoles | None, room: Room) -> tuple[float, Vector, int]:
    """Return (signed distance [m], its unit gradient, place of the nearest triangle), searching from place `start`.

    With dipoles (nuno_contact.distance_fields.winding) the sign is the winding number's, else the pseudonormal's.
    """
    near = closest(p, start, 0, tree, room)
    distance, (gx, gy, gz) = near.distance, (p[0] - near.point[0], p[1] - near.point[1], p[2] - near.point[2])
    if dipoles is not None:
        inside = winding(p, tree, dipoles, room) > 0.5
        distance = -abs(distance) if inside else abs(distance)
    size = distance
    if abs(distance) <= ON_SURFACE * (abs(p[0]) + abs(p[1]) + abs(p[2])):
        gx, gy, gz = near.normal
        size = math.sqrt(gx * gx + gy * gy + gz * gz)
    if size == 0.0:
        return distance, (0.0, 0.0, 0.0), near.place
    return distance, (gx / size, gy / size, gz / size), near.place


@parallel_kernel
def measure_points(points: Float, near: Long, tree: Tree, dipoles: Dipoles | None, out: Float) -> None:
    """Measure distance and gradient, out (n, 4), at points (n, 3); near (n,) places to start with, then found."""
    for block in prange((points.shape[0] + BLOCK - 1) // BLOCK):
        room = make_room()
        for i in range(block * BLOCK, min((block + 1) * BLOCK, points.shape[0])):
            p = (points[i, 0], points[i, 1], points[i, 2])
            out[i, 0], (out[i, 1], out[i, 2], out[i, 3]), near[i] = exact(p, near[i], tree, dipoles, room)


@forced_inline
def blend_lattice(lattice: Single, cell: int, p: int, part: int) -> float:
    """Interpolate quantity `part` at point p of a cell's lattice from the cell's corners."""
    i, j, k = p // 9, p // 3 % 3, p % 3
    value = 0.0
    for c in range(8):
        a, b, d = c // 4, c // 2 % 2, c % 2
        weight = 0.125 * (i if a else 2 - i) * (j if b else 2 - j) * (k if d else 2 - k)
        value += weight * lattice[cell, 18 * a + 6 * b + 2 * d, part]
    return value


@parallel_kernel
def measure_errors(lattice: Single, size: float, near: float, errors: Float) -> None:
    """Write, for cells of edge `size` [m] with lattices (m, 27, 4), into errors (m, 3): the largest error of the
    interpolation [m], the least distance to the surface [m], and, of cells that it may pass through, the least cosine
    between interpolated and exact gradient at points within `near` [m] or half of its edge.
    """
    for cell in prange(lattice.shape[0]):
        worst, least, along = 0.0, math.inf, 1.0
        for p in range(LATTICE):
            worst = max(worst, abs(blend_lattice(lattice, cell, p, 0) - lattice[cell, p, 0]))
            least = min(least, abs(lattice[cell, p, 0]))
        for p in range(LATTICE):
            if least <= 0.433013 * size and abs(lattice[cell, p, 0]) <= max(near, 0.5 * size):
                cosine, square = 0.0, 0.0
                for part in range(1, 4):
                    value = blend_lattice(lattice, cell, p, part)
                    cosine += value * lattice[cell, p, part]
                    square += value * value
                along = min(along, cosine / math.sqrt(square) if square > 0.0 else -1.0)
        errors[cell, 0], errors[cell, 1], errors[cell, 2] = worst, least, along


# The exact signed distance of a mesh, closed or not.


class Exact:
    """A mesh's exact signed distance, for the build and to check a field by."""

    def __init__(self, tree: Tree, closed: bool) -> None:
        """Compute signs of a mesh that is not `closed` by the winding number."""
        self.tree, self.closed = tree, closed
        self.dipoles = None if closed else make_dipoles(tree)

    def measure(self, points: Float, near: Long | None = None) -> Float:
        """Return the distance [m] and gradient (n, 4) at points (n, 3)."""
        points = np.ascontiguousarray(points, np.float64)
        out = np.empty((len(points), 4))
        near = np.zeros(len(points), np.int64) if near is None else near
        measure_points(points, near, self.tree, self.dipoles, out)
        return out
