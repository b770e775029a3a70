"""Springs, hinges and masses of a raised surface, those near its lines made anew.

A spring that the split leaves where it was keeps its stiffness; one that touches a new or smoothed vertex takes
as rest length its length now over the mean stretch of the old triangles at it. New springs have, of the rest
length r, by the wrinkle paper k = (r / r_avg) k_std, or as an elastic body's springs do k = k_std r_avg / r, with
r_avg and k_std the means of the model as it was built, also for later lines. The paper's rule keeps the stable
step, for short springs are soft; but then cloth is softest where its triangles are small.

Masses are m_i = sum A_j rho / 3 with A_j the area at rest, by Heron from rest lengths, so that stretched cloth
weighs no more. Hinges and bending springs are built once, after all flips: across each edge of a triangle that is
not as it was. A hinge's stiffness is B e^2 / (A_1 + A_2), B being the mean of those it takes the place of.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from nuno_schemas.fabric import BENDING, STRUCTURAL, Bool, Fabric, Float, Hinges, Int, Springs
from nuno_wrinkle.edges import Edges, any_of, edges_of, fold_angles, heron, keys_of, pairs_of, quads_of
from nuno_wrinkle.kept import most_stiffness
from nuno_wrinkle.near import Near, Rule, damping_of, stiffness_of
from nuno_wrinkle.raised import Raised, Region

# Bending springs and hinges of a raised surface: built once, after all flips, across edges of changed triangles.


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


@dataclass(frozen=True)
class Net:
    """Springs, hinges and masses (n + m,) [kg] of the raised surface."""

    springs: Springs
    hinges: Hinges | None
    mass: Float
    added: float
    """Area at rest that the lines added [m^2]."""


def build_net(
    fabric: Fabric, across: Int, raised: Raised, near: Near, region: Region, model: Mapping[str, float], rule: Rule,
    kept: float | None,
) -> Net:  # fmt: skip
    """The net of the raised surface; `across` are the neighbours of the fabric's triangles.

    `kept` is the rigidity [N m] of the folds of a wrinkle that is kept, None for one that is not.
    """
    n = fabric.number
    moved = np.zeros(len(raised.x), np.bool_)
    moved[raised.smoothed] = moved[n:] = True
    edges = edges_of(raised.faces[raised.local])
    ends = pairs_of(edges.key)
    at, stays = near.edges.rows(edges.key)
    flat_share = np.repeat(raised.share[raised.local], 3)
    place = edges.of_face.reshape(-1)
    share = np.bincount(place, flat_share) / np.bincount(place)
    length = np.linalg.norm(raised.x[ends[:, 1]] - raised.x[ends[:, 0]], axis=1)
    rest = np.where(stays & ~any_of(moved, ends), near.rest[at], length / share)
    before = heron(near.rest[near.edges.of_face])
    after = heron(rest[edges.of_face])
    mass = _masses(fabric, raised, moved, before, after, model["density"])
    made = Remade(fabric, raised, near, model, rule, edges, moved, mass, rest, share, (before, after))
    springs = bend_springs(made, _structural(made, stays), across)
    hinges = build_hinges(made, springs, region, kept)
    return Net(springs, hinges, mass, float(after.sum() - before.sum()))


def _masses(fabric: Fabric, raised: Raised, moved: Bool, before: Float, after: Float, density: float) -> Float:
    """(n + m,) masses, by the areas at rest of the region's triangles before and after.

    Those of vertices at changed triangles are summed anew; others, some of whose triangles may lie outside of the
    region, grow by the difference, which is 0 to the last bit where nothing has changed.
    """
    number = len(raised.x)

    def shares(corners: Int, area: Float) -> Float:
        return np.bincount(corners.reshape(-1), np.repeat(area * density / 3.0, 3), number).astype(np.float64)

    total = shares(raised.faces[raised.local], after)
    old = np.append(fabric.mass, np.zeros(number - fabric.number))
    anew = moved.copy()
    anew[raised.faces[raised.changed]] = True
    gained = total - shares(fabric.faces[raised.local[: len(before)]], before)
    return np.where(anew, total, old + gained)


def _structural(made: Remade, stays: Bool) -> Springs:
    """All old springs but those whose edges are gone, then those of new edges."""
    old, near, edges, rest = made.fabric.springs, made.near, made.edges, made.rest
    assert old is not None
    at, gone = edges.rows(near.edges.key)
    gone = ~gone
    length = old.per_spring(old.rest).copy()
    length[near.spring[~gone]] = rest[at[~gone]]
    kept = np.ones(old.number, np.bool_)
    kept[near.spring[gone]] = False
    pairs = pairs_of(edges.key[~stays])
    k = stiffness_of(rest[~stays], made.model["k_std"], made.model["r_avg"], made.rule)
    return exchange(made, old, kept, length, Springs.from_pairs(pairs, k, rest[~stays], 0.0 * k, STRUCTURAL))
