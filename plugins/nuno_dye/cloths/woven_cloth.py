"""A woven cloth as a plugin, with its resists and supplies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, Field

from nuno_dye.cloths.cloth import Cloth, ClothConfig, FibreConfig, Layout, Tau3Config, coarsen, thin_out
from nuno_dye.quantities import Angle, Length, Metres, Share
from nuno_dye.supplies.resist import read_image, stretch
from nuno_dye.supplies.supply import find_dye
from nuno_dye.weaving_drafts.drawing import draw_draft
from nuno_dye.weaving_drafts.weaves import (
    MatrixConfig,
    PlainConfig,
    SatinConfig,
    TwillConfig,
    draw_plain,
    draw_satin,
    draw_twill,
    read_matrix,
)
from nuno_dye.weaving_drafts.wif import UNDYED, Draft, Yarns, find_loom, read_wif, write_wif
from nuno_schemas.dye import Cells, DyeState, Tortuosity
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.parts import Name
from nuno_schemas.pictures import DrawnDraft
from nuno_schemas.plugin import Config, Files

# Cells of a drawdown: yarns laid out in two layers, up or down by the weave, varied from yarn to yarn.
#
# A yarn has no breaks along its direction, so that gaps are only between the yarns of a layer, and it turns from above
# to below half-way between the yarns that it crosses. Rejected: a gap at every crossing, which a small tau 3 III would
# isolate.

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


# Ikat: yarns of warp or weft that were bound and dyed before they were woven, by a pattern along and across them.
#
# Their dye is fixed: it is a share of V_d, the capacity of fibre, from the start, and does not spread. Dye that was not
# rinsed out is `loose`, a share of V_u, and runs. On the loom each yarn is displaced along itself by up to `shift` from
# its place when bound, which is the blur of ikat.

STREAM = 4
"""Stream of random numbers, different from those of the variation between yarns."""
MOST_IKATS = 64


class Bands(Config):
    """Alternating bound and dyed bands along the yarns."""

    pattern: Literal["bands"] = "bands"
    period: Length = Field(description="along the yarns, from one dyed band to the next [m]")
    width: Length = Field(description="of a dyed band, along the yarns [m]")
    angle: Angle = Field(
        default=0.0, ge=-1.5, le=1.5, description="of the bands against the way across the yarns [rad]"
    )


class Diamonds(Config):
    """Dyed lozenges that touch, with bound ones between them."""

    pattern: Literal["diamonds"] = "diamonds"
    along: Length = Field(description="length of a lozenge along the yarns [m]")
    across: Length = Field(description="width of a lozenge across the yarns [m]")


class IkatImage(Config):
    """An image: black is dyed, white was bound."""

    pattern: Literal["image"] = "image"
    file: str = Field(description="a grey PNG of any size beside the scene, drawn out over the cloth")


class Ikat(Config):
    """Yarns dyed before weaving."""

    yarns: Literal["warp", "weft"] = Field(default="warp", description="whose yarns are dyed")
    dye: Annotated[int, Field(ge=0, le=255)] | Name = Field(
        default=0, description="its name, or its place in the list of dyes, from 0"
    )
    pattern: Annotated[Bands | Diamonds | IkatImage, Field(discriminator="pattern")] = Field(
        description="bands, diamonds or image: where yarns are dyed"
    )
    amount: Share = Field(default=0.5, description="share of what fibre can hold of fixed dye")
    loose: Share = Field(default=0.0, description="share of what a cell can hold of mobile dye, which is there too")
    shift: Annotated[Metres, Field(ge=0)] = Field(
        default=0.0, description="how far each yarn is off along itself at most, either way, at random [m]"
    )


Ikats = Annotated[tuple[Ikat, ...], Field(max_length=MOST_IKATS)]


def dye_yarns(
    items: Sequence[Ikat], cells: Cells, state: DyeState, dyes: Sequence[str], files: Files, seed: int
) -> None:
    """Add the yarns' dye to `state`, in cells of the yarns themselves; of several patterns of one dye the largest
    amount counts. Raises BadInput, at `ikat[i]`, for an unknown dye, and an unusable image.
    """
    for index, item in enumerate(items):
        try:
            dye = find_dye(item.dye, dyes)
        except BadInput as error:
            raise error.at(f"ikat[{index}].dye") from None
        layer = 1 if item.yarns == "warp" else 0
        share = find_share(item, cells, files, np.random.default_rng([seed, STREAM, index]))
        share = np.where(cells.fibre[layer], share, 0.0)
        for amounts, most, capacity in (
            (state.fixed, item.amount, cells.fixed_room), (state.phi, item.loose, cells.mobile_room),
        ):  # fmt: skip
            np.maximum(amounts[dye, layer], most * share * capacity[layer], out=amounts[dye, layer])


def find_share(item: Ikat, cells: Cells, files: Files, stream: np.random.Generator) -> Float:
    """Return the share (ny, nx) of a pattern's dye in a layer, in [0, 1], with its yarns shifted. A yarn has the
    pattern's value at its middle over its whole width, like threads that are dyed through.
    """
    layer = 1 if item.yarns == "warp" else 0
    if cells.yarns is None:
        raise BadInput("the cloth does not tell its yarns apart", field="ikat")
    yarn = cells.yarns[layer]
    place = np.arange(len(yarn)) + 0.5
    middle = np.bincount(yarn, place) / np.maximum(np.bincount(yarn), 1)
    off = stream.uniform(-item.shift, item.shift, len(middle))
    pattern, length = item.pattern, cells.fibre.shape[1 if layer else 2]
    if isinstance(pattern, IkatImage):
        image = stretch(read_image(files.resolve(pattern.file), None, invert=True), cells.fibre.shape[1:])
        lines = _shift((image.T if layer else image)[middle.astype(np.intp)], off / cells.size)
    else:
        along, across = ((np.arange(length) + 0.5) * cells.size - off[:, None]), middle[:, None] * cells.size
        lines = _draw(pattern, along, across)
    return lines[yarn].T if layer else lines[yarn]


def _draw(pattern: Bands | Diamonds, along: Float, across: Float) -> Float:
    """Return 1 where yarns are dyed, at places `along` them and `across` them [m]."""
    if isinstance(pattern, Bands):
        place = along + across * np.tan(pattern.angle)
        return np.asarray(place % pattern.period < pattern.width, np.float64)
    # |p| + |q| <= 1 is a square on its corner, with its middle in the cloth's first corner.
    p, q = (
        2.0 * np.abs(v / side - np.round(v / side)) for v, side in ((along, pattern.along), (across, pattern.across))
    )
    return np.asarray(p + q <= 1.0, np.float64)


def _shift(lines: Float, off: Float) -> Float:
    """Return lines (n, m) displaced by `off` cells each, by linear interpolation, constant beyond their ends."""
    last = lines.shape[1] - 1
    place = np.clip(np.arange(last + 1) - off[:, None], 0.0, last)
    low = place.astype(np.intp)
    line, share = np.arange(len(lines))[:, None], place - low
    return np.asarray((1.0 - share) * lines[line, low] + share * lines[line, np.minimum(low + 1, last)])


class WifConfig(Config):
    """A draft of a weaving program, WIF 1.1."""

    plugin: Literal["wif"] = "wif"
    file: str = Field(description="the WIF file, beside the scene")
    measured: bool = Field(
        default=False, description="yarns as wide and as far apart as the file says, in place of width and gap"
    )


Weave = Annotated[PlainConfig | TwillConfig | SatinConfig | MatrixConfig | WifConfig, Field(discriminator="plugin")]


class WovenClothConfig(WovenConfig):
    """A cloth from a weave and its yarns."""

    weave: Weave = Field(default=PlainConfig(), description="plain, twill, satin, matrix or wif")
    tau3: Tau3Config = Field(description="by kind of face, I to V")
    ikat: Ikats = Field(default=(), description="yarns that were dyed before they were woven")


class WovenCloth(Cloth):
    """A cloth of yarns in two layers that are woven."""

    name: ClassVar[str] = "woven"
    Config: ClassVar[type[BaseModel]] = WovenClothConfig

    def count(self, config: WovenClothConfig, files: Files) -> int:
        nx, ny = fit_draft(config, read_draft(config, files) if config.cells is None else None).coarse_extent
        return 2 * nx * ny

    def build(self, config: WovenClothConfig, files: Files, seed: int, dyes: Sequence[str]) -> tuple[Cells, DyeState]:
        """Build the cloth. Raises BadInput for a weave, resist or ikat that is invalid or does not fit the cloth."""
        draft = read_draft(config, files)
        config = fit_draft(config, draft)
        drawdown, layouts = draw_weave(config, draft)
        cells = build_cells(drawdown, config, config.tau3.with_weave(config.tau2), seed, layouts, config.v_max)
        if draft is not None:
            cells = replace(cells, ground=find_ground(draft, cells))
        cells, state = self.undyed(config, cells, files, len(dyes))
        dye_yarns(config.ikat, cells, state, dyes, files, seed)
        return cells, state

    def left_out(self, config: WovenClothConfig, files: Files) -> tuple[str, ...]:
        """Describe the parts of the weave that the cloth lacks: a file's surplus lines, and yarns that are cut off."""
        draft = read_draft(config, files)
        config = fit_draft(config, draft)
        drawdown, layouts = draw_weave(config, draft)
        (nx, ny), weft, warp = config.extent, config.weft, config.warp
        used = layouts or (lay_evenly(weft.width, weft.gap, ny), lay_evenly(warp.width, warp.gap, nx))
        fitting = [min(int(one.yarn.max()) + 1, number) for one, number in zip(used, drawdown.shape, strict=True)]
        notes = list(draft.left_out) if draft is not None else []
        if fitting != list(drawdown.shape):
            part = f"{fitting[1]} of {drawdown.shape[1]} ends and {fitting[0]} of {drawdown.shape[0]} picks"
            notes.append(f"cells: [{nx}, {ny}] hold {part} of the weave; the others are cut off")
        return tuple(notes)

    def draw_draft(self, path: Path) -> DrawnDraft:
        """Draw a WIF file as weavers do. Raises BadInput for one that does not define a weave."""
        return draw_draft(read_wif(path))

    def write_draft(self, rows: Sequence[str]) -> str:
        """Return a WIF file of a weave drawn as rows of 0 and 1, as in `matrix`. Raises BadInput for no such weave."""
        return write_wif(find_loom(read_matrix(rows)))


