"""Bending springs and hinges of a raised surface: built once, after all flips, across edges of changed triangles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from nuno_schemas.fabric import BENDING, Bool, Fabric, Float, Hinges, Int, Springs
from nuno_wrinkle.edges import Edges, any_of, edges_of, fold_angles, keys_of, quads_of
from nuno_wrinkle.kept import most_stiffness
from nuno_wrinkle.near import Near, Rule, damping_of, stiffness_of
from nuno_wrinkle.raised import Raised, Region


@dataclass(frozen=True)
class Remade:
    """A raised surface whose net is being made: of n + m vertices, with e edges of the region's triangles."""

    fabric: Fabric
    raised: Raised
    near: Near
    model: Mapping[str, float]
    rule: Rule
    edges: Edges
    moved: Bool
    """(n + m,) vertices that are new or smoothed"""
    mass: Float
    """(n + m,) [kg]"""
    rest: Float
    """(e,) rest lengths [m]"""
    share: Float
    """(e,) mean stretch of the old triangles at each edge"""
    areas: tuple[Float, Float]
    """Areas of the region's triangles at rest [m^2], before and after."""


def bend_springs(made: Remade, springs: Springs, across: Int) -> Springs:
    """The springs with bending ones across new edges, and without those across edges that are gone.

    Across an old edge, one that could not be flipped, a spring that would double a structural one is left out. Across
    a new edge it is not: of a triangle without neighbours the division makes three, along its sides.
    """
    fabric, raised, model, moved, edges = made.fabric, made.raised, made.model, made.moved, made.edges
    if not model["k_bend"]:
        return springs
    old = raised.changed[raised.changed < len(fabric.faces)]
    before = quads_of(fabric.faces, across, old)
    after = quads_of(raised.faces, raised.across, raised.changed)
    wanted, number = np.unique(keys_of(before[:, 2:]), return_counts=True)
    near = moved.copy()
    near[raised.faces[raised.changed]] = near[before] = True
    bent = np.flatnonzero((springs.kind == BENDING) & near[springs.first[:, 0]] & near[springs.first[:, 1]])
    keys = keys_of(springs.first[bent])
    table = Edges(wanted, np.zeros((0, 3), np.int64))
    at, named = table.rows(keys)
    # Opposite pairs of vertices may have two bending springs, across two edges: as many go as edges are gone.
    bent, at, keys = bent[named], at[named], keys[named]
    order = np.argsort(keys, kind="stable")
    rank = np.arange(len(order)) - np.searchsorted(keys[order], keys[order])
    gone = bent[order][rank < number[at[order]]]
    kept = np.ones(springs.number, np.bool_)
    kept[gone] = False
    rest = springs.rest.copy()
    turned = kept & (springs.kind == BENDING) & any_of(moved, springs.first)
    one, other = springs.first[turned].T
    rest[turned] *= _length(raised.x, one, other) / _length(raised.flat, one, other)
    doubled = edges.rows(keys_of(after[:, 2:]))[1] & (after[:, :2] < fabric.number).all(axis=1)
    pairs = np.ascontiguousarray(after[~doubled, 2:])
    length = _length(raised.x, *pairs.T) / made.share[edges.rows(keys_of(after[~doubled, :2]))[0]]
    k = stiffness_of(length, model["k_bend"], model["r_bend"], made.rule)
    return exchange(made, springs, kept, rest, Springs.from_pairs(pairs, k, length, 0.0 * k, BENDING))


def exchange(made: Remade, old: Springs, kept: Bool, rest: Float, new: Springs) -> Springs:
    """Those of the old springs (s,) that are kept, of rest lengths (s,) [m], and then new ones, given their damping."""
    c = damping_of(new.k, new.first, made.mass, made.model["damping_ratio"])
    pairs, kind = old.pairs().compress(kept, axis=0), np.repeat(old.kind, old.count)[kept]
    stay = Springs.from_pairs(pairs, old.per_spring(old.k)[kept], rest[kept], old.per_spring(old.c)[kept])
    return Springs.join([replace(stay, kind=kind), replace(new, c=c)])


def _length(x: Float, one: Int, other: Int) -> Float:
    return np.asarray(np.linalg.norm(x[other] - x[one], axis=1))


def build_hinges(made: Remade, springs: Springs, region: Region, kept: float | None) -> Hinges | None:
    """Hinges across the edges of changed triangles made anew; those of rigidity `kept` [N m] have the folds of the
    line at rest.
    """
    fabric, raised, near, edges, mass = made.fabric, made.raised, made.near, made.edges, made.mass
    old = fabric.hinges
    if old is None:
        return None
    quads, k, angle = old.quads(), old.per_hinge(old.k), old.per_hinge(old.rest).copy()
    was = edges_of(fabric.faces[raised.changed[raised.changed < len(fabric.faces)]])
    near_by = np.flatnonzero(any_of(region.vertex, quads[:, :2]))
    key = keys_of(quads[near_by, :2])
    gone = near_by[was.rows(key)[1]]
    place, _ = near.edges.rows(keys_of(quads[gone, :2]))
    total = np.bincount(near.edges.of_face.reshape(-1), np.repeat(made.areas[0], 3))
    rigidity = float((k[gone] * total[place] / np.square(near.rest[place])).mean()) if len(gone) else 0.0
    anew = quads_of(raised.faces, raised.across, raised.changed)
    place, _ = edges.rows(keys_of(anew[:, :2]))
    total = np.bincount(edges.of_face.reshape(-1), np.repeat(made.areas[1], 3))
    shape = np.square(made.rest[place]) / total[place]
    stiff, folds = rigidity * shape, np.zeros(len(anew))
    if kept is not None:
        pinned = np.append(fabric.pinned, np.zeros(len(mass) - fabric.number, np.bool_))
        stiff = np.maximum(stiff, np.minimum(kept * shape, most_stiffness(raised.x, anew, mass, pinned, springs)))
        folds = fold_angles(raised.x, anew) - fold_angles(raised.flat, anew)
        turned = near_by[any_of(made.moved, quads[near_by])]
        angle[turned] += fold_angles(raised.x, quads[turned]) - fold_angles(raised.flat, quads[turned])
    stays = np.ones(len(quads), np.bool_)
    stays[gone] = False
    quads = np.concatenate([quads.compress(stays, axis=0), anew])
    one = np.ones(len(quads), np.int32)
    return Hinges(
        np.ascontiguousarray(quads),
        one,
        one,
        np.concatenate([k[stays], stiff]),
        np.concatenate([angle[stays], folds]),
    )
