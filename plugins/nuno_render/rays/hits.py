"""Intersections of rays o + t d, d a unit vector, with triangles and capsules, found by trees of boxes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_geometry.poses import Vector
from nuno_geometry.tree import ROUNDING, in_eights, order_triangles, push_children, stack_boxes
from nuno_kernels import inlined, kernel
from nuno_kernels.lanes import (
    WIDTH,
    cross,
    dot,
    first_lane,
    higher,
    lane,
    lanes_up_to,
    load,
    load_triple,
    lower,
    minus,
    plus,
    root,
    splat,
    times,
    where_not_negative,
)
from nuno_schemas.fabric import Float, Int

# Trees of boxes for rays: over triangles of bodies, and over pieces of yarns as capsules.
#
# The trees are those of nuno_geometry.tree, with eight children a node and eight items a leaf, so that a node, like
# a leaf, is one vector test.
#
# Rejected: Embree, by embreex or Open3D. It is in single precision, its Python packages intersect triangles but not
# capsules, and its choice of two hits at one distance is unspecified: a picture would change with its version.
#
# Rejected: cylinders without round ends, which leave gaps on the outer side of every bend; and exact curves, each of
# which takes several Newton steps where a capsule takes three roots.


class RayTree(NamedTuple):
    """N nodes and L leaves over i items.

    boxes (6 N, 8), child (N,)  as in nuno_geometry.tree.Tree; no nodes without items
    rows  (r L, 8)              of leaf k in rows r k to r k + r - 1, its eight items; NaN for missing ones. Triangles,
          r = 9: corner a, edges b - a and c - a [m]. Capsules, r = 7: end a, axis b - a and radius [m]
    item  (8 L,) int32          number of the item in each place of the leaves, -1 if empty
    """

    boxes: Float
    child: NDArray[np.int64]
    rows: Float
    item: Int


def triangle_tree(x: Float, faces: Int) -> RayTree:
    """Return the tree of triangles faces (f, 3) of vertices x (n, 3) [m]."""
    corners = x[faces]
    a, b, c = (corners[:, k] for k in range(3))
    return _build(corners, np.concatenate([a, b - a, c - a], axis=1), float(np.abs(corners).max(initial=0.0)))


def capsule_tree(start: Float, end: Float, radius: Float) -> RayTree:
    """Return the tree of capsules from start (i, 3) to end (i, 3) of radius (i,), all [m]."""
    thick = radius[:, None]
    low, high = np.minimum(start, end) - thick, np.maximum(start, end) + thick
    size = max(float(np.abs(low).max(initial=0.0)), float(np.abs(high).max(initial=0.0)))
    return _build(np.stack([low, high], axis=1), np.concatenate([start, end - start, thick], axis=1), size)


def _build(points: Float, rows: Float, size: float) -> RayTree:
    """Return the tree of items in boxes round points (i, c, 3), with rows (i, r), all within `size` [m] of 0."""
    count = len(points)
    if not count:
        return RayTree(np.zeros((0, WIDTH)), np.zeros(0, np.int64), np.zeros((0, WIDTH)), np.zeros(0, np.int32))
    order = np.arange(count, dtype=np.int64)
    capacity = WIDTH
    while capacity < count:
        capacity *= WIDTH
    order_triangles(points.mean(axis=1), capacity, order)
    boxes, child = stack_boxes(points[order], ROUNDING * size)
    item = np.full(-(-count // WIDTH) * WIDTH, -1, np.int32)
    item[:count] = order
    return RayTree(boxes, child, in_eights(rows[order], np.nan), item)


# Intersections of rays o + t d, d a unit vector, with triangles and capsules.
#
# A capsule is the union of two spheres and the side of a cylinder between them, and convex: a ray enters it at its
# first entry into one of the three, and leaves it at its last exit from one. With p = o - a from the axis's end a and w
# = b - a, and t counted from the ray's nearest point to a (so that a distant eye costs no digits), the ray meets the
# side where A t^2 + 2 B t + C = 0 with
#
#     A = |d x w|^2,  B = (p x w).(d x w),  C = |p x w|^2 - r^2 w.w,   0 <= w.p + t w.d <= w.w,
#
# and a sphere where t^2 + 2 t p.d + p.p - r^2 = 0. The root of a negative number, and a ray along the axis, give NaN,
# for which every comparison is false. Rejected: dot products, |p|^2 |w|^2 - (p.w)^2, which lose the digits of (|w| /
# r)^2.
#
# Of items at one distance the lowest number comes first: the result depends neither on the order of the search nor on
# the tree, to the last bit.

DEPTH = 96
"""Capacity of the stack of nodes: at most seven a level, and twelve levels hold 5e11 items."""
SLOP = 1.0 + 2.0**-49
"""Factor by which boxes end later, more than rounding errors (Ize, Robust BVH ray traversal, JCGT 2(2), 2013)."""
EDGE = 1e-12
"""Share of a triangle by which it extends over its edges, so that no ray passes between two."""


class Buffers(NamedTuple):
    """Scratch for rays: capsules met (keep,), where rays enter and leave them [m], those of one ray that are shaded
    after it, the stack of nodes (DEPTH,) with their distances, and vectors (2, 3) for shading.
    """

    items: NDArray[np.int64]
    enters: Float
    leaves: Float
    met: NDArray[np.int64]
    met_at: Float
    waiting: NDArray[np.int64]
    bound: Float
    work: Float


@kernel
def make_buffers(keep: int) -> Buffers:
    """Return buffers for rays through at most `keep` capsules."""
    return Buffers(
        np.empty(keep, np.int64), np.empty(keep), np.empty(keep), np.empty(keep, np.int64), np.empty(keep),
        np.empty(DEPTH, np.int64), np.empty(DEPTH), np.empty((2, 3)),
    )  # fmt: skip


@kernel
def invert(d: float) -> float:
    """Return 1 / d, huge if d is 0, so that no product with 0 is NaN."""
    if abs(d) < 1e-300:
        return 1e300
    return 1.0 / d


@inlined
def box_entries(o: Vector, inverse: Vector, boxes: Float, row: int) -> Any:
    """Return distances at which a ray enters a node's eight boxes, NaN if it misses them; `inverse` is 1 / d."""
    low, high = minus(load_triple(boxes, row, 0), o), minus(load_triple(boxes, row + 3, 0), o)
    ax, bx = low[0] * inverse[0], high[0] * inverse[0]
    ay, by = low[1] * inverse[1], high[1] * inverse[1]
    az, bz = low[2] * inverse[2], high[2] * inverse[2]
    enter = higher(higher(lower(ax, bx), lower(ay, by)), higher(lower(az, bz), splat(0.0)))
    leave = lower(lower(higher(ax, bx), higher(ay, by)), higher(az, bz)) * SLOP
    return where_not_negative(leave - enter, enter, splat(np.nan))