def read_draft(config: WovenClothConfig, files: Files) -> Draft | None:
    """Return the draft of a WIF weave, None for any other weave. Raises BadInput."""
    return read_wif(files.resolve(config.weave.file)) if isinstance(config.weave, WifConfig) else None


def fit_draft(config: WovenClothConfig, draft: Draft | None) -> WovenClothConfig:
    """Return the configuration with enough cells for a draft's yarns, if it has none. Raises BadInput."""
    weave = config.weave
    if config.cells is not None or draft is None or not isinstance(weave, WifConfig):
        return config

    def along(what: str, yarns: Yarns, even: YarnConfig, number: int) -> int:
        if weave.measured:
            return max(1, round(float(require_spacing(what, yarns, weave.file).sum()) / config.cell_size))
        return number * (even.width + even.gap)

    picks, ends = draft.drawdown.shape
    across, down = along("WARP", draft.warp, config.warp, ends), along("WEFT", draft.weft, config.weft, picks)
    return config.model_copy(update={"cells": (across, down)})


def find_ground(draft: Draft, cells: Cells) -> tuple[Float, Float] | None:
    """Return colours of the yarns by row of weft and by column of warp; None if the draft has none."""
    if cells.yarns is None or (draft.weft.colour is None and draft.warp.colour is None):
        return None

    def colours(yarns: Yarns, yarn: Int) -> Float:
        palette = np.array([UNDYED]) if yarns.colour is None else yarns.colour
        return palette[yarn % len(palette)]

    return colours(draft.weft, cells.yarns[0]), colours(draft.warp, cells.yarns[1])


