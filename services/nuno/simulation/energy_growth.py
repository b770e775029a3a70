"""Energy that grows by more than all work done: how a step that is too long shows itself while numbers are finite.

The longest stable step is that of the cloth at its start. Cloth that is stretched, sheared or crushed is stiffer, for a
moment and at a few vertices. Triangles that are crushed have no bound on that, and a look at the limit once a frame
comes too late: an undamped membrane was lost within ten steps of a frame before which its limit was 1.5 times the step.
Energy shows it. Where gravity alone does work, kinetic and elastic energy are at most those of the start and m g drop.

Work of bodies, wind, pins that move and forces in Python is not summed: a sum over frames misses impacts, and a sum
over steps slows all of them. Instead a frame that ends with more energy than is accounted for is simulated again in
steps of an eighth. Work is done then, too; what the step itself brought in is not there. Half steps are not short
enough: triangles that are crushed gain energy in them as well.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from nuno_schemas.fabric import Float

NEAREST = 0.95
"""Share of the limit from which on the bound on the energy stays as it is."""
FINER = 8
"""Steps for one, of a frame that is simulated again."""
MARGIN = 1.25
"""Over the bound on what a stable step makes of the energy: errors of its higher orders."""


class EnergyGrowth:
    """The energy of a run [J] against what there is for it.

    Symplectic Euler keeps H = T + U - h v F / 2 of a mode, h being the step, while T + U comes to H / (1 - r) at a
    share r of the limit, and H is at most T + U + 2 r sqrt(T U) of the start; leapfrog keeps T + U nearer. Only more
    than that, for all energy in the fastest mode, is growth.

    account  (2,) kinetic, elastic and gravitational energy of the start, and the most kinetic and elastic energy that
             gravity has left room for so far; a run that is resumed goes on with it
    """

    def __init__(self, energy: Mapping[str, float], share: float, least: float) -> None:
        """energy: by kind at the start; share: of the longest stable step; least: energy that is never growth [J]."""
        inner, kinetic, r = internal(energy), energy.get("kinetic", 0.0), min(share, NEAREST)
        swing = 2.0 * r * math.sqrt(max(kinetic * (inner - kinetic), 0.0)) / inner if inner > 0.0 else 0.0
        self.factor, self.least = MARGIN * (1.0 + swing) / (1.0 - r), least
        self.account: Float = np.array([sum(energy.values()), inner])

    def exceeds(self, energy: Mapping[str, float]) -> bool:
        """Whether it is more than there is for it; never where it is not finite."""
        self.account[1] = max(self.account[1], self.account[0] - energy.get("gravitational", 0.0))
        return self.is_more(energy, float(self.account[1]))

    def is_more(self, energy: Mapping[str, float], there: float) -> bool:
        """Whether a step that is stable does not make it of the energy that is `there` [J]."""
        return internal(energy) > self.factor * there + self.least

    def allow(self, energy: Mapping[str, float]) -> None:
        """Take it for what work has come to."""
        self.account[:] = np.maximum(self.account, [sum(energy.values()), internal(energy)])


def internal(energy: Mapping[str, float]) -> float:
    """Kinetic and elastic energy [J]."""
    return sum(energy.values()) - energy.get("gravitational", 0.0)
