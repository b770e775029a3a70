"""Explicit integrators of a fixed step, by a compiled loop over an interval's steps: Euler, symplectic Euler,
leapfrog.
"""

from __future__ import annotations

from types import FunctionType
from typing import Any, ClassVar

import numpy as np
from pydantic import BaseModel

from nuno_integrators.compiled import Compiled, StepResult, Work
from nuno_integrators.explicit.updates import add, add_twice
from nuno_integrators.stability import measure_rates, stable_step
from nuno_kernels import kernel
from nuno_kernels.step.acceleration import Packed, add_forces, commit, evaluate, hold, settle, slow
from nuno_kernels.step.blocks import copy_rows
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Float, State
from nuno_schemas.plugin import Config
from nuno_schemas.system import StepLimit, System

ROOM = 16
"""Arrays (3, n) in `stages`; those that a loop leaves alone take no memory. Compiled code does not check for an index
beyond them: running the loop's source does, which is done before, for its stable step."""


class NoConfig(Config):
    """No configuration: the step is the scene's."""


class Explicit(Compiled):
    """An integrator by a compiled `loop(x, v, stages, steps, dt, packed)`; `stages` (room, 3, n) is its own."""

    Config: ClassVar[type[BaseModel]] = NoConfig
    explicit: ClassVar[bool] = True
    loop: ClassVar[Any]

    def make_work(self, config: BaseModel, system: System, packed: Packed) -> Work:
        return Work(packed, np.empty((self.room, 3, system.fabric.number)))

    @property
    def room(self) -> int:
        """Number of arrays (3, n) in `stages`."""
        return ROOM

    def steps_of(self, work: Work) -> Any:
        return type(self).loop

    def go(self, work: Work, packed: Packed, steps: int, dt: float) -> StepResult:
        self.steps_of(work)(work.x, work.v, work.stages, steps, dt, packed)
        return StepResult(steps)

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

        felt = list[float]()

        def evaluate_springs(x: Float, v: Float, s: float, a: Float, p: Packed) -> None:
            felt.append(s)
            a[...] = -w * w * x - d * v

        packed = Packed(np.ones(w.size), np.zeros(3), 0.0)
        in_numpy(type(self).loop, evaluate_springs)(x, v, np.empty((ROOM, 3, w.size)), 1, 1.0, packed)
        if not felt:
            raise RunFailed(f"the loop of {self.name!r} does not call nuno_kernels.step.acceleration.evaluate by name")
        return np.array([[x[0], x[1] * h], [v[0] / h, v[1]]]).reshape(2, 2, *shape)


def in_numpy(loop: Any, acceleration: Any) -> Any:
    """Return a loop's source with `acceleration` in the place of evaluate, and NumPy's functions in the place of other
    compiled ones: to run it compiles nothing but what it calls besides.
    """
    source = getattr(loop, "py_func", loop)
    plain = PLAIN | {id(evaluate): acceleration}
    names = {name: plain[id(value)] for name, value in source.__globals__.items() if id(value) in plain}
    return FunctionType(source.__code__, source.__globals__ | names, closure=source.__closure__)


def _add(out: Float, y: Float, h: float, k: Float, threads: int | None) -> None:
    out[...] = y + h * k


def _add_twice(
    first: Float, y: Float, h: float, k: Float, second: Float, z: Float, g: float, m: Float, threads: int | None
) -> None:
    first[...] = y + h * k
    second[...] = z + g * m


PLAIN = {id(add): _add, id(add_twice): _add_twice}
PLAIN |= {id(function): lambda *arguments: None for function in (commit, hold, settle, slow)}
"""what free masses without bodies make of a loop's functions"""


# Explicit Euler: x += v dt, v += a dt, both from the old state. Order 1, never stable undamped.


@kernel
def advance_euler(x: Float, v: Float, stages: Float, steps: int, dt: float, p: Packed) -> None:
    """Take `steps` steps of x, v (3, n)."""
    a = stages[0]
    for step in range(steps):
        if p.leave[0] != 0:
            break
        evaluate(x, v, step / steps, a, p)
        add_twice(x, x, dt, v, v, v, dt, a, p.threads)
        commit(x, v, (step + 1) / steps, p.bodies, p.bodies_on, p.threads)


class Euler(Explicit):
    """Explicit Euler: the amplitude of an undamped oscillator grows by sqrt(1 + omega^2 dt^2) a step."""

    name: ClassVar[str] = "euler"
    order: ClassVar[int] = 1
    loop: ClassVar[Any] = advance_euler


# Symplectic Euler: v += a dt from the old state, damping included, then x += v_new dt. Order 1.


@kernel
def advance_symplectic_euler(x: Float, v: Float, stages: Float, steps: int, dt: float, p: Packed) -> None:
    """Take `steps` steps of x, v (3, n)."""
    a = stages[0]
    for step in range(steps):
        if p.leave[0] != 0:
            break
        evaluate(x, v, step / steps, a, p)
        add_twice(v, v, dt, a, x, x, dt, v, p.threads)
        commit(x, v, (step + 1) / steps, p.bodies, p.bodies_on, p.threads)


@kernel
def advance_at_once(x: Float, v: Float, stages: Float, steps: int, dt: float, p: Packed) -> None:
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

    def steps_of(self, work: Work) -> Any:
        """Use one pass a step if contact and Python add no forces."""
        return advance_at_once if work.packed.late is None else advance_symplectic_euler


# Leapfrog, or velocity Verlet: x += v dt + a dt^2/2; v += (a_old + a_new) dt/2. Order 2.
#
# The second acceleration is a(x_new, v + a_old dt): the predicted velocity keeps the order where a
# force depends on velocity. Where none does, a_new serves as the next step's a_old unchanged.


@kernel
def advance_leapfrog(x: Float, v: Float, stages: Float, steps: int, dt: float, p: Packed) -> None:
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
            evaluate(x, v, step / steps, a, p)
        add_twice(v, v, 0.5 * dt, a, x, x, dt, v, p.threads)
        hold(p.bodies, p.bodies_on, x, v, (step + 1) / steps, p.threads)
        if p.velocity_matters:
            add(u, v, 0.5 * dt, a, p.threads)
            slow(p.bodies, p.bodies_on, x, u, p.threads)
        evaluate(x, u if p.velocity_matters else v, (step + 1) / steps, b, p)
        add(v, v, 0.5 * dt, b, p.threads)
        slow(p.bodies, p.bodies_on, x, v, p.threads)
        settle(x, v, (step + 1) / steps, p.bodies, p.bodies_on, p.threads)
        a, b = b, a


class Leapfrog(Explicit):
    """Leapfrog: stable for omega dt < 2 undamped."""

    name: ClassVar[str] = "leapfrog"
    order: ClassVar[int] = 2
    loop: ClassVar[Any] = advance_leapfrog
