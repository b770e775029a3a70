"""Symplectic Euler: v += a dt from the old state, damping included, then x += v_new dt. Order 1."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from nuno_integrators.explicit import Explicit
from nuno_kernels import kernel, shared_source
from nuno_kernels.acceleration import commit, evaluate, step_at_once
from nuno_kernels.updates import add_twice
from nuno_schemas.fabric import Float


@shared_source
def march(x: Any, v: Any, stages: Any, steps: int, dt: float, p: Any, extra: Any, late: Any) -> None:
    """Forces first, then both updates; where nothing adds to the forces, all in one pass between two states."""
    if late is not None:
        a = stages[0]
        for step in range(steps):
            evaluate(x, v, step / steps, a, p, extra)
            add_twice(v, v, dt, a, x, x, dt, v, p.threads)
            commit(x, v, (step + 1) / steps, p.bindings, p.contact, p.threads)
    if late is None:
        here_x, here_v, to_x, to_v = x, v, stages[0], stages[1]
        for step in range(steps):
            step_at_once(here_x, here_v, step / steps, to_x, to_v, dt, p)
            here_x, here_v, to_x, to_v = to_x, to_v, here_x, here_v
            commit(here_x, here_v, (step + 1) / steps, p.bindings, p.contact, p.threads)
        if steps % 2 == 1:
            x[...] = here_x
            v[...] = here_v


@kernel
def advance_symplectic_euler(x: Any, v: Any, stages: Any, steps: int, dt: float, p: Any, extra: Any) -> None:
    """`steps` steps of x, v (3, n); stages (2, 3, n)."""
    march(x, v, stages, steps, dt, p, extra, p.late)


class SymplecticEuler(Explicit):
    """Stable for damping dt + omega^2 dt^2 / 2 < 2; the skirt paper's "FB Euler"."""

    name: ClassVar[str] = "symplectic_euler"
    order: ClassVar[int] = 1
    buffers: ClassVar[int] = 2
    loop: ClassVar[Any] = advance_symplectic_euler

    def amplification(self, omega: float, damping: float, dt: float) -> Float:
        """(2, 2) matrix of one step on x'' = -omega^2 x - damping x', state (x, v)."""
        square, kept = omega * omega * dt, 1.0 - damping * dt
        return np.array([[1.0 - square * dt, kept * dt], [-square, kept]])
