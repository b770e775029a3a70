"""Explicit methods that choose their own steps: an embedded pair, a PI controller, output in between.

A step may reach past the end of a frame, whose state is then read from the polynomial that the
step's slopes define; the step itself goes on into the next frame. Where bodies move or a force is
written in Python a step ends with the frame, because what comes after is not known yet.

Weighed: SciPy's RK45 and DOP853, which return to Python for every stage and begin anew in every frame; `nuno bench
peers` measures them on the stiff sheet.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nuno_integrators.compiled import Compiled, StepResult, Work, cloth_size, source_of
from nuno_integrators.explicit.combine import Buffers, Stage, combine
from nuno_integrators.explicit.stepsize import (
    ACCEPTED,
    AT,
    PENDING,
    REJECTED,
    SMALLEST,
    Interval,
    Pair,
    advance_adaptive,
    attempt,
    attempt_interpreted,
)  # fmt: skip
from nuno_integrators.explicit.tableaux import DOP853, DOPRI5, Tableau
from nuno_integrators.stability import measure_rates, stable_step
from nuno_kernels.lanes.simd import WIDTH
from nuno_kernels.step.acceleration import Extra, Packed
from nuno_kernels.step.blocks import block_count
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, State
from nuno_schemas.plugin import Config
from nuno_schemas.system import StepLimit, System

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
    pair: Pair
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
    tableau: ClassVar[Tableau]

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
        n, stages = fabric.number, len(table.c)
        k = np.zeros((stages, 3, n))
        blocks = block_count(n)
        x, v, y, u = np.empty((4, 3, n))
        buffers = Buffers(x, v, y, u, k, k.reshape(3 * stages, n), np.empty(blocks), np.empty((blocks, 1, WIDTH)))
        pair = Pair(table.stages, table.estimate, table.a, table.aa, table.c, table.errors, table.position_errors)
        control = np.array([0.0, 0.0, np.inf, 1e-4])
        known_ahead = not packed.bodies and not any(term.in_python for term in system.terms)
        free = max(1, int((~fabric.pinned).sum()))
        allowed = config.tolerance * size * np.sqrt(free)
        # From the fabric, not from the state of a run that goes on: it must choose the same steps again.
        omega, damping = measure_rates(system, State(fabric.position, np.zeros_like(fabric.position)))
        longest = OF_LIMIT * stable_step(self.amplification, omega, damping, system.damping)
        longest = longest if longest > 0.0 else float("inf")
        x, v = np.empty((2, 3, n))
        return AdaptiveWork(packed, x, v, k, buffers, pair, control, allowed, not known_ahead, longest)

    def limit(self, config: AdaptiveConfig, system: System, state: State) -> StepLimit:
        """Return an unlimited step: the scene's is only the largest that is tried."""
        rates = super().limit(config, system, state)
        return StepLimit(float("inf"), rates.omega, rates.damping)

    def go(self, work: AdaptiveWork, packed: Packed, extra: Extra, steps: int, dt: float) -> StepResult:
        b, control, span = work.b, work.control, steps * dt
        if not self._goes_on(work, packed, span):
            b.x[...], b.v[...] = work.x, work.v
            control[AT] = control[PENDING] = 0.0
        counts = np.zeros(2, np.int64)
        interval = Interval(span, min(dt, work.longest), work.landing, work.allowed)
        whole = source_of(advance_adaptive, extra)(b, work.pair, control, counts, interval, packed, extra)
        if control[PENDING] > 0.0 and whole:
            self._read_inside(work, packed, span)
            control[AT] -= span
        else:
            work.x[...], work.v[...] = b.x, b.v
        work.left = (work.x.copy(), work.v.copy(), control.copy())
        accepted, rejected = int(counts[ACCEPTED]), int(counts[REJECTED])
        problem = "" if whole else f"no step above {SMALLEST * span:.2g} s meets the tolerance"
        return StepResult(accepted, problem, {"steps": accepted, "rejected_steps": rejected})

    def compile(self, work: AdaptiveWork, packed: Packed, extra: Extra) -> None:
        """Compile by an interval of no length, which ends before its first step."""
        b, table, interval = work.b, self.tableau, Interval(0.0, 0.0, work.landing, work.allowed)
        control, counts = np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(2, np.int64)
        source_of(advance_adaptive, extra)(b, work.pair, control, counts, interval, packed, extra)
        if not work.landing:
            # The function that reads a state within a step: without stages, into separate arrays.
            attempt(b, work.pair, 0, 0, 0.0, 0.0, 1.0, packed, None)
            weights = table.output(0.0)
            stage = Stage(0.0, 0.0, weights @ table.a, weights, len(table.c))
            combine(b, stage, np.empty_like(b.x), np.empty_like(b.v), packed.threads)

    def _goes_on(self, work: AdaptiveWork, packed: Packed, span: float) -> bool:
        """Whether the pending step leads to the present state; its slopes are computed anew after a resume."""
        control = work.control
        if not control[PENDING] > 0.0:
            return False
        if work.left is not None and all(map(np.array_equal, work.left, (work.x, work.v, control))):
            return True
        now_x, now_v = work.x.copy(), work.v.copy()
        stages, h, start = self.tableau.stages, float(control[PENDING]), float(control[AT])
        attempt(work.b, work.pair, 0, stages, h, start, span, packed, None)
        control[AT] += span
        self._read_inside(work, packed, span)
        control[AT] -= span
        same = np.array_equal(now_x, work.x) and np.array_equal(now_v, work.v)
        work.x[...], work.v[...] = now_x, now_v
        return same

    def _read_inside(self, work: AdaptiveWork, packed: Packed, span: float) -> None:
        """Interpolate the state `span` after the interval's start from the pending step."""
        b, h, table = work.b, float(work.control[PENDING]), self.tableau
        if len(table.c) > table.stages:
            y, u = b.y.copy(), b.u.copy()
            start = float(work.control[AT])
            attempt(b, work.pair, table.stages, len(table.c), h, start, span, packed, None)
            b.y[...], b.u[...] = y, u
        theta = (span - float(work.control[AT])) / h
        weights = table.output(theta)
        stage = Stage(theta * h, h, weights @ table.a, weights, len(table.c))
        combine(b, stage, work.x, work.v, packed.threads)

    def step_at_rest(self, work: AdaptiveWork, extra: Extra) -> Any:
        def steps_of_no_length(
            x: Float, v: Float, stages: Float, steps: int, dt: float, p: Packed, force: Extra
        ) -> None:
            work.b.x[...], work.b.v[...] = x, v
            call = attempt if force is None else attempt_interpreted
            for _ in range(steps):
                call(work.b, work.pair, 0, self.tableau.stages, 0.0, 0.0, 1.0, p, force)

        return steps_of_no_length

    def amplification(self, omega: float, damping: float, dt: float) -> Float:
        """(2, 2) matrix of one accepted step on x'' = -omega^2 x - damping x', state (x, v)."""
        one = np.eye(2)
        z = dt * np.array([[0.0, 1.0], [-omega * omega, -damping]])
        result: Float = 0.0 * one
        for coefficient in reversed(self.tableau.polynomial):
            result = z @ result + coefficient * one
        return result


class Dopri5(Adaptive):
    """Dormand & Prince's pair of orders 5 and 4 (1980, J. Comp. Appl. Math. 6, 19-26)."""

    name: ClassVar[str] = "dopri5"
    order: ClassVar[int] = 5
    tableau: ClassVar[Tableau] = DOPRI5


class Dop853(Adaptive):
    """Dormand & Prince's method of order 8 with estimates of orders 5 and 3 (Hairer's DOP853)."""

    name: ClassVar[str] = "dop853"
    order: ClassVar[int] = 8
    tableau: ClassVar[Tableau] = DOP853
