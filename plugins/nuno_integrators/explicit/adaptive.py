"""Explicit methods that choose their own steps: an embedded pair, a PI controller, output in between.

A step may reach past the end of a frame, whose state is then read from the polynomial that the
step's slopes define; the step itself goes on into the next frame. Where bodies move or a force is
written in Python a step ends with the frame, because what comes after is not known yet; and where one depends on the
time, since slopes that a resumed run finds anew would have it rounded otherwise.

Weighed: SciPy's RK45 and DOP853, which return to Python for every stage and begin anew in every frame; `nuno bench
peers` measures them on the stiff sheet.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.integrate import DOP853 as EIGHTH
from scipy.integrate import RK45

from nuno_integrators.compiled import Compiled, StepResult, Work, cloth_size
from nuno_integrators.explicit.runge_kutta import (
    Buffers,
    Stage,
    Tableau,
    Weights,
    combine,
    take_stages,
)
from nuno_integrators.packing import reads_time
from nuno_integrators.stability import measure_rates, stable_step
from nuno_kernels import block_kernel, kernel
from nuno_kernels.lanes import WIDTH, lane, read, splat
from nuno_kernels.step.acceleration import Packed, commit
from nuno_kernels.step.blocks import BLOCK, Long, block_count, copy_rows
from nuno_kernels.terms import over_blocks
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, State
from nuno_schemas.plugin import Config
from nuno_schemas.system import StepLimit, System

# The compiled loop of an adaptive method: stages, error estimate, PI control of the step.

SAFETY, SHRINK, GROW = 0.9, 0.2, 10.0
"""Hairer's factors: the safety factor on the estimated step, and the bounds on its change from one step to the next"""
SMALLEST = 1e-10
"""share of the interval below which a step is given up"""
LANDED = 1e-9
"""share of a step by which it may miss the end of an interval and still count as ending there"""


class Estimate(NamedTuple):
    """How the error of a step is estimated: its order, and the weights (1 or 2, slopes) for velocities and positions,
    see Pair; sums (blocks,) is scratch.
    """

    order: int
    velocity: Float
    position: Float
    sums: Float


class Interval(NamedTuple):
    """Limits of an interval's steps: its length [s], the longest step [s], whether one must land on the interval's end,
    and the error allowed for a step [m], times the root of the number of vertices.
    """

    span: float
    longest: float
    landing: bool
    allowed: float


AT, PENDING, NEXT, BEFORE = 0, 1, 2, 3
"""Places in `control` (4,): where the pending step starts, seconds after the start of the interval; its
length, 0 for none; the step to try next; the error of the last accepted step, as a share of the allowed."""

ACCEPTED, REJECTED = 0, 1
"""Places in `counts` (2,)."""


@block_kernel
def add_squares(block: int, k: Float, weights: Float, sums: Float) -> None:
    """Sum (sum_j weights_j k_j)^2 over a block, into sums."""
    low, high = block * BLOCK, min((block + 1) * BLOCK, k.shape[1])
    total = splat(0.0)
    for row in range(3):
        for p in range(low, high, WIDTH):
            m = min(WIDTH, high - p)
            e = splat(0.0)
            for j in range(weights.shape[0]):
                if weights[j] != 0.0:
                    e = e + weights[j] * read(k, 3 * j + row, p, m)
            total = total + e * e
    result = 0.0
    for j in range(WIDTH):
        result += lane(total, j)
    sums[block] = result


square_blocks = over_blocks(add_squares, "k, weights, sums")


@block_kernel
def square(k: Float, weights: Float, sums: Float, threads: int | None) -> float:
    """Return the sum over all vertices of |sum_j weights_j k_j|^2, in an order independent of threads.

    sums (blocks,) is scratch; a pinned vertex has slopes 0.
    """
    square_blocks(k, weights, sums, sums.shape[0], threads)
    total = 0.0
    for block in range(sums.shape[0]):
        total += sums[block]
    return total


@kernel
def estimated(b: Buffers, e: Estimate, which: int, h: float, threads: int | None) -> float:
    """Return one of the estimates [m], root of the sum over vertices: h times velocities, and positions."""
    velocity = np.sqrt(square(b.k, e.velocity[which], e.sums, threads))
    return float(h * h * (velocity + np.sqrt(square(b.k, e.position[which], e.sums, threads))))


