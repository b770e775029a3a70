"""Symplectic Euler: v += a dt from the old state, damping included, then x += v_new dt. Order 1."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from nuno_integrators.explicit.fixed_step import Explicit
from nuno_integrators.explicit.updates import add_twice
from nuno_kernels import kernel
from nuno_kernels.step.acceleration import Extra, Packed, add_forces, commit, evaluate
from nuno_kernels.step.blocks import copy_rows
from nuno_schemas.fabric import Float


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
