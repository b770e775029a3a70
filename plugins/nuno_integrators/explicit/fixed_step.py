"""Explicit integrators of a fixed step, by a compiled loop over an interval's steps: Euler, symplectic Euler,
leapfrog.
"""

from __future__ import annotations

from types import FunctionType
from typing import Any, ClassVar

import numpy as np
from pydantic import BaseModel

from nuno_integrators.compiled import Compiled, StepResult, Work, source_of
from nuno_integrators.explicit.updates import add, add_twice
from nuno_integrators.stability import measure_rates, stable_step
from nuno_kernels import kernel
from nuno_kernels.step.acceleration import Extra, Packed, add_forces, commit, evaluate, hold, settle, slow
from nuno_kernels.step.blocks import copy_rows
from nuno_schemas.fabric import Float, State
from nuno_schemas.plugin import Config
from nuno_schemas.system import StepLimit, System

ROOM = 16
"""Arrays (3, n) in `stages`; those that a loop leaves alone take no memory. Compiled code does not check for an index
beyond them: running the loop's source does, which is done before, for its stable step."""


class NoConfig(Config):
    """No configuration: the step is the scene's."""


class Explicit(Compiled):
    """An integrator by a compiled `loop(x, v, stages, steps, dt, packed, extra)`; `stages` (room, 3, n) is its own."""

    Config: ClassVar[type[BaseModel]] = NoConfig
    explicit: ClassVar[bool] = True
    loop: ClassVar[Any]

    def make_work(self, config: BaseModel, system: System, packed: Packed) -> Work:
        n = system.fabric.number
        return Work(packed, np.empty((3, n)), np.empty((3, n)), np.empty((self.room, 3, n)))

    @property
    def room(self) -> int:
        """Number of arrays (3, n) in `stages`."""
        return ROOM

    def loop_of(self, packed: Packed, extra: Extra) -> Any:
        """Return the loop for a system."""
        return source_of(type(self).loop, extra)

    def go(self, work: Work, packed: Packed, extra: Extra, steps: int, dt: float) -> StepResult:
        self.loop_of(packed, extra)(work.x, work.v, work.stages, steps, dt, packed, extra)
        return StepResult(steps)

    def step_at_rest(self, work: Work, extra: Extra) -> Any:
        return self.loop_of(work.packed, extra)

    def limit(self, config: Any, system: System, state: State) -> StepLimit:
        omega, damping = measure_rates(system, state)
        return StepLimit(stable_step(self.amplification, omega, damping, system.damping), omega, damping)

    def amplification(self, omega: float | Float, damping: float | Float, dt: float | Float) -> Float:
        """Return the matrices (2, 2, ...) of one step on x'' = -omega^2 x - damping x', state (x, v), by the loop.

        The masses are vertices of their own, of 1 kg. Their step is 1 s, since the matrix depends on omega dt and
        damping dt alone but for the units of x and v. One row of the arrays starts at x = 1, the next at v = 1.
        """
        shape = np.broadcast_shapes(*map(np.shape, (omega, damping, dt)))
        w, d, h = (np.broadcast_to(value, shape).ravel() for value in (omega * dt, damping * dt, dt))
        x, v = np.zeros((2, 3, w.size))
        x[0], v[1] = 1.0, 1.0

        def pull(x: Float, v: Float, s: float, a: Float) -> None:
            a -= w * w * x + d * v

        packed = Packed(np.ones(w.size), np.zeros(3), 0.0, late=True)
        in_numpy(type(self).loop)(x, v, np.empty((ROOM, 3, w.size)), 1, 1.0, packed, pull)
        return np.array([[x[0], x[1] * h], [v[0] / h, v[1]]]).reshape(2, 2, *shape)


def in_numpy(loop: Any) -> Any:
    """Return a loop's source with NumPy's functions in the place of compiled ones: to run it compiles nothing. One that
    it knows by other names than its module's is compiled, for a system without forces but those in Python.
    """
    source = getattr(loop, "py_func", loop)
    plain = {name: PLAIN[id(value)] for name, value in source.__globals__.items() if id(value) in PLAIN}
    return FunctionType(source.__code__, source.__globals__ | plain, closure=source.__closure__)


def _evaluate(x: Float, v: Float, s: float, a: Float, p: Packed, extra: Any) -> None:
    a[...] = 0.0
    extra(x, v, s, a)


def _add(out: Float, y: Float, h: float, k: Float, threads: int | None) -> None:
    out[...] = y + h * k


def _add_twice(
    first: Float, y: Float, h: float, k: Float, second: Float, z: Float, g: float, m: Float, threads: int | None
) -> None:
    first[...] = y + h * k
    second[...] = z + g * m


PLAIN = {id(evaluate): _evaluate, id(add): _add, id(add_twice): _add_twice}
PLAIN |= {id(function): lambda *arguments: None for function in (commit, hold, settle, slow)}
"""what free masses without bodies make of a loop's functions"""


# Explicit Euler: x += v dt, v += a dt, both from the old state. Order 1, never stable undamped.


@kernel
def advance_euler(x: Float, v: Float, stages: Float, steps: int, dt: float, p: Packed, extra: Extra) -> None:
    """Take `steps` steps of x, v (3, n)."""
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
    loop: ClassVar[Any] = advance_euler


# Symplectic Euler: v += a dt from the old state, damping included, then x += v_new dt. Order 1.


@kernel
def advance_symplectic_euler(x: Float, v: Float, stages: Float, steps: int, dt: float, p: Packed, extra: Extra) -> None:
    """Take `steps` steps of x, v (3, n)."""
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
    loop: ClassVar[Any] = advance_symplectic_euler

    def loop_of(self, packed: Packed, extra: Extra) -> Any:
        """Use one pass a step if contact and Python add no forces."""
        return advance_at_once if packed.late is None else source_of(advance_symplectic_euler, extra)


# Leapfrog, or velocity Verlet: x += v dt + a dt^2/2; v += (a_old + a_new) dt/2. Order 2.
#
# The second acceleration is a(x_new, v + a_old dt): the predicted velocity keeps the order where a
# force depends on velocity. Where none does, a_new serves as the next step's a_old unchanged.


@kernel
def advance_leapfrog(x: Float, v: Float, stages: Float, steps: int, dt: float, p: Packed, extra: Extra) -> None:
    """Take `steps` steps of x, v (3, n).

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
    loop: ClassVar[Any] = advance_leapfrog
