"""Springs and hinges as compliant constraints of an XPBD step: the sweep, and batches to be solved side by side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from nuno_kernels import block_kernel, kernel
from nuno_kernels.compilation.reference import by_reference
from nuno_kernels.forces.hinges import HingeLists, HingeRuns, hinge_shape
from nuno_kernels.forces.springs import SpringLists, SpringRuns, listed_difference, run_constant, run_difference
from nuno_kernels.lanes import (
    WIDTH,
    Lanes,
    Triple,
    add_at,
    dot,
    gather,
    gather_triple,
    load,
    load_triple,
    minus,
    plus,
    read,
    read_triple,
    root,
    store,
    times,
    where_not_zero,
    write,
)
from nuno_kernels.step.acceleration import Packed
from nuno_kernels.step.blocks import BLOCK, Long
from nuno_kernels.terms import Displaced, Terms, call_each, each, over_blocks, register
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int

# Springs and hinges as compliant constraints, solved one after another: the sweep of an XPBD step.
#
# Backward Euler over a step h asks for displacements u with m' u / h^2 = m' u^ / h^2 + sum of forces at
# x + u, m' = m (1 + h damping) and u^ the displacement without these forces. XPBD (Macklin, Mueller &
# Chentanez 2016, MIG, 49-54) solves it element by element: where a spring's tension k C + c dC/dt, with
# C = |d| - L and dC/dt = n.(u_j - u_i) / h, were it alone, it becomes
#
#     T = (k C + c dC/dt) / (1 + (k + c / h) (mobility_i + mobility_j)),   mobility = h^2 / m',
#
# C and dC/dt taken without T, which moves both ends along n by their mobility times T: the paper's
# equation 18 and its damping, eq. 26, with T = -lambda / h^2 and compliance 1 / k; so written a stiffness
# of 0 is no special case. For two vertices this is exact, however far they turn.
#
# Where sweeps are repeated the paper adds up multipliers, so that what a first sweep did along another
# direction stays: its limit is not quite backward Euler's step. Here a spring's force is kept as a vector
# and taken back before it is found anew, and a hinge's is brought to the force F(x + u) that it exerts,
# (1 + k g g^T mobility) dF = F(x + u) - F with g its angle's gradient. The limit is the step itself. The
# second derivative of a hinge's energy k (1 - cos) is at most k, so that no change leads beyond its minimum.
#
# Displacements are kept, not new positions: velocities u / h then lose no digits however far from the
# origin, and the damping reads them as they are. Not chosen: relaxing each tension by (1 + z) / (1 + z / 2),
# z = (k + c / h) times both mobilities, which makes an evenly tense sheet exact in one sweep, but grows from
# about the step on that explicit methods stop at.
#
# Elements are sorted into batches, and batches into colours: batches of one colour share no vertex, so
# that threads change nothing; within a batch, eight elements computed together share none either.


class RunBatches(NamedTuple):
    """Runs of springs whose ends lie eight vertices apart at least.

    start     (batches + 1,) int64  tasks of each batch
    task      (m, 5) int64          first vertex i, first vertex j, springs, column of the constants,
                                    column of the first force
    constants, each                 as in nuno_kernels.forces.springs.SpringRuns
    forces    (3, w)                forces on the i ends [N], padded to whole vectors, or None where one
                                    sweep needs no memory
    """

    start: Long
    task: Long
    constants: Float
    each: bool | None
    forces: Float | None


class SpringBatches(NamedTuple):
    """Springs by index, in whole vectors without a common vertex.

    start     (batches + 1,) int64  columns of each batch
    ends      (2, p) int32
    constants (3, p)                k [N/m], rest [m], c [N s/m]
    forces    (3, p)                forces [N] on the i ends; None as above
    """

    start: Long
    ends: Int
    constants: Float
    forces: Float | None


@by_reference
class Constraints(NamedTuple):
    """A system's constraints: (colours + 1,) bounds over the batches, the batches of each kind, and which kinds act."""

    colour: Long
    kinds: Terms
    on: Bool


@kernel
def spring_pull(d: Triple, u: Triple, mobility: Lanes, k: Lanes, rest: Lanes, rate: Lanes) -> Triple:
    """Return the forces on the i ends of eight springs.

    d is the vector from i to j at the step's start, u how it changed since without the spring; `rate` is
    c / h and `mobility` that of both ends. Springs of length 0 have no direction and exert no force.
    """
    p = plus(d, u)
    square = dot(p, p)
    length = root(square)
    missing = k * (length - rest) * length + rate * dot(u, p)
    return times(where_not_zero(square, missing / (square * (1.0 + (k + rate) * mobility))), p)


