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
from dataclasses import dataclass

import numpy as np

from nuno_schemas.fabric import STRUCTURAL, Bool, Fabric, Float, Hinges, Int, Springs
from nuno_wrinkle.edges import any_of, edges_of, heron, pairs_of
from nuno_wrinkle.folds import Remade, bend_springs, build_hinges, exchange
from nuno_wrinkle.near import Near, Rule, stiffness_of
from nuno_wrinkle.raised import Raised, Region


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
