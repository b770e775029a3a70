"""Leapfrog, or velocity Verlet: x += v dt + a dt^2/2; v += (a_old + a_new) dt/2. Order 2.

The second acceleration is a(x_new, v + a_old dt): the predicted velocity keeps the order where a
force depends on velocity. Where none does, a_new serves as the next step's a_old unchanged.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from nuno_integrators.explicit.fixed_step import Explicit
from nuno_integrators.explicit.updates import add, add_twice
from nuno_kernels import kernel
from nuno_kernels.step.acceleration import Extra, Packed, evaluate, hold, settle, slow
from nuno_schemas.fabric import Float


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
