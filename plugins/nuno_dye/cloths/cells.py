"""A cloth from the arrays of a .npz file, cell by cell, which poses an exact problem."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np
from pydantic import BaseModel, Field

from nuno_dye.cloths.cloth import Cloth, ClothConfig, Tau3Config
from nuno_dye.quantities import CellSize
from nuno_dye.supplies.resist import Resists, put_on
from nuno_geometry.mesh_files.npz import NpzFile, Spec, open_npz, require_values
from nuno_schemas.dye import Cells, DyeState
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import Files

CELLS: tuple[int | str, ...] = (2, "ny", "nx")
REAL = "fiu"
KEYS: dict[str, Spec] = {
    "fibre": (CELLS, "b"), "up": (CELLS, "b"), "porosity": (CELLS, REAL), "tau1": (CELLS, REAL),
    "resist": (CELLS, REAL), "phi": (CELLS, REAL), "fixed": (CELLS, REAL),
}  # fmt: skip
"""Arrays of the file, layer 0 the weft and layer 1 the warp; phi and fixed have one per dye if there are several."""
ROUNDING = 1e-12
"""Relative excess of an amount over a cell's capacity that rounding may cause: the cell is full."""


class CellsConfig(ClothConfig):
    """The arrays of a file, unchanged."""

    file: str = Field(
        description="a .npz beside the scene; each of its arrays is (2, ny, nx), layer 0 the weft, whose yarns lie "
        "along x, layer 1 the warp: fibre and up bool, porosity, tau1, resist, phi (mobile dye), fixed; phi and "
        "fixed are (dyes, 2, ny, nx) where there are several dyes; no other key"
    )
    cell_size: CellSize = Field(description="side of a cell [m]")
    tau3: Tau3Config = Field(description="by kind of face, I to V")
    v_max: float = Field(default=1.0, gt=0, le=1e12, description="capacity of a cell")
    resist: Resists = Field(default=(), description="resists on both layers, added to the file's")


class CellsCloth(Cloth):
    """A cloth with exactly the cells of its file."""

    name: ClassVar[str] = "cells"
    Config: ClassVar[type[BaseModel]] = CellsConfig

    def count(self, config: CellsConfig, files: Files) -> int:
        with open_npz(files.resolve(config.file)) as file:
            sizes = read_sizes(file)
        return 2 * sizes["ny"] * sizes["nx"]

    def build(self, config: CellsConfig, files: Files, seed: int, dyes: Sequence[str]) -> tuple[Cells, DyeState]:
        """Build the cloth. Raises BadInput that names the array, the index and the value."""
        path = files.resolve(config.file)
        with open_npz(path) as file:
            read_sizes(file, len(dyes))
            data = file.arrays(KEYS)
        for name in ("porosity", "tau1", "resist"):
            require_values(path, name, data[name], (data[name] >= 0.0) & (data[name] <= 1.0), "out of range", "0 to 1")
        cells = Cells(
            data["fibre"], data["up"], data["porosity"], data["tau1"], data["resist"], config.cell_size,
            config.tau3.with_weave(config.tau2), v_max=config.v_max,
        )  # fmt: skip
        put_on(self.resists(config, cells, files), cells)
        capacities = {
            "phi": (cells.mobile_room, "v_max P (1 - B)"),
            "fixed": (cells.fixed_room, "(1 - P) v_max in fibre"),
        }
        for name, (capacity, formula) in capacities.items():
            data[name] = _amounts(path, name, data[name].reshape(len(dyes), *capacity.shape), capacity, formula)
        return cells, DyeState(data["phi"], data["fixed"])


def read_sizes(file: NpzFile, dyes: int | None = None) -> dict[str, int]:
    """Return the cells down "ny" and across "nx", from the headers alone, for any number of dyes if it is not given.

    Raises BadInput for a missing or unknown array, a wrong dtype, shapes that differ, and a header that announces more
    than the file holds.
    """
    file.require(KEYS, KEYS)
    specs = dict(KEYS)
    for name in ("phi", "fixed"):
        if dyes not in (None, 1) or (dyes is None and len(file.header(name).shape) == 4):
            specs[name] = ("dyes" if dyes is None else dyes, *CELLS), REAL
    sizes = file.sizes(specs)
    if 0 in sizes.values():
        limit = "(2, ny, nx): layer 0 the weft, layer 1 the warp"
        raise BadInput("wrong shape", file=str(file.path), field="fibre", value=tuple(sizes.values()), limit=limit)
    return sizes


def _amounts(path: Path, name: str, values: Float, capacity: Float, formula: str) -> Float:
    """Return amounts, at most the capacity of each cell. Raises BadInput for amounts that no cell can hold."""
    indexed = values[0] if len(values) == 1 else values
    require_values(path, name, indexed, np.isfinite(indexed), "not a finite number", "finite")
    require_values(path, name, indexed, indexed >= 0.0, "there is no less than no dye", ">= 0")
    fits = indexed <= capacity * (1.0 + ROUNDING)
    if not fits.all():
        index = tuple(np.argwhere(~fits)[0])
        most = f"{capacity[index[-3:]]:g} = {formula}"
        require_values(path, name, indexed, fits, "more dye than the cell can hold", most)
    return np.asarray(np.minimum(values, capacity))
