"""A specimen as laboratories cut them: a strip or a disc of triangles, held at one end or round its middle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, Field, model_validator

from nuno_cloth.fabrics.material import FABRIC, FabricChoice, HandSet, resolve
from nuno_cloth.models.bending_friction import bytes_of_friction
from nuno_cloth.models.delaunay import triangulate
from nuno_cloth.models.elements import BYTES_PER_VERTEX, TENSION, Tension, build_elements
from nuno_cloth.models.placement import TEXTURE, Point, Rotation, find_texture
from nuno_cloth.models.triangles import find_edges
from nuno_cloth.quantities import Angle, Length
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Fabric, Float, Int
from nuno_schemas.plugin import Config, Files
from nuno_schemas.vectors import turn

INSET = 0.6
"""Least distance of points from outlines that they are not on, in edges: nearer ones would give flat triangles."""
THROWN = 0.25
"""Points of an irregular mesh are thrown by up to so many edges."""
MOST = 250_000
"""Vertices: what a disc is made of."""
Layout = Literal["irregular", "aligned", "crossed"]


class SwatchConfig(Config):
    """Flat, with its outside up; strips are as long as x, from the clamp's outer end at `centre`."""

    size: tuple[Length, Length] | None = Field(default=None, description="length and width of a strip [m]")
    radius: Length | None = Field(default=None, description="of a disc [m]")
    hold: Length | None = Field(
        default=None,
        description="what is held: so much of a strip's length, before its free part; a radius of a disc [m]",
    )
    edge: Length = Field(default=0.01, description="length of the triangles' edges [m]")
    layout: Layout = Field(
        default="irregular",
        description="of the triangles: irregular, by the scene's seed; aligned, squares cut all alike; crossed, "
        "squares cut to and fro",
    )
    angle: Angle = Field(default=0.0, description="of the warp to a strip's length, or to x [rad]")
    centre: Point = Field(
        default=(0.0, 0.0, 0.0), description="middle of a disc, or of the line where a strip is free [m]"
    )
    rotate: Rotation | None = Field(default=None, description="a turn about the centre")
    fabric: FabricChoice = Field(default="denim", description=FABRIC)
    tension: Tension = Field(default="auto", description=TENSION)
    texture: str | None = Field(default=None, description=TEXTURE)

    @model_validator(mode="after")
    def _one_shape(self) -> SwatchConfig:
        if (self.size is None) == (self.radius is None):
            raise ValueError("a strip has a size, a disc a radius: give one of them")
        if self.radius is not None and self.hold is not None and self.hold >= self.radius:
            raise ValueError(f"all of a disc of {self.radius:g} m would be held: give a hold below its radius")
        widths = self.size or (self.radius or 0.0,)
        if min(widths) < self.edge:
            raise ValueError(f"an edge of {self.edge:g} m is longer than the piece is wide: {min(widths):g} m")
        return self


class Swatch:
    """Of a measured fabric; see nuno_cloth.models.elements for what bears tension and bending."""

    name: ClassVar[str] = "swatch"
    Config: ClassVar[type[BaseModel]] = SwatchConfig

    def count(self, config: SwatchConfig, files: Files) -> int:
        return len(lay(config, 0)[0])

    def memory(self, config: SwatchConfig, files: Files, vertices: int) -> int:
        """What a run takes at most [bytes]."""
        return vertices * (BYTES_PER_VERTEX + bytes_of_friction(config.fabric))

    def measures(self, config: SwatchConfig) -> Mapping[str, float | str]:
        """What its fabric is described by, in SI, `bend_bias` and `bend_twist` among it, and its source. Raises
        BadInput for constants per spring.
        """
        material = resolve(config.fabric)
        if isinstance(material, HandSet):
            remedy = "give a preset or measured values"
            raise BadInput("constants per spring are no measures of a fabric", field="fabric", remedy=remedy)
        found = {each.name: getattr(material, each.name) for each in fields(material)}
        both = material.bend_warp > 0.0 < material.bend_weft
        bias = 4.0 / (material.straight + 1.0 / material.bend_twist) if both else 0.0
        return found | {"bend_twist": material.bend_twist, "bend_bias": bias}

    def build(self, config: SwatchConfig, files: Files, seed: int) -> Fabric:
        """Raises BadInput for more than MOST vertices, and a missing texture."""
        flat, faces = lay(config, seed)
        far = np.linalg.norm(flat, axis=1) if config.size is None else flat[:, 0]
        held = np.zeros(len(flat), np.bool_) if config.hold is None else far <= _held_to(config) + 1e-9
        # The outside is up: x, y of the flat piece become x, -z.
        level = np.column_stack([flat[:, 0], np.zeros(len(flat)), -flat[:, 1]])
        matrix = np.eye(3) if config.rotate is None else config.rotate.matrix()
        x = np.ascontiguousarray(turn(matrix, level) + np.asarray(config.centre))
        material = resolve(config.fabric)
        warp = turn(matrix, np.array([[np.cos(config.angle), 0.0, -np.sin(config.angle)]]))[0]
        elements = build_elements(material, x, faces, find_edges(faces), warp, tension=config.tension, held=held)
        low, high = flat.min(axis=0), flat.max(axis=0)
        return Fabric(
            name=self.name,
            position=x,
            velocity=np.zeros_like(x),
            pinned=held,
            uv=np.ascontiguousarray((flat - low) / (high - low).max(), np.float32),
            texture=find_texture(config.texture, files),
            **elements._asdict(),
        )