@kernel
def estimate_error(b: Buffers, e: Estimate, h: float, allowed: float, threads: int | None) -> float:
    """Return the estimated error over the allowed: root mean square of positions and of h times velocities.

    `allowed` is in metres times the root of the number of vertices. Of two estimates e5 and e3 the
    error is e5^2 / sqrt(e5^2 + e3^2 / 100) (Hairer, Norsett & Wanner 1993, section II.10).
    """
    total = estimated(b, e, 0, h, threads)
    if e.velocity.shape[0] == 2 and total > 0.0:
        other = estimated(b, e, 1, h, threads)
        total = total * total / np.sqrt(total * total + 0.01 * other * other)
    return float(total / allowed)


@kernel
def choose_length(wish: float, left: float, longest: float, landing: bool) -> float:
    """Return the next step's length; one that must land on the end takes half the way if two are left."""
    h = min(wish, longest)
    if landing and h > left * (1.0 - LANDED):
        return left
    if landing and h > 0.5 * left:
        return 0.5 * left
    return h


@kernel
def take(control: Float, h: float, error: float, alpha: float, again: bool) -> None:
    """Leave an accepted step of h pending, and choose the next; `again` after a rejected one."""
    error = max(error, 1e-4)
    wish = SAFETY * control[BEFORE] ** 0.04 / error**alpha
    factor = min(1.0 if again else GROW, max(SHRINK, wish))
    # A step cut short by the interval's end does not hold back the next.
    control[NEXT] = max(h * factor, control[NEXT]) if h < control[NEXT] and factor > 1.0 else h * factor
    control[BEFORE] = error
    control[PENDING] = h


@kernel
def advance_adaptive(
    b: Buffers, weights: Weights, estimate: Estimate, control: Float, counts: Long, interval: Interval, p: Packed
) -> bool:
    """Step to the end of an interval, until the pending step ends at or beyond it.

    A step that is accepted stays pending until the next is tried, so that the state at the end of the interval can be
    read inside of it. False where the step has become too small.
    """
    span, slopes = interval.span, estimate.velocity.shape[1]
    alpha = 1.0 / (estimate.order + 1) - 0.75 * 0.04
    first, again = 0, False
    while True:
        h = control[PENDING]
        if h > 0.0:
            over = control[AT] + h - span
            if over > LANDED * h:
                return True
            control[AT] += h
            control[PENDING] = 0.0
            copy_rows(b.y, b.x)
            copy_rows(b.u, b.v)
            commit(b.x, b.v, control[AT] / span, p.bodies, p.bodies_on, p.threads)
            # The last slope is the next step's first, unless bodies have moved vertices or anchors.
            first = 0
            if not p.moved:
                copy_rows(b.k[3 * slopes - 3 : 3 * slopes], b.k[:3])
                first = 1
            if over > -LANDED * h:
                control[AT] = 0.0
                return True
        h = choose_length(control[NEXT], span - control[AT], interval.longest, interval.landing)
        if p.leave[0] != 0 or not h > SMALLEST * span:
            return False
        take_stages(b, weights, first, slopes, h, control[AT], span, p)
        error = estimate_error(b, estimate, h, interval.allowed, p.threads)
        if error <= 1.0:
            counts[ACCEPTED] += 1
            take(control, h, error, alpha, again)
            again = False
        else:
            counts[REJECTED] += 1
            # NaN compares false with everything: such a step is shortened as far as allowed.
            control[NEXT] = h * (max(SHRINK, SAFETY / error**alpha) if error < 1e30 else SHRINK)
            first, again = 1, True


# Embedded Runge-Kutta pairs: Dormand & Prince 5(4) and 8(5,3), with output between steps.
#
# Coefficients are SciPy's: those of Hairer, Norsett & Wanner 1993, "Solving Ordinary Differential Equations I", section
# II.5 and the programs DOPRI5 and DOP853; the fourth-order output of DOPRI5 is Shampine's (1986,
# Math. Comp. 46, 135-150).


@dataclass(frozen=True)
class Pair(Tableau):
    """A tableau with an estimate of its error, and output between steps. The slope at a step's end is the next one's
    first.

    order   of the estimate, which sets the step
    errors  (1, stages + 1) or (2, stages + 1) weights of the estimate; of two, the first is the leading one
    output  theta -> (rows,) weights of the state at fraction theta of the step
    further weights of stages after the end, which serve the output alone
    """

    order: int
    errors: Float
    output: Callable[[float], Float]
    further: Sequence[Sequence[float]] = ()

    @property
    def rows(self) -> Sequence[Sequence[float]]:
        """Weights of each stage, of the result and of the further stages."""
        return *super().rows, *self.further

    def estimate(self, blocks: int) -> Estimate:
        """Return the estimate in the layout of compiled code."""
        slopes = self.stages + 1
        return Estimate(self.order, self.errors, self.errors @ self.weights.a[:slopes, :slopes], np.empty(blocks))


