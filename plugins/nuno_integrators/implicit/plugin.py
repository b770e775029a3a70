"""Implicit methods: stable at any step, for cloth too stiff to follow.

Implicit Euler and TR-BDF2 share one stage, x = x^ + g v with v = v^ + g a(x, v), solved by Newton's
method to a stated residual (nuno_integrators.implicit.newton). Where it does not converge the step is halved, and where
that does not help solved with more patience.

TR-BDF2 (Bank et al. 1985; Hosea & Shampine 1996, Appl. Numer. Math. 20, 21-37) takes a trapezoidal
stage to gamma = 2 - sqrt(2) of the step and the second-order backward formula from there: of order 2,
and like implicit Euler it damps what it cannot follow. It needs no history, so that a step may change its
length, and a checkpoint holds nothing of it. Plain BDF2 would keep the state before.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numba
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nuno_integrators.compiled import Compiled, StepResult, Work, cloth_size, lacking
from nuno_integrators.implicit.linear_solve import Counts, prefer_factors
from nuno_integrators.implicit.newton import Limits, Stage, compile_stage, limit_approach, make_stage, solve_stage
from nuno_integrators.stability import measure_rates
from nuno_kernels.step.acceleration import Packed, commit, evaluate
from nuno_kernels.terms import call_each
from nuno_schemas.fabric import Float, State
from nuno_schemas.layout import Bounds
from nuno_schemas.plugin import Config
from nuno_schemas.system import StepLimit, System

GAMMA = 2.0 - math.sqrt(2.0)
MOST_HALVINGS = 14
"""halvings at most: a frame of 1/60 s then has steps of 1 us. Before that the inertia m / h^2 outweighs 4 k s / (1 -
s), with which springs that are shorter than at rest by the share s push a vertex m aside, and a step has one solution:
at a third and a gram for every k up to 5e8 N/m."""
PATIENT_FROM = 4
"""A step that so many halvings did not help is not one that is too long. Most steps that fail, as over contact, go
through after one halving or two, and those cost less than patience."""
CUT_FROM = 6
"""After so many halvings vertices that contact holds back stay in place: cloth pressed together harder than contact can
push it apart would take thousands of steps."""
MOST_SETS = 6
"""Solutions of a step with different sets of held vertices. Further changes happen in the next step, or vertices are
put back at this one's end."""
PATIENCE = 10
"""factor on the number of Newton steps then, by factorisations. A chain of stiff springs in compression gives way to
the side: tens of steps leave the straight line, where rounding alone pushes it aside, and then it takes about one for
every vertex along it. Loose solutions turn stiff springs by so little a step that they take hundreds."""


class ImplicitConfig(Config):
    """The accuracy of Newton's method."""

    residual: float = Field(
        1e-3,
        ge=1e-12,
        lt=1,
        description="force that may be missing at a vertex, as a share of the largest single force",
    )
    most_iterations: int = Field(
        20,
        ge=1,
        le=1000,
        description="Newton steps before a time step is halved; where four halvings do not help, ten times as many",
    )


@dataclass
class ImplicitWork(Work):
    """Memory of the method: `stage` of the solver; `grips` hold vertices on bodies (nuno_contact.sliding.grip)."""

    stage: Stage
    limits: Limits
    grips: tuple[Any, ...]

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        return {f"held_{name}-{k}": getattr(one, name) for k, one in enumerate(self.grips) for name in ("body", "push")}

    def bounds(self) -> dict[str, Bounds]:
        return {f"held_body-{k}": Bounds(-1, len(one.slides.root) - 1) for k, one in enumerate(self.grips)}


