"""Patches of a triangle mesh: each triangle with all that touch one of its corners, laid open into its plane.

Neighbours are unfolded one after another across the edges that they share, round each corner both ways until the two
meet. Cloth that is sewn, or lies folded, is thus laid open; where a mesh is curved in both directions, angles round a
corner do not sum to a full turn, and the gap is where the two ways meet.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from nuno_schemas.fabric import Bool, Float, Int


class Patches(NamedTuple):
    """Patches of f triangles, padded to k vertices by the triangle's first.

    vertices (f, k); flat (f, k, 2) where they lie, along weft and warp from the first vertex on [m]; there (f, k)
    whether one is; area (f,) of the triangles [m^2]
    """

    vertices: Int
    flat: Float
    there: Bool
    area: Float

    def of(self, which: Any) -> Patches:
        """Some of them."""
        return Patches(self.vertices[which], self.flat[which], self.there[which], self.area[which])


class _Sides(NamedTuple):
    """Sides of triangles, 3 f, each from a corner to the next: the side that runs the other way or -1; where the third
    corner is, `along` from the side's start on and `high` over it [m]; of vertices, the triangles round each and
    whether it is on a border.
    """

    faces: Int
    other: Int
    along: Float
    high: Float
    round: Int
    border: Bool


def find_patches(x: Float, faces: Int, warp: Float, weft: Float) -> Patches:
    """Patches of triangles faces (f, 3) at rest at x (n, 3) [m], with yarn directions (f, 3)."""
    sides = _find_sides(x, faces)
    edges = x[faces] - x[faces[:, :1]]
    flat = np.stack([np.einsum("fcd,fd->fc", edges, axis) for axis in (weft, warp)], axis=2)
    area = 0.5 * sides.high[::3] * np.linalg.norm(edges[:, 1], axis=1)
    found: list[Any] = [(np.repeat(np.arange(len(faces)), 3), faces.reshape(-1), flat.reshape(-1, 2))]
    for corner in range(3):
        for way in (1, -1):
            found += _walk(sides, flat, corner, way)
    face, vertex, place = (np.concatenate(part) for part in zip(*found, strict=True))
    # Of a vertex that is met twice the first place stays.
    _, first = np.unique(face.astype(np.int64) * len(x) + vertex, return_index=True)
    first = first[np.lexsort((first, face[first]))]
    face, vertex, place = face[first], vertex[first], place[first]
    count = np.bincount(face, minlength=len(faces))
    column = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    shape = (len(faces), int(count.max(initial=0)))
    vertices, places, there = (
        np.repeat(faces[:, :1], shape[1], axis=1),
        np.zeros((*shape, 2)),
        np.zeros(shape, np.bool_),
    )
    vertices[face, column], places[face, column], there[face, column] = vertex, place, True
    return Patches(vertices, places, there, area)


def _find_sides(x: Float, faces: Int) -> _Sides:
    start, end, third = (np.roll(faces, -k, axis=1).reshape(-1) for k in range(3))
    n = len(x)
    key, sought = start.astype(np.int64) * n + end, end.astype(np.int64) * n + start
    order = np.argsort(key)
    at = order[np.minimum(np.searchsorted(key, sought, sorter=order), len(key) - 1)]
    other = np.where(key[at] == sought, at, -1).astype(np.int32)
    border = np.zeros(n, np.bool_)
    for ends in (start, end):
        border[ends[other < 0]] = True
    edge, slant = x[end] - x[start], x[third] - x[start]
    length = np.linalg.norm(edge, axis=1)
    along, high = np.einsum("sd,sd->s", slant, edge) / length, np.linalg.norm(np.cross(edge, slant), axis=1) / length
    return _Sides(faces, other, along, high, np.bincount(start, minlength=n).astype(np.int32), border)


def _walk(sides: _Sides, flat: Float, corner: int, way: int) -> list[Any]:
    """Triangles, vertices and their places, step by step round one corner of every triangle, counter-clockwise (1) or
    clockwise (-1).
    """
    number = len(sides.faces)
    face, pivot, beside = np.arange(number), flat[:, corner], flat[:, (corner - way) % 3]
    left = (sides.round[sides.faces[:, corner]] - (1 if way == 1 else 2)) // 2
    left = np.where(sides.border[sides.faces[:, corner]], np.iinfo(np.int32).max, left)
    side = sides.other[3 * face + (corner if way == -1 else (corner + 2) % 3)]
    found: list[Any] = []
    while True:
        on = (side >= 0) & (left > 0)
        face, pivot, beside, left, side = face[on], pivot[on], beside[on], left[on] - 1, side[on]
        if not len(face):
            return found
        start, end = (pivot, beside) if way == 1 else (beside, pivot)
        along = (end - start) / np.linalg.norm(end - start, axis=1)[:, None]
        up = np.stack([-along[:, 1], along[:, 0]], axis=1)
        beside = start + sides.along[side, None] * along + sides.high[side, None] * up
        base, place = side - side % 3, side % 3
        found.append((face, sides.faces[base // 3, (place + 2) % 3], beside))
        side = sides.other[base + (place + (2 if way == 1 else 1)) % 3]
