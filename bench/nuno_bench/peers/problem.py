"""The stiff sheet as plain arrays, which any engine can be given, and how an end is judged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.fabric import Float

SCENE = "stiff-sheet"
SECONDS = 1.0
"""Simulated time [s]."""
RATE = 60
"""Published frames a second."""
REFERENCE = "plugin: dop853, tolerance: 1e-8, dt: auto"
"""The solver of the converged run."""
CENTRE, STRAIN = 6e-3, 0.2
"""Largest errors of an accurate end: of its centre of mass [m], and of its mean strain as a share."""


@dataclass(frozen=True)
class Sheet:
    """Vertices and springs of a sheet at rest.

    x       (n, 3) positions [m], in which every spring has its rest length
    mass    (n,) [kg]; pinned (n,) bool
    pairs   (s, 2) int64; k, rest, c (s,) [N/m, m, N s/m]
    gravity (3,) [m/s^2]; drag is a deceleration in proportion to velocity [1/s]
    """

    x: Float
    mass: Float
    pinned: NDArray[np.bool_]
    pairs: NDArray[np.int64]
    k: Float
    rest: Float
    c: Float
    gravity: Float
    drag: float

    @property
    def free(self) -> NDArray[np.bool_]:
        return np.asarray(~self.pinned)


class Peer(Protocol):
    """An engine with what is posed in it; it is made as `cls(posed, **setting)`.

    remark is what a user should know of the last run, e.g. that something did not converge.
    """

    remark: str

    def reset(self) -> None:
        """Back to the start; in no time that is measured."""

    def advance(self, seconds: float) -> Float:
        """Positions [m]: (n, 3) after this time, or (frames, n, 3) of all frames until then, as what judges them takes
        them. Raises RuntimeError where the engine breaks down.
        """


@dataclass(frozen=True)
class SheetScore:
    """How far an end is from the converged one: the centre of mass [m], the mean strain as a share of the
    converged run's, and the largest strain of any spring.
    """

    centre: float
    strain: float
    peak: float

    @property
    def stretched(self) -> bool:
        """Whether the strain is off by more than an accurate one may be."""
        return abs(self.strain - 1.0) > STRAIN

    @property
    def accurate(self) -> bool:
        return self.centre <= CENTRE and not self.stretched


def judge(sheet: Sheet, x: Float, exact: Float) -> SheetScore:
    """Score an end against the converged one, both (n, 3) [m]."""
    own, other = _strains(sheet, x), _strains(sheet, exact)
    centre = np.linalg.norm(sheet.mass @ (x - exact)) / sheet.mass.sum()
    return SheetScore(float(centre), float(own.mean() / other.mean()), float(own.max()))


def _strains(sheet: Sheet, x: Float) -> Float:
    ends = x[sheet.pairs]
    return np.asarray(np.abs(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / sheet.rest - 1.0))
