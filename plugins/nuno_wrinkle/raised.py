"""The surface with raised lines: split, moved along normals, smoothed. net.py builds springs and masses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nuno_geometry.normals import face_normals
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Corners, Fabric, Float, Int
from nuno_schemas.lines import Smoothing
from nuno_wrinkle.edges import any_of
from nuno_wrinkle.lines import Crossed
from nuno_wrinkle.split import smooth, split_faces
from nuno_wrinkle.surface import link_faces

THIN = 1e-6
"""Least area of a triangle, as a share of its longest side squared."""
SAME = 1e-6
"""Tolerance of equal texture coordinates, which are float32."""
ROUNDS = 50
"""The most times that smoothing restarts, with more vertices held."""


@dataclass(frozen=True)
class Region:
    """The part of a mesh of f triangles and n vertices that lines can change.

    face (l,) triangles with a vertex that may be smoothed; vertex (n,) those vertices
    """

    face: Int
    vertex: Bool


@dataclass(frozen=True)
class Raised:
    """A surface of n + m vertices with raised lines.

    faces (f + 2 m, 3), across: by `surface.link_faces`; x (n + m, 3) [m], flat (n + m, 3) before it was raised;
    smoothed (s,) vertices; local (l,) the triangles of the region; changed (c,) those that are new or different; share
    (f + 2 m,) of old triangles' values, by `split_faces`; flipped, left: edges; held: vertices of `smoothed` that stay,
    so that no triangle turns over
    """

    faces: Int
    across: Int
    x: Float
    flat: Float
    smoothed: Int
    held: int
    local: Int
    changed: Int
    share: Float
    flipped: int
    left: int
    normal: Float
    """normals (m, 3) of the split triangles"""
    uv: Float | None
    """texture coordinates (f + 2 m, 3, 2) of corners; None for cloth without any by corners"""


def find_region(faces: Int, n: int, crossed: Crossed) -> Region:
    """Return the vertices within two edges of the new ones, and all triangles at them.

    A new vertex has edges to its triangle's corners and to those opposite, one edge beyond the corners; its two-ring
    extends one edge further.
    """
    near = np.zeros(n, np.bool_)
    near[faces[crossed.face]] = True
    for _ in range(2):
        near[faces[any_of(near, faces)]] = True
    return Region(np.flatnonzero(any_of(near, faces)).astype(np.int32), near)


def raise_lines(
    fabric: Fabric, x: Float, across: Int, crossed: Crossed, smoothing: Smoothing, region: Region, share: Float
) -> Raised:
    """Return the raised surface; `share` (f,) is a value that each triangle passes on to its parts. Raises BadInput if
    all smoothing turns triangles over.
    """
    old, n, m = fabric.faces, fabric.number, len(crossed.face)
    normal = face_normals(x, old[crossed.face])
    flat = np.concatenate([x, np.einsum("mc,mck->mk", crossed.at, x[old[crossed.face]])])
    faces, beyond, shares = (
        np.concatenate([a, np.zeros((2 * m, *a.shape[1:]), a.dtype)]) for a in (old, across, share)
    )
    raised = flat.copy()
    raised[n:] += crossed.height[:, None] * normal
    laid, uv = fabric.corners, None
    turn = None if laid is None else _period(laid)
    if laid is None or turn is not None:
        flipped, left = split_faces(flat, raised, crossed.face, n, faces, beyond, shares)
    else:  # cut along the seams of its texture, where no edge is flipped
        vertex, points = np.append(laid.vertex, np.arange(n, n + m, dtype=np.int32)), len(laid.vertex)
        drawn, beyond = (
            np.concatenate([a, np.zeros((2 * m, 3), np.int32)]) for a in (laid.faces, link_faces(laid.faces, points))
        )
        flipped, left = split_faces(flat[vertex], raised[vertex], crossed.face, points, drawn, beyond, shares)
        faces = vertex[drawn]
        beyond = link_faces(faces, len(flat))
    if laid is not None:
        between = np.einsum("mc,mcu->mu", crossed.at, laid.points[laid.faces[crossed.face]])
        cut = np.concatenate([laid.points, between])
        uv = cut[drawn] if turn is None else _wrapped(laid, between, turn, faces, n)
    local = np.append(region.face, np.arange(len(old), len(faces), dtype=np.int32))
    neighbours = _find_neighbours(fabric, faces[local], beyond[local] < 0, len(flat), smoothing)
    held = _smooth(flat, raised, faces[local], neighbours, smoothing)
    same = (faces[region.face] == old[region.face]).all(axis=1)
    changed = np.append(region.face[~same], local[len(region.face) :]).astype(np.int32)
    smoothed = neighbours.vertex if smoothing.passes else np.arange(n, len(flat), dtype=np.int32)
    return Raised(faces, beyond, raised, flat, smoothed, held, local, changed, shares, flipped, left, normal, uv)


def _period(laid: Corners) -> Float | None:
    """Return the number of whole images (2,) by which the two sides of all seams differ, if it is the same, as round a
    skirt, or None. Only then the image continues beyond a seam.
    """
    order = np.argsort(laid.vertex, kind="stable")
    apart = np.diff(laid.points[order].astype(np.float64), axis=0)[np.diff(laid.vertex[order]) == 0]
    if not len(apart):
        return None
    apart *= np.sign(apart @ apart[0])[:, None]
    turn = np.round(apart[0])
    return turn if turn.any() and np.abs(apart - turn).max() <= SAME else None


def _wrapped(laid: Corners, between: Float, turn: Float, faces: Int, n: int) -> Float:
    """Return texture coordinates (f + 2 m, 3, 2) of corners, those of changed triangles on the side of their new
    vertex: beyond the seam the image continues, shifted by `turn`.
    """
    place = np.zeros((n + len(between), 2))
    place[laid.vertex], place[n:] = laid.points, between
    uv, newest = place[faces], faces.argmax(axis=1)
    uv += np.round((uv[np.arange(len(faces)), newest][:, None] - uv) @ turn / (turn @ turn))[..., None] * turn
    same = (faces[: len(laid.faces)] == laid.vertex[laid.faces]).all(axis=1)
    uv[: len(same)][same] = laid.points[laid.faces[same]]
    return uv


@dataclass(frozen=True)
class Neighbours:
    """Neighbours for smoothing: vertices (s,), and sorted pairs (p, 2) of one of them and a neighbour."""

    vertex: Int
    pair: NDArray[np.int64]


def _find_neighbours(fabric: Fabric, triangles: Int, rim: Bool, number: int, smoothing: Smoothing) -> Neighbours:
    """Return the neighbours of the new vertices and of their two-ring, by the triangles (l, 3) there; rim (l, 3)
    borders. Pinned vertices stay, and those of the border are smoothed along it, so that it does not move inwards
    (Taubin's hierarchical constraint); so are new vertices among themselves if `smoothing.hierarchical`. The end of a
    border or of such a line stays: its one neighbour would pull it in.
    """
    n = fabric.number
    near = np.zeros(number, np.bool_)
    near[n:] = True
    for _ in range(2):
        near[triangles[any_of(near, triangles)]] = True
    near[:n][fabric.pinned] = False
    start, end = triangles.reshape(-1), np.roll(triangles, -1, axis=1).reshape(-1)
    edge = rim.reshape(-1)
    pair = np.stack([np.append(start, end[edge]), np.append(end, start[edge])], 1).astype(np.int64)
    border = np.zeros(number, np.bool_)
    border[start[edge]] = border[end[edge]] = True
    kept = near[pair[:, 0]] & (~border[pair[:, 0]] | np.append(edge, edge[edge]))
    if smoothing.hierarchical:
        kept &= (pair[:, 0] < n) | (pair[:, 1] >= n)
    pair = pair[kept]
    alone = np.bincount(pair[:, 0], minlength=number) < 2
    return Neighbours(np.flatnonzero(near).astype(np.int32), pair[~alone[pair[:, 0]]])


def _smooth(flat: Float, x: Float, triangles: Int, neighbours: Neighbours, smoothing: Smoothing) -> int:
    """Smooth x, in place, except the vertices of triangles that would turn over. Return their number. Without smoothing
    no triangle turns over (split.py), so that there is always a set of vertices to hold.
    """
    if smoothing.passes == 0:
        return 0
    start, held = x.copy(), np.zeros(len(x), np.bool_)
    for _ in range(ROUNDS):
        pair = neighbours.pair[~held[neighbours.pair[:, 0]]]
        pair = pair[np.argsort(pair[:, 0], kind="stable")]
        at = np.concatenate([[0], np.cumsum(np.bincount(pair[:, 0], minlength=len(x))[neighbours.vertex])])
        x[...] = start
        smooth(
            x, neighbours.vertex, at.astype(np.int32), pair[:, 1].astype(np.int32),
            smoothing.passes, smoothing.shrink, smoothing.inflate,
        )  # fmt: skip
        bad = _turned(flat, x, triangles)
        if not bad.any():
            return int(held.sum())
        held[triangles[bad]] = True
    remedy = "fewer passes, a smaller height, or a mesh of rounder triangles"
    raise BadInput(
        "smoothing would turn triangles over", field="smoothing.passes", value=smoothing.passes, remedy=remedy
    )


def _turned(flat: Float, raised: Float, faces: Int) -> Bool:
    """Return which triangles (l,) have turned over or have lost their area."""
    before, after = (_normals(x, faces) for x in (flat, raised))
    side = raised[faces] - raised[np.roll(faces, 1, axis=1)]
    least = THIN * np.square(side).sum(axis=2).max(axis=1)
    same = np.einsum("fk,fk->f", before, after) > 0.0
    return np.asarray(~(same & (np.linalg.norm(after, axis=1) > 2.0 * least)))


def _normals(x: Float, faces: Int) -> Float:
    """Return normals (f, 3), of lengths twice the triangles' areas."""
    a = x[faces[:, 0]]
    return np.cross(x[faces[:, 1]] - a, x[faces[:, 2]] - a)
