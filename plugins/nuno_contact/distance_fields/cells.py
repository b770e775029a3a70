"""The data of a cell of a distance field: exact distances at its 27 lattice points, and its interpolation error.

The lattice of a cell are the corners of its eight parts. Of the interpolation from the eight corners the error is
measured at the other 19 points. Where the distance has a kink (at edges, and halfway between two parts of the surface)
that error halves with the cell, so that between the lattice's points it is at most about twice what is found
there; where the distance is smooth it falls by four.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from nuno_geometry.closest_point import closest, corners_of
from nuno_geometry.poses import Vector, row_at
from nuno_geometry.tree import Room, Tree, make_room
from nuno_kernels import forced_inline, kernel, parallel_kernel
from nuno_kernels.lanes import WIDTH, cross, dot, minus, over, plus
from nuno_kernels.step.blocks import Long
from nuno_schemas.fabric import Float

# The winding number of a triangle mesh, which separates inside from outside where the mesh has holes or overlaps.

BETA = 2.3
"""The paper's 2 for its expansion to the second order; the first order takes a little more."""


@kernel
def solid_angle(p: Vector, corners: Float, place: int) -> float:
    """Return the solid angle of a triangle (A. van Oosterom, J. Strackee 1983), positive where its inside is seen."""
    first, second, third = corners_of(place, corners)
    a = minus(first, p)
    b, c = plus(a, second), plus(a, third)
    size_a, size_b, size_c = math.sqrt(dot(a, a)), math.sqrt(dot(b, b)), math.sqrt(dot(c, c))
    below = size_a * size_b * size_c + dot(a, b) * size_c
    below += dot(b, c) * size_a + dot(c, a) * size_b
    return 2.0 * math.atan2(dot(a, cross(b, c)), below)


@kernel
def far_angle(p: Vector, dipole: Float, i: int) -> float:
    """Return the solid angle of a group of triangles; NaN if the point is too near for it."""
    away = minus((dipole[i, 3], dipole[i, 4], dipole[i, 5]), p)
    square = dot(away, away)
    if square <= BETA * BETA * dipole[i, 6]:
        return math.nan
    return float(dot(row_at(dipole, i), away) / (square * math.sqrt(square)))


class Dipoles(NamedTuple):
    """Dipoles of groups of triangles: leaves (L, 8) and nodes (N, 8) of a tree, with area vector [m^2], middle [m],
    squared radius [m^2], and of leaves the number of triangles.
    """

    leaves: Float
    nodes: Float


@kernel
def winding(p: Vector, tree: Tree, dipoles: Dipoles, room: Room) -> float:
    """Return the winding number of a tree's mesh about a point."""
    boxes, child, corners, waiting = tree.boxes, tree.child, tree.corners, room.waiting
    leaf_dipoles, node_dipoles = dipoles.leaves, dipoles.nodes
    total = 0.0
    waiting[0] = 0
    top = 1
    while top > 0:
        top -= 1
        node = waiting[top]
        angle = far_angle(p, leaf_dipoles, -1 - node) if node < 0 else far_angle(p, node_dipoles, node)
        if angle == angle:
            total += angle
        elif node < 0:
            leaf = -1 - node
            for place in range(WIDTH * leaf, WIDTH * leaf + int(leaf_dipoles[leaf, 7])):
                total += solid_angle(p, corners, place)
        else:
            first = child[node]
            for lane in range(WIDTH):
                if boxes[6 * node, lane] < math.inf:
                    waiting[top] = first + lane if first >= 0 else first - lane
                    top += 1
    return total / (4.0 * math.pi)


