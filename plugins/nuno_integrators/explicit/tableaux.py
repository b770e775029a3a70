"""Embedded Runge-Kutta pairs: Dormand & Prince 5(4) and 8(5,3), with output between steps.

Coefficients are SciPy's: those of Hairer, Norsett & Wanner 1993, "Solving Ordinary Differential Equations I", section
II.5 and the programs DOPRI5 and DOP853; the fourth-order output of DOPRI5 is Shampine's (1986,
Math. Comp. 46, 135-150).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.integrate import DOP853 as EIGHTH
from scipy.integrate import RK45

from nuno_schemas.fabric import Float


@dataclass(frozen=True)
class Tableau:
    """One pair, whose last stage is at the end of the step and is the first of the next.

    order   of the result; `estimate` is that of the error estimate, which sets the step
    a       (s, s) weights; rows from `stages` on serve the output between steps alone
    c       (s,) fractions of the step
    errors  (1, stages) or (2, stages) weights of the estimate; of two, the first is the leading one
    output  theta -> (s,) weights of the state at fraction theta of the step
    """

    order: int
    estimate: int
    stages: int
    a: Float
    c: Float
    errors: Float
    output: Callable[[float], Float]

    @cached_property
    def aa(self) -> Float:
        """Return the weights (s, s) of the positions, A A: see nuno_integrators.explicit.combine."""
        return self.a @ self.a

    @cached_property
    def position_errors(self) -> Float:
        """Return the weights (1 or 2, stages) of the position error's estimate."""
        used: Float = self.errors @ self.a[: self.stages, : self.stages]
        return used

    @cached_property
    def polynomial(self) -> tuple[float, ...]:
        """Coefficients of 1, z, z^2, ... of the stability polynomial: a step on y' = z y multiplies y with it.

        The stages are the sum of z^k A^k 1, and the last one is the step's end.
        """
        power, found = np.ones(self.stages), []
        for _ in range(self.stages):
            found.append(float(power[-1]))
            power = self.a[: self.stages, : self.stages] @ power
        return tuple(found)


def _dopri5_output(theta: float) -> Float:
    powers = theta ** np.arange(1, 5)
    weights: Float = powers @ np.ascontiguousarray(RK45.P.T)
    return weights


def _dop853_output(theta: float) -> Float:
    """Evaluate Hairer's nested form, outermost last: factors theta and 1 - theta in turn."""
    end = _A8[12]
    first, last = np.eye(16)[0], np.eye(16)[12]
    parts = [end, first - end, 2.0 * end - (first + last), *EIGHTH.D]
    weights = np.zeros(16)
    for i, part in enumerate(reversed(parts)):
        weights = (weights + part) * (theta if i % 2 == 0 else 1.0 - theta)
    return weights


def _square(*parts: Float) -> Float:
    """Return (s, s) weights of s rows in all, each padded with zeros."""
    rows = [row for part in parts for row in np.atleast_2d(part)]
    return np.array([np.pad(row, (0, len(rows) - len(row))) for row in rows])


_A5, _A8 = _square(RK45.A, RK45.B), _square(EIGHTH.A, EIGHTH.B, EIGHTH.A_EXTRA)
"""The row after the stages ends the step; those of DOP853 behind it serve the output between steps alone."""
_C8 = np.concatenate([EIGHTH.C, [1.0], EIGHTH.C_EXTRA])
DOPRI5 = Tableau(5, 4, 7, _A5, _A5.sum(axis=1), 0.0 - RK45.E[None], _dopri5_output)
DOP853 = Tableau(8, 7, 13, _A8, _C8, np.stack([EIGHTH.E5, EIGHTH.E3]), _dop853_output)
