"""The classical fourth-order Runge-Kutta method, and a variant with the skirt paper's slips."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from nuno_integrators.explicit.fixed_step import Explicit
from nuno_integrators.explicit.updates import add, add_twice
from nuno_kernels import kernel, shared_source
from nuno_kernels.step.acceleration import Extra, Packed, commit, evaluate
from nuno_schemas.fabric import Float


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
        result: Float = one + h @ (one + h / 2.0 @ (one + h / 3.0 @ (one + h / 4.0)))
        return result


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