def _held_to(config: SwatchConfig) -> float:
    """Where what is held ends: at 0 of a strip, at a radius of a disc [m]."""
    return 0.0 if config.size is not None else float(config.hold or 0.0)


def lay(config: SwatchConfig, seed: int) -> tuple[Float, Int]:
    """Points (n, 2) [m] and triangles (f, 3), counter-clockwise. Raises BadInput for more than MOST."""
    area = config.size[0] * config.size[1] if config.size is not None else np.pi * float(config.radius or 0.0) ** 2
    if (many := area / config.edge**2) > MOST:
        raise BadInput(
            "too many vertices", field="edge", value=config.edge, limit=f"{MOST:,} vertices, these are {many:,.0f}",
            remedy="longer edges, or a smaller piece",
        )  # fmt: skip
    return _disc(config, seed) if config.size is None else _strip(config, seed)


def _strip(config: SwatchConfig, seed: int) -> tuple[Float, Int]:
    """From -hold to its length less that, and across."""
    assert config.size is not None
    (length, width), hold = config.size, float(config.hold or 0.0)
    held = max(2, round(hold / config.edge)) if hold else 0
    free = max(1, round((length - hold) / config.edge))
    across = max(1, round(width / config.edge))
    x = np.concatenate([np.linspace(-hold, 0.0, held + 1)[:-1], np.linspace(0.0, length - hold, free + 1)])
    y = np.linspace(-0.5 * width, 0.5 * width, across + 1)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    if config.layout == "irregular":
        # Borders, and the line where it is free, stay straight; along them points slide.
        thrown = THROWN * config.edge * np.random.default_rng(seed).uniform(-1.0, 1.0, points.shape)
        ends, rims = np.isin(points[:, 0], [x[0], 0.0, x[-1]]), np.isin(points[:, 1], [y[0], y[-1]])
        points[:, 0] += np.where(ends, 0.0, thrown[:, 0])
        points[:, 1] += np.where(rims, 0.0, thrown[:, 1])
        faces = triangulate(points)
        size = points[faces]
        one, other = size[:, 1] - size[:, 0], size[:, 2] - size[:, 0]
        area = 0.5 * (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
        return points, faces[area > 1e-6 * config.edge**2]
    row, column = (each.reshape(-1) for each in np.mgrid[: len(x) - 1, :across])
    a = row * (across + 1) + column
    b, c, d = a + across + 1, a + across + 2, a + 1
    other = (config.layout == "crossed") & ((row + column) % 2 == 1)
    first = np.where(other[:, None], np.column_stack([a, b, d]), np.column_stack([a, b, c]))
    second = np.where(other[:, None], np.column_stack([b, c, d]), np.column_stack([a, c, d]))
    return points, np.concatenate([first, second]).astype(np.int32)


def _disc(config: SwatchConfig, seed: int) -> tuple[Float, Int]:
    """With points on its rim and round what is held."""
    edge, radius = config.edge, float(config.radius or 0.0)
    circles = [radius, *([config.hold] if config.hold else [])]
    random = np.random.default_rng(seed)
    rings: list[Any] = []
    for size in circles:
        around = max(12, round(2.0 * np.pi * size / edge))
        turned = 2.0 * np.pi * (np.arange(around) + random.uniform()) / around
        rings.append(size * np.stack([np.cos(turned), np.sin(turned)], axis=1))
    irregular = config.layout == "irregular"
    steps = edge, edge * np.sqrt(0.75) if irregular else edge
    across, down = (np.arange(-np.ceil(radius / step), radius / step + 1.0) * step for step in steps)
    grid = np.stack(np.meshgrid(across, down), axis=-1)
    if irregular:
        grid[1::2, :, 0] += 0.5 * edge
        grid += THROWN * edge * random.uniform(-1.0, 1.0, grid.shape)
    inner = grid.reshape(-1, 2)
    far = np.linalg.norm(inner, axis=1)
    clear: Bool = far < radius
    for size in circles:
        clear &= np.abs(far - size) > INSET * edge
    points = np.concatenate([*rings, inner[clear]])
    return points, triangulate(points)
