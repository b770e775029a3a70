"""The way out: cloth is moved a little at a time until nothing crosses and all keep their gaps.

Each time, what crosses is pushed by STEP of an edge at most, as nuno_contact.untangle.sides says, and what has come
too near is pushed apart, each vertex by the mean of what its pairs ask of it. What crosses is pushed by a displacement
that is smoothed over the mesh, and scaled so that it still comes nearest to what was asked: cloth moves as a whole and
not vertex by vertex. What takes no part then follows by the mean displacement of its neighbours, as a net of
springs that resists being displaced unevenly.

Where the number of tangled vertices has not fallen for PATIENCE times, the contours' lengths decide for as many; after
four times as many nothing is smoothed any more, since small tangles may ask for displacements that differ from
vertex to vertex.

Not chosen: steps that never let a new crossing come up, by the bounds of nuno_contact.offset.hold. What has to pass
through one sheet on its way out of another could not.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from nuno_contact.untangle.cloth import Cloth, Long
from nuno_contact.untangle.contours import Nodes, find_contours, make_nodes
from nuno_contact.untangle.search import OVER, Near, find_crossings, find_near_pairs
from nuno_contact.untangle.sides import Sides, find_sides
from nuno_schemas.fabric import Bool, Float

STEP = 0.5
"""Share of the mean edge by which what crosses is pushed at most."""
SWEEPS, MOST = 24, 5.0
"""How often a push is smoothed, and how much it is scaled at most."""
FOLLOW, SHARE = 4, 0.25
"""How often what takes no part is moved towards the mean displacement of its neighbours, and by what share."""
LEAST = 0.25
"""Of the squares of weights that a pair is moved by: less has one of which hardly anything is free."""
PATIENCE, SETTLED = 15, 50
"""How often nothing may get better before something else is tried; and how often, where nothing crosses any more,
parts of one object are pushed further apart."""


class Loosened(NamedTuple):
    """Displacements (n, 3) [m], how often the cloth was moved, edges (k,) and triangles (k,) that still cross, and
    pairs that are nearer than they ought to be.
    """

    moved: Float
    iterations: int
    edge: Long
    face: Long
    near: Near


def loosen(cloth: Cloth, gap: float, most: int) -> Loosened:
    """Move the cloth at most so many times, from where it crosses, until what was tangled and objects keep a gap [m].

    Of one object parts may stay nearer, as in a sharp fold: they are given up after a while.
    """
    moved = np.zeros_like(cloth.begun)
    ever, fewest, since, clear = np.zeros(len(moved), bool), len(moved) + 1, 0, 0
    for iteration in range(most + 1):
        x = cloth.begun + moved
        edge, face = find_crossings(cloth.tree, x, cloth.piece, cloth.meets)
        tangled, push = np.zeros(len(x), bool), np.zeros_like(x)
        if len(edge):
            nodes = make_nodes(cloth, x, edge, face)
            sides = find_sides(cloth, x, nodes, find_contours(cloth, x, nodes), since // PATIENCE % 2 == 1)
            tangled, count = sides.tangled, int(sides.tangled.sum())
            fewest, since = (count, 0) if count < fewest else (fewest, since + 1)
            ever |= tangled
            push = pushed(cloth, nodes, sides, gap, smooth=since <= 4 * PATIENCE)
        near = find_near_pairs(cloth, x + push, ever, gap)
        close = near.distance < near.wanted
        between = cloth.piece[near.pair[:, 0]] != cloth.piece[near.pair[:, 3]]
        clear = 0 if len(edge) or (close & between).any() else clear + 1
        if iteration == most or clear > SETTLED or (clear and not close.any()):
            break
        moved += push + parted(cloth, near, tangled)
        if len(edge) and since <= 4 * PATIENCE:
            follows = cloth.free.copy()
            follows[tangled] = follows[near.pair] = 0.0
            for _ in range(FOLLOW):
                moved += SHARE * follows * (cloth.mean @ moved - moved)
    return Loosened(moved, iteration, edge, face, near)


def pushed(cloth: Cloth, nodes: Nodes, sides: Sides, gap: float, smooth: bool) -> Float:
    """(n, 3) how far what crosses is to go now [m]."""
    known, step = sides.wrong >= 0, STEP * cloth.edge
    is_wrong = nodes.ends == sides.wrong[:, None]
    depth = np.abs(np.where(is_wrong, nodes.heights, 0.0)).max(axis=1)
    amount = np.where(known, np.minimum(depth + gap, step), 0.5 * step)
    ends = np.where(known[:, None], is_wrong.astype(np.float64), nodes.end_shares)
    weights = np.concatenate([ends, -nodes.corner_shares], axis=1)
    vertices = np.concatenate([nodes.ends, nodes.corners], axis=1)
    raw, asked = displaced(cloth, vertices, weights, amount, sides.way)
    push = raw
    if smooth:
        for _ in range(SWEEPS):
            push = cloth.free * 0.5 * (push + cloth.mean @ push)
        along = math.fsum((raw[asked] * push[asked]).ravel().tolist())
        own = math.fsum((push[asked] ** 2).ravel().tolist())
        push = min(max(along / own, 1.0), MOST) * push if own > 0.0 else push
    return push


def parted(cloth: Cloth, near: Near, tangled: Bool) -> Float:
    """(n, 3) how far what is too near is to go apart [m]; what is tangled does not know where to."""
    apart = ~tangled[near.pair].any(axis=1)
    amount = OVER * near.wanted[apart] - near.distance[apart]
    return displaced(cloth, near.pair[apart], near.weights[apart], amount, near.normal[apart])[0]


def displaced(cloth: Cloth, vertices: Long, weights: Float, amount: Float, way: Float) -> tuple[Float, Bool]:
    """(n, 3) displacements by which the sums of weights (k, c) times vertices (k, c) go by an amount (k,) [m] along a
    way (k, 3) each, if each were alone: the mean of them at each vertex, by weight. And (n,) where there is any.
    """
    n, size = len(cloth.free), np.abs(weights)
    free = weights * cloth.free[vertices, 0]
    room = (free * weights).sum(axis=1)
    scale = amount / np.maximum(room, LEAST)
    asked = size[:, :, None] * (free * scale[:, None])[:, :, None] * way[:, None, :]
    total, weight = np.zeros((n, 3)), np.bincount(vertices.ravel(), size.ravel(), n)
    np.add.at(total, vertices.ravel(), asked.reshape(-1, 3))
    taken = weight > 1e-12
    return np.divide(total, weight[:, None], out=np.zeros_like(total), where=taken[:, None]), taken
