"""Springs and hinges as compliant constraints, solved one after another: the sweep of an XPBD step.

Backward Euler over a step h asks for displacements u with m' u / h^2 = m' u^ / h^2 + sum of forces at
x + u, m' = m (1 + h damping) and u^ the displacement without these forces. XPBD (Macklin, Mueller &
Chentanez 2016, MIG, 49-54) solves it element by element: where a spring's tension k C + c dC/dt, with
C = |d| - L and dC/dt = n.(u_j - u_i) / h, were it alone, it becomes

    T = (k C + c dC/dt) / (1 + (k + c / h) (mobility_i + mobility_j)),   mobility = h^2 / m',

C and dC/dt taken without T, which moves both ends along n by their mobility times T: the paper's
equation 18 and its damping, eq. 26, with T = -lambda / h^2 and compliance 1 / k; so written a stiffness
of 0 is no special case. For two vertices this is exact, however far they turn.

Where sweeps are repeated the paper adds up multipliers, so that what a first sweep did along another
direction stays: its limit is not quite backward Euler's step. Here a spring's force is kept as a vector
and taken back before it is found anew, and a hinge's is brought to the force F(x + u) that it exerts,
(1 + k g g^T mobility) dF = F(x + u) - F with g its angle's gradient. The limit is the step itself. The
second derivative of a hinge's energy k (1 - cos) is at most k, so that no change leads beyond its minimum.

Displacements are kept, not new positions: velocities u / h then lose no digits however far from the
origin, and the damping reads them as they are. Not chosen: relaxing each tension by (1 + z) / (1 + z / 2),
z = (k + c / h) times both mobilities, which makes an evenly tense sheet exact in one sweep, but grows from
about the step on that explicit methods stop at.

Elements are sorted into batches, and batches into colours: batches of one colour share no vertex, so
that threads change nothing; within a batch, eight elements computed together share none either
(nuno_kernels.forces.constraint_packing).
"""

from __future__ import annotations

from typing import Any, NamedTuple

from nuno_kernels import block_kernel, kernel
from nuno_kernels.compile.reference import by_reference
from nuno_kernels.forces.springs import listed_difference, run_constant, run_difference
from nuno_kernels.lanes.choose import where_not_zero
from nuno_kernels.lanes.simd import WIDTH, Lanes, Triple, add_at, gather, load, read, root, store, write
from nuno_kernels.lanes.triples import dot, load_triple, minus, plus, read_triple, times
from nuno_kernels.step.blocks import Long
from nuno_kernels.terms import Displaced, each, over_blocks, register
from nuno_schemas.fabric import Bool, Float, Int


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
    kinds: tuple[Any, ...]
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
