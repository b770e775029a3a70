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


class Sides(NamedTuple):
    """Sides of triangles, 3 f, each from a corner to the next: the side that runs the other way or -1; where the third
    corner is, `along` from the side's start on and `high` over it [m]; of vertices, the triangles round each and
    whether it is on a border. Triangles between vertices faces (f, 3) have their corners (f, 3, 3) at rest [m].
    """

    corners: Float
    faces: Int
    other: Int
    along: Float
    high: Float
    round: Int
    border: Bool


def find_patches(sides: Sides, of: Int, warp: Float, weft: Float) -> Patches:
    """Patches of some triangles (f,) of a mesh, with the yarn directions (f, 3) of these."""
    corners, at = sides.faces[of], sides.corners[of]
    edges = at - at[:, :1]
    flat = np.stack([np.einsum("fcd,fd->fc", edges, axis) for axis in (weft, warp)], axis=2)
    area = 0.5 * sides.high[3 * of] * np.linalg.norm(edges[:, 1], axis=1)
    found: list[Any] = [(np.repeat(np.arange(len(of)), 3), corners.reshape(-1), flat.reshape(-1, 2))]
    for corner in range(3):
        for way in (1, -1):
            found += _walk(sides, of, flat, corner, way)
    face, vertex, place = (np.concatenate(part) for part in zip(*found, strict=True))
    # Of a vertex that is met twice the first place stays.
    _, first = np.unique(face.astype(np.int64) * len(sides.border) + vertex, return_index=True)
    first = first[np.lexsort((first, face[first]))]
    face, vertex, place = face[first], vertex[first], place[first]
    count = np.bincount(face, minlength=len(of))
    column = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    shape = (len(of), int(count.max(initial=0)))
    vertices, places = np.repeat(corners[:, :1], shape[1], axis=1), np.zeros((*shape, 2))
    there = np.zeros(shape, np.bool_)
    vertices[face, column], places[face, column], there[face, column] = vertex, place, True
    return Patches(vertices, places, there, area)


def find_sides(corners: Float, faces: Int) -> Sides:
    """Of triangles between vertices faces (f, 3), each with its corners (f, 3, 3) at rest [m]: two that are sewn to
    each other have corners of their own along the seam.
    """
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    n = int(faces.max(initial=-1)) + 1
    key, sought = start.astype(np.int64) * n + end, end.astype(np.int64) * n + start
    order = np.argsort(key)
    at = order[np.minimum(np.searchsorted(key, sought, sorter=order), len(key) - 1)]
    other = np.where(key[at] == sought, at, -1).astype(np.int32)
    border = np.zeros(n, np.bool_)
    for ends in (start, end):
        border[ends[other < 0]] = True
    edge, slant = (np.roll(corners, -k, axis=1).reshape(-1, 3) - corners.reshape(-1, 3) for k in (1, 2))
    length = np.linalg.norm(edge, axis=1)
    along, high = np.einsum("sd,sd->s", slant, edge) / length, np.linalg.norm(np.cross(edge, slant), axis=1) / length
    return Sides(corners, faces, other, along, high, np.bincount(start, minlength=n).astype(np.int32), border)


def _walk(sides: Sides, of: Int, flat: Float, corner: int, way: int) -> list[Any]:
    """Triangles, vertices and their places, step by step round one corner of every triangle, counter-clockwise (1) or
    clockwise (-1).
    """
    face, pivot, beside = np.arange(len(of)), flat[:, corner], flat[:, (corner - way) % 3]
    around = sides.faces[of, corner]
    left = (sides.round[around] - (1 if way == 1 else 2)) // 2
    left = np.where(sides.border[around], np.iinfo(np.int32).max, left)
    side = sides.other[3 * of + (corner if way == -1 else (corner + 2) % 3)]
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