def _dopri5_output(theta: float) -> Float:
    powers = theta ** np.arange(1, 5)
    return np.asarray(powers @ np.ascontiguousarray(RK45.P.T))


def _dop853_output(theta: float) -> Float:
    """Evaluate Hairer's nested form, outermost last: factors theta and 1 - theta in turn."""
    first, last, end = np.eye(16)[0], np.eye(16)[12], DOP853.weights.a[12]
    parts = [end, first - end, 2.0 * end - (first + last), *EIGHTH.D]
    weights = np.zeros(16)
    for i, part in enumerate(reversed(parts)):
        weights = (weights + part) * (theta if i % 2 == 0 else 1.0 - theta)
    return weights


DOPRI5 = Pair(RK45.A[1:], RK45.B, 4, 0.0 - RK45.E[None], _dopri5_output)
DOP853 = Pair(EIGHTH.A[1:], EIGHTH.B, 7, np.stack([EIGHTH.E5, EIGHTH.E3]), _dop853_output, EIGHTH.A_EXTRA)


OF_LIMIT = 0.95
"""Largest step as a share of the stable one, which is measured at the start. The estimate alone lets steps
run along the limit, where the fastest modes grow until they are as large as the tolerance: at 1e-3 of the
cloth's size that is many times a spring's length."""
ROUNDING = 8.0 * float(np.finfo(float).eps)


class AdaptiveConfig(Config):
    """An error a step may make; the scene's dt is the largest step."""

    tolerance: float = Field(
        1e-6, gt=0, le=1, description="error of a step, as a share of the cloth's size: root mean square over vertices"
    )


@dataclass
class AdaptiveWork(Work):
    """`x`, `v` hold the state at an interval's end, `b` the pending step."""

    b: Buffers
    estimate: Estimate
    control: Float
    allowed: float
    landing: bool
    longest: float
    left: tuple[Float, Float, Float] | None = None
    """x, v and `control` after the last interval, while the slopes still belong to them"""

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        state_arrays: dict[str, NDArray[Any]] = {"control": self.control}
        return state_arrays if self.landing else state_arrays | {"pending_x": self.b.x, "pending_v": self.b.v}


