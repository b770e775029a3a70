"""The surface on which a function of space is zero, as a closed mesh of triangles of about equal size.

One vertex is put into every cell of a grid that the surface passes through, at the mean of the places where it
crosses the cell's edges, and every crossed edge of the grid becomes a quad of the four vertices about it (S. F. F.
Gibson, Constrained elastic surface nets, MICCAI 1998). Vertices are then evened out along the surface and brought onto
it by Newton's method, so that the grid leaves no steps. Marching cubes would give slivers wherever the surface passes
close to a corner of the grid.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.fabric import Bool, Float, Int

Field = Callable[[Float, Float, Float], Float]
"""a function (x, y, z) [m], arrays that broadcast, -> about the signed distance [m], negative inside"""
ROUNDS = 7
"""steps of Newton's method; before all but the last two, vertices are evened out"""
SLIGHT = 1e-6
"""share of the largest value that nodes put inside get: the surface passes close by them"""
STEP = 1e-5
"""step of the differences for a field's gradient [m]"""


def find_isosurface(field: Field, low: Float, high: Float, spacing: float) -> tuple[Float, Int]:
    """Return vertices (n, 3) [m] and triangles (f, 3), outwards, of field = 0 in the box from low to high (3,).

    The box must hold the whole surface, and cells of `spacing` [m] must resolve it: two sheets of it that cross one
    cell may be joined there.
    """
    counts = np.ceil((high - low) / spacing).astype(int) + 1
    axes = [low[k] + spacing * np.arange(counts[k]) for k in range(3)]
    value = field(axes[0][:, None, None], axes[1][None, :, None], axes[2][None, None, :])
    x, quads = _net(_without_pinches(value))
    x = low + spacing * x
    for turn in range(ROUNDS):
        differences = [(field(*(x + step).T) - field(*(x - step).T)) / (2.0 * STEP) for step in STEP * np.eye(3)]
        gradient = np.stack(differences, axis=1)
        if turn < ROUNDS - 2:
            x = _even(x, quads, gradient)
        x -= (field(*x.T) / (gradient * gradient).sum(axis=1))[:, None] * gradient
    return np.ascontiguousarray(x), _cut(x, quads)


def net_of(value: Float, low: Float, spacing: float) -> tuple[Float, Int]:
    """Return vertices (n, 3) [m] and triangles (f, 3), outwards, of the surface on which values (i, j, k) at the nodes
    of a grid are zero, no nearer to it than a cell. Values are negative inside, and nonnegative on the grid's outside.
    """
    x, quads = _net(_without_pinches(value))
    return low + spacing * x, _cut(x, quads)


def _without_pinches(value: Float) -> Float:
    """Lower some values (i, j, k) below zero so that the net is a surface: no square of the grid, and no cube, has just
    two opposite corners inside, or outside, where two sheets would share a cell.
    """
    inside = value < 0.0
    while True:
        before = int(inside.sum())
        for one, other in ((0, 1), (1, 2), (2, 0)):
            square = _corners(inside, one, other)
            (a, b), (c, d) = square
            pinched = (a == d) & (b == c) & (a != b)
            for corner in (a, b, c, d):
                corner |= pinched
        cube = [corner for half in _corners(inside, 0, 1) for one in half for corner in _halves(one, 2)]
        count = sum(corner.astype(np.int8) for corner in cube)
        for first, last in ((0, 7), (1, 6), (2, 5), (3, 4)):
            alone = (cube[first] == cube[last]) & (count == np.where(cube[first], 2, 6))
            for corner in cube:
                corner |= alone
        if int(inside.sum()) == before:
            return np.where(inside & (value >= 0.0), -np.abs(value).max() * SLIGHT, value)


def _halves(values: NDArray[Any], axis: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return views of all but the last, and of all but the first, along an axis."""
    n = values.shape[axis]
    index = [slice(None)] * values.ndim
    first, last = index.copy(), index
    first[axis], last[axis] = slice(0, n - 1), slice(1, n)
    return values[tuple(first)], values[tuple(last)]


def _corners(values: NDArray[Any], one: int, other: int) -> list[tuple[NDArray[Any], NDArray[Any]]]:
    """Return views of the four corners of each square along two axes."""
    return [_halves(half, other) for half in _halves(values, one)]


def _net(value: Float) -> tuple[Float, Int]:
    """Return vertices (n, 3), in cells from the first node, and quads (q, 4) of values (i, j, k) at the nodes."""
    inside = value < 0.0
    total, count = np.zeros((*(n - 1 for n in value.shape), 3)), np.zeros([n - 1 for n in value.shape], int)
    crossed = []
    for axis in range(3):
        first, last = _halves(value, axis)
        cut = (first < 0.0) != (last < 0.0)
        at = np.stack(np.nonzero(cut), axis=1).astype(float)
        at[:, axis] += first[cut] / (first[cut] - last[cut])
        crossed.append((cut, _halves(inside, axis)[0]))
        place = np.zeros((*cut.shape, 3))
        place[cut] = at
        sides = (axis + 1) % 3, (axis + 2) % 3
        # Each cell has four edges along an axis.
        for edges, there in zip(_corners(place, *sides), _corners(cut, *sides), strict=True):
            for k in (0, 1):
                total += edges[k]
                count += there[k]
    number = np.full(count.shape, -1)
    number[count > 0] = np.arange(int((count > 0).sum()))
    quads = np.concatenate([_quads(number, cut, within, axis) for axis, (cut, within) in enumerate(crossed)])
    return total[count > 0] / count[count > 0][:, None], quads


def _quads(number: Int, cut: Bool, inside: Bool, axis: int) -> Int:
    """Return vertices (q, 4) about the crossed edges along an axis, counter-clockwise seen from outside."""
    one, other = (axis + 1) % 3, (axis + 2) % 3
    at = np.stack(np.nonzero(cut), axis=1)
    corners = []
    for i, j in ((1, 1), (0, 1), (0, 0), (1, 0)):
        cell = at.copy()
        cell[:, one] -= i
        cell[:, other] -= j
        corners.append(number[tuple(cell.T)])
    quads = np.stack(corners, axis=1)
    return np.where(inside[cut][:, None], quads, quads[:, ::-1])


def _even(x: Float, quads: Int, normal: Float) -> Float:
    """Move vertices halfway to the mean of their neighbours, across the normals (n, 3) of any length."""
    ends = np.concatenate([quads.reshape(-1), np.roll(quads, -1, axis=1).reshape(-1)])
    others = np.concatenate([np.roll(quads, -1, axis=1).reshape(-1), quads.reshape(-1)])
    count = np.bincount(ends, minlength=len(x))
    mean = np.stack([np.bincount(ends, x[others, k], len(x)) for k in range(3)], axis=1) / count[:, None]
    way = mean - x
    share = (way * normal).sum(axis=1) / (normal * normal).sum(axis=1)
    return np.asarray(x + 0.5 * (way - share[:, None] * normal))


def _cut(x: Float, quads: Int) -> Int:
    """Return two triangles of each quad, along its shorter diagonal."""
    a, b, c, d = quads.T
    short = np.linalg.norm(x[a] - x[c], axis=1) <= np.linalg.norm(x[b] - x[d], axis=1)
    first = np.where(short[:, None], np.stack([a, b, c], 1), np.stack([a, b, d], 1))
    second = np.where(short[:, None], np.stack([a, c, d], 1), np.stack([b, c, d], 1))
    return np.stack([first, second], axis=1).reshape(-1, 3).astype(np.int32)
