"""Batches of constraints, made of packed springs and hinges, that may be solved side by side.

A batch holds the elements whose vertices lie in one block, or in one and the same set of blocks; batches without a
common block get one colour. A sheet of rows has two kinds of batches, blocks and the seams between neighbours, and
three colours. What a batch holds in lists is coloured once more, so that eight elements side by side never meet at a
vertex. All of it depends on the fabric alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from nuno_kernels import block_kernel, kernel
from nuno_kernels.forces.constraints import Constraints, RunBatches, SpringBatches, zero_forces
from nuno_kernels.forces.hinges import HingeLists, HingeRuns, hinge_shape
from nuno_kernels.forces.springs import SpringLists, SpringRuns
from nuno_kernels.lanes.simd import WIDTH, Lanes, Triple, add_at, gather, load, root, store
from nuno_kernels.lanes.triples import dot, gather_triple, load_triple, minus, plus, times
from nuno_kernels.step.acceleration import Packed, call_each
from nuno_kernels.step.blocks import BLOCK, Long
from nuno_kernels.terms import Displaced, register
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int

# Hinges as compliant constraints, solved one after another in the order of nuno_kernels.forces.constraints.


class HingeBatches(NamedTuple):
    """Hinges by index, in whole vectors without a common vertex.

    start     (batches + 1,) int64  columns of each batch
    ends      (4, p) int32
    constants (3, p)                k cos(rest), k sin(rest), k [N m]
    forces    (9, p)                forces [N] as `sweep_hinges` says; None as above
    """

    start: Long
    ends: Int
    constants: Float
    forces: Float | None


Parts = tuple[Lanes, Triple, Triple, Triple, Triple]


@kernel
def hinge_parts(x0: Triple, x1: Triple, x2: Triple, x3: Triple, k_cos: Lanes, k_sin: Lanes) -> Parts:
    """Return moments k sin(angle - rest) of eight hinges; the angle's gradient at x2 and x3, and minus it at x0 and x1.

    r is 0 for a triangle without area: see nuno_kernels.forces.hinges.hinge_shape.
    """
    n1, n2, d3, ee, q1, q2, r, t2, t3 = hinge_shape(x0, x1, x2, x3)
    sine, cosine = dot(n1, d3) * (ee * root(r)), dot(n1, n2) * root(r * ee)
    size = root(ee) * (ee * r)
    g2, g3 = times(size * q2, n1), times(size * q1, n2)
    g1 = plus(times(t2, g2), times(t3, g3))
    return k_cos * sine - k_sin * cosine, minus(plus(g2, g3), g1), g1, g2, g3


@kernel
def moved_corner(x: Float, u: Float, ends: Int, which: int, p: int) -> Triple:
    """Return positions x + u of one corner of eight hinges."""
    return plus(gather_triple(x, ends, which, p), gather_triple(u, ends, which, p))


@block_kernel
def sweep_hinges(batch: int, moved: Displaced, hinges: HingeBatches, forces: Float | None) -> None:
    """Solve a batch's hinges in their order, in place in the displacements; `forces` is the hinges'.

    Forces are f0 and f1 on x0 and x1, minus f2 and f3 on x2 and x3, with f0 = f2 + f3 - f1; (9, p) are stored.
    """
    x, u, mobility = moved.x, moved.u, moved.mobility
    start, ends, constants = hinges.start, hinges.ends, hinges.constants
    for p in range(start[batch], start[batch + 1], WIDTH):
        m0, m1 = gather(mobility, 0, ends, 0, p), gather(mobility, 0, ends, 1, p)
        m2, m3 = gather(mobility, 0, ends, 2, p), gather(mobility, 0, ends, 3, p)
        moment, g0, g1, g2, g3 = hinge_parts(
            moved_corner(x, u, ends, 0, p), moved_corner(x, u, ends, 1, p), moved_corner(x, u, ends, 2, p),
            moved_corner(x, u, ends, 3, p), load(constants, 0, p), load(constants, 1, p),
        )  # fmt: skip
        k = load(constants, 2, p)
        all_k = 1.0 + k * (m0 * dot(g0, g0) + m1 * dot(g1, g1) + m2 * dot(g2, g2) + m3 * dot(g3, g3))
        if forces is None:
            moment = moment / all_k
            f1, f2, f3 = times(moment, g1), times(moment, g2), times(moment, g3)
        else:
            f1 = minus(times(moment, g1), load_triple(forces, 0, p))
            f2 = minus(times(moment, g2), load_triple(forces, 3, p))
            f3 = minus(times(moment, g3), load_triple(forces, 6, p))
            f0 = minus(plus(f2, f3), f1)
            along = k * (m0 * dot(g0, f0) + m1 * dot(g1, f1) + m2 * dot(g2, f2) + m3 * dot(g3, f3)) / all_k
            f1, f2, f3 = minus(f1, times(along, g1)), minus(f2, times(along, g2)), minus(f3, times(along, g3))
            for row in range(3):
                store(forces, row, p, load(forces, row, p) + f1[row])
                store(forces, 3 + row, p, load(forces, 3 + row, p) + f2[row])
                store(forces, 6 + row, p, load(forces, 6 + row, p) + f3[row])
        for row in range(3):
            add_at(u, row, ends, 0, p, m0 * (f2[row] + f3[row] - f1[row]))
            add_at(u, row, ends, 1, p, m1 * f1[row])
            add_at(u, row, ends, 2, p, 0.0 - m2 * f2[row])
            add_at(u, row, ends, 3, p, 0.0 - m3 * f3[row])


@kernel
def solve_hinges(hinges: HingeBatches, batch: int, moved: Displaced) -> None:
    """Solve a batch's hinges."""
    sweep_hinges(batch, moved, hinges, hinges.forces)


