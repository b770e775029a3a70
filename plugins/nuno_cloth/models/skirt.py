"""A skirt: a tube or cone of quads whose top row follows a body's waist.

The cloth is cut as a ring: row r, at the slant distance s from the waist, is 2 pi waist_radius
long at the waist, 2 pi hem_radius fullness at the hem, linear between. It starts on a cone from
waist_radius to hem_radius; what the cloth is longer than the cone's circle (fullness > 1) goes into
`pleats` folds, whose depth follows row by row from the length. So the folds are cloth that is
really there, not a texture, and they stay when the skirt swings.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import BaseModel, Field, field_validator

from nuno_cloth.fabrics.constants import Lattice
from nuno_cloth.fabrics.material import FABRIC, FabricChoice, resolve
from nuno_cloth.models.grid import Grid
from nuno_cloth.models.placement import STILL, TEXTURE, VELOCITY, Attach, Point, Rotation, Velocity, find_texture
from nuno_cloth.models.sheet import CELLS, CellKind, build_grid, bytes_of_grid, texture_coordinates
from nuno_cloth.quantities import Flatness, Fullness, Length
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Binding, Fabric, Float
from nuno_schemas.plugin import Config, Files
from nuno_schemas.vectors import turn

SAMPLES = 2048
"""Points by which a row's curve is measured."""

ROUNDS = 4


class SkirtConfig(Config):
    """A cone whose top row is pinned. Columns start at +x and run towards -z.

    Texture: u runs from 0 to 1 and back around the waist, so that an image has no seam; v is 1 at
    the waist and 0 at the hem.
    """

    waist_radius: Length = Field(default=0.13, description="of the waist, half its width [m]")
    hem_radius: Length = Field(default=0.28, description="of the circle on which the hem starts [m]")
    length: Length = Field(default=0.5, description="along the cloth, from waist to hem [m]")
    columns: int = Field(default=128, ge=4, le=16384, description="vertices around, an even number")
    rows: int = Field(default=64, ge=2, le=16384, description="vertices from waist to hem")
    fullness: Fullness = Field(default=1.0, description="the cloth's length at the hem over the circle it starts on")
    pleats: int = Field(default=12, ge=2, le=200, description="folds around, where fullness is above 1")
    ratio: Flatness = Field(default=1.0, description="the waist's depth over its width, z over x")
    centre: Point = Field(default=(0.0, 0.0, 0.0), description="middle of the waist [m]")
    rotate: Rotation | None = Field(
        default=None, description="a turn about the centre; before it the axis points down (-y)"
    )
    velocity: Velocity = Field(default=STILL, description=VELOCITY)
    cells: CellKind = Field(default="quads", description=CELLS)
    attach: Attach | None = Field(
        default=None, description="the body and frame that the waist moves with; it stands unless given"
    )
    fabric: FabricChoice = Field(default="denim", description=FABRIC)
    texture: str | None = Field(default=None, description=TEXTURE)

    @field_validator("columns")
    @classmethod
    def _even(cls, columns: int) -> int:
        if columns % 2:
            raise ValueError("must be even, so that alternating diagonals close around the tube")
        return columns


class Skirt:
    """A ring of cloth; unstretched at the start, but for some per cent of shear that folds, and an
    elliptic waist, need.
    """

    name: ClassVar[str] = "skirt"
    Config: ClassVar[type[BaseModel]] = SkirtConfig

    def count(self, config: SkirtConfig, files: Files) -> int:
        return config.columns * config.rows

    def memory(self, config: SkirtConfig, files: Files, vertices: int) -> int:
        """What a run takes at most [bytes]."""
        return vertices * bytes_of_grid(config.cells, config.fabric)

    def build(self, config: SkirtConfig, files: Files, seed: int) -> Fabric:
        """Raises BadInput for impossible measures, a missing texture, elongated cells."""
        require_measures(config)
        grid = Grid(config.rows, config.columns, periodic=True)
        along = np.linspace(0, 1, config.rows)
        circle = 2 * np.pi * (config.waist_radius + along * (config.hem_radius * config.fullness - config.waist_radius))
        slant = np.full(config.rows - 1, config.length / (config.rows - 1))
        lattice = Lattice(circle / config.columns, slant)
        material = resolve(config.fabric)
        x = drape(config, circle)
        held = np.repeat(np.arange(config.rows) == 0, config.columns)
        elements = build_grid(grid, lattice, material, x, config.cells, held)
        waist = np.arange(config.columns, dtype=np.int32)
        attach = config.attach
        across = 1 - np.abs(2 * np.arange(config.columns) / config.columns - 1)
        return Fabric(
            name=self.name,
            position=x,
            velocity=np.tile(np.asarray(config.velocity, np.float64), (grid.number, 1)),
            pinned=held,
            uv=texture_coordinates(across, config.rows),
            bindings=() if attach is None else (Binding(waist, attach.body, attach.frame),),
            texture=find_texture(config.texture, files),
            **elements._asdict(),
        )


