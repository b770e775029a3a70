"""Springs, hinges and masses of a raised surface, rebuilt near its lines; and the stiffness of folds that are kept."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import BENDING, STRUCTURAL, Bool, Fabric, Float, Hinges, Int, Springs
from nuno_wrinkle.edges import Edges, any_of, area_of, edges_of, fold_angles, heron, keys_of, pairs_of, quads_of
from nuno_wrinkle.raised import Raised, Region

# The springs and triangles near a line, and the rules for its new springs.

Rule = Literal["paper", "physical"]
ON_SPRINGS = (
    "give the line a width, or draw on a mesh or shirt of tension: springs, a sheet or skirt of cells: triangles"
)


def describe(fabric: Fabric) -> dict[str, float]:
    """Return the parameters of a model as built, also for later lines: r_avg [m], k_std [N/m], density [kg/m^2], the
    damping ratio of springs, and r_bend, k_bend of bending springs. Raises BadInput for a model without structural
    springs.

    A mesh without inner edges has no bending springs: k_bend is then that of `fabric.origin`, and r_bend is sqrt(3)
    r_avg, the distance of the far corners of two equilateral triangles of side r_avg.
    """
    springs = fabric.springs
    if springs is None or not springs.of_kind(STRUCTURAL).any():
        problem = "the cloth has no structural springs, and so neither k_std nor r_avg"
        raise BadInput(problem, field="k_std", remedy=ON_SPRINGS)
    pairs, k, rest, c = springs.pairs(), *(springs.per_spring(a) for a in (springs.k, springs.rest, springs.c))
    one, other = fabric.mass[pairs[:, 0]], fabric.mass[pairs[:, 1]]
    critical = 2.0 * np.sqrt(k * one * other / (one + other))
    structural, bent = springs.of_kind(STRUCTURAL), springs.of_kind(BENDING)
    damped = structural & (critical > 0.0)  # on elongated triangles a measured fabric has springs of stiffness 0
    r_avg = float(rest[structural].mean())
    return {
        "r_avg": r_avg,
        "k_std": float(k[structural].mean()),
        "density": float(fabric.mass.sum()) / area_of(fabric.position, fabric.faces),
        "damping_ratio": float((c[damped] / critical[damped]).mean()),
        "r_bend": float(rest[bent].mean()) if bent.any() else float(np.sqrt(3.0)) * r_avg,
        "k_bend": float(k[bent].mean()) if bent.any() else fabric.origin.get("k_bend", 0.0),
    }


@dataclass(frozen=True)
class Near:
    """Springs and triangles of a region: `edges` of its triangles, their rest lengths (e,), the springs (e,)
    on them, and the mean stretch (f,) of each triangle of the whole mesh, 1 outside of the region.
    """

    edges: Edges
    rest: Float
    spring: NDArray[np.int64]
    stretch: Float


def find_sprung(fabric: Fabric) -> NDArray[np.bool_]:
    """Return whether triangles (f,) have structural springs along all their edges."""
    springs, edges = fabric.springs, edges_of(fabric.faces)
    assert springs is not None
    pairs = springs.pairs()[springs.of_kind(STRUCTURAL)]
    return np.asarray(np.isin(edges.key, keys_of(pairs))[edges.of_face].all(axis=1))


def find_near(fabric: Fabric, x: Float, region: Region) -> Near:
    """Return the region's springs and triangles. Raises BadInput if edges lack springs, as on a grid of quads."""
    springs = fabric.springs
    assert springs is not None
    edges = edges_of(fabric.faces[region.face])
    pairs = springs.pairs()
    inside = np.zeros(fabric.number, np.bool_)
    inside[fabric.faces[region.face]] = True
    selected = inside[pairs[:, 0]] & inside[pairs[:, 1]] & springs.of_kind(STRUCTURAL)
    chosen = np.flatnonzero(selected)
    key = keys_of(pairs[chosen])
    order = np.argsort(key, kind="stable")
    place, present = Edges(key[order], np.zeros((0, 3), np.int64)).rows(edges.key)
    ends = pairs_of(edges.key)
    if not present.all():
        raise BadInput(
            "the cloth has no spring along an edge of its triangles", field="lines",
            value=ends[~present][0].tolist(), limit="springs on all edges, as the wrinkle paper has them",
            remedy=ON_SPRINGS,
        )  # fmt: skip
    length = np.linalg.norm(x[ends[:, 1]] - x[ends[:, 0]], axis=1)
    spring = chosen[order][place]
    rest = springs.per_spring(springs.rest)[spring]
    stretch = np.ones(len(fabric.faces))
    stretch[region.face] = (length / rest)[edges.of_face].mean(axis=1)
    return Near(edges, rest, spring, stretch)


