"""The closest point of a closed mesh that moves, found by walking to it from a triangle near by.

Over an interval each vertex moves in a straight line, as those of a skin do. A walk goes from a triangle to the nearest
of those beyond the side or round the corner on which its own closest point lies, until none is nearer, which need not
be the nearest of all. It begins where a search of the tree, which has the interval's start, has ended.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from nuno_geometry.closest_point import nearest_in
from nuno_geometry.poses import Vector, row_at
from nuno_geometry.tree import ROUNDING, Tree, build_tree
from nuno_kernels import block_kernel, forced_inline, kernel
from nuno_kernels.compilation.reference import by_reference
from nuno_kernels.lanes import WIDTH, cross, dot, minus, plus, times
from nuno_kernels.step.blocks import Long
from nuno_schemas.fabric import Float, Int

NEARER = 1.0 - 1e-12
"""share of a squared distance below which another one is less, and not by rounding"""
STEPS = 400
"""most triangles on a way"""


@by_reference
class MovingMesh(NamedTuple):
    """v vertices and f triangles, closed and oriented, over an interval.

    start, end (v, 3) [m]; across (f, 3) the triangle beyond each one's sides a-b, b-c and c-a; those around vertex i
    are around[first[i]:first[i + 1]]; tree: of the start, as `fit_tree` leaves it, without normals
    """

    start: Float
    end: Float
    across: Long
    first: Int
    around: Long
    tree: Tree


def make_moving_mesh(x: Float, faces: Int) -> MovingMesh:
    """Return a mesh at rest at x (v, 3) [m], faces (f, 3), which is closed (nuno_geometry.check.check_closed)."""
    tree, none = build_tree(x, faces), np.zeros((0, 3))
    sides, corners = (np.argsort(part.reshape(-1), kind="stable") for part in (tree.edges, faces))
    across = np.empty(faces.size, np.int64)
    across[sides[::2]], across[sides[1::2]] = sides[1::2] // 3, sides[::2] // 3
    first = np.searchsorted(faces.reshape(-1)[corners], np.arange(len(x) + 1)).astype(np.int32)
    tree = tree._replace(vertex_normals=none, edge_normals=none)
    return MovingMesh(x.copy(), x.copy(), across.reshape(-1, 3), first, corners // 3, tree)


@block_kernel
def fit_tree(x: Float, tree: Tree) -> None:
    """Fit a tree's corners and boxes to vertices x (v, 3)."""
    boxes, child, corners, margin = tree.boxes, tree.child, tree.corners, 0.0
    for i in range(x.shape[0]):
        margin = max(margin, ROUNDING * max(abs(x[i, 0]), abs(x[i, 1]), abs(x[i, 2])))
    for leaf in range(tree.leaf_parent.shape[0]):
        node = tree.leaf_parent[leaf]
        at = leaf + child[node] + 1
        for c in range(3):
            low, high = math.inf, -math.inf
            for j in range(WIDTH):
                face = tree.face[WIDTH * leaf + j]
                p, q, r = x[tree.faces[face, 0], c], x[tree.faces[face, 1], c], x[tree.faces[face, 2], c]
                corners[9 * leaf + c, j], corners[9 * leaf + 3 + c, j], corners[9 * leaf + 6 + c, j] = p, q - p, r - p
                low, high = min(low, p, q, r), max(high, p, q, r)
            boxes[6 * node + c, at], boxes[6 * node + 3 + c, at] = low - margin, high + margin
    for node in range(child.shape[0] - 1, 0, -1):
        above = tree.parent[node]
        for c in range(3):
            low, high = math.inf, -math.inf
            for j in range(WIDTH):
                if boxes[6 * node + c, j] < math.inf:  # there is such a child
                    low, high = min(low, boxes[6 * node + c, j]), max(high, boxes[6 * node + 3 + c, j])
            boxes[6 * above + c, node - child[above]], boxes[6 * above + 3 + c, node - child[above]] = low, high


class Foot(NamedTuple):
    """The closest point of a triangle: its coordinates (s, t), its feature as in `nearest_in`, the way from there to
    the point that is asked about [m], and its square [m^2].
    """

    face: int
    s: float
    t: float
    part: int
    way: Vector
    square: float


@forced_inline
def corner_at(i: int, s: float, x: Float, y: Float) -> Vector:
    """Return the place of vertex i at fraction s of the interval from x to y."""
    return plus(times(1.0 - s, row_at(x, i)), times(s, row_at(y, i)))


@forced_inline
def sides_at(i: int, j: int, k: int, s: float, x: Float, y: Float) -> tuple[Vector, Vector, Vector]:
    """Return the place of vertex i, and the ways from there to j and k."""
    a, b, c = corner_at(i, s, x, y), corner_at(j, s, x, y), corner_at(k, s, x, y)
    return a, minus(b, a), minus(c, a)


@forced_inline
def foot_on(p: Vector, face: int, s: float, faces: Int, x: Float, y: Float) -> Foot:
    """Return the closest point of a triangle at fraction s of the interval."""
    o, b, c = sides_at(faces[face, 0], faces[face, 1], faces[face, 2], s, x, y)
    a = minus(p, o)
    u, w, part = nearest_in(a, b, c)
    way = minus(minus(a, times(u, b)), times(w, c))
    return Foot(face, u, w, part, way, dot(way, way))


@kernel
def walk(p: Vector, face: int, s: float, m: MovingMesh) -> Foot:
    """Return the closest point at fraction s of the interval that is reached from a triangle."""
    faces, x, y, across, first, around = m.tree.faces, m.start, m.end, m.across, m.first, m.around
    here = foot_on(p, face, s, faces, x, y)
    for _ in range(STEPS):
        best = here
        if 0 < here.part < 4:
            best = foot_on(p, across[here.face, here.part - 1], s, faces, x, y)
        elif here.part >= 4:
            i = faces[here.face, here.part - 4]
            for k in range(first[i], first[i + 1]):
                there = foot_on(p, around[k], s, faces, x, y)
                if there.square < NEARER * best.square:
                    best = there
        if not best.square < NEARER * here.square:
            break
        here = best
    return here


@forced_inline
def add_normal(n: Vector, b: Vector, c: Vector, by_angle: bool) -> Vector:
    """Return n and the unit normal of a triangle with sides b and c from a corner, or that times its angle there."""
    m = cross(b, c)
    size = math.sqrt(dot(m, m))
    share = 1.0 / size if size > 0.0 else 0.0
    if by_angle:
        share *= math.atan2(size, dot(b, c))
    return plus(n, times(share, m))


@kernel
def normal_at(foot: Foot, s: float, m: MovingMesh) -> Vector:
    """Return the pseudonormal (nuno_geometry.normals) at a closest point, of any length."""
    faces, x, y, n = m.tree.faces, m.start, m.end, (0.0, 0.0, 0.0)
    if foot.part < 4:
        for beyond in range(1 if foot.part == 0 else 2):
            f = m.across[foot.face, foot.part - 1] if beyond == 1 else foot.face
            _, b, c = sides_at(faces[f, 0], faces[f, 1], faces[f, 2], s, x, y)
            n = add_normal(n, b, c, False)
        return n
    i = faces[foot.face, foot.part - 4]
    for q in range(m.first[i], m.first[i + 1]):
        f = m.around[q]
        k = 0 if faces[f, 0] == i else 1 if faces[f, 1] == i else 2
        _, b, c = sides_at(i, faces[f, (k + 1) % 3], faces[f, (k + 2) % 3], s, x, y)
        n = add_normal(n, b, c, True)
    return n
