"""Explicit integrators of a fixed step: Euler, symplectic Euler, leapfrog, and Runge-Kutta of order 4."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from pydantic import BaseModel

from nuno_integrators.compiled import Compiled, StepResult, Work, source_of
from nuno_integrators.explicit.updates import add, add_twice
from nuno_kernels import kernel, shared_source
from nuno_kernels.step.acceleration import Extra, Packed, add_forces, commit, evaluate, hold, settle, slow
from nuno_kernels.step.blocks import copy_rows
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import Config
from nuno_schemas.system import System

# Explicit integrators of a fixed step: one compiled loop over an interval's steps.

SPARE = 4
"""Unused buffers behind a loop's own. Compiled code does not check bounds: a loop that uses more buffers than it
declares would write into foreign memory."""


@dataclass
class GuardedWork(Work):
    """`spare` (SPARE, 3, n) lies behind `stages`, and is NaN at the first vertex as long as no loop has written there.

    The first vertex alone: a buffer is written whole, and the memory of the others is never touched.
    """

    spare: Float


class NoConfig(Config):
    """No configuration: the step is the scene's."""


class Explicit(Compiled):
    """An integrator whose `loop(x, v, stages, steps, dt, packed, extra)` is compiled.

    buffers  arrays (3, n) of float64 that the loop has in `stages`, from number 0 to buffers - 1
    """

    Config: ClassVar[type[BaseModel]] = NoConfig
    explicit: ClassVar[bool] = True
    buffers: ClassVar[int]
    loop: ClassVar[Any]

    def make_work(self, config: BaseModel, system: System, packed: Packed) -> GuardedWork:
        n = system.fabric.number
        room = np.empty((self.buffers + SPARE, 3, n))
        stages, spare = room[: self.buffers], room[self.buffers :]
        spare[:, :, :1] = np.nan
        return GuardedWork(packed, np.empty((3, n)), np.empty((3, n)), stages, spare)

    def loop_for(self, packed: Packed) -> Any:
        """Return the loop for a system."""
        return type(self).loop

    def go(self, work: GuardedWork, packed: Packed, extra: Extra, steps: int, dt: float) -> StepResult:
        """Raise RunFailed if the loop has written behind its buffers."""
        source_of(self.loop_for(packed), extra)(work.x, work.v, work.stages, steps, dt, packed, extra)
        written = np.flatnonzero(~np.isnan(work.spare[:, :, :1]).all(axis=(1, 2)))
        if written.size:
            last = self.buffers + int(written[-1])
            raise RunFailed(
                f"the solver {self.name!r} writes into stages[{last}], and its buffers = {self.buffers} end at "
                f"stages[{self.buffers - 1}]: give its class buffers = {last + 1}"
            )
        return StepResult(steps)

    def compile(self, work: GuardedWork, packed: Packed, extra: Extra) -> None:
        self.go(work, packed, extra, 0, 0.0)

    def step_at_rest(self, work: Work, extra: Extra) -> Any:
        return source_of(self.loop_for(work.packed), extra)


# Explicit Euler: x += v dt, v += a dt, both from the old state. Order 1, never stable undamped.


@kernel
def advance_euler(x: Float, v: Float, stages: Float, steps: int, dt: float, p: Packed, extra: Extra) -> None:
    """Take `steps` steps of x, v (3, n); stages (1, 3, n)."""
    a = stages[0]
    for step in range(steps):
        if p.leave[0] != 0:
            break
        evaluate(x, v, step / steps, a, p, extra)
        add_twice(x, x, dt, v, v, v, dt, a, p.threads)
        commit(x, v, (step + 1) / steps, p.bodies, p.bodies_on, p.threads)


class Euler(Explicit):
    """Explicit Euler: the amplitude of an undamped oscillator grows by sqrt(1 + omega^2 dt^2) a step."""

    name: ClassVar[str] = "euler"
    order: ClassVar[int] = 1
    buffers: ClassVar[int] = 1
    loop: ClassVar[Any] = advance_euler

    def amplification(self, omega: float, damping: float, dt: float) -> Float:
        return np.array([[1.0, dt], [-omega * omega * dt, 1.0 - damping * dt]])


# Symplectic Euler: v += a dt from the old state, damping included, then x += v_new dt. Order 1.


