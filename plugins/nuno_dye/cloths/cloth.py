"""The common parts of all cloths to dye: tortuosities, resists, supplies of dye, and the same cloth in fewer, larger
cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from nuno_dye.quantities import CellSize, Positive, Share
from nuno_dye.supplies.resist import Resists, find_resists, put_on
from nuno_dye.supplies.supply import Supplies, prepare_supplies
from nuno_schemas.dye import Cells, DyeState, Supply, Tortuosity
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.plugin import Config, Files

# The same cloth in fewer, larger cells: their layout, and the tortuosities of their faces.
#
# A cell in the place of n x n others has n^2 times their area, and its middle is n cells from the next one's. Flow from
# cell to cell in a layer is proportional to T over that distance: faces between cells of one kind keep their T, and a
# face between two kinds conducts like n faces in series,
#
#     n / T' = (n - 1) / 2 (1 / T_a + 1 / T_b) + 1 / T_ab.
#
# Flow to the other layer, and into fibre, is proportional to T and D_ab over the square of a cell's side, which stands
# for the distance of the layers, and of fibre from liquor. It stays the same in larger cells with n^2 T and n^2 D_ab.


class Layout(NamedTuple):
    """The layout of a layer's yarns, by cell across them.

    yarn   (n,) int32  the yarn whose pitch contains the cell
    fibre  (n,) bool   whether the cell is in the yarn, not in a gap
    """

    yarn: Int
    fibre: Bool


def thin_out(layout: Layout, times: int) -> Layout:
    """Return the layout at the middle of every `times` cells. Raises BadInput if it could miss a yarn or a gap."""
    if times == 1:
        return layout
    label = np.where(layout.fibre, layout.yarn + 1, 0)
    starts = np.flatnonzero(np.diff(label)) + 1
    finest = int(np.diff(starts).min(initial=len(label)))
    if finest < times:
        raise BadInput(
            "a yarn or a gap is narrower than a cell would be", field="coarser", value=times,
            limit=f"{finest} cells, the narrowest yarn or gap between yarns",
            remedy="a smaller number, or larger cells with yarns given in them",
        )  # fmt: skip
    places = slice(times // 2, len(label) // times * times, times)
    return Layout(layout.yarn[places], layout.fibre[places])


def coarsen(tortuosity: Tortuosity, times: int) -> Tortuosity:
    """Return the tortuosities of cells that are `times` as large."""
    t, n = tortuosity, times
    # tau 2 multiplies only the middle face, between fibre above and below, not the rest of the way.
    weave = _in_series(n, 1.0, t.weave, 1.0)
    return replace(t, layers=n * n * t.layers, rim=_in_series(n, t.beside, t.rim, t.gap), weave=weave)


def _in_series(n: int, before: float, between: float, after: float) -> float:
    """Return T of n faces in series, the middle one between two kinds; 0 if one lets nothing pass."""
    rest = 0.5 * (n - 1)
    if between == 0.0 or (rest and 0.0 in (before, after)):
        return 0.0
    return n / (1.0 / between + (rest / before + rest / after if rest else 0.0))


# The common parts of all cloths to dye: tortuosities, resists and supplies of dye.

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