def make_dipoles(tree: Tree) -> Dipoles:
    """Return the dipoles of a tree's leaves and nodes."""
    count = len(tree.faces)
    corner = tree.corners.reshape(-1, 9, WIDTH).transpose(0, 2, 1).reshape(-1, 3, 3)[:count]
    a, b, c = corner[:, 0], corner[:, 0] + corner[:, 1], corner[:, 0] + corner[:, 2]
    area = 0.5 * np.cross(corner[:, 1], corner[:, 2])
    leaves, nodes = np.zeros((len(tree.corners) // 9, 8)), np.zeros((len(tree.child), 8))
    gather_leaves(area, (a + b + c) / 3.0, np.stack([a, b, c], axis=1), leaves)
    gather_nodes(tree.boxes, tree.child, leaves, nodes)
    return Dipoles(leaves, nodes)


@kernel
def gather_leaves(area: Float, centre: Float, corner: Float, leaves: Float) -> None:
    """Compute leaves' dipoles from area vectors (f, 3), centroids (f, 3) and corners (f, 3, 3) in places' order."""
    for leaf in range(leaves.shape[0]):
        low, high = WIDTH * leaf, min(WIDTH * (leaf + 1), area.shape[0])
        whole = 0.0
        for i in range(low, high):
            size = math.sqrt(dot(area[i], area[i]))
            whole += size
            for c in range(3):
                leaves[leaf, c] += area[i, c]
                leaves[leaf, 3 + c] += size * centre[i, c]
        for c in range(3):
            leaves[leaf, 3 + c] = leaves[leaf, 3 + c] / whole if whole > 0.0 else centre[low, c]
        for i in range(low, high):
            for k in range(3):
                away = minus(corner[i, k], leaves[leaf, 3:6])
                leaves[leaf, 6] = max(leaves[leaf, 6], dot(away, away))
        leaves[leaf, 7] = high - low


@kernel
def gather_nodes(boxes: Float, child: NDArray[np.int64], leaves: Float, nodes: Float) -> None:
    """Compute dipoles of nodes from those of their children, which stand after them. Their middle is weighted by area
    vectors' lengths, and their radius encloses their children's.
    """
    for node in range(child.shape[0] - 1, -1, -1):
        first, whole = child[node], 0.0
        for turn in range(2):
            for lane in range(WIDTH):
                if not boxes[6 * node, lane] < math.inf:
                    continue
                part = leaves[-1 - (first - lane)] if first < 0 else nodes[first + lane]
                if turn == 1:
                    away = minus(part[3:6], nodes[node, 3:6])
                    nodes[node, 6] = max(nodes[node, 6], (math.sqrt(dot(away, away)) + math.sqrt(part[6])) ** 2)
                    continue
                size = math.sqrt(dot(part, part)) + 1e-3 * part[6]
                whole += size
                for c in range(3):
                    nodes[node, c] += part[c]
                    nodes[node, 3 + c] += size * part[3 + c]
            if turn == 0:
                for c in range(3):
                    nodes[node, 3 + c] /= whole


Single = NDArray[np.float32]

BLOCK = 256
"""points handled together"""
LATTICE = 27
ON_SURFACE = 1e-9
"""A point nearer to the surface than this share of its coordinates has no direction of its own."""


@kernel
def exact(p: Vector, start: int, tree: Tree, dipoles: Dipoles | None, room: Room) -> tuple[float, Vector, int]:
    """Return (signed distance [m], its unit gradient, place of the nearest triangle), searching from place `start`.

    With dipoles the sign is the winding number's, else the pseudonormal's.
    """
    near = closest(p, start, 0, tree, room)
    distance, way = near.distance, minus(p, near.point)
    if dipoles is not None:
        inside = winding(p, tree, dipoles, room) > 0.5
        distance = -abs(distance) if inside else abs(distance)
    size = distance
    if abs(distance) <= ON_SURFACE * (abs(p[0]) + abs(p[1]) + abs(p[2])):
        way = near.normal
        size = math.sqrt(dot(way, way))
    return distance, over(way, size) if size != 0.0 else (0.0, 0.0, 0.0), near.place


@parallel_kernel
def measure_points(points: Float, near: Long, tree: Tree, dipoles: Dipoles | None, out: Float) -> None:
    """Measure distance and gradient, out (n, 4), at points (n, 3); near (n,) places to start with, then found."""
    for block in prange((points.shape[0] + BLOCK - 1) // BLOCK):
        room = make_room()
        for i in range(block * BLOCK, min((block + 1) * BLOCK, points.shape[0])):
            found = exact(row_at(points, i), near[i], tree, dipoles, room)
            out[i, 0], (out[i, 1], out[i, 2], out[i, 3]), near[i] = found


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