@kernel
def advance_symplectic_euler(x: Float, v: Float, stages: Float, steps: int, dt: float, p: Packed, extra: Extra) -> None:
    """Take `steps` steps of x, v (3, n); stages (2, 3, n)."""
    a = stages[0]
    for step in range(steps):
        if p.leave[0] != 0:
            break
        evaluate(x, v, step / steps, a, p, extra)
        add_twice(v, v, dt, a, x, x, dt, v, p.threads)
        commit(x, v, (step + 1) / steps, p.bodies, p.bodies_on, p.threads)


@kernel
def advance_at_once(x: Float, v: Float, stages: Float, steps: int, dt: float, p: Packed, extra: Extra) -> None:
    """Do what advance_symplectic_euler does, to the last bit, where no force is added after the blocks: each step in
    one pass over the vertices instead of two, from one pair of arrays to another, with one barrier of the threads.
    """
    here_x, here_v, to_x, to_v = x, v, stages[0], stages[1]
    for step in range(steps):
        if p.leave[0] != 0:
            break
        add_forces(here_x, here_v, step / steps, to_x, to_v, dt, p)
        here_x, here_v, to_x, to_v = to_x, to_v, here_x, here_v
        commit(here_x, here_v, (step + 1) / steps, p.bodies, p.bodies_on, p.threads)
    if steps % 2 == 1:
        copy_rows(here_x, x)
        copy_rows(here_v, v)


class SymplecticEuler(Explicit):
    """Symplectic Euler: stable for damping dt + omega^2 dt^2 / 2 < 2; the skirt paper's "FB Euler"."""

    name: ClassVar[str] = "symplectic_euler"
    order: ClassVar[int] = 1
    buffers: ClassVar[int] = 2
    loop: ClassVar[Any] = advance_symplectic_euler

    def loop_for(self, packed: Packed) -> Any:
        """Use one pass a step if contact and Python add no forces."""
        return advance_at_once if packed.late is None else advance_symplectic_euler

    def amplification(self, omega: float, damping: float, dt: float) -> Float:
        square, decay = omega * omega * dt, 1.0 - damping * dt
        return np.array([[1.0 - square * dt, decay * dt], [-square, decay]])


# Leapfrog, or velocity Verlet: x += v dt + a dt^2/2; v += (a_old + a_new) dt/2. Order 2.
#
# The second acceleration is a(x_new, v + a_old dt): the predicted velocity keeps the order where a
# force depends on velocity. Where none does, a_new serves as the next step's a_old unchanged.


@kernel
def advance_leapfrog(x: Float, v: Float, stages: Float, steps: int, dt: float, p: Packed, extra: Extra) -> None:
    """Take `steps` steps of x, v (3, n); stages (3, 3, n).

    Half a kick comes first: x + v dt + a dt^2/2 is x + (v + a dt/2) dt, one update less.

    Vertices that slide on bodies are held off them between the kicks, and their velocities again after the second. Held
    off after it, they would be inside while the second force is found: cloth that stands still would then have the mean
    of two forces at rest, 0, but keep half a step of their difference as velocity.
    """
    a, b, u = stages[0], stages[1], stages[2]
    for step in range(steps):
        if p.leave[0] != 0:
            break
        if step == 0 or p.velocity_matters:
            evaluate(x, v, step / steps, a, p, extra)
        add_twice(v, v, 0.5 * dt, a, x, x, dt, v, p.threads)
        hold(x, v, (step + 1) / steps, p.bodies, p.bodies_on, p.threads)
        if p.velocity_matters:
            add(u, v, 0.5 * dt, a, p.threads)
            slow(x, u, p.bodies, p.bodies_on, p.threads)
        evaluate(x, u if p.velocity_matters else v, (step + 1) / steps, b, p, extra)
        add(v, v, 0.5 * dt, b, p.threads)
        slow(x, v, p.bodies, p.bodies_on, p.threads)
        settle(x, v, (step + 1) / steps, p.bodies, p.bodies_on, p.threads)
        a, b = b, a


