"""Isotherms: the limit of fixed dye at the mobile amount phi (dye paper, equations 5 to 8).

They are formulas, as those of any package may be (nuno_kernels.formula; docs/how-to/plugins.md).
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, NamedTuple

from pydantic import BaseModel, Field

from nuno_kernels.formula import formula
from nuno_kernels.lanes import lower, splat
from nuno_schemas.dye import Isotherm
from nuno_schemas.plugin import Config

PARTITION, FREUNDLICH, LANGMUIR = 0, 1, 2
KINDS = {"partition": PARTITION, "freundlich": FREUNDLICH, "langmuir": LANGMUIR}
ROUNDS = 60
"""The most Newton steps for Freundlich's limit; four to six suffice."""


@formula
class Known(NamedTuple):
    """The isotherms that come with nuno. Solvers are compiled once for all three.

    kind           one of the isotherms above
    first, second  its parameters: k, k and b, or K
    """

    kind: int
    first: float
    second: float

    def limit(self, phi: Any, room: Any) -> Any:
        """Return k phi, k phi^b, or V_d K phi / (1 + K phi)."""
        if self.kind == PARTITION:
            return self.first * phi
        if self.kind == FREUNDLICH:
            return self.first * phi**self.second
        return room * (self.first * phi) / (1.0 + self.first * phi)

    def least(self, phi: Any) -> Any:
        """Return a bound of Freundlich's limit in eight cells: phi^b >= min(phi, 1), as b <= 1. It usually decides."""
        return self.first * lower(phi, splat(1.0)) if self.kind == FREUNDLICH else splat(-math.inf)

    def root(self, total: float, ways: float, room: float) -> float:
        """Return the x >= 0 with ways x + A_d(x) = total, total > 0."""
        first, second = self.first, self.second
        if self.kind == PARTITION:
            return total / (ways + first)
        if self.kind == FREUNDLICH:
            # Concave in x: from below its root Newton's steps stay below it.
            x = min(0.5 * total / ways, (0.5 * total / first) ** (1.0 / second)) if first > 0.0 else total / ways
            for _ in range(ROUNDS):
                bound = first * x**second
                step = (total - ways * x - bound) / (ways + second * bound / x) if x > 0.0 else 0.0
                x += step
                if step <= 1e-15 * x:
                    break
            return x
        # ways K x^2 + (ways + K (V_d - S)) x - S = 0, the greater root, without cancellation.
        p, q = ways + first * (room - total), 4.0 * ways * first * total
        root = math.sqrt(p * p + q)
        return 2.0 * total / (p + root) if p > 0.0 else (root - p) / (2.0 * ways * first)


def formula_of(isotherm: Isotherm) -> Any:
    """Return the formula of an isotherm. Freundlich's with exponent 1 is partition."""
    if isotherm.law is not None:
        return isotherm.law
    kind = PARTITION if isotherm.kind == "freundlich" and isotherm.second == 1.0 else KINDS[isotherm.kind]
    return Known(kind, isotherm.first, isotherm.second)


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
