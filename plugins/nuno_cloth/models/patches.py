"""Patches of a triangle mesh: each triangle with all triangles that touch one of its corners, unfolded into its plane.

Neighbours are unfolded one after another across the edges that they share, round each corner both ways until the two
meet. Sewn or folded cloth is thus laid open; where a mesh is curved in both directions, angles round a corner do not
sum to a full turn, and the gap is where the two ways meet.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from nuno_schemas.fabric import Bool, Float, Int

WIDE = 0.5
"""What angles on both sides of a side must sum to, beyond half a turn, for it to be flipped: not those of a regular
mesh, whatever its file rounds."""


class Patches(NamedTuple):
    """Patches of f triangles, padded to k vertices by the triangle's first.

    vertices (f, k); flat (f, k, 2) their places along weft and warp from the first vertex [m]; there (f, k) whether an
    entry is a vertex and not padding; area (f,) of the triangles [m^2]
    """

    vertices: Int
    flat: Float
    there: Bool
    area: Float


class Sides(NamedTuple):
    """The 3 f sides of triangles with vertices faces (f, 3) and corners (f, 3, 3) at rest [m]: `other` the side that
    runs the other way or -1, the third corner's place `along` the side and its height `high` over it [m]; of each
    vertex, the number of triangles `round` it, whether it is on a `border`, and the vertex `after` it there or -1.
    """

    corners: Float
    faces: Int
    other: Int
    along: Float
    high: Float
    round: Int
    border: Bool
    after: Int


def find_patches(sides: Sides, triangles: Int, warp: Float, weft: Float) -> Patches:
    """Return the patches of `triangles` (f,) of a mesh, with their yarn directions (f, 3)."""
    corners, at = sides.faces[triangles], sides.corners[triangles]
    edges = at - at[:, :1]
    flat = np.stack([np.einsum("fcd,fd->fc", edges, axis) for axis in (weft, warp)], axis=2)
    area = 0.5 * sides.high[3 * triangles] * np.linalg.norm(edges[:, 1], axis=1)
    steps: list[Any] = [(np.repeat(np.arange(len(triangles)), 3), corners.reshape(-1), flat.reshape(-1, 2))]
    for corner in range(3):
        for way in (1, -1):
            steps += _walk(sides, triangles, flat, corner, way)
    face, vertex, place = (np.concatenate(part) for part in zip(*steps, strict=True))
    # A vertex that is reached twice keeps its first place.
    _, first = np.unique(face.astype(np.int64) * len(sides.border) + vertex, return_index=True)
    first = first[np.lexsort((first, face[first]))]
    face, vertex, place = face[first], vertex[first], place[first]
    count = np.bincount(face, minlength=len(triangles))
    column = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    shape = (len(triangles), int(count.max(initial=0)))
    vertices, places = np.repeat(corners[:, :1], shape[1], axis=1), np.zeros((*shape, 2))
    there = np.zeros(shape, np.bool_)
    vertices[face, column], places[face, column], there[face, column] = vertex, place, True
    return Patches(vertices, places, there, area)


def find_sides(corners: Float, faces: Int) -> Sides:
    """Return the sides of triangles with vertices faces (f, 3) and corners (f, 3, 3) at rest [m]. Two triangles that
    are sewn to each other each have their own corners along the seam.
    """
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    n = int(faces.max(initial=-1)) + 1
    key, sought = start.astype(np.int64) * n + end, end.astype(np.int64) * n + start
    order = np.argsort(key)
    at = order[np.minimum(np.searchsorted(key, sought, sorter=order), len(key) - 1)]
    other = np.where(key[at] == sought, at, -1).astype(np.int32)
    border, after, rim = np.zeros(n, np.bool_), np.full(n, -1, np.int32), other < 0
    border[start[rim]] = border[end[rim]] = True
    after[start[rim]] = end[rim]
    edge, slant = (np.roll(corners, -k, axis=1).reshape(-1, 3) - corners.reshape(-1, 3) for k in (1, 2))
    length = np.linalg.norm(edge, axis=1)
    along, high = np.einsum("sd,sd->s", slant, edge) / length, np.linalg.norm(np.cross(edge, slant), axis=1) / length
    return Sides(corners, faces, other, along, high, np.bincount(start, minlength=n).astype(np.int32), border, after)


def flip_slivers(corners: Float, faces: Int, traits: Float) -> Sides:
    """Return the sides of the same flat pieces, with triangles of which no side lies between angles that sum to more
    than half a turn by WIDE: such sides are flipped to the other diagonal of their two triangles (Lawson 1977,
    Mathematical Software III, 161-194), where these lie in one plane, side by side, and have the same traits (f, m).
    """
    corners, faces = corners.copy(), faces.copy()
    points, number = corners.reshape(-1, 3), faces.reshape(-1)
    while True:
        sides = find_sides(corners, faces)
        length = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).reshape(-1)
        angle = np.arctan2(length * sides.high, np.square(sides.high) - sides.along * (length - sides.along))
        side = np.flatnonzero(sides.other > np.arange(len(number)))
        side = side[angle[side] + angle[sides.other[side]] > np.pi + WIDE]
        other = sides.other[side]
        (start, end, apex), (end_too, start_too, beyond) = (
            [k - k % 3 + (k + step) % 3 for step in range(3)] for k in (side, other)
        )
        edge, far = points[end] - points[start], points[beyond] - points[start]
        up = np.cross(edge, points[apex] - points[start])
        flips = np.all(points[[*start, *end]] == points[[*start_too, *end_too]], axis=1).reshape(2, -1).all(axis=0)
        flips &= np.abs((up * far).sum(axis=1)) <= 1e-9 * length[side] ** 3
        flips &= (up * np.cross(edge, far)).sum(axis=1) <= 0.0
        flips &= np.all(np.abs(traits[side // 3] - traits[other // 3]) < 1e-6, axis=1)
        # Of each triangle the side between the widest angles, if it is so for both.
        total, widest = np.where(flips, angle[side] + angle[other], 0.0), np.zeros(len(faces))
        for triangle in (side // 3, other // 3):
            np.maximum.at(widest, triangle, total)
        flips &= (total >= widest[side // 3]) & (total >= widest[other // 3])
        if not flips.any():
            return sides
        for values in (points, number):
            values[end[flips]], values[start_too[flips]] = values[beyond[flips]], values[apex[flips]]


def _walk(sides: Sides, triangles: Int, flat: Float, corner: int, way: int) -> list[Any]:
    """Unfold triangles round one corner of every triangle, counter-clockwise (`way` 1) or clockwise (-1). Return, step
    by step, the patches, their new vertices and the places of these.
    """
    face, pivot, edge_end = np.arange(len(triangles)), flat[:, corner], flat[:, (corner - way) % 3]
    around = sides.faces[triangles, corner]
    remaining = (sides.round[around] - (1 if way == 1 else 2)) // 2
    remaining = np.where(sides.border[around], np.iinfo(np.int32).max, remaining)
    side = sides.other[3 * triangles + (corner if way == -1 else (corner + 2) % 3)]
    steps: list[Any] = []
    while True:
        on = (side >= 0) & (remaining > 0)
        face, pivot, edge_end, remaining, side = face[on], pivot[on], edge_end[on], remaining[on] - 1, side[on]
        if not len(face):
            return steps
        start, end = (pivot, edge_end) if way == 1 else (edge_end, pivot)
        along = (end - start) / np.linalg.norm(end - start, axis=1)[:, None]
        up = np.stack([-along[:, 1], along[:, 0]], axis=1)
        edge_end = start + sides.along[side, None] * along + sides.high[side, None] * up
        base, place = side - side % 3, side % 3
        steps.append((face, sides.faces[base // 3, (place + 2) % 3], edge_end))
        side = sides.other[base + (place + (2 if way == 1 else 1)) % 3]
