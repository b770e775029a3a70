"""The explicit integrators of a fixed step, which several tests go through."""

from __future__ import annotations

from typing import Any

from nuno_integrators.explicit.fixed_step import Euler, Leapfrog, SymplecticEuler
from nuno_integrators.explicit.runge_kutta import RK4, RK4Printed

ALL: list[Any] = [Euler(), SymplecticEuler(), Leapfrog(), RK4(), RK4Printed()]
METHODS = ALL[:4]


def name(plugin: Any) -> str:
    return str(plugin.name)
