"""Bending between two triangles that share an edge: energy k (1 - cos(theta - rest)).

Edge e = x1 - x0, opposite vertices x2 (left) and x3 (right), normals n1 = e x (x2 - x0) and
n2 = (x3 - x0) x e, both up for a flat counter-clockwise pair. theta is 0 when flat and positive
when the triangles fold towards their normals (a valley).

Both normals are perpendicular to e, so x3's height over the left triangle, n1.(x3 - x0)/|n1|, and
its distance from the edge, |n2|/|e|, give

    sin theta = n1.(x3 - x0) |e| / (|n1| |n2|),    cos theta = n1.n2 / (|n1| |n2|)

and the moment k sin(theta - rest) needs no angle. Where x2 or x3 moves along its normal, theta
grows by the inverse of its distance from the edge; x0 and x1 share the reaction like a lever
(Bridson et al. 2003; Tamstorf & Grinspun 2013), with t = (x - x0).e/|e|^2:

    grad2 = |e|/|n1|^2 n1,  grad3 = |e|/|n2|^2 n2,
    grad1 = -(t2 grad2 + t3 grad3),  grad0 = -(grad1 + grad2 + grad3)

A cosine, not a square: the second derivative k cos(theta - rest) never exceeds k, and a fully
folded hinge has no jump. A triangle without area has no normal: its hinge exerts no force.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_kernels import kernel
from nuno_kernels.lanes import (
    WIDTH,
    Lanes,
    Triple,
    add_at,
    cross,
    dot,
    gather_triple,
    load,
    minus,
    plus,
    read,
    read_triple,
    root,
    splat,
    store,
    times,
    where_greater,
    write,
)
from nuno_kernels.step.blocks import Long, assign_runs, block_count, choose_runs, cut_runs, is_small, list_copies
from nuno_kernels.terms import register
from nuno_schemas.fabric import Bool, Float, Hinges, Int

FLAT = 1e-20
"""squared sine of a triangle's angle at x0 below which its normal is rounding"""


LONGEST = 128
"""hinges of a piece of a run: their forces wait in a buffer of 13 kB"""


class HingeRuns(NamedTuple):
    """Runs of hinges whose vertices follow each other.

    start     (blocks + 1,) int64  tasks of each block
    task      (m, 7) int64         first vertices x0..x3, hinges, column of the constants, and the
                                   corners to add to (bit c for corner c)
    constants (2, r) float64       k cos(rest) and k sin(rest) [N m] of every run
    curved    None where all rest angles are 0, else True
    """

    start: Long
    task: Long
    constants: Float
    curved: bool | None


class HingeLists(NamedTuple):
    """Hinges by index, padded to whole vectors by hinges without area.

    start     (blocks + 1,) int64  places of each block's hinges
    corners   (8, p) int32         vertices x0..x3, then their columns in the block's forces
    constants (2, p) float64       k cos(rest) and k sin(rest) [N m]
    curved    as in HingeRuns
    """

    start: Long
    corners: Int
    constants: Float
    curved: bool | None


Shape = tuple[Triple, Triple, Triple, Lanes, Lanes, Lanes, Lanes, Lanes, Lanes]


@kernel
def hinge_shape(x0: Triple, x1: Triple, x2: Triple, x3: Triple) -> Shape:
    """Return n1, n2, x3 - x0, |e|^2, |n1|^2, |n2|^2, r, t2 and t3 of eight hinges.

    All quotients come from one, r = 1/(|n1|^2 |n2|^2 |e|^2), which is set to 0 where a triangle has no area; divisions
    and roots are what a hinge costs.
    """
    e, d2, d3 = minus(x1, x0), minus(x2, x0), minus(x3, x0)
    n1, n2 = cross(e, d2), cross(d3, e)
    ee, q1, q2 = dot(e, e), dot(n1, n1), dot(n2, n2)
    r = where_greater(q2, FLAT * ee * dot(d3, d3), 1.0 / (q1 * q2 * ee))
    r = where_greater(q1, FLAT * ee * dot(d2, d2), r)
    return n1, n2, d3, ee, q1, q2, r, dot(d2, e) * (r * q1 * q2), dot(d3, e) * (r * q1 * q2)


@kernel
def hinge_forces(
    x0: Triple, x1: Triple, x2: Triple, x3: Triple, k_cos: Lanes, k_sin: Lanes, curved: bool | None
) -> tuple[Triple, Triple, Triple]:
    """Return pull on x1 and push on x2 and x3 of eight hinges: force 1, minus force 2, minus force 3."""
    n1, n2, d3, ee, q1, q2, r, t2, t3 = hinge_shape(x0, x1, x2, x3)
    moment = k_cos * (dot(n1, d3) * root(r * ee))
    if curved is not None:
        moment = moment - k_sin * (dot(n1, n2) * root(r))
    pull = moment * (ee * ee * r)
    f2, f3 = times(pull * q2, n1), times(pull * q1, n2)
    return plus(times(t2, f2), times(t3, f3)), f2, f3


