"""Pressure of a knit on its body: the inward force of yarns on each point over its share of the surface.

The body bears the inward pull of yarns on a point: p = -F.n / A, F the net force of all links on the point, n the
knit's outward normal there and A its share of the area, a quarter of each cell around it. On a cylinder of radius r
under hoops of tension T, w apart, this is Laplace's law p = T / (r w): of Q points on a hoop each is pulled inwards by
2 T sin(pi / Q) and has the area 2 r sin(pi / Q) w. Weight and friction are not included, and over a hollow p may be
negative: the knit stands off there, or friction holds it.

Points on an edge have half a share of area at the whole tension of their course; the report leaves them out.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import BaseModel, Field

from nuno_kernels.forces.yarn_tension import point_forces
from nuno_knit.quantities import Length, Metres
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Fabric, Float, Int, State
from nuno_schemas.operation import Outcome, Surface
from nuno_schemas.plugin import Config
from nuno_schemas.vectors import unit_rows


class PressureConfig(Config):
    """Named places whose pressure is reported."""

    heights: dict[str, Metres] = Field(default={}, description="named places on the body: how high each is [m]")
    band: Length = Field(default=0.02, description="height of the band around a place that is averaged over [m]")


class Pressure:
    """Computes the pressure [Pa] of yarns on their body, point by point."""

    name: ClassVar[str] = "pressure"
    Config: ClassVar[type[BaseModel]] = PressureConfig

    def apply(self, config: PressureConfig, fabric: Fabric, state: State, skin: Surface | None) -> Outcome:
        """Return the array `pressure` (n,) of all points, 0 for those without cells, and the facts `min`, `mean`, `max`
        over the area inside of the edges, and the mean at every place that the knit covers [Pa].

        Raises BadInput for a fabric without cells.
        """
        if fabric.cells is None or not len(fabric.cells):
            problem = "only what has cells, as a knit has, has a pressure"
            raise BadInput(problem, field="model", value=fabric.name, remedy="use the model knit")
        area, normal, inner = shares(state.x, fabric.cells)
        inward = -(point_forces(fabric, state.x) * normal).sum(axis=1)
        pressure = np.divide(inward, area, out=np.zeros_like(area), where=area > 0.0)
        facts = _facts(pressure, area, inner)
        for name, height in config.heights.items():
            in_band = inner & (np.abs(state.x[:, 1] - height) <= 0.5 * config.band)
            if in_band.any():
                facts[name] = float(np.average(pressure[in_band], weights=area[in_band]))
        return Outcome(facts, None, {"pressure": pressure})


def _facts(pressure: Float, area: Float, inner: Bool) -> dict[str, float]:
    if not (area[inner] > 0.0).any():
        return {}
    inner_pressure = pressure[inner]
    return {
        "min": float(inner_pressure.min()),
        "mean": float(np.average(inner_pressure, weights=area[inner])),
        "max": float(inner_pressure.max()),
    }


def shares(x: Float, cells: Int) -> tuple[Float, Float, Bool]:
    """Return areas (n,) [m^2] and unit normals (n, 3), 0 without area, and whether points (n,) are off the edges.

    A cell's vector area is half the cross product of its diagonals, whether it is flat or not.
    """
    corner = [x[cells[:, c]] for c in range(4)]
    vector = 0.5 * np.cross(corner[2] - corner[0], corner[3] - corner[1])
    size = np.sqrt((vector * vector).sum(axis=1))
    n, every = len(x), cells.T.reshape(-1)
    area: Float = np.bincount(every, np.tile(0.25 * size, 4), n).astype(np.float64)
    normal = np.stack([np.bincount(every, np.tile(vector[:, axis], 4), n) for axis in range(3)], axis=1)
    return area, unit_rows(normal), np.bincount(every, minlength=n) == 4