def stiffness_of(rest: Float, k_std: float, r_avg: float, rule: Rule) -> Float:
    return np.asarray(k_std * (rest / r_avg if rule == "paper" else r_avg / rest))


def damping_of(k: Float, pairs: Int, mass: Float, ratio: float) -> Float:
    m = mass[pairs]
    return np.asarray(2.0 * ratio * np.sqrt(k * m[:, 0] * m[:, 1] / m.sum(axis=1)))


# Stiffness of the folds of a kept wrinkle, which bear the cloth that hangs from it.
#
# A fold of rigidity B whose rest shape is a wave of height h and length w, under a line tension T along it, has the
# height
#
#     y / h = B q^2 / (B q^2 + T) = 1 / (1 + T w^2 / (4 pi^2 B)),    q = 2 pi / w,
#
# the balance of B (y'''' - h'''') and T y''. T is the weight of hung cloth below, rho g L at most. So B must grow with
# the load and the width of the fold: no multiple of the cloth's rigidity suits all weights of cloth and all sizes of
# meshes.

GRAVITY = 9.81
"""Acceleration that kept wrinkles bear [m/s^2], also in a scene without gravity."""
HOLD = 0.03
"""B / (rho g L w^2). A wave under the whole weight would need 0.1 to keep four fifths of its height, but most of the
cloth bears less, and flat cloth at the ends of a line bears part of it: on cloth hung at its corners 0.03 keeps that
share of ridges of several heights, directions and weights, and 0.02 loses a quarter of low ones."""


def kept_rigidity(density: float, x: Float, crests: Int, n: int) -> Float:
    """Return the rigidity [N m] of folds at the new vertices (m,) of x (n + m, 3) [m] that holds on cloth of `density`
    [kg/m^2], by the width of the wrinkle at the nearest of `find_crests` (5, c). 0 without any, as of a line of two
    triangles.
    """
    new = x[n:]
    if not crests.size:
        return np.zeros(len(new))
    square = np.square(x[crests[1]] - x[crests[2]]).sum(axis=1)
    nearest = np.array([np.square(x[crests[0]] - place).sum(axis=1).argmin() for place in new])
    return np.asarray(HOLD * density * GRAVITY * float(np.ptp(x, axis=0).max()) * square[nearest])


def most_stiffness(x: Float, quads: Int, cloth: Fabric) -> Float:
    """Return the stiffness (h,) [N m] at which a hinge alone moves its vertices as fast as the cloth's tension may.

    A hinge of stiffness k moves along its gradients g with omega^2 = k sum |g_c|^2 / m_c, and springs with at most 2
    max sum_j k_j / m_i (Gershgorin); triangles of a membrane count as they do. Slivers as stiff as the rest would halve
    the step without raising the wrinkle.
    """
    free, mass, row = ~cloth.pinned, cloth.mass, cloth.stiffness()
    edge = x[quads[:, 1]] - x[quads[:, 0]]
    square = np.einsum("hk,hk->h", edge, edge)
    slope, lever = np.zeros(len(quads)), np.zeros((2, len(quads)))
    for corner in (2, 3):
        side = x[quads[:, corner]] - x[quads[:, 0]]
        share = np.einsum("hk,hk->h", side, edge) / square
        tilt = np.sqrt(square / np.square(np.cross(edge, side)).sum(axis=1))
        slope += tilt**2 / mass[quads[:, corner]]
        lever += tilt * np.stack([1.0 - share, share])
    slope += (lever**2 / mass[quads[:, :2].T]).sum(axis=0)
    return np.asarray(2.0 * (row[free] / mass[free]).max(initial=0.0) / slope)