class Adaptive(Compiled):
    """Takes the largest steps whose estimated error stays within a tolerance."""

    Config: ClassVar[type[AdaptiveConfig]] = AdaptiveConfig
    explicit: ClassVar[bool] = True
    adaptive: ClassVar[bool] = True
    tableau: ClassVar[Pair]

    def make_work(self, config: AdaptiveConfig, system: System, packed: Packed) -> AdaptiveWork:
        """Raise BadInput for a tolerance below rounding error."""
        fabric, table = system.fabric, self.tableau
        size = cloth_size(fabric)
        rounding = ROUNDING * float(np.abs(fabric.position).max(initial=0.0)) / size
        if config.tolerance < rounding:
            raise BadInput(
                "no step can be as accurate as that: positions are rounded more",
                field="solver.tolerance",
                value=f"{config.tolerance:g}",
                limit=f"{rounding:.1e} for cloth of {size:.3g} m that far from the origin",
                remedy="raise the tolerance, or move the scene nearer to the origin",
            )
        n = fabric.number
        x, v, y, u = np.empty((4, 3, n))
        buffers = Buffers(x, v, y, u, np.zeros((3 * len(table.rows), n)))
        control = np.array([0.0, 0.0, np.inf, 1e-4])
        known_ahead = not packed.bodies and not reads_time(system)
        free = max(1, int((~fabric.pinned).sum()))
        allowed = config.tolerance * size * np.sqrt(free)
        # From the fabric, not from the state of a run that goes on: it must choose the same steps again.
        omega, damping = measure_rates(system, State(fabric.position, np.zeros_like(fabric.position)))
        longest = OF_LIMIT * stable_step(self.amplification, omega, damping, system.damping)
        longest = longest if longest > 0.0 else float("inf")
        estimate = table.estimate(block_count(n))
        return AdaptiveWork(packed, buffers.k, buffers, estimate, control, allowed, not known_ahead, longest)

    def limit(self, config: AdaptiveConfig, system: System, state: State) -> StepLimit:
        """Return an unlimited step: the scene's is only the largest that is tried."""
        return StepLimit(float("inf"), *measure_rates(system, state))

    def amplification(self, omega: float | Float, damping: float | Float, dt: float | Float) -> Float:
        """Return the matrices (2, 2, ...) of one accepted step; see Tableau."""
        return self.tableau.amplification(omega, damping, dt)

    def go(self, work: AdaptiveWork, packed: Packed, steps: int, dt: float) -> StepResult:
        b, control, span = work.b, work.control, steps * dt
        if not self._goes_on(work, packed, span):
            b.x[...], b.v[...] = work.x, work.v
            control[AT] = control[PENDING] = 0.0
        counts = np.zeros(2, np.int64)
        interval = Interval(span, min(dt, work.longest), work.landing, work.allowed)
        method = self.tableau.weights, work.estimate
        whole = advance_adaptive(b, *method, control, counts, interval, packed)
        if control[PENDING] > 0.0 and whole:
            self._read_inside(work, packed, span)
            control[AT] -= span
        else:
            work.x[...], work.v[...] = b.x, b.v
        work.left = (work.x.copy(), work.v.copy(), control.copy())
        accepted, rejected = int(counts[ACCEPTED]), int(counts[REJECTED])
        problem = "" if whole else f"no step above {SMALLEST * span:.2g} s meets the tolerance"
        return StepResult(accepted, problem, {"steps": accepted, "rejected_steps": rejected})

    def compile(self, work: AdaptiveWork, packed: Packed) -> None:
        """Compile by an interval of no length, which ends before its first step."""
        b, weights, interval = work.b, self.tableau.weights, Interval(0.0, 0.0, work.landing, work.allowed)
        control, counts = np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(2, np.int64)
        advance_adaptive(b, weights, work.estimate, control, counts, interval, packed)
        if not work.landing:
            # The function that reads a state within a step: without stages, into separate arrays.
            take_stages(b, weights, 0, 0, 0.0, 0.0, 1.0, packed)
            self._interpolate(b, 0.0, 0.0, np.empty_like(b.x), np.empty_like(b.v), packed.threads)

    def _goes_on(self, work: AdaptiveWork, packed: Packed, span: float) -> bool:
        """Whether the pending step leads to the present state; its slopes are computed anew after a resume."""
        control = work.control
        if not control[PENDING] > 0.0:
            return False
        if work.left is not None and all(map(np.array_equal, work.left, (work.x, work.v, control))):
            return True
        now_x, now_v = work.x.copy(), work.v.copy()
        h, start = float(control[PENDING]), float(control[AT])
        take_stages(work.b, self.tableau.weights, 0, self.tableau.stages + 1, h, start, span, packed)
        control[AT] += span
        self._read_inside(work, packed, span)
        control[AT] -= span
        same = np.array_equal(now_x, work.x) and np.array_equal(now_v, work.v)
        work.x[...], work.v[...] = now_x, now_v
        return same

    def _read_inside(self, work: AdaptiveWork, packed: Packed, span: float) -> None:
        """Interpolate the state `span` after the interval's start from the pending step."""
        b, h, start, table = work.b, float(work.control[PENDING]), float(work.control[AT]), self.tableau
        if len(table.further):
            y, u = b.y.copy(), b.u.copy()
            take_stages(b, table.weights, table.stages + 1, len(table.rows), h, start, span, packed)
            b.y[...], b.u[...] = y, u
        self._interpolate(b, (span - start) / h, h, work.x, work.v, packed.threads)

    def _interpolate(self, b: Buffers, theta: float, h: float, x: Float, v: Float, threads: int | None) -> None:
        """Write the state at fraction theta of the pending step of h into x, v (3, n)."""
        weights = self.tableau.output(theta)
        stage = Stage(theta * h, h, weights @ self.tableau.weights.a, weights, len(self.tableau.rows))
        combine(b, stage, x, v, threads)

    def steps_of(self, work: AdaptiveWork) -> Any:
        def steps_of_no_length(x: Float, v: Float, stages: Float, steps: int, dt: float, p: Packed) -> None:
            work.b.x[...], work.b.v[...] = x, v
            for _ in range(steps):
                take_stages(work.b, self.tableau.weights, 0, self.tableau.stages + 1, 0.0, 0.0, 1.0, p)

        return steps_of_no_length


class Dopri5(Adaptive):
    """Dormand & Prince's pair of orders 5 and 4 (1980, J. Comp. Appl. Math. 6, 19-26)."""

    name: ClassVar[str] = "dopri5"
    order: ClassVar[int] = 5
    tableau: ClassVar[Pair] = DOPRI5


class Dop853(Adaptive):
    """Dormand & Prince's method of order 8 with estimates of orders 5 and 3 (Hairer's DOP853)."""

    name: ClassVar[str] = "dop853"
    order: ClassVar[int] = 8
    tableau: ClassVar[Pair] = DOP853
