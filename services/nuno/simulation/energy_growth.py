"""Growth of energy beyond all work done, which shows a step that is too long while numbers are finite.

The longest stable step is that of the cloth at its start. Cloth that is stretched, sheared or crushed is stiffer, for a
moment and at a few vertices. Crushed triangles have no bound on that, and a check of the limit once a frame
comes too late: an undamped membrane diverged within ten steps of a frame before which its limit was 1.5 times the step.
Energy shows it. Where gravity alone does work, kinetic and elastic energy are at most those of the start and m g drop.

Work of bodies, wind, pins that move and forces in Python is not summed: a sum over frames misses impacts, and a sum
over steps slows all of them. Instead a frame that ends with more energy than its bound is simulated again in
steps of an eighth. These include the work, but not the energy that the long step added. Half steps are not short
enough: crushed triangles gain energy in them as well.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from nuno_schemas.fabric import Float

NEAREST = 0.95
"""Share of the limit above which the bound on the energy is constant."""
FINER = 8
"""Steps in place of one, in a frame that is simulated again."""
MARGIN = 1.25
"""Factor over the energy bound of a stable step, for its errors of higher order."""


class EnergyGrowth:
    """The energy of a run [J] against its bound.

    Symplectic Euler keeps H = T + U - h v F / 2 of a mode, h being the step, while T + U comes to H / (1 - r) at a
    share r of the limit, and H is at most T + U + 2 r sqrt(T U) of the start; leapfrog keeps T + U nearer. Only more
    than that, for all energy in the fastest mode, is growth.

    account  (2,) kinetic, elastic and gravitational energy of the start, and the largest kinetic and elastic energy
             that gravity has allowed so far; a resumed run continues with it
    """

    def __init__(self, energy: Mapping[str, float], share: float, least: float) -> None:
        """energy: by kind at the start; share: of the longest stable step; least: energy that is never growth [J]."""
        inner, kinetic, r = internal(energy), energy.get("kinetic", 0.0), min(share, NEAREST)
        swing = 2.0 * r * math.sqrt(max(kinetic * (inner - kinetic), 0.0)) / inner if inner > 0.0 else 0.0
        self.factor, self.least = MARGIN * (1.0 + swing) / (1.0 - r), least
        self.account: Float = np.array([sum(energy.values()), inner])

    def exceeds(self, energy: Mapping[str, float]) -> bool:
        """Return whether energy [J] by kind exceeds the bound; false where it is not finite."""
        self.account[1] = max(self.account[1], self.account[0] - energy.get("gravitational", 0.0))
        return self.is_more(energy, float(self.account[1]))

    def is_more(self, energy: Mapping[str, float], available: float) -> bool:
        """Return whether no stable step turns the `available` energy [J] into this energy [J] by kind."""
        return internal(energy) > self.factor * available + self.least

    def allow(self, energy: Mapping[str, float]) -> None:
        """Raise the bound to this energy [J] by kind, as the result of work."""
        self.account[:] = np.maximum(self.account, [sum(energy.values()), internal(energy)])


def internal(energy: Mapping[str, float]) -> float:
    """Return the sum of kinetic and elastic energy [J]."""
    return sum(energy.values()) - energy.get("gravitational", 0.0)