def draw_weave(config: WovenClothConfig, draft: Draft | None) -> tuple[Bool, tuple[Layout, Layout] | None]:
    """Return the drawdown (picks, ends), and layouts of weft and warp if a file measures them. Raises BadInput."""
    weave = config.weave
    if isinstance(weave, WifConfig) and draft is not None:
        return draft.drawdown, lay_draft(draft, weave.file, config) if weave.measured else None
    try:
        return _draw_named(weave), None
    except BadInput as error:
        raise replace(error, field=f"weave.{error.field}") from None


def _draw_named(weave: Weave) -> Bool:
    """Return the drawdown (picks, ends) of a weave that the scene defines. Raises BadInput with the weave's field."""
    if isinstance(weave, TwillConfig):
        return draw_twill(weave.over, weave.under, weave.direction)
    if isinstance(weave, SatinConfig):
        return draw_satin(weave.ends, weave.step, weave.face)
    if isinstance(weave, MatrixConfig):
        return read_matrix(weave.rows)
    return draw_plain()


def lay_draft(draft: Draft, file: str, config: WovenConfig) -> tuple[Layout, Layout]:
    """Return layouts of weft and warp as measured. Raises BadInput for a file without spacing, and yarns finer than a
    cell. Yarns of a file without thickness touch.
    """

    def lay(what: str, yarns: Yarns, cells: int) -> Layout:
        unused = sorted(getattr(config, what.lower()).model_fields_set & {"width", "gap"})
        if unused:
            raise BadInput(
                "the yarns are as the file measures them", field=f"{what.lower()}.{unused[0]}",
                remedy="leave it out, or measured: false",
            )  # fmt: skip
        spacing = require_spacing(what, yarns, file)
        thickness = spacing if yarns.thickness is None else np.minimum(yarns.thickness, spacing)
        if thickness.min() < config.cell_size:
            raise BadInput(
                "a yarn is finer than a cell", file=file, field="cell_size", value=config.cell_size,
                limit=f"{thickness.min():g} m, the finest yarn of [{what}]",
            )  # fmt: skip
        return lay_measured(spacing, thickness, config.cell_size, cells)

    return lay("WEFT", draft.weft, config.extent[1]), lay("WARP", draft.warp, config.extent[0])


def require_spacing(what: str, yarns: Yarns, file: str) -> Float:
    """Return the spacing (n,) of yarns [m]. Raises BadInput for a file without spacing."""
    if yarns.spacing is None:
        raise BadInput(
            "the file does not say how far its yarns are apart", file=file, field=f"[{what}] Spacing",
            remedy="measured: false, and width and gap of the yarns in cells",
        )  # fmt: skip
    return yarns.spacing