class Leapfrog(Explicit):
    """Leapfrog: stable for omega dt < 2 undamped."""

    name: ClassVar[str] = "leapfrog"
    order: ClassVar[int] = 2
    buffers: ClassVar[int] = 3
    loop: ClassVar[Any] = advance_leapfrog

    def amplification(self, omega: float, damping: float, dt: float) -> Float:
        """The acceleration a = (-omega^2, -damping) is a row on (x, v), so that every line below is a row."""
        x, v = np.eye(2)
        a = -omega * omega * x - damping * v
        moved = x + dt * v + 0.5 * dt * dt * a
        after = -omega * omega * moved - damping * (v + dt * a)
        return np.stack([moved, v + 0.5 * dt * (a + after)])


# The classical fourth-order Runge-Kutta method, and a variant with the skirt paper's slips.


@shared_source
def evaluate_stage(y: Float, u: Float, v: Float, s: float, a: Float, p: Packed, extra: Extra) -> None:
    """Compute a = acceleration at the stage (y, u); damping frozen at the step's start acts on its v."""
    evaluate(y, u, s, a, p, extra)
    if p.frozen_damping != 0.0:
        add(a, a, -p.frozen_damping, v, p.threads)


@kernel
def advance_rk4(x: Float, v: Float, stages: Float, steps: int, dt: float, p: Packed, extra: Extra) -> None:
    """Take `steps` steps of x, v (3, n); stages (5, 3, n).

    Stage i is (y, u) with slopes (u, a). The weighted slopes gather in (nx, nv) while the stages run; y is moved before
    u, because y's slope is the old u.
    """
    a, y, u, nx, nv = stages[0], stages[1], stages[2], stages[3], stages[4]
    for step in range(steps):
        if p.leave[0] != 0:
            break
        evaluate_stage(x, v, v, step / steps, a, p, extra)
        add_twice(nx, x, dt / 6.0, v, nv, v, dt / 6.0, a, p.threads)
        add_twice(y, x, 0.5 * dt, v, u, v, 0.5 * dt, a, p.threads)
        for stage in range(1, 4):
            ahead = 0.5 if stage < 3 else 1.0
            evaluate_stage(y, u, v, (step + ahead) / steps, a, p, extra)
            if stage < 3:
                add_twice(nx, nx, dt / 3.0, u, nv, nv, dt / 3.0, a, p.threads)
                onward = 0.5 * dt if stage == 1 else dt
                add_twice(y, x, onward, u, u, v, onward, a, p.threads)
            else:
                add_twice(x, nx, dt / 6.0, u, v, nv, dt / 6.0, a, p.threads)
        commit(x, v, (step + 1) / steps, p.bodies, p.bodies_on, p.threads)


class RK4(Explicit):
    """RK4: stable for omega dt < 2 sqrt(2) undamped; contact is evaluated at every stage."""

    name: ClassVar[str] = "rk4"
    order: ClassVar[int] = 4
    buffers: ClassVar[int] = 5
    loop: ClassVar[Any] = advance_rk4

    def amplification(self, omega: float, damping: float, dt: float) -> Float:
        """Return exp(A dt) to fourth order."""
        h = dt * np.array([[0.0, 1.0], [-omega * omega, -damping]])
        one = np.eye(2)
        return np.asarray(one + h @ (one + h / 2.0 @ (one + h / 3.0 @ (one + h / 4.0))))


class RK4Printed(RK4):
    """RK4 as the skirt paper prints it, kept to show what its slips do.

    The viscous damping is frozen at the step's start, so the method converges at order 1 only, and
    gravity is counted twice. Not meant for simulation.
    """

    name: ClassVar[str] = "rk4_printed"
    order: ClassVar[int] = 1

    def adapt(self, packed: Packed) -> Packed:
        """Remove damping from the acceleration and double gravity."""
        return packed._replace(damping=0.0, frozen_damping=packed.damping, gravity=2.0 * packed.gravity)

    def damped(self, packed: Packed, damping: float) -> Packed:
        return packed if packed.frozen_damping == 0.0 else packed._replace(frozen_damping=damping)

    def amplification(self, omega: float, damping: float, dt: float) -> Float:
        x, v = np.eye(2)
        y, u, nx, nv = x, v, x, v
        for ahead, weight in ((0.5, 1.0), (0.5, 2.0), (1.0, 2.0), (0.0, 1.0)):
            a = -omega * omega * y - damping * v
            nx, nv = nx + dt * weight / 6.0 * u, nv + dt * weight / 6.0 * a
            y, u = x + ahead * dt * u, v + ahead * dt * a
        return np.stack([nx, nv])
