"""A garment drawn together round a body: from panels far apart, joined by their seams, to about the size it is cut to.

Its edges are springs. They start at the length they have and shorten, all in the same share of rounds, to that of the
pattern; each round also straightens the cloth a little, and puts out of the body what came nearer than the clearance:
vertices, and points along the edges, since one that is stretched across a shoulder passes it between its ends. Cloth
does not feel itself here. It hardly has to: drawn from all sides at once it stays spread out.

This is no simulation, and ends at no equilibrium: it is where one can start, with strains of some tenths.

Rejected: a simulation from the panels on, whose seams snap shut at 100 m/s, crumple what hangs loose, and take
minutes where cloth contact is to keep up; pushing the body out along the cloth's own normals, which throws
about cuffs and hems that have none to speak of.
"""

from __future__ import annotations

import numpy as np

from nuno_cloth.models.triangles import Edges
from nuno_kernels.meshes.closest_point import closest_points
from nuno_kernels.meshes.tree import Tree
from nuno_schemas.fabric import Bool, Float, Int

FIRST = 40
"""Rounds, at most, in which the panels are only put out of the body."""
ROUNDS = 240
SHORTENED = 0.6
"""Share of the rounds after which edges are as long as they are cut."""
MOMENTUM = 0.95
"""Share of what the cloth moved the last time by which it goes on each time."""
BENT = 0.2, 0.015
"""What bending is at first and besides, which ends at the second: springs alone would crumple cloth of which there is
too much until it goes through itself."""
COARSE, FINE = 1e-2, 7e-3
"""So far apart are the points of an edge that are kept out of the body at most [m]; the second in the last quarter of
the rounds, when toes and fingers are to be kept out."""
NOWHERE = 1e-9
"""Nearer to the surface than this [m] a point has no direction from it."""


def draw_together(
    x: Float, edges: Edges, rest: Float, body: Tree | None, clearance: float, worn: bool = False,
    held: Bool | None = None,
) -> Float:  # fmt: skip
    """(n, 3) places of cloth that starts at x (n, 3) [m], its edges about `rest` (e,) long [m], no point of them nearer
    to the body than `clearance` [m] unless it is caught.

    Cloth that is `worn` from the start, with edges about as long as they are cut, is not shortened, and only its
    vertices are kept out. What is `held` (n,) stays where it is.
    """
    pairs, begun = edges.pairs, x
    share = 1.0 / np.bincount(pairs.reshape(-1), minlength=len(x))[:, None]
    inside = np.ones((len(x), 1))
    inside[pairs[edges.count == 1]] = 0.0
    face: Int | None = None

    def cleared(x: Float, spacing: float) -> tuple[Float, int]:
        """Points before vertices: the other way round, they take vertices back into the body."""
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
    before = x
    for turn in range(1, ROUNDS + 1):
        length = start * (rest / start) ** min(1.0, turn / (SHORTENED * ROUNDS))
        bent = BENT[0] * (1.0 - turn / ROUNDS) + BENT[1]
        curve = inside * share * _pull(x, pairs, 0.0 * rest)
        move = share * (_pull(x, pairs, length) - 4.0 * bent * inside * _pull(curve, pairs, 0.0 * rest))
        x, before = x + MOMENTUM * (x - before) + move, x
        x, _ = cleared(x, COARSE if turn < 0.75 * ROUNDS else FINE)
        if held is not None:
            x[held] = begun[held]
    return np.ascontiguousarray(x)


def put_points_out(
    x: Float, pairs: Int, body: Tree, clearance: float, spacing: float, face: Int | None
) -> tuple[Float, int, Int]:
    """Vertices (n, 3) moved so that points of edges come out of the body, how many had to, and the body's triangle (n,)
    next to each vertex, which `face` is thought to be.
    """
    found = closest_points(body, x, face)
    a, b, part = points_between(x, pairs, found.distance, clearance, spacing)
    there = (1.0 - part)[:, None] * x[a] + part[:, None] * x[b]
    between = closest_points(body, there, found.face[a])
    at = np.flatnonzero(between.distance < clearance)
    a, b, part, away = a[at], b[at], part[at], between.distance[at]
    out = (clearance - away)[:, None] * _way(there[at], between.point[at], away)
    ends, own = np.concatenate([a, b]), np.concatenate([1.0 - part, part])
    out = np.concatenate([out, out]) / np.tile((1.0 - part) ** 2 + part**2, 2)[:, None]
    weight = np.bincount(ends, own, len(x))
    move = np.stack([np.bincount(ends, own**2 * along, len(x)) for along in out.T], axis=1)
    x = x + np.divide(move, weight[:, None], out=np.zeros_like(x), where=weight[:, None] > 0.0)
    return x, len(at), found.face


def put_out(x: Float, body: Tree, clearance: float, face: Int | None) -> tuple[Float, int, Int]:
    """Vertices (n, 3) put out of the body, how many had to be, and the body's triangle (n,) next to each."""
    found = closest_points(body, x, face)
    near = found.distance < clearance
    x = np.where(near[:, None], x + (clearance - found.distance)[:, None] * _way(x, found.point, found.distance), x)
    return x, int(np.count_nonzero(near)), found.face


def points_between(x: Float, pairs: Int, distance: Float, clearance: float, spacing: float) -> tuple[Int, Int, Float]:
    """Points of edges, `spacing` [m] apart at most, that may be nearer to a body than the clearance: the ends (k,) (k,)
    and how far from the first on (k,). Vertices are at a `distance` (n,) [m], and no point loses more of that than it
    is off.
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


def _way(x: Float, point: Float, distance: Float) -> Float:
    """(n, 3) unit vectors out of the body."""
    size = np.where(np.abs(distance) < NOWHERE, NOWHERE, distance)
    return np.asarray((x - point) / size[:, None])


def _lengths(x: Float, pairs: Int) -> Float:
    return np.asarray(np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1))


def _pull(x: Float, pairs: Int, rest: Float) -> Float:
    """(n, 3) sums of half of what each spring's ends are off its rest length [m]."""
    d = x[pairs[:, 1]] - x[pairs[:, 0]]
    size = np.linalg.norm(d, axis=1)
    move = (0.5 * (size - rest) / np.maximum(size, 1e-12))[:, None] * d
    first, last = pairs.T
    return np.stack(
        [np.bincount(first, move[:, k], len(x)) - np.bincount(last, move[:, k], len(x)) for k in range(3)], 1
    )
