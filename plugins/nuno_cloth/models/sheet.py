"""A rectangular sheet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, Field

from nuno_cloth.fabrics.constants import Lattice, grid_constants
from nuno_cloth.fabrics.material import FABRIC, FabricChoice, HandSet, resolve
from nuno_cloth.fabrics.presets import MEASURES, Material
from nuno_cloth.models.bending import build_bending
from nuno_cloth.models.bending_friction import build_friction, bytes_of_friction
from nuno_cloth.models.grid import Grid, build_faces, build_hinges, build_springs
from nuno_cloth.models.membrane import BYTES_PER_VERTEX, SPRUNG, Elements, build_elements
from nuno_cloth.models.placement import (
    STILL,
    TEXTURE,
    VELOCITY,
    PinName,
    Point,
    Rotation,
    Velocity,
    find_texture,
    pin_grid,
)
from nuno_cloth.models.triangles import find_edges, yarn_axes
from nuno_cloth.quantities import Length
from nuno_schemas.fabric import Bool, Fabric, Float
from nuno_schemas.plugin import Config, Files
from nuno_schemas.preset import Imported, Preset
from nuno_schemas.vectors import turn

CellKind = Literal["quads", "triangles"]
CELLS = (
    "quads: springs along rows, columns and both diagonals; triangles: on the edges of triangles, as the wrinkle paper "
    "has them and ridge and valley lines need them"
)
BYTES = {"quads": 400, "triangles": SPRUNG}
"""The most memory that a run takes per vertex: rows of quads are runs of springs; `nuno bench speed` measures them."""


def bytes_of_grid(cells: CellKind, fabric: FabricChoice) -> int:
    """Return the most memory that a run of a grid takes per vertex [bytes]."""
    material = resolve(fabric)
    curls = cells == "quads" and isinstance(material, Material) and material.bend_poisson != 0.0
    return BYTES[cells] + bytes_of_friction(fabric) + (BYTES_PER_VERTEX - SPRUNG if curls else 0)


Vertices = Annotated[int, Field(ge=2, le=16384)]

# Directions of columns and rows for each plane. Their cross product rows x columns is the plane's normal, on the
# outside.
PLANES: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "xy": ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0)),
    "xz": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "yz": ((0.0, 0.0, -1.0), (0.0, -1.0, 0.0)),
}


class SheetConfig(Config):
    """A rectangle; warp yarns run down it."""

    size: tuple[Length, Length] = Field(default=(1.0, 1.0), description="width and height [m]")
    resolution: tuple[Vertices, Vertices] = Field(default=(32, 32), description="vertices across and down")
    centre: Point = Field(default=(0.0, 0.0, 0.0), description="middle of the sheet [m]")
    plane: Literal["xy", "xz", "yz"] = Field(
        default="xy", description="xy hangs with its outside to +z, yz hangs to +x, xz lies with its outside up"
    )
    rotate: Rotation | None = Field(default=None, description="a turn about the centre, after `plane`")
    cells: CellKind = Field(default="quads", description=CELLS)
    velocity: Velocity = Field(default=STILL, description=VELOCITY)
    pin: tuple[PinName | int, ...] = Field(
        default=(), description="names of edges or corners, or vertices: row * columns + column"
    )
    fabric: FabricChoice = Field(default="denim", description=FABRIC)
    texture: str | None = Field(default=None, description=TEXTURE)


def build_grid(
    grid: Grid, lattice: Lattice, material: Material | HandSet, x: Float, cells: CellKind, held: Bool
) -> Elements:
    """Build the elements of a grid, of quads or of the triangles that it is drawn with. Raises BadInput for elongated
    cells.

    Triangles are those of any mesh (triangles.py), with the warp down the grid. Cloth with a Poisson's ratio of bending
    bends by a matrix also on quads, whose hinges cannot have one.
    """
    faces = build_faces(grid)
    rows = faces // grid.cols
    low = faces[np.arange(len(faces)), np.argmin(rows, axis=1)]
    down = x[low + grid.cols] - x[low]
    if cells == "quads":
        constants = grid_constants(material, lattice)
        mass, springs = grid_mass(grid, material.density, lattice), build_springs(grid, constants)
        if isinstance(material, HandSet):
            return Elements(mass, faces, springs, build_hinges(grid, constants))
        axes = yarn_axes(x[faces], down)
        friction = build_friction(material, x[faces], faces, *axes, held)
        if material.bend_poisson != 0.0:
            bending = build_bending(material, x[faces], faces, *axes, held)
            return Elements(mass, faces, springs, bending=bending, friction=friction)
        return Elements(mass, faces, springs, build_hinges(grid, constants), friction=friction)
    return build_elements(material, x, faces, find_edges(faces), down, held=held)


def grid_mass(grid: Grid, density: float, lattice: Lattice) -> Float:
    """Return masses (n,) [kg]: each cell gives a quarter to each of its corners. Rejected: thirds of triangles, which
    would weigh vertices by where the diagonals happen to meet.
    """
    mass = np.repeat(density * lattice.row_area()[:, None], grid.cols, axis=1)
    if not grid.periodic:
        mass[:, [0, -1]] *= 0.5
    return np.ascontiguousarray(mass.reshape(-1))


class Sheet:
    """A rectangle of quads, flat and unstretched at the start."""

    name: ClassVar[str] = "sheet"
    Config: ClassVar[type[BaseModel]] = SheetConfig

    def count(self, config: SheetConfig, files: Files) -> int:
        return config.resolution[0] * config.resolution[1]

    def memory(self, config: SheetConfig, files: Files, vertices: int) -> int:
        """Return the most memory that a run takes [bytes]."""
        return vertices * bytes_of_grid(config.cells, config.fabric)

    def presets(self) -> tuple[Preset, ...]:
        """Return the presets, which all models here know by name. Their virtual tests take about a second."""
        from nuno_cloth.fabrics.kes import RESOLUTION, SIZE, list_presets

        def cut(name: str) -> Fabric:
            config = SheetConfig(size=SIZE, resolution=RESOLUTION, fabric=name)
            return self.build(config, None, 0)  # type: ignore[arg-type] # specimens carry no images

        return list_presets(cut)

    def import_fabric(self, given: Mapping[str, Any], like: str | None, folder: Path = Path()) -> Imported:
        """Import a fabric from a laboratory's sheet in this folder, with results of virtual tests. Raises BadInput."""
        from nuno_cloth.fabrics.kes import RESOLUTION, SIZE, measure
        from nuno_cloth.fabrics.laboratory import read_sheet

        imported = read_sheet(given, like, folder)
        config = SheetConfig.model_validate({"size": SIZE, "resolution": RESOLUTION, "fabric": dict(imported.fabric)})
        tests = measure(self.build(config, None, 0), RESOLUTION, SIZE)  # type: ignore[arg-type] # no images
        return replace(
            imported, measured={name: float(getattr(tests, name)) for name in imported.fabric if name in MEASURES}
        )

    def build(self, config: SheetConfig, files: Files, seed: int) -> Fabric:
        """Build the sheet. Raises BadInput for a pin that does not exist, a missing texture, elongated cells."""
        cols, rows = config.resolution
        grid = Grid(rows, cols)
        a, b = config.size[0] / (cols - 1), config.size[1] / (rows - 1)
        lattice = Lattice(np.full(rows, a), np.full(rows - 1, b))
        material = resolve(config.fabric)
        x = place(config, rows, cols)
        held = pin_grid(grid, config.pin)
        elements = build_grid(grid, lattice, material, x, config.cells, held)
        uv, texture = texture_coordinates(np.linspace(0, 1, cols), rows), find_texture(config.texture, files)
        return elements.fabric(self.name, x, held, config.velocity, uv=uv, texture=texture)


def place(config: SheetConfig, rows: int, cols: int) -> Float:
    """Return positions (n, 3) [m]."""
    right, down = (np.asarray(axis) for axis in PLANES[config.plane])
    if config.rotate is not None:
        matrix = config.rotate.matrix()
        right, down = turn(matrix, right), turn(matrix, down)
    u = config.size[0] * np.linspace(-0.5, 0.5, cols)[None, :, None]
    v = config.size[1] * np.linspace(-0.5, 0.5, rows)[:, None, None]
    return np.ascontiguousarray((u * right + v * down + np.asarray(config.centre)).reshape(-1, 3))


def texture_coordinates(across: Float, rows: int) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    """Return texture coordinates (n, 2) float32: u from `across` (cols,), v from 1 on the top row to 0 below."""
    uv = np.empty((rows, across.shape[0], 2), np.float32)
    uv[..., 0] = across
    uv[..., 1] = np.linspace(1, 0, rows)[:, None]
    return uv.reshape(-1, 2)