@inlined
def capsule_ends(o: Vector, d: Vector, rows: Float, row: int) -> Any:
    """Return distances at which a ray enters and leaves a leaf's eight capsules; inf and -inf if it misses."""
    p, w, radius = minus(o, load_triple(rows, row, 0)), load_triple(rows, row + 3, 0), load(rows, row + 6, 0)
    near, none = splat(0.0) - dot(p, d), splat(np.inf)
    p = plus(p, times(near, d))
    ww, wd, wp, pd, pp = dot(w, w), dot(w, d), dot(w, p), dot(p, d), dot(p, p) - radius * radius
    # The sphere round a, then that round b, whose p is p - w.
    half = root(pd * pd - pp)
    enter, leave = lower(splat(0.0) - pd - half, none), higher(half - pd, splat(-np.inf))
    qd = pd - wd
    half = root(qd * qd - (pp - 2.0 * wp + ww))
    enter, leave = lower(splat(0.0) - qd - half, enter), higher(half - qd, leave)
    u, v = cross(p, w), cross(d, w)
    a, b = dot(v, v), dot(u, v)
    half = root(b * b - a * (dot(u, u) - ww * radius * radius))
    first, last = (splat(0.0) - b - half) / a, (half - b) / a
    along = wp + first * wd
    enter = lower(where_not_negative(lower(along, ww - along), first, none), enter)
    along = wp + last * wd
    leave = higher(where_not_negative(lower(along, ww - along), last, splat(-np.inf)), leave)
    return enter + near, leave + near