@kernel
def add_hinge_lists(lists: HingeLists, block: int, origin: int, x: Float, v: Float, force: Float) -> None:
    """Add a block's listed hinges to its forces (3, w)."""
    start, corners, constants = lists.start, lists.corners, lists.constants
    for p in range(start[block], start[block + 1], WIDTH):
        f1, f2, f3 = hinge_forces(
            gather_triple(x, corners, 0, p), gather_triple(x, corners, 1, p),
            gather_triple(x, corners, 2, p), gather_triple(x, corners, 3, p),
            load(constants, 0, p), load(constants, 1, p), lists.curved,
        )  # fmt: skip
        for row in range(3):
            add_at(force, row, corners, 4, p, f2[row] + f3[row] - f1[row])
            add_at(force, row, corners, 5, p, f1[row])
            add_at(force, row, corners, 6, p, 0.0 - f2[row])
            add_at(force, row, corners, 7, p, 0.0 - f3[row])


@kernel
def add_waiting(force: Float, task: Long, t: int, origin: int, wait: Float) -> None:
    """Add a run's buffered forces, three rows of (12, .) for each corner, to a block's forces (3, w)."""
    for c in range(4):
        if (task[t, 6] >> c) & 1:
            for q in range(0, task[t, 4], WIDTH):
                m, p = min(WIDTH, task[t, 4] - q), task[t, c] + q - origin
                for row in range(3):
                    write(force, row, p, m, read(force, row, p, m) + load(wait, 3 * c + row, q))


@kernel
def add_hinge_runs(runs: HingeRuns, block: int, origin: int, x: Float, v: Float, force: Float) -> None:
    """Add a block's runs to its forces (3, w); `origin` is the block's first vertex.

    Forces wait until a run is through: added corner by corner at once, a read would overlap the
    write just before it and wait for it.
    """
    start, task, constants = runs.start, runs.task, runs.constants
    wait = np.empty((12, LONGEST + WIDTH))
    for t in range(start[block], start[block + 1]):
        i0, i1, i2, i3, count, at = task[t, 0], task[t, 1], task[t, 2], task[t, 3], task[t, 4], task[t, 5]
        k_cos, k_sin = splat(constants[0, at]), splat(constants[1, at])
        for q in range(0, count, WIDTH):
            m = min(WIDTH, count - q)
            f1, f2, f3 = hinge_forces(
                read_triple(x, 0, i0 + q, m), read_triple(x, 0, i1 + q, m), read_triple(x, 0, i2 + q, m),
                read_triple(x, 0, i3 + q, m), k_cos, k_sin, runs.curved,
            )  # fmt: skip
            for row in range(3):
                store(wait, row, q, f2[row] + f3[row] - f1[row])
                store(wait, 3 + row, q, f1[row])
                store(wait, 6 + row, q, 0.0 - f2[row])
                store(wait, 9 + row, q, 0.0 - f3[row])
        add_waiting(force, task, t, origin, wait)


for _kind, _add, _layout in ((HingeRuns, add_hinge_runs, "runs"), (HingeLists, add_hinge_lists, "lists")):
    register(
        _kind, "hinges", block=_add, rows=f"linear:rows_of_hinge_{_layout}",
        elements=f"linear:elements_of_hinge_{_layout}", fill=f"linear:fill_hinge_{_layout}",
        diagonal=f"linear:sum_hinge_{_layout}", multiply=f"linear:multiply_hinge_{_layout}",
        assemble="linear:assemble_hinges", constraints=f"constraints:constraints_of_hinge_{_layout}",
        energy=f"energy:measure_hinge_{_layout}",
    )  # fmt: skip


def pack_hinges(hinges: Hinges | None, vertices: int) -> tuple[HingeRuns | HingeLists, ...]:
    """Return the kernel layout of a fabric's hinges, runs before lists, without empty ones."""
    if hinges is None or hinges.number == 0:
        return ()
    per_run = hinges.k.shape == hinges.rest.shape == hinges.count.shape
    direct = per_run & choose_runs(hinges.count, hinges.stride)
    listed = ~np.repeat(direct, hinges.count)
    runs = (_pack_hinge_runs(hinges, direct, vertices),) if direct.any() else ()
    return runs + ((_pack_hinge_lists(hinges, listed, vertices),) if listed.any() else ())


def _constants(k: Float, rest: Float) -> Float:
    return np.stack([k * np.cos(rest), k * np.sin(rest)])


def _pack_hinge_runs(hinges: Hinges, chosen: Bool, vertices: int) -> HingeRuns:
    first = hinges.first[chosen].astype(np.int64)
    cut = cut_runs(np.column_stack([first, hinges.count[chosen], np.arange(first.shape[0])]), LONGEST)
    cut[:, 5] = cut[:, 6]
    task, start = assign_runs(cut[:, :6], block_count(vertices))
    constants = _constants(hinges.k[chosen], hinges.rest[chosen])
    return HingeRuns(start, task, constants, True if constants[1].any() else None)


def _pack_hinge_lists(hinges: Hinges, chosen: Bool, vertices: int) -> HingeLists:
    quads = hinges.quads()[chosen].astype(np.int64)
    order = np.lexsort((quads.max(axis=1), quads.min(axis=1)))
    quads = np.ascontiguousarray(quads[order].T)
    values = _constants(hinges.per_hinge(hinges.k)[chosen][order], hinges.per_hinge(hinges.rest)[chosen][order])
    element, start, corners = list_copies(quads, vertices)
    constants = np.ascontiguousarray(np.where(element >= 0, values[:, element], 0.0))
    curved = True if is_small(hinges.number) or constants[1].any() else None
    return HingeLists(start, corners, constants, curved)