# Springs, hinges and masses of a raised surface, rebuilt near its lines.
#
# A spring that the split leaves in place keeps its stiffness; the rest length of one at a new or smoothed vertex is its
# present length over the mean stretch of the old triangles at it. New springs of rest length r have k = (r / r_avg)
# k_std by the wrinkle paper, or k = k_std r_avg / r like an elastic body's, with r_avg and k_std the means of the model
# as built, also for later lines. The paper's rule keeps the stable step, for short springs are soft; but then cloth is
# softest where its triangles are small.
#
# Masses are m_i = sum A_j rho / 3 with A_j the area at rest, by Heron from rest lengths, so that stretched cloth weighs
# no more. Hinges and bending springs are built once, after all flips, across each edge of a changed triangle. A hinge's
# stiffness is B e^2 / (A_1 + A_2), B being the mean of those that it replaces.

# Bending springs and hinges of a raised surface: built once, after all flips, across edges of changed triangles.


@dataclass(frozen=True)
class NetParts:
    """The parts from which a raised surface's net is built: n + m vertices, and e edges of the region's triangles."""

    fabric: Fabric
    raised: Raised
    near: Near
    model: Mapping[str, float]
    rule: Rule
    edges: Edges
    moved: Bool
    """whether vertices (n + m,) are new or smoothed"""
    mass: Float
    """masses (n + m,) [kg]"""
    rest: Float
    """rest lengths (e,) [m]"""
    share: Float
    """mean stretch (e,) of the old triangles at each edge"""
    areas: tuple[Float, Float]
    """areas of the region's triangles at rest [m^2], before and after"""


def bend_springs(work: NetParts, springs: Springs, across: Int) -> Springs:
    """Return the springs with bending ones across new edges, and without those across removed edges.

    Across an old edge, which could not be flipped, a spring that would double a structural one is left out. Across a
    new edge it is kept: the division of a triangle without neighbours makes three, along its sides.
    """
    fabric, raised, model, moved, edges = work.fabric, work.raised, work.model, work.moved, work.edges
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
    at, known = table.rows(keys)
    # Opposite pairs of vertices may have two bending springs, across two edges: one is removed per removed edge.
    bent, at, keys = bent[known], at[known], keys[known]
    order = np.argsort(keys, kind="stable")
    rank = np.arange(len(order)) - np.searchsorted(keys[order], keys[order])
    removed = bent[order][rank < number[at[order]]]
    kept = np.ones(springs.number, np.bool_)
    kept[removed] = False
    rest = springs.rest.copy()
    turned = kept & (springs.kind == BENDING) & any_of(moved, springs.first)
    one, other = springs.first[turned].T
    rest[turned] *= _length(raised.x, one, other) / _length(raised.flat, one, other)
    doubled = edges.rows(keys_of(after[:, 2:]))[1] & (after[:, :2] < fabric.number).all(axis=1)
    pairs = np.ascontiguousarray(after[~doubled, 2:])
    length = _length(raised.x, *pairs.T) / work.share[edges.rows(keys_of(after[~doubled, :2]))[0]]
    k = stiffness_of(length, model["k_bend"], model["r_bend"], work.rule)
    return exchange(work, springs, kept, rest, Springs.from_pairs(pairs, k, length, 0.0 * k, BENDING))


def exchange(work: NetParts, old: Springs, kept: Bool, rest: Float, new: Springs) -> Springs:
    """Return the kept ones of old springs (s,), with rest lengths (s,) [m], then new ones with their damping."""
    c = damping_of(new.k, new.first, work.mass, work.model["damping_ratio"])
    pairs, kind = old.pairs().compress(kept, axis=0), np.repeat(old.kind, old.count)[kept]
    stay = Springs.from_pairs(pairs, old.per_spring(old.k)[kept], rest[kept], old.per_spring(old.c)[kept])
    return Springs.join([replace(stay, kind=kind), replace(new, c=c)])


def _length(x: Float, one: Int, other: Int) -> Float:
    return np.asarray(np.linalg.norm(x[other] - x[one], axis=1))


