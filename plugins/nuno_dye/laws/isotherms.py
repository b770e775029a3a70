"""Isotherms: the limit of fixed dye at the mobile amount phi (dye paper, equations 5 to 8).

The formulas are in the kernels: limits in adsorption.py and solvers/fixing.py, solutions with them in closed form in
solvers/fixing.py and solvers/implicit.py, names in `KINDS` (solvers/solving.py). A formula of any package needs none of
these (nuno_kernels.formula; docs/how-to/plugins.md): solvers find its root by themselves.
"""

from __future__ import annotations

from typing import ClassVar

from pydantic import BaseModel, Field

from nuno_schemas.dye import Isotherm
from nuno_schemas.plugin import Config

MOST = 1e12
"""Largest coefficient: amounts are fractions, so that a larger one has the same effect."""


class PartitionConfig(Config):
    """A_d = k phi."""

    k: float = Field(ge=0, le=MOST, description="fixed to mobile dye at rest")


class FreundlichConfig(Config):
    """A_d = k phi^b."""

    k: float = Field(ge=0, le=MOST, description="fixed dye where phi is 1")
    b: float = Field(ge=0.1, le=1, description="exponent")


class LangmuirConfig(Config):
    """A_d = V_d K phi / (1 + K phi)."""

    K: float = Field(ge=0, le=MOST, description="K_L: fibre is filled by half where phi is 1 / K")


class Partition:
    """Fixed dye in proportion to mobile dye."""

    name: ClassVar[str] = "partition"
    Config: ClassVar[type[BaseModel]] = PartitionConfig

    def prepare(self, config: PartitionConfig) -> Isotherm:
        return Isotherm("partition", config.k)


class Freundlich:
    """Fixed dye as a power of mobile dye."""

    name: ClassVar[str] = "freundlich"
    Config: ClassVar[type[BaseModel]] = FreundlichConfig

    def prepare(self, config: FreundlichConfig) -> Isotherm:
        return Isotherm("freundlich", config.k, config.b)


class Langmuir:
    """Fixed dye in a limited number of places."""

    name: ClassVar[str] = "langmuir"
    Config: ClassVar[type[BaseModel]] = LangmuirConfig

    def prepare(self, config: LangmuirConfig) -> Isotherm:
        return Isotherm("langmuir", config.K)
