"""A cloth from arrays, cell by cell, so that anybody can pose an exact problem."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from pydantic import BaseModel, Field

from nuno_dye.cloths.cells_file import load_arrays, read_shape
from nuno_dye.quantities import CellSize
from nuno_dye.supplies.resist import Resists, find_resists, put_on
from nuno_dye.supplies.supply import Supplies, prepare_supplies
from nuno_schemas.dye import Cells, DyeState, Supply, Tortuosity
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float
from nuno_schemas.plugin import Config, Files

Tau = Annotated[float, Field(ge=0, le=1)]

ROUNDING = 1e-12
"""Relative: an amount that is over its room by no more is a full cell, computed in another order."""


class Tau3Config(Config):
    """How straight dye's way is from a cell to its neighbour, 0 to 1; 0 lets nothing pass."""

    I: Tau = Field(description="to the other layer")  # noqa: E741
    II: Tau = Field(description="in a layer, across the yarn")
    III: Tau = Field(description="between fibre and gap")
    IV: Tau = Field(default=1.0, description="between gap and gap")
    V: Tau = Field(default=1.0, description="in a layer, along the yarn")

    def with_weave(self, tau2: float) -> Tortuosity:
        """All of a cloth's, tau 2 among them."""
        return Tortuosity(layers=self.I, beside=self.II, rim=self.III, gap=self.IV, yarn=self.V, weave=tau2)


class CellsConfig(Config):
    """Arrays of a file, as they are."""

    file: str = Field(
        description="a .npz beside the scene; each of its arrays is (2, ny, nx), layer 0 the weft, whose yarns lie "
        "along x, layer 1 the warp: fibre and up bool, porosity, tau1, resist, phi (mobile dye), fixed; phi and "
        "fixed are (dyes, 2, ny, nx) where there are several dyes; no other key"
    )
    cell_size: CellSize = Field(description="side of a cell [m]")
    tau2: Tau = Field(default=1.0, description="in a layer, between fibre above and fibre below")
    tau3: Tau3Config = Field(description="by kind of face, I to V")
    v_max: float = Field(default=1.0, gt=0, le=1e12, description="most that a cell holds")
    resist: Resists = Field(default=(), description="what keeps dye out on both layers, beside the file's")
    supply: Supplies = Field(default=(), description="dye that is given, at the start and later")


class CellsCloth:
    """Exactly the cells of the file."""

    name: ClassVar[str] = "cells"
    Config: ClassVar[type[BaseModel]] = CellsConfig

    def count(self, config: CellsConfig, files: Files) -> int:
        _, ny, nx = read_shape(files.resolve(config.file))
        return 2 * ny * nx

    def build(self, config: CellsConfig, files: Files, seed: int, dyes: int) -> tuple[Cells, DyeState]:
        """Raises BadInput that names the array, the index and the value."""
        path = files.resolve(config.file)
        data = load_arrays(path, dyes)
        for name in ("porosity", "tau1", "resist"):
            good = (data[name] >= 0.0) & (data[name] <= 1.0)
            _require(path, name, data[name], good, "0 to 1", "out of range")
        cells = Cells(
            data["fibre"], data["up"], data["porosity"], data["tau1"], data["resist"], config.cell_size,
            config.tau3.with_weave(config.tau2), config.v_max,
        )  # fmt: skip
        put_on(self.resists(config, cells, files), cells)
        rooms = {"phi": (cells.mobile_room, "v_max P (1 - B)"), "fixed": (cells.fixed_room, "(1 - P) v_max in fibre")}
        for name, (room, formula) in rooms.items():
            data[name] = _amounts(path, name, data[name], room, formula)
        return cells, DyeState(data["phi"], data["fixed"])

    def resists(self, config: CellsConfig, cells: Cells, files: Files) -> tuple[Float, ...]:
        """Raises BadInput for what touches no cell, and an image that does not fit."""
        _, ny, nx = cells.fibre.shape
        return find_resists(config.resist, (ny, nx), config.cell_size, files)

    def supplies(self, config: CellsConfig, cells: Cells, dyes: Sequence[str]) -> tuple[Supply, ...]:
        """Raises BadInput for one that is outside of the cloth, or of a dye that the scene does not have."""
        _, ny, nx = cells.fibre.shape
        return prepare_supplies(config.supply, (ny, nx), config.cell_size, dyes)


def _amounts(path: Path, name: str, values: Float, room: Float, formula: str) -> Float:
    """Amounts that are there and fit. Raises BadInput."""
    shown = values[0] if len(values) == 1 else values
    _require(path, name, shown, np.isfinite(shown), "finite", "not a finite number")
    _require(path, name, shown, shown >= 0.0, ">= 0", "there is no less than no dye")
    good = shown <= room * (1.0 + ROUNDING)
    if not good.all():
        index = tuple(np.argwhere(~good)[0])
        most = f"{room[index[-3:]]:g} = {formula}"
        _require(path, name, shown, good, most, "more dye than the cell can hold")
    full: Float = np.minimum(values, room)
    return full


def _require(path: Path, name: str, values: Float, good: Bool, limit: str, problem: str) -> None:
    bad = np.argwhere(~good)
    if bad.size:
        index = tuple(int(i) for i in bad[0])
        place = f"{name}[{', '.join(map(str, index))}]"
        raise BadInput(problem, file=str(path), field=place, value=float(values[index]), limit=limit)
