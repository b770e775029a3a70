"""The surface with raised lines: triangles split and flipped along them, moved along normals, and smoothed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_geometry.normals import face_normals
from nuno_geometry.poses import Vector, row_at
from nuno_kernels import kernel
from nuno_kernels.lanes import cross, dot, minus, over, plus
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Corners, Fabric, Float, Int
from nuno_wrinkle.edges import any_of
from nuno_wrinkle.lines import Crossed, Smoothing
from nuno_wrinkle.surface import link_faces

# Algorithm 2 of the wrinkle paper: new vertices in triangles, and flips of these triangles' edges.
#
#      a ------ b          a ------ b          a        b
#       \\  f   /            \\  p  //            \\   //|     p is joined to the corners of its triangle f; then
#        \\    /              \\ \\/ /              \\ p  |     each edge of f with a triangle g beyond gives way to
#         \\  /      ->        \\|/       ->        \\|\\ |     one from p to the opposite corner of g: so no bending
#          c                   c                   c \\q     spring lies beside a structural one.
#
# Every edge is tested once, also if both its triangles are split: then it connects two new vertices, and the line
# becomes a chain of edges. These edges stay: one whose other diagonal exists (at a vertex that would keep only two
# edges), one whose two triangles are not a convex quad (a triangle would turn over, before or after raising), and a
# fold of 90 degrees and more (its crease would be cut). Flips change no count: a strip of n split triangles inside of a
# mesh has V + n, E + 3 n, F + 2 n whatever is flipped.

CONVEX = 0.02
"""Least area of a triangle after a flip, as a share of the quad's."""
STEEP = 0.02
"""Least cosine between the normals of such a triangle before and after raising."""


@kernel
def _set_neighbour(faces: Int, across: Int, face: int, a: int, b: int, to: int) -> None:
    """Set the neighbour of `face` across its edge from a to b to `to`."""
    if face >= 0:
        for c in range(3):
            if faces[face, c] == a and faces[face, (c + 1) % 3] == b:
                across[face, c] = to


@kernel
def _has_edge(faces: Int, across: Int, face: int, p: int, q: int) -> bool:
    """Return whether an edge connects p, which has triangles all round and is a corner of `face`, to q."""
    here = face
    while True:
        corner = 0
        for c in range(3):
            if faces[here, c] == q:
                return True
            if faces[here, c] == p:
                corner = c
        here = across[here, corner]
        if here == face:
            return False


@kernel
def _area_vector(x: Float, a: int, b: int, c: int) -> Vector:
    """Return twice the area of the triangle a, b, c times its normal."""
    corner = row_at(x, a)
    return cross(minus(row_at(x, b), corner), minus(row_at(x, c), corner))


@kernel
def _may_flip(x: Float, u: int, v: int, p: int, q: int) -> bool:
    """Return whether the triangles u, v, p and v, u, q form a convex quad, seen along the sum of their normals."""
    s, g = _area_vector(x, u, v, p), _area_vector(x, v, u, q)
    if dot(s, g) <= 0.0:
        return False
    normal = plus(over(s, np.sqrt(dot(s, s))), over(g, np.sqrt(dot(g, g))))
    least = CONVEX * dot(plus(s, g), normal)
    return bool(dot(_area_vector(x, p, u, q), normal) > least and dot(_area_vector(x, q, v, p), normal) > least)


@kernel
def _keeps_facing(x: Float, raised: Float, a: int, b: int, c: int) -> bool:
    """Return whether the triangle a, b, c faces the same way after raising."""
    before, after = _area_vector(x, a, b, c), _area_vector(raised, a, b, c)
    return bool(dot(before, after) > STEEP * np.sqrt(dot(before, before) * dot(after, after)))


@kernel
def split_faces(x: Float, raised: Float, split: Int, n: int, faces: Int, across: Int, share: Float) -> tuple[int, int]:
    """Split triangles and flip their edges, in place. Return the numbers of edges flipped and of edges kept.

    x, raised (n + m, 3)  positions before and after raising; the m new vertices, in their triangles, follow the n old
                          ones
    split (m,)           the triangles of the new vertices, ascending
    faces, across (f + 2 m, 3)  triangles and `surface.link_faces` of them, f of them filled in
    share (f + 2 m,)     a value of each old triangle, which parts keep; a flip gives both triangles the mean
    """
    f = len(faces) - 2 * len(split)
    parts: Any = np.empty(3, np.int32)
    for j in range(len(split)):
        i, p = split[j], n + j
        parts[0], parts[1], parts[2] = i, f + 2 * j, f + 2 * j + 1
        a, b, c = faces[i, 0], faces[i, 1], faces[i, 2]
        outer_b, outer_c = across[i, 1], across[i, 2]
        faces[parts[0], 2] = p
        faces[parts[1], 0], faces[parts[1], 1], faces[parts[1], 2] = b, c, p
        faces[parts[2], 0], faces[parts[2], 1], faces[parts[2], 2] = c, a, p
        across[parts[1], 0], across[parts[2], 0] = outer_b, outer_c
        for k in range(3):
            across[parts[k], 1], across[parts[k], 2] = parts[(k + 1) % 3], parts[(k + 2) % 3]
            share[parts[k]] = share[i]
        _set_neighbour(faces, across, outer_b, c, b, parts[1])
        _set_neighbour(faces, across, outer_c, a, c, parts[2])
    flipped, left = 0, 0
    done = np.zeros(len(faces), np.bool_)
    own = np.zeros(len(faces), np.bool_)
    own[f:] = True
    for j in range(len(split)):
        own[split[j]] = True
    for j in range(len(split)):
        parts[0], parts[1], parts[2] = split[j], f + 2 * j, f + 2 * j + 1
        for s in parts:
            g = across[s, 0]
            if done[s] or g < 0:
                continue
            u, v, p = faces[s, 0], faces[s, 1], faces[s, 2]
            c = 0
            for k in range(3):
                if faces[g, k] == v and faces[g, (k + 1) % 3] == u:
                    c = k
            q = faces[g, (c + 2) % 3]
            done[s] = True
            done[g] = own[g]
            stays = p == q or _has_edge(faces, across, s, p, q) or not _may_flip(x, u, v, p, q)
            if stays or not (_keeps_facing(x, raised, p, u, q) and _keeps_facing(x, raised, q, v, p)):
                left += 1
                continue
            beyond_uq, beyond_qv = across[g, (c + 1) % 3], across[g, (c + 2) % 3]
            beyond_vp, beyond_pu = across[s, 1], across[s, 2]
            faces[s, 0], faces[s, 1], faces[s, 2] = p, u, q
            faces[g, 0], faces[g, 1], faces[g, 2] = q, v, p
            across[s, 0], across[s, 1], across[s, 2] = beyond_pu, beyond_uq, g
            across[g, 0], across[g, 1], across[g, 2] = beyond_qv, beyond_vp, s
            _set_neighbour(faces, across, beyond_uq, q, u, s)
            _set_neighbour(faces, across, beyond_vp, p, v, g)
            share[s] = share[g] = 0.5 * (share[s] + share[g])
            flipped += 1
    return flipped, left


