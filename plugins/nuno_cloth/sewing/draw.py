"""Drawing a garment together round a body, from panels that are far apart to about its cut size.

Its edges are springs. They shorten from their starting lengths, all in the same share of rounds, to those of the
pattern. Each round also straightens the cloth a little, and moves out of the body what came nearer than the clearance:
vertices, and points along edges, since an edge that is stretched across a shoulder cuts through it between its ends.
Cloth does not touch itself here, and hardly would: drawn from all sides at once it stays spread out.

This is no simulation, and does not end in equilibrium: a simulation can start there, with strains of some tenths.

Rejected: a simulation from the panels, whose seams close at 100 m/s, crumple loose cloth, and take minutes if cloth
contact is to keep up; pushing the body out along the cloth's normals, which throws cuffs and hems about, where normals
are ill defined.
"""

from __future__ import annotations

import numpy as np

from nuno_cloth.models.triangles import Edges
from nuno_geometry.closest_point import closest_points
from nuno_geometry.tree import Tree
from nuno_schemas.fabric import Bool, Float, Int

FIRST = 40
"""The most rounds that only move the panels out of the body."""
ROUNDS = 240
SHORTENED = 0.6
"""Share of the rounds after which edges have their cut lengths."""
MOMENTUM = 0.95
"""Share of the last displacement that is added to the next."""
BENT = 0.2, 0.015
"""Bending stiffness that falls to 0, and a constant one: springs alone would crumple surplus cloth until it passes
through itself."""
COARSE, FINE = 1e-2, 7e-3
"""Largest distance between points of an edge that are kept out of the body [m]; FINE in the last quarter of the rounds,
to keep toes and fingers out."""
NOWHERE = 1e-9
"""A point nearer to the surface than this [m] has no direction from it."""


def draw_together(
    x: Float, edges: Edges, rest: Float, body: Tree | None, clearance: float, worn: bool = False,
    held: Bool | None = None,
) -> Float:  # fmt: skip
    """Return places (n, 3) of cloth that starts at x (n, 3) [m], its edges about `rest` (e,) long [m], no point of
    these nearer to the body than `clearance` [m] unless caught.

    Cloth that is `worn` from the start, with edges about as long as they are cut, is not shortened, and only its
    vertices are kept out. Vertices that are `held` (n,) do not move.
    """
    pairs, initial = edges.pairs, x
    share = 1.0 / np.bincount(pairs.reshape(-1), minlength=len(x))[:, None]
    inside = np.ones((len(x), 1))
    inside[pairs[edges.count == 1]] = 0.0
    face: Int | None = None

    def cleared(x: Float, spacing: float) -> tuple[Float, int]:
        """Move points out before vertices: after them, points would move vertices back into the body."""
        nonlocal face
        if body is None:
            return x, 0
        points = 0
        if not worn:
            x, points, face = put_points_out(x, pairs, body, clearance, spacing, face)
        x, vertices, face = put_out(x, body, clearance, face)
        return x, points + vertices

    for _ in range(FIRST):
        x, near = cleared(x, COARSE)
        if not near:
            break
    start = rest if worn else np.maximum(_lengths(x, pairs), rest)
    previous = x
    for turn in range(1, ROUNDS + 1):
        length = start * (rest / start) ** min(1.0, turn / (SHORTENED * ROUNDS))
        bent = BENT[0] * (1.0 - turn / ROUNDS) + BENT[1]
        curve = inside * share * _pull(x, pairs, 0.0 * rest)
        move = share * (_pull(x, pairs, length) - 4.0 * bent * inside * _pull(curve, pairs, 0.0 * rest))
        x, previous = x + MOMENTUM * (x - previous) + move, x
        x, _ = cleared(x, COARSE if turn < 0.75 * ROUNDS else FINE)
        if held is not None:
            x[held] = initial[held]
    return np.ascontiguousarray(x)


def put_points_out(
    x: Float, pairs: Int, body: Tree, clearance: float, spacing: float, face: Int | None
) -> tuple[Float, int, Int]:
    """Move vertices (n, 3) so that points of edges leave the body. Return these, the number of such points, and the
    body's triangle (n,) nearest to each vertex; `face` is a guess of it.
    """
    nearest = closest_points(body, x, face)
    a, b, part = points_between(x, pairs, nearest.distance, clearance, spacing)
    points = (1.0 - part)[:, None] * x[a] + part[:, None] * x[b]
    nearby = closest_points(body, points, nearest.face[a])
    inside = np.flatnonzero(nearby.distance < clearance)
    a, b, part, away = a[inside], b[inside], part[inside], nearby.distance[inside]
    out = (clearance - away)[:, None] * _outwards(points[inside], nearby.point[inside], away)
    ends, share = np.concatenate([a, b]), np.concatenate([1.0 - part, part])
    out = np.concatenate([out, out]) / np.tile((1.0 - part) ** 2 + part**2, 2)[:, None]
    weight = np.bincount(ends, share, len(x))
    move = np.stack([np.bincount(ends, share**2 * along, len(x)) for along in out.T], axis=1)
    x = x + np.divide(move, weight[:, None], out=np.zeros_like(x), where=weight[:, None] > 0.0)
    return x, len(inside), nearest.face


def put_out(x: Float, body: Tree, clearance: float, face: Int | None) -> tuple[Float, int, Int]:
    """Move vertices (n, 3) out of the body. Return these, the number moved, and the body's nearest triangles (n,)."""
    nearest = closest_points(body, x, face)
    near = nearest.distance < clearance
    x = np.where(
        near[:, None], x + (clearance - nearest.distance)[:, None] * _outwards(x, nearest.point, nearest.distance), x
    )
    return x, int(np.count_nonzero(near)), nearest.face


def points_between(x: Float, pairs: Int, distance: Float, clearance: float, spacing: float) -> tuple[Int, Int, Float]:
    """Return points of edges, at most `spacing` [m] apart, that may be nearer to a body than the clearance: the edge's
    ends (k,), (k,) and the share of the way between (k,). Vertices are at a `distance` (n,) [m], which changes along an
    edge by no more than the length.
    """
    length = _lengths(x, pairs)
    reached = distance[pairs].sum(axis=1) - length < 2.0 * clearance
    pairs, length = pairs[reached], length[reached]
    inner = np.ceil(length / spacing).astype(np.int64) - 1
    edge = np.repeat(np.arange(len(pairs)), np.maximum(inner, 0))
    first = np.cumsum(inner) - inner
    part = (np.arange(len(edge)) - first[edge] + 1) / (inner[edge] + 1)
    a, b = pairs[edge].T
    kept = (distance[a] - part * length[edge] < clearance) & (distance[b] - (1.0 - part) * length[edge] < clearance)
    return a[kept], b[kept], part[kept]


def _outwards(x: Float, point: Float, distance: Float) -> Float:
    """Return unit vectors (n, 3) out of the body."""
    size = np.where(np.abs(distance) < NOWHERE, NOWHERE, distance)
    return np.asarray((x - point) / size[:, None])


def _lengths(x: Float, pairs: Int) -> Float:
    return np.asarray(np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1))


def _pull(x: Float, pairs: Int, rest: Float) -> Float:
    """Return sums (n, 3) over springs of half their excess over the rest length [m], along each."""
    d = x[pairs[:, 1]] - x[pairs[:, 0]]
    size = np.linalg.norm(d, axis=1)
    move = (0.5 * (size - rest) / np.maximum(size, 1e-12))[:, None] * d
    first, last = pairs.T
    return np.stack(
        [np.bincount(first, move[:, k], len(x)) - np.bincount(last, move[:, k], len(x)) for k in range(3)], 1
    )