@block_kernel
def sweep_spring_runs(batch: int, moved: Displaced, runs: RunBatches, each: bool | None, forces: Float | None) -> None:
    """Solve a batch's runs in their order, in place in the displacements; `each` and `forces` are the runs'."""
    x, u, mobility, inverse_step = moved.x, moved.u, moved.mobility, moved.inverse_step
    start, task, constants = runs.start, runs.task, runs.constants
    for t in range(start[batch], start[batch + 1]):
        i, j, count, at, column = task[t, 0], task[t, 1], task[t, 2], task[t, 3], task[t, 4]
        for q in range(0, count, WIDTH):
            m = min(WIDTH, count - q)
            a, b, p = i + q, j + q, column + q
            where = at if each is None else at + q
            k, rest = run_constant(0, where, m, constants, each), run_constant(1, where, m, constants, each)
            c = run_constant(2, where, m, constants, each)
            mi, mj = read(mobility, 0, a, m), read(mobility, 0, b, m)
            ui, uj = read_triple(u, 0, a, m), read_triple(u, 0, b, m)
            if forces is not None:
                ui, uj = minus(ui, times(mi, load_triple(forces, 0, p))), plus(uj, times(mj, load_triple(forces, 0, p)))
            d = run_difference(x, a, b, m)
            f = spring_pull(d, minus(uj, ui), mi + mj, k, rest, inverse_step * c)
            for row in range(3):
                if forces is not None:
                    store(forces, row, p, f[row])
                write(u, row, a, m, ui[row] + mi * f[row])
                write(u, row, b, m, uj[row] - mj * f[row])


@block_kernel
def sweep_spring_lists(batch: int, moved: Displaced, lists: SpringBatches, forces: Float | None) -> None:
    """Solve a batch's listed springs in their order, in place in the displacements; `forces` is the lists'."""
    x, u, mobility, inverse_step = moved.x, moved.u, moved.mobility, moved.inverse_step
    start, ends, constants = lists.start, lists.ends, lists.constants
    for p in range(start[batch], start[batch + 1], WIDTH):
        mi, mj = gather(mobility, 0, ends, 0, p), gather(mobility, 0, ends, 1, p)
        d, change = listed_difference(x, ends, 0, p), listed_difference(u, ends, 0, p)
        if forces is not None:
            change = plus(change, times(mi + mj, load_triple(forces, 0, p)))
        k, rest, c = load(constants, 0, p), load(constants, 1, p), load(constants, 2, p)
        f = spring_pull(d, change, mi + mj, k, rest, inverse_step * c)
        change = f
        if forces is not None:
            change = minus(f, load_triple(forces, 0, p))
        for row in range(3):
            if forces is not None:
                store(forces, row, p, f[row])
            add_at(u, row, ends, 0, p, mi * change[row])
            add_at(u, row, ends, 1, p, 0.0 - mj * change[row])


@kernel
def solve_spring_runs(runs: RunBatches, batch: int, moved: Displaced) -> None:
    """Solve a batch's runs: fields that may be None are arguments, for numba prunes by these."""
    sweep_spring_runs(batch, moved, runs, runs.each, runs.forces)


@kernel
def solve_springs(lists: SpringBatches, batch: int, moved: Displaced) -> None:
    """Solve a batch's listed springs."""
    sweep_spring_lists(batch, moved, lists, lists.forces)


@kernel
def clear(array: Float | None) -> None:
    """Zero an array, if there is one."""
    if array is not None:
        array[:] = 0.0


@kernel
def zero_forces(batches: Any) -> None:
    """Begin a step without forces."""
    clear(batches.forces)


register(RunBatches, name="springs", sweep=solve_spring_runs, forget=zero_forces)
register(SpringBatches, name="springs", sweep=solve_springs, forget=zero_forces)

sweep_each = each("sweep", "batch, moved")
forget = each("forget", "")


@block_kernel
def solve_batch(place: int, constraints: Constraints, first: int, moved: Displaced) -> None:
    """Solve all of a batch, so many after the first."""
    sweep_each(constraints.kinds, constraints.on, first + place, moved)


solve_batches = over_blocks(solve_batch, "constraints, first, moved")


@kernel
def sweep(moved: Displaced, constraints: Constraints, threads: int | None) -> None:
    """Solve every element once, in place in the displacements.

    Batches of one colour share no vertex, and may have threads.
    """
    colour = constraints.colour
    for c in range(colour.shape[0] - 1):
        solve_batches(constraints, colour[c], moved, colour[c + 1] - colour[c], threads)


# Batches of constraints, made of packed springs and hinges, that may be solved side by side.
#
# A batch holds the elements whose vertices lie in one block, or in one and the same set of blocks; batches without a
# common block get one colour. A sheet of rows has two kinds of batches, blocks and the seams between neighbours, and
# three colours. What a batch holds in lists is coloured once more, so that eight elements side by side never meet at a
# vertex. All of it depends on the fabric alone.

# Hinges as compliant constraints, solved one after another in the order of those of springs.


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
        if other := joined.get(key):
            corners = np.concatenate([other.corners, part.corners])
            part = ListElements(part.kind, corners, np.concatenate([other.constants, part.constants], axis=1))
        joined[key] = part
    elements = list(joined.values())
    of_elements, colour = find_batches([part.corners // BLOCK for part in elements])
    batches = int(colour[-1])
    kinds = [part.pack(of, batches, vertices, remember) for part, of in zip(elements, of_elements, strict=True)]
    return Constraints(colour, Terms(kinds, ("sweep", "forget")), np.ones(len(kinds), np.bool_))


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
