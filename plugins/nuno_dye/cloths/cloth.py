"""The common parts of all cloths to dye: tortuosities, resists and supplies of dye."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from nuno_dye.quantities import CellSize, Positive, Share
from nuno_dye.supplies.resist import Resists, find_resists, put_on
from nuno_dye.supplies.supply import Supplies, prepare_supplies
from nuno_schemas.dye import Cells, DyeState, Supply, Tortuosity
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import Config, Files

Tau = Annotated[float, Field(ge=0, le=1)]


class Tau3Config(Config):
    """Tortuosity of the way from a cell to its neighbour, 0 to 1: 1 is straight, 0 lets nothing pass."""

    I: Tau = Field(description="to the other layer")  # noqa: E741
    II: Tau = Field(description="in a layer, across the yarn")
    III: Tau = Field(description="between fibre and gap")
    IV: Tau = Field(default=1.0, description="between gap and gap")
    V: Tau = Field(default=1.0, description="in a layer, along the yarn")

    def with_weave(self, tau2: float) -> Tortuosity:
        """Return all tortuosities of a cloth, with this tau 2."""
        return Tortuosity(layers=self.I, beside=self.II, rim=self.III, gap=self.IV, yarn=self.V, weave=tau2)


class ClothConfig(Config):
    """The fields of every cloth."""

    cell_size: CellSize = Field(default=5e-5, description="side of a cell [m]")
    tau2: Tau = Field(default=1.0, description="in a layer, between fibre above and fibre below")
    v_max: Positive = Field(default=1.0, description="capacity of a cell")
    resist: Resists = Field(default=(), description="resists, which keep dye out of both layers")
    supply: Supplies = Field(default=(), description="dye that is given, at the start and later")


class FibreConfig(Config):
    """The fibre of one layer."""

    porosity: Share = Field(default=0.5, description="P, share of the yarn that is not fibre")
    twist: Share = Field(default=1.0, description="tau 1; smaller is more twisted")
    resist: Share = Field(default=0.0, description="B, share of the room for mobile dye that is taken")


class Cloth:
    """The base of cloths, with their resists and supplies."""

    def resists(self, config: Any, cells: Cells, files: Files) -> tuple[Float, ...]:
        """Return B of each resist. Raises BadInput for one that covers no cell, and an image that does not fit."""
        _, ny, nx = cells.fibre.shape
        return find_resists(config.resist, (ny, nx), cells.size, files)

    def supplies(self, config: Any, cells: Cells, dyes: Sequence[str]) -> tuple[Supply, ...]:
        """Return the supplies. Raises BadInput for one outside of the cloth, or of a dye that is not in the scene."""
        _, ny, nx = cells.fibre.shape
        return prepare_supplies(config.supply, (ny, nx), cells.size, dyes)

    def undyed(self, config: Any, cells: Cells, files: Files, dyes: int) -> tuple[Cells, DyeState]:
        """Return the cells with their resists, and without dye. Raises BadInput as `resists`."""
        put_on(self.resists(config, cells, files), cells)
        empty = np.zeros((dyes, *cells.fibre.shape))
        return cells, DyeState(empty, empty.copy())