class Implicit(Compiled):
    """A method whose steps solve for their end."""

    Config: ClassVar[type[ImplicitConfig]] = ImplicitConfig
    explicit: ClassVar[bool] = False
    holds: ClassVar[bool] = False

    def make_work(self, config: ImplicitConfig, system: System, packed: Packed) -> ImplicitWork:
        n = system.fabric.number
        stage = make_stage(packed, system.fabric.position, cloth_size(system.fabric))
        limits, grips = Limits(config.residual, config.most_iterations), tuple(call_each(packed, "grip"))
        return ImplicitWork(packed, np.empty((2, 3, n)), stage, limits, grips)

    def limit(self, config: ImplicitConfig, system: System, state: State) -> StepLimit:
        """Return no limit."""
        return StepLimit(float("inf"), *measure_rates(system, state))

    def about(self, system: System) -> str:
        """Describe the threads, and which forces have no matrix of their own in Newton's method."""
        names = lacking(system.terms, "rows")
        by_differences = f"; without a matrix, by differences: {', '.join(names)}" if names else ""
        return super().about(system) + by_differences

    def go(self, work: ImplicitWork, packed: Packed, steps: int, dt: float) -> StepResult:
        work.stage.solver.counts = Counts()
        acting = [id(term) for term, on in zip(packed.bodies, packed.bodies_on, strict=True) if on]
        work.stage.grips = tuple(grip for grip in work.grips if id(grip.slides) in acting)
        taken, span = 0, steps * dt
        for step in range(steps):
            done, residual = self._step(work, packed, step * dt, dt, span, 0)
            taken += done
            if residual is not None:
                message = f"a residual of {residual:.3g} N is left after steps of {dt / 2**MOST_HALVINGS:.2g} s"
                return StepResult(taken, message, _totals(work.stage.counts, taken))
        return StepResult(taken, "", _totals(work.stage.counts, taken))

    def compile(self, work: ImplicitWork, packed: Packed) -> None:
        compile_stage(work.stage, packed, work.x, work.v)
        for grip in work.grips:
            grip.begin(work.x, 0.0, 1.0)
            grip.enter(work.x, work.v.copy(), 1.0)
            grip.revise(work.stage.missing, work.x)
        # By its signature: calling it would move friction's anchors.
        held = (work.x, work.v, 1.0, packed.bodies, packed.bodies_on, packed.threads)
        kernel: Any = commit
        kernel.compile(tuple(numba.typeof(value) for value in held))

    def _step(
        self, work: ImplicitWork, packed: Packed, start: float, h: float, span: float, depth: int
    ) -> tuple[int, float | None]:
        """Take one step, halved as often as needed; return the steps, and the residual of a failure, else None."""
        solver, limits = work.stage.solver, work.limits._replace(cut=depth >= CUT_FROM)
        solver.direct = solver.hindered = False
        ok, residual = self._attempt_held(work, packed, start, h, span, limits)
        if not ok and depth == PATIENT_FROM and not packed.leave[0] and prefer_factors(solver):
            limits = limits._replace(most=PATIENCE * limits.most)
            ok, residual = self._attempt_held(work, packed, start, h, span, limits)
        if ok:
            work.x[...], work.v[...] = work.stage.x, work.stage.v
            for grip in work.stage.grips:
                grip.finish(work.stage.missing, work.x, h)
            commit(work.x, work.v, (start + h) / span, packed.bodies, packed.bodies_on, packed.threads)
            for grip in work.stage.grips:
                grip.count()
            return 1, None
        if depth == MOST_HALVINGS or packed.leave[0]:
            return 0, residual
        work.stage.counts.halvings += 1
        first, failed = self._step(work, packed, start, 0.5 * h, span, depth + 1)
        if failed is not None:
            return first, failed
        second, failed = self._step(work, packed, start + 0.5 * h, 0.5 * h, span, depth + 1)
        return first + second, failed

    def _attempt_held(
        self, work: ImplicitWork, packed: Packed, start: float, h: float, span: float, limits: Limits
    ) -> tuple[bool, float]:
        """Call `attempt`, again while the set of vertices held on bodies changes."""
        st, v = work.stage, work.v.copy()
        for grip in st.grips:
            grip.begin(work.x, start / span, (start + h) / span)
        for turn in range(MOST_SETS):
            for grip in st.grips:
                grip.enter(work.x, work.v, h)
            ok, residual = self.attempt(work, packed, start, h, span, limits)
            work.v[...] = v
            if not ok or turn == MOST_SETS - 1:
                break
            revised = [grip.revise(st.missing, st.x) for grip in st.grips]
            if not any(revised):
                break
        return ok, residual

    def attempt(
        self, work: ImplicitWork, packed: Packed, start: float, h: float, span: float, limits: Limits
    ) -> tuple[bool, float]:
        """Write the state after a step of h to work.stage; return whether it converged, and the residual [N]."""
        raise NotImplementedError

    def steps_of(self, work: ImplicitWork) -> Any:
        def forces_only(x: Float, v: Float, stages: Float, steps: int, dt: float, p: Packed) -> None:
            for _ in range(steps):
                evaluate(x, v, 0.0, stages[0], p)

        return forces_only


def _totals(counts: Counts, taken: int) -> dict[str, int]:
    return {
        "steps": taken,
        "newton_steps": counts.newton,
        "linear_iterations": counts.linear,
        "factorisations": counts.factorisations,
        "evaluations": counts.evaluations,
        "halvings": counts.halvings,
    }


class ImplicitEuler(Implicit):
    """Implicit Euler: x_new = x + h v_new, v_new = v + h a(x_new, v_new). Order 1."""

    name: ClassVar[str] = "implicit_euler"
    order: ClassVar[int] = 1

    def attempt(
        self, work: ImplicitWork, packed: Packed, start: float, h: float, span: float, limits: Limits
    ) -> tuple[bool, float]:
        work.stage.v[...] = work.v
        return solve_stage(work.stage, packed, work.x, work.v, h, (start + h) / span, work.x, limits)


class TRBDF2(Implicit):
    """Trapezoidal rule to gamma h, backward differences from there. Order 2."""

    name: ClassVar[str] = "tr_bdf2"
    order: ClassVar[int] = 2

    def attempt(
        self, work: ImplicitWork, packed: Packed, start: float, h: float, span: float, limits: Limits
    ) -> tuple[bool, float]:
        """Solve both stages as x = x^ + g v, g = gamma h / 2: x^ = x + g v at first, then the backward formula's."""
        st, (xhat, vhat), g = work.stage, work.stages, 0.5 * GAMMA * h
        # Also for the forces at the start: they would else depend on the step before, which a checkpoint lacks.
        limit_approach(packed, g)
        evaluate(work.x, work.v, start / span, st.a, packed)
        st.counts.evaluations += 1
        for grip in st.grips:
            st.a += packed.inverse_mass * grip.rub
        np.multiply(work.v, g, out=xhat)
        xhat += work.x
        np.multiply(st.a, g, out=vhat)
        vhat += work.v
        st.v[...] = work.v
        ok, residual = solve_stage(st, packed, xhat, vhat, g, (start + GAMMA * h) / span, work.x, limits)
        if not ok:
            return ok, residual
        first = st.missing.copy()
        # near * middle - (near - 1) * old, written so that a vertex at rest stays so to the last bit.
        near = 1.0 / (GAMMA * (2.0 - GAMMA))
        for hat, middle, old in ((xhat, st.x, work.x), (vhat, st.v, work.v)):
            np.subtract(middle, old, out=hat)
            hat *= near
            hat += old
        result = solve_stage(st, packed, xhat, vhat, g, (start + h) / span, st.x.copy(), limits)
        # The whole step's force, by which both stages bring it from v to its end: at the end alone it oscillates.
        st.missing += near * first
        st.missing *= 0.5 * GAMMA
        return result
