"""Explicit Euler: x += v dt, v += a dt, both from the old state. Order 1, never stable undamped."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from nuno_integrators.explicit.fixed_step import Explicit
from nuno_integrators.explicit.updates import add_twice
from nuno_kernels import kernel
from nuno_kernels.step.acceleration import Extra, Packed, commit, evaluate
from nuno_schemas.fabric import Float


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