def require_measures(config: SkirtConfig) -> None:
    """Raises BadInput if the cone cannot be as wide as asked for, or has too few columns to fold."""
    if abs(config.hem_radius - config.waist_radius) >= config.length:
        raise BadInput(
            "the hem lies further out than the cloth is long",
            field="hem_radius",
            value=config.hem_radius,
            limit=f"less than {config.length:g} m from waist_radius {config.waist_radius:g} m",
            remedy="make the skirt longer; for more cloth at the hem raise fullness",
        )
    if config.fullness > 1 and config.columns < 8 * config.pleats:
        raise BadInput(
            "too few columns to show the pleats",
            field="columns",
            value=config.columns,
            limit=f"at least 8 for each of {config.pleats} pleats",
            remedy=f"columns: {8 * config.pleats}, or fewer pleats",
        )


def drape(config: SkirtConfig, circle: Float) -> Float:
    """(n, 3) starting positions [m] of rows that are `circle` (rows,) long.

    Waves, heights and steps around depend on each other: chords are shorter than the curve they
    span, and rise and fall along a row add to its length. A few rounds make the steps of
    each row equal and as long together as its cloth.
    """
    around = np.linspace(0, 2 * np.pi, SAMPLES + 1)
    outline = np.stack([np.cos(around), config.ratio * np.sin(around)], -1)
    outline *= 2 * np.pi / _reached(outline)[-1]
    phase = _reached(outline) * config.pleats
    radius = np.linspace(config.waist_radius, config.hem_radius, config.rows)
    depths, lengths = _wave_depths(outline, phase)
    if circle[-1] / radius[-1] > lengths[-1]:
        raise BadInput("the folds would reach the axis", field="fullness", remedy="more pleats, or less fullness")
    steps = np.tile(np.arange(config.columns + 1) / config.columns, (config.rows, 1))
    even = steps[0].copy()
    aim = circle.copy()
    position = np.empty((config.rows, config.columns, 3))
    for _ in range(ROUNDS):
        for row in range(config.rows):
            depth = np.interp(aim[row] / radius[row], lengths, depths) if config.fullness > 1 else 0.0
            ring = radius[row] * outline * (1 + depth * np.cos(phase))[:, None]
            reached = _reached(ring)
            at = steps[row, :-1] * reached[-1]
            position[row, :, 0] = np.interp(at, reached, ring[:, 0])
            position[row, :, 2] = -np.interp(at, reached, ring[:, 1])
        position[0, :, 1] = 0.0
        position[1:, :, 1] = -np.cumsum(_fall(position[..., [0, 2]], config), axis=0)
        for row in range(config.rows):
            reached = _reached(np.concatenate([position[row], position[row, :1]]))
            steps[row] = np.interp(even, reached / reached[-1], steps[row])
            aim[row] *= circle[row] / reached[-1]
    points = position.reshape(-1, 3)
    turned = points if config.rotate is None else turn(config.rotate.matrix(), points)
    return np.ascontiguousarray(turned + np.asarray(config.centre))


def _reached(points: Float) -> Float:
    """(p,) length of a chain of points (p, d) up to each of them."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def _wave_depths(outline: Float, phase: Float) -> tuple[Float, Float]:
    """Depths of waves on a ring, as parts of its radius, and the lengths that they give it per
    radius. The length grows with the square of small depths, and so do the table's steps.
    """
    depths = 0.95 * np.linspace(0, 1, 256) ** 2
    return depths, np.array([_reached(outline * (1 + depth * np.cos(phase))[:, None])[-1] for depth in depths])


def _fall(flat: Float, config: SkirtConfig) -> Float:
    """(rows - 1, columns) how far each warp edge goes down, so that it keeps its length."""
    step = config.length / (config.rows - 1)
    outwards = np.square(np.diff(flat, axis=0)).sum(axis=-1)
    down: Float = np.sqrt(np.maximum(step**2 - outwards, (0.1 * step) ** 2))
    return down