@inlined
def triangle_entries(o: Vector, d: Vector, rows: Float, row: int) -> Any:
    """Return distances at which a ray meets a leaf's eight triangles, NaN if it misses (Moeller, Trumbore 1997)."""
    s, e, f = minus(o, load_triple(rows, row, 0)), load_triple(rows, row + 3, 0), load_triple(rows, row + 6, 0)
    p, q = cross(d, f), cross(s, e)
    det = dot(e, p)
    u, v, t = dot(s, p) / det, dot(d, q) / det, dot(f, q) / det
    inside = lower(lower(u, v), 1.0 - u - v) + EDGE
    return where_not_negative(lower(inside, t), t, splat(np.nan))


@kernel
def meet_triangle(o: Vector, d: Vector, tree: RayTree, buffers: Buffers) -> tuple[int, float]:
    """Return (triangle, distance) of the first that a ray from o along d meets; (-1, inf) if none."""
    waiting, bound = buffers.waiting, buffers.bound
    best, nearest = np.inf, -1
    top = 0
    if tree.child.shape[0] > 0:
        waiting[0], bound[0], top = 0, 0.0, 1
    inverse = invert(d[0]), invert(d[1]), invert(d[2])
    while top > 0:
        top -= 1
        if bound[top] > best:
            continue
        node = waiting[top]
        if node >= 0:
            entries = box_entries(o, inverse, tree.boxes, 6 * node)
            top = push_children(entries, lanes_up_to(entries, best), tree.child[node], waiting, bound, top)
            continue
        leaf = -1 - node
        t = triangle_entries(o, d, tree.rows, 9 * leaf)
        bits = lanes_up_to(t, best)
        while bits != 0:
            j = first_lane(bits)
            bits &= bits - 1
            value, item = lane(t, j), tree.item[WIDTH * leaf + j]
            if value > 0.0 and (value < best or (value == best and item < nearest)):
                best, nearest = value, item
    return nearest, best


@kernel
def meet_capsules(o: Vector, d: Vector, most: float, tree: RayTree, keep: int, buffers: Buffers) -> int:
    """Write the first `keep` capsules that a ray meets up to a distance into the buffers, nearest first. Return their
    number. A capsule in which the ray starts has a distance below 0.
    """
    items, enters, leaves = buffers.items, buffers.enters, buffers.leaves
    waiting, bound = buffers.waiting, buffers.bound
    count, limit = 0, most
    top = 0
    if tree.child.shape[0] > 0:
        waiting[0], bound[0], top = 0, 0.0, 1
    inverse = invert(d[0]), invert(d[1]), invert(d[2])
    while top > 0:
        top -= 1
        if bound[top] > limit:
            continue
        node = waiting[top]
        if node >= 0:
            entries = box_entries(o, inverse, tree.boxes, 6 * node)
            top = push_children(entries, lanes_up_to(entries, limit), tree.child[node], waiting, bound, top)
            continue
        leaf = -1 - node
        enter, leave = capsule_ends(o, d, tree.rows, 7 * leaf)
        bits = lanes_up_to(enter, limit) & lanes_up_to(splat(0.0) - leave, 0.0)
        while bits != 0:
            j = first_lane(bits)
            bits &= bits - 1
            count = _keep(
                lane(enter, j), lane(leave, j), tree.item[WIDTH * leaf + j], keep, items, enters, leaves, count
            )
            if count == keep:
                limit = min(limit, enters[keep - 1])
    return count


@kernel
def _keep(
    enter: float, leave: float, item: int, keep: int, items: NDArray[np.int64], enters: Float, leaves: Float, count: int
) -> int:
    """Insert a hit among the first `keep`. Return their number."""
    place = count
    while place > 0 and (enters[place - 1] > enter or (enters[place - 1] == enter and items[place - 1] > item)):
        place -= 1
    if place == keep:
        return count
    last = min(count, keep - 1)
    for k in range(last, place, -1):
        items[k], enters[k], leaves[k] = items[k - 1], enters[k - 1], leaves[k - 1]
    items[place], enters[place], leaves[place] = item, enter, leave
    return last + 1
