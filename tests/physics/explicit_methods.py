"""The explicit integrators of a fixed step, which several tests go through."""

from __future__ import annotations

from typing import Any

from nuno_integrators.euler import Euler
from nuno_integrators.leapfrog import Leapfrog
from nuno_integrators.rk4 import RK4, RK4Printed
from nuno_integrators.symplectic_euler import SymplecticEuler

ALL: list[Any] = [Euler(), SymplecticEuler(), Leapfrog(), RK4(), RK4Printed()]
METHODS = ALL[:4]


def name(plugin: Any) -> str:
    return str(plugin.name)