def build_hinges(work: NetParts, springs: Springs, region: Region, kept: Float | None) -> Hinges | None:
    """Return hinges, rebuilt across the edges of changed triangles; with rigidities `kept` (m,) [N m] at new vertices
    all folds there are at rest as they are raised, and those at several have the mean: were they at rest as the cloth
    lay before, only stiffer, a ridge would straighten a skirt or a sleeve.
    """
    fabric, raised, near, edges, mass = work.fabric, work.raised, work.near, work.edges, work.mass
    old = fabric.hinges
    if old is None:
        return None
    quads, k, angle = old.quads(), old.per_hinge(old.k), old.per_hinge(old.rest).copy()
    old_edges = edges_of(fabric.faces[raised.changed[raised.changed < len(fabric.faces)]])
    near_by = np.flatnonzero(any_of(region.vertex, quads[:, :2]))
    key = keys_of(quads[near_by, :2])
    removed = near_by[old_edges.rows(key)[1]]
    place, _ = near.edges.rows(keys_of(quads[removed, :2]))
    total = np.bincount(near.edges.of_face.reshape(-1), np.repeat(work.areas[0], 3))
    rigidity = float((k[removed] * total[place] / np.square(near.rest[place])).mean()) if len(removed) else 0.0
    new_quads = quads_of(raised.faces, raised.across, raised.changed)
    place, _ = edges.rows(keys_of(new_quads[:, :2]))
    total = np.bincount(edges.of_face.reshape(-1), np.repeat(work.areas[1], 3))
    shape = np.square(work.rest[place]) / total[place]
    stiff, folds = rigidity * shape, np.zeros(len(new_quads))
    if kept is not None:
        pinned = np.append(fabric.pinned, np.zeros(len(mass) - fabric.number, np.bool_))
        cloth = replace(fabric, mass=mass, pinned=pinned, springs=springs)
        held = np.append(np.zeros(fabric.number), kept)[new_quads].sum(axis=1)
        held /= (new_quads >= fabric.number).sum(axis=1)
        most = most_stiffness(raised.x, new_quads, cloth)
        stiff, folds = np.maximum(stiff, np.minimum(held * shape, most)), fold_angles(raised.x, new_quads)
        turned = near_by[any_of(work.moved, quads[near_by])]
        angle[turned] = fold_angles(raised.x, quads[turned])
    stays = np.ones(len(quads), np.bool_)
    stays[removed] = False
    quads = np.concatenate([quads.compress(stays, axis=0), new_quads])
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
    """Area at rest that the lines add [m^2]."""


def build_net(
    fabric: Fabric, across: Int, raised: Raised, near: Near, region: Region, model: Mapping[str, float], rule: Rule,
    kept: Float | None,
) -> Net:  # fmt: skip
    """Return the net of the raised surface; `across` are the neighbours of the fabric's triangles. `kept` (m,)
    is the rigidity [N m] of a kept wrinkle's folds at new vertices, or None.
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
    work = NetParts(fabric, raised, near, model, rule, edges, moved, mass, rest, share, (before, after))
    springs = bend_springs(work, _structural(work, stays), across)
    hinges = build_hinges(work, springs, region, kept)
    return Net(springs, hinges, mass, float(after.sum() - before.sum()))


def _masses(fabric: Fabric, raised: Raised, moved: Bool, before: Float, after: Float, density: float) -> Float:
    """Return masses (n + m,), by the areas at rest of the region's triangles before and after. Those of vertices at
    changed triangles are summed again; others, some of whose triangles may be outside of the region, grow by the
    difference, which is 0 to the last bit without a change.
    """
    number = len(raised.x)

    def shares(corners: Int, area: Float) -> Float:
        return np.bincount(corners.reshape(-1), np.repeat(area * density / 3.0, 3), number).astype(np.float64)

    total = shares(raised.faces[raised.local], after)
    old = np.append(fabric.mass, np.zeros(number - fabric.number))
    resummed = moved.copy()
    resummed[raised.faces[raised.changed]] = True
    gained = total - shares(fabric.faces[raised.local[: len(before)]], before)
    return np.where(resummed, total, old + gained)


def _structural(work: NetParts, stays: Bool) -> Springs:
    """Return all old springs except those of removed edges, then those of new edges."""
    old, near, edges, rest = work.fabric.springs, work.near, work.edges, work.rest
    assert old is not None
    at, removed = edges.rows(near.edges.key)
    removed = ~removed
    length = old.per_spring(old.rest).copy()
    length[near.spring[~removed]] = rest[at[~removed]]
    kept = np.ones(old.number, np.bool_)
    kept[near.spring[removed]] = False
    pairs = pairs_of(edges.key[~stays])
    k = stiffness_of(rest[~stays], work.model["k_std"], work.model["r_avg"], work.rule)
    return exchange(work, old, kept, length, Springs.from_pairs(pairs, k, rest[~stays], 0.0 * k, STRUCTURAL))
