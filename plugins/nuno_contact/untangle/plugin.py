"""The operation `untangle`: cloth that passes through cloth at the start is moved until it does so no more."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, Field

from nuno_contact.quantities import Size
from nuno_contact.untangle.contours import (
    JITTER,
    Cloth,
    Long,
    Nodes,
    Sides,
    find_contours,
    find_sides,
    make_cloth,
    make_nodes,
)
from nuno_contact.untangle.search import OVER, Near, find_crossings, find_near_pairs
from nuno_geometry.check import place_of
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Fabric, Float, Int, State
from nuno_schemas.operation import Arranged, Changed, Outcome, Surface
from nuno_schemas.plugin import Config
from nuno_schemas.vectors import norm

# The way out: cloth is moved a little at a time until nothing crosses and all keep their gaps.
#
# Each time, what crosses is pushed by STEP of an edge at most, as nuno_contact.untangle.contours says, and what has
# come too near is pushed apart, each vertex by the mean of what its pairs ask of it. What crosses is pushed by a
# displacement that is smoothed over the mesh, and scaled so that it still comes nearest to what was asked: cloth does
# not move vertex by vertex. Where the number of tangled vertices has not fallen for PATIENCE times, the next of WAYS is
# taken for as many. Not chosen: to smooth over more of the mesh, or to let what takes no part follow as by springs.
# Both draw what has been freed of a crumpled skirt into itself again, and move more of it. Nor steps that never let a
# new crossing come up, by the bounds of nuno_contact.offset.ccd: what has to pass through one sheet on its way out of
# another could not.

STEP = 0.5
"""share of the mean edge by which crossing cloth is pushed at most"""
WAYS = ((3, False), (3, True), (1, False), (1, True))
"""how often a push is smoothed, and whether all contours are shortened, also where they cut"""
MOST = 5.0
"""most scaling of a smoothed push"""
LEAST = 0.25
"""least sum of squared weights by which a pair is moved: less means hardly any of it is free"""
PATIENCE, SETTLED = 15, 50
"""Iterations without progress before another way is tried; and those, when nothing crosses any more, in which parts of
one object are pushed further apart."""


class Loosened(NamedTuple):
    """Displacements (n, 3) [m], how often the cloth was moved, and edges (k,) and triangles (k,) that still cross."""

    moved: Float
    iterations: int
    edge: Long
    face: Long


def loosen(cloth: Cloth, gap: float, most: int) -> Loosened:
    """Move the cloth, up to `most` times, from where it crosses, until its tangled parts and objects keep a gap [m].

    Parts may stay nearer, as in a sharp fold or between layers that are held: they are given up after a while.
    """
    moved = np.zeros_like(cloth.begun)
    ever, fewest, since, clear = np.zeros(len(moved), bool), len(moved) + 1, 0, 0
    for iteration in range(most + 1):
        x = cloth.begun + moved
        edge, face = find_crossings(cloth.tree, x, cloth.piece, cloth.meets, cloth.bodies >= 0)
        tangled, push = np.zeros(len(x), bool), np.zeros_like(x)
        if len(edge):
            nodes = make_nodes(cloth, x, edge, face)
            sweeps, shorten = WAYS[since // PATIENCE % len(WAYS)]
            sides = find_sides(cloth, x, nodes, find_contours(cloth, x, nodes), shorten)
            tangled, count = sides.tangled, int(sides.tangled.sum())
            fewest, since = (count, 0) if count < fewest else (fewest, since + 1)
            ever |= tangled
            push = pushed(cloth, nodes, sides, gap, sweeps)
        near = find_near_pairs(cloth, x + push, ever, gap)
        close = near.distance < near.wanted
        clear = 0 if len(edge) else clear + 1
        if iteration == most or clear > SETTLED or (clear and not close.any()):
            break
        moved += push + parted(cloth, near, tangled)
    return Loosened(moved, iteration, edge, face)


def pushed(cloth: Cloth, nodes: Nodes, sides: Sides, gap: float, sweeps: int) -> Float:
    """Return the displacement of crossing cloth (n, 3) [m]."""
    known, step = sides.wrong >= 0, STEP * cloth.edge
    is_wrong = nodes.ends == sides.wrong[:, None]
    depth = np.abs(np.where(is_wrong, nodes.heights, 0.0)).max(axis=1)
    amount = np.where(known, np.minimum(depth + gap, step), 0.5 * step)
    ends = np.where(known[:, None], is_wrong.astype(np.float64), nodes.end_shares)
    weights = np.concatenate([ends, -nodes.corner_shares], axis=1)
    vertices = np.concatenate([nodes.ends, nodes.corners], axis=1)
    raw, wanted = displaced(cloth, vertices, weights, amount, sides.way)
    push = raw
    for _ in range(sweeps):
        push = cloth.free * 0.5 * (push + cloth.mean @ push)
    along = math.fsum((raw[wanted] * push[wanted]).ravel().tolist())
    own = math.fsum((push[wanted] ** 2).ravel().tolist())
    return min(max(along / own, 1.0), MOST) * push if own > 0.0 else push


def parted(cloth: Cloth, near: Near, tangled: Bool) -> Float:
    """Return the displacement of cloth that is too near (n, 3) [m]; for tangled cloth the direction is unknown."""
    apart = ~tangled[near.pair].any(axis=1)
    amount = OVER * near.wanted[apart] - near.distance[apart]
    return displaced(cloth, near.pair[apart], near.weights[apart], amount, near.normal[apart])[0]


def displaced(cloth: Cloth, vertices: Long, weights: Float, amount: Float, way: Float) -> tuple[Float, Bool]:
    """Return displacements (n, 3) by which sums of weights (k, c) times vertices (k, c) go by an amount (k,) [m] along
    a way (k, 3), each as if alone: their weighted mean at each vertex; and (n,) where there is any.
    """
    n, size = len(cloth.free), np.abs(weights)
    free = weights * cloth.free[vertices, 0]
    room = (free * weights).sum(axis=1)
    scale = amount / np.maximum(room, LEAST)
    wanted = size[:, :, None] * (free * scale[:, None])[:, :, None] * way[:, None, :]
    total, weight = np.zeros((n, 3)), np.bincount(vertices.ravel(), size.ravel(), n)
    np.add.at(total, vertices.ravel(), wanted.reshape(-1, 3))
    taken = weight > 1e-12
    return np.divide(total, weight[:, None], out=np.zeros_like(total), where=taken[:, None]), taken


GAP = 1e-3
"""gap of cloth that has no thickness [m]"""


class UntangleConfig(Config):
    """The gap, and the number of attempts."""

    gap: Size | Literal["auto"] = Field(
        default="auto",
        description="distance that objects, and what was tangled, come to have where there is room [m]; auto: the "
        f"thickness of cloth_contact, {GAP:g} without",
    )
    iterations: int = Field(default=1000, ge=1, le=1_000_000, description="how often the cloth is moved at most")


class Untangle:
    """Moves crossing cloth and its neighbourhood; nothing if nothing crosses."""

    name: ClassVar[str] = "untangle"
    Config: ClassVar[type[BaseModel]] = UntangleConfig

    def apply(self, config: UntangleConfig, fabric: Fabric, state: State, skin: Surface | None) -> Outcome:
        """Untangle one fabric by itself, at `state`; velocities stay. Raises BadInput if it stays tangled."""
        whole = {fabric.name: np.arange(fabric.number, dtype=np.int32)}
        made = self.arrange(config, replace(fabric, position=state.x), whole, np.ones((1, 1), np.bool_), None)
        after = State(made.position, state.v.copy(), state.t)
        return Outcome(made.facts, changed=Changed(fabric, after, np.arange(fabric.number, dtype=np.int32)))

    def arrange(
        self, config: UntangleConfig, fabric: Fabric, objects: Mapping[str, Int], meet: Bool,
        thickness: float | None, bodies: Surface | None = None,
    ) -> Arranged:  # fmt: skip
        """Untangle all; see nuno_schemas.operation. Raises BadInput if cloth stays tangled, with how much and where."""
        x = fabric.position.copy()
        if not len(fabric.faces):
            return Arranged(x, facts_of(0, 0, np.zeros_like(x)))
        cloth = make_cloth(fabric, objects, meet, bodies)
        whole = x if bodies is None else np.concatenate([x, bodies.vertices])
        before = len(find_crossings(cloth.tree, whole, cloth.piece, cloth.meets, cloth.bodies >= 0)[0])
        if not before:
            return Arranged(x, facts_of(0, 0, np.zeros_like(x)))
        gap = (thickness or GAP) if config.gap == "auto" else config.gap
        found = loosen(cloth, gap + 4.0 * JITTER * cloth.edge, config.iterations)
        # Vertices that have hardly moved stay. The check is of the real places: the search shifted them a little.
        gone = norm(found.moved) > JITTER * cloth.edge
        whole = np.where(gone[:, None], whole + found.moved, whole)
        edge, face = find_crossings(cloth.tree, whole, cloth.piece, cloth.meets, cloth.bodies >= 0)
        check_loose(cloth, whole, edge, face, found.iterations, before, list(objects), fabric)
        x = whole[: fabric.number]
        return Arranged(x, facts_of(before, found.iterations, x - fabric.position))


def facts_of(crossings: int, iterations: int, moved: Float) -> dict[str, float]:
    """Return edges through triangles before, iterations, moved vertices, and their way [m]."""
    far = norm(moved)
    return {
        "crossings": float(crossings),
        "iterations": float(iterations),
        "vertices": float((far > 0.0).sum()),
        "largest": float(far.max(initial=0.0)),
        "mean": float(np.cumsum(far)[-1] / len(far)) if len(far) else 0.0,
    }


def check_loose(
    cloth: Cloth, x: Float, edge: Long, face: Long, iterations: int, before: int, names: list[str], fabric: Fabric
) -> None:
    """Raise BadInput for edges (k,) that still go through triangles (k,)."""
    if not len(edge):
        return
    ends, corners = cloth.tree.edges[edge], cloth.tree.faces[face]
    held = (cloth.free[np.concatenate([ends, corners], axis=1), 0] == 0.0).any(axis=1)
    i, j = ends[0]
    one, two, place = cloth.piece[i], cloth.piece[corners[0, 0]], place_of(x[[i, j]].mean(axis=0))
    of_body, remedy = cloth.bodies in (one, two), "place the objects so that less of them crosses, hold less of them"
    where = place
    if not of_body:
        adjacent = int(np.flatnonzero(np.isin(fabric.faces, [i, j]).sum(axis=1) == 2)[0])
        panels = [_panel_of(fabric, int(k)) for k in (adjacent, face[0])]
        where = f"edge {i}-{j} of {names[one]} through triangle {face[0]} of {names[two]}, {place}"
        if all(panels):
            where = f"{panels[0]} of {names[one]} through {panels[1]} of {names[two]}, {place}"
            remedy = "cut panels that are too small for the body wider, place panels so that less of them crosses"
    raise BadInput(
        f"cloth still passes through {'a body' if of_body else 'cloth'} after {iterations:,} iterations "
        f"({len(edge):,} edges through triangles of {before:,}, {int(held.sum()):,} with vertices that are held)",
        value=where,
        limit="none",
        remedy=f"{remedy}, or allow more iterations",
    )


def _panel_of(fabric: Fabric, face: int) -> str:
    """Return the panel of a triangle of a sewn garment, "" for none."""
    panels = None if fabric.corners is None else fabric.corners.panels
    return "" if panels is None or panels.of[face] < 0 else panels.names[panels.of[face]]
