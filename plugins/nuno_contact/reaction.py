"""The stiffness of cloth at each vertex, and that of contact, which is measured by it."""

from __future__ import annotations

import numpy as np

from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.vectors import norm

STOP_SPEED = 1.0
"""A vertex that arrives at this speed [m/s] is stopped within a given depth, if its stiffness is no more than what its
share of the springs allows."""


def auto_stiffness(fabric: Fabric, gravity: Float, rest: float, stop: float, share: float) -> Float:
    """Return the contact stiffness (n,) of each vertex [N/m]: k = m max(g / rest, min(w0^2, share sum_j k_j / m)).

    w0 = STOP_SPEED / stop stops an arriving vertex within `stop` [m]: of 1 mm, m g / w0^2 is only 10 um at rest. The
    rows of the spring matrix bound its largest eigenvalue by w^2 <= 2 max_i sum_j k_j / m_i (Gershgorin), so contact at
    a quarter of a row's sum raises the bound by an eighth and shortens the stable step by at most about 6 %. Where
    springs are that soft, the depth at rest [m] still holds; gravity may be zero, since the other two terms do not need
    it. A vertex without springs is stopped at w0.
    """
    weight, elastic = fabric.mass * float(norm(gravity)) / rest, fabric.stiffness()
    elastic = share * np.where(elastic == 0.0, np.inf, elastic)
    return np.maximum(weight, np.minimum(fabric.mass * (STOP_SPEED / stop) ** 2, elastic))
