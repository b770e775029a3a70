"""Cells of a drawdown: yarns laid out in two layers, up or down by the weave, varied from yarn to yarn.

A yarn has no breaks along its direction, so that gaps are only between the yarns of a layer, and it turns from above to
below half-way between the yarns that it crosses. Rejected: a gap at every crossing, which a small tau 3 III would
isolate.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from nuno_dye.cloths.cloth import ClothConfig, FibreConfig
from nuno_dye.cloths.coarse import Layout, coarsen, thin_out
from nuno_dye.quantities import Share
from nuno_schemas.dye import Cells, Tortuosity
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float
from nuno_schemas.plugin import Config

MOST_CELLS = 2**27
"""The most cells of both layers together: 7 GiB of arrays."""

Number = Annotated[int, Field(ge=1, le=65_536)]
Gap = Annotated[int, Field(ge=0, le=65_536)]
Quantity = Literal["P", "T", "B"]


class YarnConfig(FibreConfig):
    """The yarns of one layer."""

    width: Number = Field(default=8, description="of a yarn, in cells")
    gap: Gap = Field(default=2, description="to the next yarn, in cells")


class VaryConfig(Config):
    """Quantities that differ from yarn to yarn by a factor r, uniform between `low` and `high`."""

    of: tuple[Quantity, ...] = Field(default=("P",), description="P porosity, T tortuosity, B volume taken")
    low: Share = Field(default=0.5, description="smallest r")
    high: Share = Field(default=1.0, description="largest r")


class WovenConfig(ClothConfig):
    """A woven cloth without its weave."""

    cells: tuple[Number, Number] | None = Field(
        default=None,
        description="across and down, in each of the two layers; left out: as many as the yarns of a WIF file take, or "
        "200 x 200 of another weave",
    )
    weft: YarnConfig = Field(default=YarnConfig(), description="yarns along x")
    warp: YarnConfig = Field(default=YarnConfig(), description="yarns along y")
    gap_porosity: Share | None = Field(default=None, description="P of a gap; its layer's yarns' unless given")
    vary: VaryConfig | None = Field(default=None, description="differences from yarn to yarn")

    coarser: Annotated[int, Field(ge=1, le=8)] = Field(
        default=1, description="the same cloth in cells so many times as large, and fewer: quicker, smaller, less exact"
    )

    @property
    def extent(self) -> tuple[int, int]:
        """Cells across and down, before coarsening."""
        return self.cells or (200, 200)

    @property
    def coarse_extent(self) -> tuple[int, int]:
        """Cells across and down of the cloth, after coarsening."""
        nx, ny = self.extent
        return nx // self.coarser, ny // self.coarser


def lay_evenly(width: int, gap: int, cells: int) -> Layout:
    """Return the layout of yarns of a width with a gap between them, each in the middle of its pitch."""
    yarn, place = np.divmod(np.arange(cells), width + gap)
    before = gap // 2
    return Layout(yarn.astype(np.int32), (place >= before) & (place < before + width))


def lay_measured(spacing: Float, thickness: Float, size: float, cells: int) -> Layout:
    """Return the layout of yarns with pitches `spacing` and widths `thickness` (k,) [m], repeated over cells of `size`
    [m]. A cell belongs to the yarn whose pitch contains its middle, and is fibre if that is within the yarn's width.
    """
    ends = np.cumsum(spacing)
    turn, middle = np.divmod((np.arange(cells) + 0.5) * size, ends[-1])
    yarn = np.minimum(np.searchsorted(ends, middle, side="right"), len(ends) - 1)
    away = np.abs(middle - (ends[yarn] - 0.5 * spacing[yarn]))
    return Layout((turn.astype(np.int64) * len(ends) + yarn).astype(np.int32), away <= 0.5 * thickness[yarn])


def build_cells(
    drawdown: Bool, config: WovenConfig, tortuosity: Tortuosity, seed: int, lays: tuple[Layout, Layout] | None = None,
    v_max: float = 1.0,
) -> Cells:  # fmt: skip
    """Build the cells of a cloth from a weave, repeated over all yarns. `lays` are those of weft and warp, if yarns
    are not even. Raises BadInput for a cloth of too many cells, and for a variation of nothing.
    """
    (across_all, down_all), weft, warp = config.extent, config.weft, config.warp
    _check_size(config)
    fine = lays or (lay_evenly(weft.width, weft.gap, down_all), lay_evenly(warp.width, warp.gap, across_all))
    (down, across), (nx, ny) = (thin_out(layout, config.coarser) for layout in fine), config.coarse_extent
    picks, ends = drawdown.shape
    over = drawdown[np.ix_(down.yarn % picks, across.yarn % ends)]
    fibre = np.empty((2, ny, nx), np.bool_)
    fibre[0], fibre[1] = down.fibre[:, None], across.fibre
    porosity, twist, resist = np.empty((3, 2, ny, nx))
    for layer, (yarn, layout) in enumerate(((weft, down), (warp, across))):
        values = _values_by_cell(yarn, layout, config, seed, layer)
        shape = (ny, 1) if layer == 0 else (1, nx)
        porosity[layer], twist[layer], resist[layer] = (value.reshape(shape) for value in values)
    up, yarns = np.stack([~over, over]), (down.yarn, across.yarn)
    return Cells(
        fibre, up, porosity, twist, resist, config.cell_size * config.coarser, coarsen(tortuosity, config.coarser),
        v_max=v_max, yarns=yarns, coarser=config.coarser,
    )  # fmt: skip


def _values_by_cell(
    yarn: YarnConfig, layout: Layout, config: WovenConfig, seed: int, layer: int
) -> tuple[Float, Float, Float]:
    """Return P, tau 1 and B across a layer's yarns. A gap has the nominal P, no twist and no resist."""
    in_gap = yarn.porosity if config.gap_porosity is None else config.gap_porosity
    nominal: tuple[tuple[Quantity, float, float], ...] = (
        ("P", yarn.porosity, in_gap), ("T", yarn.twist, 1.0), ("B", yarn.resist, 0.0),
    )  # fmt: skip
    p, t, b = (
        np.where(layout.fibre, value * draw_factors(config.vary, name, layout, seed, layer), gap)
        for name, value, gap in nominal
    )
    return p, t, b


def draw_factors(vary: VaryConfig | None, name: Quantity, layout: Layout, seed: int, layer: int) -> Float:
    """Return the factor r (n,) of each cell's yarn. Quantities and layers have streams of their own: more wefts change
    no warps.
    """
    if vary is None or name not in vary.of:
        return np.ones(len(layout.yarn))
    stream = np.random.default_rng([seed, "PTB".index(name), layer])
    return stream.uniform(vary.low, vary.high, int(layout.yarn.max()) + 1)[layout.yarn]


def _check_size(config: WovenConfig) -> None:
    nx, ny = config.coarse_extent
    if not nx * ny:
        problem, limit = "no cell is left", f"{min(config.extent)}, the cells across or down"
        raise BadInput(problem, field="coarser", value=config.coarser, limit=limit)
    if 2 * nx * ny > MOST_CELLS:
        raise BadInput("too many cells", field="cells", value=f"2 x {ny} x {nx}", limit=f"{MOST_CELLS}")
    vary = config.vary
    if vary is None:
        return
    if vary.low > vary.high:
        raise BadInput("the smallest r is above the largest", field="vary.low", value=vary.low, limit=f"{vary.high}")
    if "B" in vary.of and config.weft.resist == config.warp.resist == 0.0:
        raise BadInput(
            "B is 0, and stays 0 times any r", field="vary.of", value="B", remedy="a resist for weft or warp"
        )
