"""Wind and air drag as force plugins; the laws are in nuno_cloth.wind.kernels."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import BaseModel, Field

from nuno_cloth.models.placement import Velocity
from nuno_cloth.quantities import AirDensity, Angle, Newtons, Ratio
from nuno_cloth.wind.kernels import ParticleWind, prepare_wind
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.plugin import Config
from nuno_schemas.system import Term


class WindConfig(Config):
    """The air, and the drag coefficients of a flat plate in it.

    normal 1.17 is a square plate across the flow (Hoerner, Fluid-Dynamic Drag, 1965); tangential
    0.01 is laminar skin friction on two sides at a Reynolds number of about 10^5 (2 x 1.328 /
    sqrt(Re), Blasius).
    """

    velocity: Velocity = Field(default=(0.0, 0.0, 0.0), description="of the air [m/s]; zero is still air: drag alone")
    density: AirDensity = Field(default=1.2, description="of the air [kg/m^3]")
    normal: Ratio = Field(default=1.17, description="drag coefficient of cloth across the flow")
    tangential: Ratio = Field(
        default=0.01, description="friction coefficient of cloth along the flow, both sides together"
    )


class Wind:
    """Wind and drag on every triangle, by the angle between its normal and the relative wind."""

    name: ClassVar[str] = "wind"
    any_numbering: ClassVar[bool] = True
    Config: ClassVar[type[BaseModel]] = WindConfig

    def prepare(self, config: WindConfig, fabric: Fabric, seed: int) -> Term:
        """Return the wind's term. Raises BadInput for a fabric without faces."""
        if fabric.faces.shape[0] == 0:
            raise BadInput(
                f"wind blows on triangles, and {fabric.name!r} has none",
                remedy="use particle_wind, which pushes particles",
            )
        velocity = np.asarray(config.velocity, np.float64)
        data = prepare_wind(fabric.faces, fabric.number, velocity, config.density, config.normal, config.tangential)
        return Term("wind", data)


class ParticleWindConfig(Config):
    """The direction is (cos beta sin gamma, sin beta sin gamma, cos gamma)."""

    strength: Newtons = Field(description="the skirt paper's alpha, on each particle [N]")
    beta: Angle = Field(default=0.0, description="angle of the wind's direction about z, from x [rad]")
    gamma: Angle = Field(default=0.0, description="angle of the wind's direction from z [rad]")


class ParticleWindForce:
    """The skirt paper's wind: the same force on every particle, whatever its velocity or area. Its sum grows with the
    number of vertices, so it suits fabrics set by hand.
    """

    name: ClassVar[str] = "particle_wind"
    any_numbering: ClassVar[bool] = True
    Config: ClassVar[type[BaseModel]] = ParticleWindConfig

    def prepare(self, config: ParticleWindConfig, fabric: Fabric, seed: int) -> Term:
        return Term("particle_wind", (ParticleWind(direction(config.beta, config.gamma) * config.strength),))


def direction(beta: float, gamma: float) -> Float:
    """Return the unit vector (3,) of the skirt paper's angles."""
    return np.array([np.cos(beta) * np.sin(gamma), np.sin(beta) * np.sin(gamma), np.cos(gamma)])
