"""Trees of boxes for rays: over triangles of bodies, and over pieces of yarns as capsules.

The trees are those of nuno_geometry.tree, with eight children a node and eight items a leaf, so that a node, like
a leaf, is one vector test.

Rejected: Embree, by embreex or Open3D. It is in single precision, its Python packages intersect triangles but not
capsules, and its choice of two hits at one distance is unspecified: a picture would change with its version.

Rejected: cylinders without round ends, which leave gaps on the outer side of every bend; and exact curves, each of
which takes several Newton steps where a capsule takes three roots.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_geometry.tree import ROUNDING, in_eights, order_triangles, stack_boxes
from nuno_kernels.lanes.simd import WIDTH
from nuno_schemas.fabric import Float, Int


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
