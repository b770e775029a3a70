"""The explicit integrators of a fixed step, which several tests go through."""

from __future__ import annotations

from typing import Any

from nuno_integrators.explicit.euler import Euler
from nuno_integrators.explicit.leapfrog import Leapfrog
from nuno_integrators.explicit.rk4 import RK4, RK4Printed
from nuno_integrators.explicit.symplectic_euler import SymplecticEuler

ALL: list[Any] = [Euler(), SymplecticEuler(), Leapfrog(), RK4(), RK4Printed()]
METHODS = ALL[:4]


def name(plugin: Any) -> str:
    return str(plugin.name)