@kernel
def smooth(x: Float, moved: Int, start: Int, neighbours: Int, passes: int, shrink: float, inflate: float) -> None:
    """Smooth by Taubin's lambda|mu (SIGGRAPH 1995) on x (n, 3), in place, by uniform weights.

    moved (m,) vertices, of which the i-th has the neighbours neighbours[start[i]:start[i + 1]]; one without stays. A
    pass scales a wave with the eigenvalue kappa of the Laplacian by (1 - lambda kappa)(1 - mu kappa).
    """
    step = np.empty((len(moved), 3))
    for turn in range(2 * passes):
        factor = shrink if turn % 2 == 0 else inflate
        for i in range(len(moved)):
            for k in range(3):
                total = 0.0
                for e in range(start[i], start[i + 1]):
                    total += x[neighbours[e], k]
                count = start[i + 1] - start[i]
                step[i, k] = factor * (total / count - x[moved[i], k]) if count else 0.0
        for i in range(len(moved)):
            for k in range(3):
                x[moved[i], k] += step[i, k]


# The surface with raised lines: split, moved along normals, smoothed. net.py builds springs and masses.

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
    """Neighbours for smoothing: vertices (s,), and sorted pairs (p, 2) of one of them and a neighbour, by which places
    on the cloth are smoothed (`along`) and what it is raised by (`raised`).
    """

    vertex: Int
    along: NDArray[np.int64]
    raised: NDArray[np.int64]


def _find_neighbours(fabric: Fabric, triangles: Int, rim: Bool, number: int, smoothing: Smoothing) -> Neighbours:
    """Return the neighbours of the new vertices and of their two-ring, by the triangles (l, 3) there; rim (l, 3)
    borders. Pinned vertices stay. On the cloth, those of the border are smoothed along it, so that it does not move
    inwards (Taubin's hierarchical constraint); but it is raised with the cloth beside it, or a line would end in front
    of a hem. New vertices are smoothed among themselves if `smoothing.hierarchical`. The end of a border or of such a
    line stays: its one neighbour would pull it in.
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
    kept = near[pair[:, 0]]
    if smoothing.hierarchical:
        kept &= (pair[:, 0] < n) | (pair[:, 1] >= n)
    on_border = kept & (~border[pair[:, 0]] | np.append(edge, edge[edge]))
    along, raised = (_without_ends(pair[one], number) for one in (on_border, kept))
    return Neighbours(np.flatnonzero(near).astype(np.int32), along, raised)


def _without_ends(pair: NDArray[np.int64], number: int) -> NDArray[np.int64]:
    """Return sorted pairs (p, 2) of a vertex and a neighbour, without those of vertices that have one only."""
    pair = pair[np.bincount(pair[:, 0], minlength=number)[pair[:, 0]] > 1]
    return pair[np.argsort(pair[:, 0], kind="stable")]


def _smooth(flat: Float, x: Float, triangles: Int, neighbours: Neighbours, smoothing: Smoothing) -> int:
    """Smooth x, in place, except the vertices of triangles that would turn over. Return their number. Without smoothing
    no triangle turns over (split.py), so that there is always a set of vertices to hold.
    """
    if smoothing.passes == 0:
        return 0
    raised, held = x - flat, np.zeros(len(x), np.bool_)
    for _ in range(ROUNDS):
        place, height = flat.copy(), raised.copy()
        for values, pairs in ((place, neighbours.along), (height, neighbours.raised)):
            pair = pairs[~held[pairs[:, 0]]]
            at = np.concatenate([[0], np.cumsum(np.bincount(pair[:, 0], minlength=len(x))[neighbours.vertex])])
            smooth(
                values, neighbours.vertex, at.astype(np.int32), pair[:, 1].astype(np.int32),
                smoothing.passes, smoothing.shrink, smoothing.inflate,
            )  # fmt: skip
        x[...] = place + height
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
    # Normals of lengths twice the triangles' areas.
    before, after = (np.cross(x[b] - x[a], x[c] - x[a]) for a, b, c in [faces.T] for x in (flat, raised))
    side = raised[faces] - raised[np.roll(faces, 1, axis=1)]
    least = THIN * np.square(side).sum(axis=2).max(axis=1)
    same = np.einsum("fk,fk->f", before, after) > 0.0
    return np.asarray(~(same & (np.linalg.norm(after, axis=1) > 2.0 * least)))