register(HingeBatches, name="hinges", sweep=solve_hinges, forget=zero_forces)


MOST_BATCHES = 4096
"""Sets of blocks that are distinguished: beyond, vertices are in no order, and what crosses blocks is one batch."""

COLOURS = 62
"""colours of elements within a batch, bits of a vertex's mask; an element that finds none free goes alone"""


@dataclass(frozen=True)
class ListElements:
    """Constraints by index: the result of a term's role `constraints`.

    kind      type of their batches, with the role `sweep`: a NamedTuple of the fields of SpringBatches
    corners   (s, w) vertices of each
    constants (c, s)
    """

    kind: type
    corners: Long
    constants: Float

    def pack(self, batch: Long, batches: int, vertices: int, remember: bool) -> Any:
        """Return batches: whole vectors of one colour each; padding is the vector's first vertex, w times."""
        order = np.lexsort((self.corners.min(axis=1), batch))
        elements, constants, batch = np.ascontiguousarray(self.corners[order]), self.constants[:, order], batch[order]
        colour = np.empty(elements.shape[0], np.int64)
        colour_elements(elements, batch, np.zeros(vertices, np.int64), np.full(vertices, -1, np.int64), colour)
        order = np.lexsort((colour, batch))
        batch, colour = batch[order], colour[order]
        first = np.flatnonzero(np.concatenate([[True], (np.diff(batch) != 0) | (np.diff(colour) != 0)]))
        length = np.diff(np.concatenate([first, [order.shape[0]]]))
        padded = -(-length // WIDTH) * WIDTH
        begin = np.cumsum(padded) - padded
        source = np.full(int(padded.sum()), -1, np.int64)
        source[np.arange(order.shape[0]) - np.repeat(first, length) + np.repeat(begin, length)] = order
        filled = source >= 0
        anchor = np.repeat(elements[order[first], 0], padded)
        ends = np.where(filled, elements[source].T, anchor).astype(np.int32)
        values = np.where(filled, constants[:, source], 0.0)
        bounds = np.concatenate([begin, [source.shape[0]]])
        start = bounds[np.searchsorted(batch[first], np.arange(batches + 1))]
        forces = np.zeros((3 * (elements.shape[1] - 1), source.shape[0])) if remember else None
        return self.kind(start.astype(np.int64), np.ascontiguousarray(ends), np.ascontiguousarray(values), forces)


@dataclass(frozen=True)
class RunElements:
    """Long runs of springs: tasks (m, 4), each with the column of its constants as in nuno_kernels.forces.springs."""

    task: Long
    constants: Float
    each: bool | None

    @property
    def corners(self) -> Long:
        """Return first vertices (m, 2) of each run."""
        return self.task[:, :2]

    def pack(self, batch: Long, batches: int, vertices: int, remember: bool) -> RunBatches:
        """Return batches of whole runs."""
        order = np.argsort(batch, kind="stable")
        padded = -(-self.task[order, 2] // WIDTH) * WIDTH
        column = np.cumsum(padded) - padded
        start = np.searchsorted(batch[order], np.arange(batches + 1))
        table = np.column_stack([self.task[order], column]).astype(np.int64)
        forces = np.zeros((3, int(padded.sum()))) if remember else None
        return RunBatches(start.astype(np.int64), table, self.constants, self.each, forces)


def pack_constraints(packed: Packed, remember: bool) -> Constraints:
    """Return batches of a packed system's constraints, with room for forces if sweeps are repeated.

    Raises BadInput for springs that have no constraint.
    """
    vertices = packed.inverse_mass.shape[0]
    found = [part for parts in call_each(packed, "constraints", vertices) for part in parts if len(part.corners)]
    joined: dict[Any, Any] = {}
    for part in found:
        key = part.kind if isinstance(part, ListElements) else len(joined)
        joined[key] = part if key not in joined else _join(joined[key], part)
    elements = list(joined.values())
    of_elements, colour = find_batches([part.corners // BLOCK for part in elements])
    batches = int(colour[-1])
    kinds = [part.pack(of, batches, vertices, remember) for part, of in zip(elements, of_elements, strict=True)]
    return Constraints(colour, tuple(kinds), np.ones(len(kinds), np.bool_))


def _join(one: ListElements, other: ListElements) -> ListElements:
    corners = np.concatenate([one.corners, other.corners])
    return ListElements(one.kind, corners, np.concatenate([one.constants, other.constants], axis=1))


def constraints_of_spring_runs(runs: SpringRuns, vertices: int) -> tuple[RunElements | ListElements, ...]:
    """Return every spring once: long runs, and pairs if the ends are too near for eight side by side."""
    _refuse_locks(runs.locks)
    own = runs.task[(runs.task[:, 4] & 1) == 1]
    far = own[:, 1] - own[:, 0] >= WIDTH
    near = own[~far]
    place = _places(near[:, 2])
    column = np.repeat(near[:, 3], near[:, 2]) + (place if runs.each else 0)
    pairs = np.repeat(near[:, :2], near[:, 2], axis=0) + place[:, None]
    listed = ListElements(SpringBatches, pairs, runs.constants[:, column])
    return RunElements(own[far, :4], runs.constants, runs.each), listed


def constraints_of_spring_lists(lists: SpringLists, vertices: int) -> tuple[ListElements, ...]:
    """Return every listed spring once."""
    _refuse_locks(lists.locks)
    at = _at_home(lists.start, lists.ends[2], vertices)
    return (ListElements(SpringBatches, lists.ends[:2, at].T.astype(np.int64), lists.constants[:, at]),)


def constraints_of_hinge_runs(runs: HingeRuns, vertices: int) -> tuple[ListElements, ...]:
    """Return every hinge of runs once."""
    own = runs.task[(runs.task[:, 6] & 1) == 1]
    corners = np.repeat(own[:, :4], own[:, 4], axis=0) + _places(own[:, 4])[:, None]
    return (_hinges(corners, runs.constants[:, np.repeat(own[:, 5], own[:, 4])]),)


def constraints_of_hinge_lists(lists: HingeLists, vertices: int) -> tuple[ListElements, ...]:
    """Return every listed hinge once."""
    at = _at_home(lists.start, lists.corners[4], vertices)
    return (_hinges(lists.corners[:4, at].T.astype(np.int64), lists.constants[:, at]),)


def _hinges(corners: Long, constants: Float) -> ListElements:
    """Return the elements with k cos(rest), k sin(rest), k of hinges."""
    return ListElements(HingeBatches, corners, np.concatenate([constants, np.hypot(constants[:1], constants[1:])]))


def _refuse_locks(locks: bool | None) -> None:
    if locks is not None:
        raise BadInput(
            "xpbd has no constraint for springs that lock",
            field="solver.plugin",
            value="xpbd",
            remedy="use an explicit or implicit solver, or yarns without lock",
        )


def _places(count: Long) -> Long:
    """Return 0, 1, .. for each of (m,) counts, one after another."""
    return np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)


def _at_home(start: Long, target: Int, vertices: int) -> Long:
    """Return columns of a block's copies whose first vertex the block owns: every element once, no padding."""
    block = np.repeat(np.arange(start.shape[0] - 1), np.diff(start))
    return np.flatnonzero(target < np.minimum(BLOCK, vertices - block * BLOCK))


def find_batches(homes: list[Long]) -> tuple[list[Long], Long]:
    """Return each element's batch, for kinds of elements in blocks (m, w), and the colours' bounds over batches."""
    sets = np.concatenate([np.zeros((0, 4), np.int64), *(_distinct(home) for home in homes)])
    if sets.shape[0] == 0:
        return [np.zeros(0, np.int64) for _ in homes], np.zeros(1, np.int64)
    found, group = np.unique(sets, axis=0, return_inverse=True)
    group = group.reshape(-1)
    colours = np.zeros(found.shape[0], np.int64)
    if found.shape[0] <= MOST_BATCHES:
        taken: dict[int, int] = {}
        for place, row in enumerate(found.tolist()):
            blocks = [block for block in row if block >= 0]
            used = 0
            for block in blocks:
                used |= taken.get(block, 0)
            free = ~used & (used + 1)
            colours[place] = free.bit_length() - 1
            for block in blocks:
                taken[block] = taken.get(block, 0) | free
    else:
        crossing = found[:, -2] >= 0
        first = int(np.flatnonzero(crossing)[0])
        colours[crossing] = 1
        group = np.where(crossing[group], first, group)
        colours = colours[: first + 1]
    order = np.argsort(colours, kind="stable")
    number = np.argsort(order)
    bounds = np.searchsorted(colours[order], np.arange(int(colours.max()) + 2)).astype(np.int64)
    sizes = np.cumsum([home.shape[0] for home in homes])[:-1]
    return np.split(number[group], sizes), bounds


def _distinct(home: Long) -> Long:
    """Return rows of up to four distinct blocks, ascending, filled up with -1 in front."""
    rows = np.sort(home, axis=1)
    rows[:, 1:][rows[:, 1:] == rows[:, :-1]] = -1
    full = np.full((home.shape[0], 4), -1, np.int64)
    full[:, 4 - home.shape[1] :] = rows
    return np.sort(full, axis=1)


@kernel
def colour_elements(elements: Long, batch: Long, taken: Long, seen: Long, colour: Long) -> None:
    """Write the least colour that no element before it in its batch has at any of its vertices, into colour (s,).

    taken and seen (n,) are scratch: colours at a vertex as bits, and the batch that these are of.
    """
    alone = COLOURS
    for e in range(elements.shape[0]):
        used = np.int64(0)
        for c in range(elements.shape[1]):
            v = elements[e, c]
            if seen[v] != batch[e]:
                seen[v], taken[v] = batch[e], 0
            used |= taken[v]
        own = 0
        while own < COLOURS and (used >> own) & 1:
            own += 1
        if own == COLOURS:
            colour[e] = alone
            alone += 1
            continue
        colour[e] = own
        for c in range(elements.shape[1]):
            taken[elements[e, c]] |= np.int64(1) << own
