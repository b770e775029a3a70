"""The winding number of a triangle mesh, which separates inside from outside where the mesh has holes or overlaps.

It is the solid angle under which a point sees the mesh, over 4 pi: 1 inside of a closed mesh, 0 outside, and near 1
and 0 still where a hole is seen under a small angle (A. Jacobson et al. 2013). A group of triangles that is far away
acts as a dipole of its summed area vectors at their middle (G. Barill, N. G. Dickson, R. Schmidt, D. I. W. Levin,
A. Jacobson: Fast winding numbers for soups and clouds. ACM Transactions on Graphics 37(4), 2018).

    w(q) = 1 / (4 pi) sum_t solid angle of t,   of a group: A . (p - q) / (4 pi |p - q|^3)

A group is far from a point that is more than BETA times its radius away from its middle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_geometry.poses import Vector
from nuno_geometry.tree import Room, Tree
from nuno_kernels import kernel
from nuno_kernels.lanes import WIDTH
from nuno_schemas.fabric import Float

BETA = 2.3
"""The paper's 2 for its expansion to the second order; the first order takes a little more."""


@kernel
def solid_angle(px: float, py: float, pz: float, corners: Float, place: int) -> float:
    """Return the solid angle of a triangle (A. van Oosterom, J. Strackee 1983), positive where its inside is seen."""
    row, j = 9 * (place // WIDTH), place % WIDTH
    ax, ay, az = corners[row, j] - px, corners[row + 1, j] - py, corners[row + 2, j] - pz
    bx, by, bz = ax + corners[row + 3, j], ay + corners[row + 4, j], az + corners[row + 5, j]
    cx, cy, cz = ax + corners[row + 6, j], ay + corners[row + 7, j], az + corners[row + 8, j]
    a, b = math.sqrt(ax * ax + ay * ay + az * az), math.sqrt(bx * bx + by * by + bz * bz)
    c = math.sqrt(cx * cx + cy * cy + cz * cz)
    triple = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    below = a * b * c + (ax * bx + ay * by + az * bz) * c
    below += (bx * cx + by * cy + bz * cz) * a + (cx * ax + cy * ay + cz * az) * b
    return 2.0 * math.atan2(triple, below)


@kernel
def far_angle(px: float, py: float, pz: float, dipole: Float, i: int) -> float:
    """Return the solid angle of a group of triangles; NaN if the point is too near for it."""
    x, y, z = dipole[i, 3] - px, dipole[i, 4] - py, dipole[i, 5] - pz
    square = x * x + y * y + z * z
    if square <= BETA * BETA * dipole[i, 6]:
        return math.nan
    return float((dipole[i, 0] * x + dipole[i, 1] * y + dipole[i, 2] * z) / (square * math.sqrt(square)))


class Dipoles(NamedTuple):
    """Dipoles of groups of triangles: leaves (L, 8) and nodes (N, 8) of a tree, with area vector [m^2], middle [m],
    squared radius [m^2], and of leaves the number of triangles.
    """

    leaves: Float
    nodes: Float


@kernel
def winding(p: Vector, tree: Tree, dipoles: Dipoles, room: Room) -> float:
    """Return the winding number of a tree's mesh about a point."""
    px, py, pz = p
    boxes, child, corners, waiting = tree.boxes, tree.child, tree.corners, room.waiting
    leaf_dipoles, node_dipoles = dipoles.leaves, dipoles.nodes
    total = 0.0
    waiting[0] = 0
    top = 1
    while top > 0:
        top -= 1
        node = waiting[top]
        angle = (
            far_angle(px, py, pz, leaf_dipoles, -1 - node) if node < 0 else far_angle(px, py, pz, node_dipoles, node)
        )
        if angle == angle:
            total += angle
        elif node < 0:
            leaf = -1 - node
            for place in range(WIDTH * leaf, WIDTH * leaf + int(leaf_dipoles[leaf, 7])):
                total += solid_angle(px, py, pz, corners, place)
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
            size = math.sqrt(area[i, 0] ** 2 + area[i, 1] ** 2 + area[i, 2] ** 2)
            whole += size
            for c in range(3):
                leaves[leaf, c] += area[i, c]
                leaves[leaf, 3 + c] += size * centre[i, c]
        for c in range(3):
            leaves[leaf, 3 + c] = leaves[leaf, 3 + c] / whole if whole > 0.0 else centre[low, c]
        for i in range(low, high):
            for k in range(3):
                away = 0.0
                for c in range(3):
                    away += (corner[i, k, c] - leaves[leaf, 3 + c]) ** 2
                leaves[leaf, 6] = max(leaves[leaf, 6], away)
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
                size = math.sqrt(part[0] ** 2 + part[1] ** 2 + part[2] ** 2) + 1e-3 * part[6]
                away = 0.0
                for c in range(3):
                    if turn == 0:
                        nodes[node, c] += part[c]
                        nodes[node, 3 + c] += size * part[3 + c]
                    away += (part[3 + c] - nodes[node, 3 + c]) ** 2
                whole += size if turn == 0 else 0.0
                if turn == 1:
                    nodes[node, 6] = max(nodes[node, 6], (math.sqrt(away) + math.sqrt(part[6])) ** 2)
            if turn == 0:
                for c in range(3):
                    nodes[node, 3 + c] /= whole
