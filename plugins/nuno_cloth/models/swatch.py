"""A flat swatch of triangles: a rectangle or a disc. It is clamped at one end or round its middle as laboratories do,
or worn through a hole for the head.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import ClassVar, Literal

import numpy as np
from pydantic import BaseModel, Field, model_validator

from nuno_cloth.fabrics.material import FABRIC, FabricChoice, HandSet, resolve
from nuno_cloth.models.delaunay import triangulate
from nuno_cloth.models.membrane import TENSION, OfTriangles, Tension, build_elements
from nuno_cloth.models.placement import TEXTURE, Over, Point, Rotation, Wearable, find_texture
from nuno_cloth.models.triangles import find_edges
from nuno_cloth.models.wearer import check_stance, find_wearer, require_outside
from nuno_cloth.quantities import Angle, Length
from nuno_geometry.tree import build_tree
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Fabric, Float, Int
from nuno_schemas.plugin import Config, Files
from nuno_schemas.vectors import turn

# A flat piece with a hole for a head: it begins level, as low on a body's shoulders as it can.


def put_on(over: Over, hole: float, x: Float, faces: Int, worn: Sequence[Fabric]) -> Float:
    """Return the centre (3,) of a hole of radius `hole` [m] round the neck of a body x (v, 3) [m], faces (f, 3). It is
    above all points of the body and of the garments already `worn` that are below the neck and outside of the hole.

    Raises BadInput for a body without neck and arms, and a hole that is too narrow for the neck.
    """
    check_stance(x, faces, over.body)
    wearer = find_wearer(x, faces)
    _, base, back = wearer.neck
    points = np.concatenate([x, *(one.position for one in worn)])
    far = np.hypot(points[:, 0] - wearer.middle, points[:, 2] - back)
    below = points[(points[:, 1] < base) & (far > hole - over.clearance), 1]
    if not len(below):
        problem, remedy = "the hole is so wide that nothing of the body holds the cloth", "a smaller hole"
        raise BadInput(problem, field="hole", value=f"{100.0 * hole:.3g} cm", remedy=remedy)
    middle = np.array([wearer.middle, float(below.max()) + over.clearance, back])
    neck = wearer.trunk(float(middle[1]))
    if neck is not None:
        wide = float(np.hypot(*(neck.points - middle)[:, [0, 2]].T).max()) + over.clearance
        if wide > hole:
            problem, remedy = "the hole is too narrow for the neck", f"hole: {np.ceil(1e3 * wide) / 10.0:g} cm"
            raise BadInput(problem, field="hole", value=f"{100.0 * hole:.3g} cm", limit="its clearance off the neck",
                           remedy=remedy)  # fmt: skip
    return middle


INSET = 0.6
"""Least distance of inner points from an outline, in edges: nearer ones would give flat triangles."""
THROWN = 0.25
"""Largest random displacement of points of an irregular mesh, in edges."""
MOST = 250_000
"""The most vertices that a swatch may have."""
Layout = Literal["irregular", "aligned", "crossed"]


class SwatchConfig(Config):
    """A flat swatch, its outside up. A strip runs along x from the clamp's outer end at `centre`; with a hole its
    middle is at `centre`.
    """

    size: tuple[Length, Length] | None = Field(default=None, description="length and width of a strip [m]")
    radius: Length | None = Field(default=None, description="of a disc [m]")
    hold: Length | None = Field(
        default=None,
        description="what is clamped: this length of a strip before its free part, this radius of a disc [m]",
    )
    hole: Length | None = Field(default=None, description="radius of a round hole in the middle [m]; for a head: 11 cm")
    over: Over | None = Field(
        default=None, description="the body that wears it, its head through the hole; none: it begins at `centre`"
    )
    edge: Length = Field(default=0.01, description="length of the triangles' edges [m]")
    layout: Layout = Field(
        default="irregular",
        description="of the triangles: irregular, by the scene's seed; aligned, squares cut all alike; crossed, "
        "squares cut to and fro",
    )
    angle: Angle = Field(default=0.0, description="of the warp to a strip's length, or to x [rad]")
    centre: Point = Field(
        default=(0.0, 0.0, 0.0), description="middle of a disc or a hole, or of the line where a strip is free [m]"
    )
    rotate: Rotation | None = Field(default=None, description="a turn about the centre; over a body about the vertical")
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

    @model_validator(mode="after")
    def _with_a_hole(self) -> SwatchConfig:
        room = (0.5 * min(self.size) if self.size is not None else float(self.radius or 0.0)) - self.edge
        if self.hole is not None and self.hold is not None:
            raise ValueError("what has a hole in its middle is not held there: leave hold or hole out")
        if self.hole is not None and self.hole >= room:
            raise ValueError(f"a hole of {self.hole:g} m leaves no edge round it: give one below {room:g} m")
        if self.hole is not None and self.layout == "crossed":
            raise ValueError("round a hole squares are not cut to and fro: take layout aligned or irregular")
        if self.over is None:
            return self
        if self.hole is None:
            raise ValueError("a piece over a body has a hole for its head: give one, such as hole: 11 cm")
        if "centre" in self.model_fields_set:
            raise ValueError("a piece over a body takes its place from it: leave centre out")
        if self.rotate is not None and any(self.rotate.axis[k] for k in (0, 2)):
            raise ValueError("a piece over a body begins level: turn it about the vertical, axis: [0, 1, 0]")
        return self


class Swatch(Wearable, OfTriangles):
    """A swatch of a measured fabric. nuno_cloth.models.membrane gives it tension and bending."""

    name: ClassVar[str] = "swatch"
    Config: ClassVar[type[BaseModel]] = SwatchConfig

    def count(self, config: SwatchConfig, files: Files) -> int:
        return len(lay(config, 0)[0])

    def measures(self, config: SwatchConfig) -> Mapping[str, float | str]:
        """Return the measures of its fabric in SI, with `bend_bias`, `bend_twist` and the source. Raises BadInput for
        constants per spring.
        """
        material = resolve(config.fabric)
        if isinstance(material, HandSet):
            remedy = "give a preset or measured values"
            raise BadInput("constants per spring are no measures of a fabric", field="fabric", remedy=remedy)
        values = {each.name: getattr(material, each.name) for each in fields(material)}
        both = material.bend_warp > 0.0 < material.bend_weft
        bias = 4.0 / (material.bias_compliance + 1.0 / material.bend_twist) if both else 0.0
        return values | {"bend_twist": material.bend_twist, "bend_bias": bias}

    def build(self, config: SwatchConfig, files: Files, seed: int) -> Fabric:
        """Build the swatch. Raises BadInput for more than MOST vertices, and a missing texture."""
        return self._at(config, files, np.asarray(config.centre), *lay(config, seed))

    def build_over(
        self, config: SwatchConfig, files: Files, seed: int, x: Float, faces: Int, worn: Sequence[Fabric] = ()
    ) -> Fabric:
        """Build it level on the shoulders of a body's mesh x (v, 3) [m], faces (f, 3), and on garments already `worn`.

        Raises BadInput, as `build`, and for a body without neck and arms, a hole that is too narrow for its neck, and a
        piece that would start inside of the body.
        """
        assert config.over is not None and config.hole is not None
        flat, triangles = lay(config, seed)
        fabric = self._at(config, files, put_on(config.over, config.hole, x, faces, worn), flat, triangles)
        clear = np.full(fabric.number, 0.5 * config.over.clearance)
        require_outside(fabric.position, clear, build_tree(x, faces), "piece", "a wider hole; arms below the shoulders")
        return fabric

    def _at(self, config: SwatchConfig, files: Files, centre: Float, flat: Float, faces: Int) -> Fabric:
        far = np.linalg.norm(flat, axis=1) if config.size is None else flat[:, 0]
        # A clamp ends at 0 on a strip, at a radius on a disc.
        end = 0.0 if config.size is not None else float(config.hold or 0.0)
        held = np.zeros(len(flat), np.bool_) if config.hold is None else far <= end + 1e-9
        # The outside is up: x, y of the flat piece become x, -z.
        level = np.column_stack([flat[:, 0], np.zeros(len(flat)), -flat[:, 1]])
        matrix = np.eye(3) if config.rotate is None else config.rotate.matrix()
        x = np.ascontiguousarray(turn(matrix, level) + centre)
        material = resolve(config.fabric)
        warp = turn(matrix, np.array([[np.cos(config.angle), 0.0, -np.sin(config.angle)]]))[0]
        elements = build_elements(material, x, faces, find_edges(faces), warp, tension=config.tension, held=held)
        low, high = flat.min(axis=0), flat.max(axis=0)
        uv = np.ascontiguousarray((flat - low) / (high - low).max(), np.float32)
        return elements.fabric(self.name, x, held, uv=uv, texture=find_texture(config.texture, files))


def lay(config: SwatchConfig, seed: int) -> tuple[Float, Int]:
    """Return points (n, 2) [m] and triangles (f, 3), counter-clockwise. Raises BadInput for more than MOST points."""
    area = config.size[0] * config.size[1] if config.size is not None else np.pi * float(config.radius or 0.0) ** 2
    if (many := area / config.edge**2) > MOST:
        raise BadInput(
            "too many vertices", field="edge", value=config.edge, limit=f"{MOST:,} vertices, these are {many:,.0f}",
            remedy="longer edges, or a smaller piece",
        )  # fmt: skip
    return _disc(config, seed) if config.size is None else _strip(config, seed)


def _strip(config: SwatchConfig, seed: int) -> tuple[Float, Int]:
    """Mesh a strip: x runs from -hold to length - hold; with a hole, about the strip's middle."""
    assert config.size is not None
    (length, width), hold, edge = config.size, float(config.hold or 0.0), config.edge
    held = max(2, round(hold / edge)) if hold else 0
    free = max(1, round((length - hold) / edge))
    across = max(1, round(width / edge))
    x = np.concatenate([np.linspace(-hold, 0.0, held + 1)[:-1], np.linspace(0.0, length - hold, free + 1)])
    y = np.linspace(-0.5 * width, 0.5 * width, across + 1)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    random = np.random.default_rng(seed)
    if config.layout == "irregular":
        # Borders, and the clamp's edge, stay straight: points on them move along them only.
        noise = THROWN * edge * random.uniform(-1.0, 1.0, points.shape)
        ends, rims = np.isin(points[:, 0], [x[0], 0.0, x[-1]]), np.isin(points[:, 1], [y[0], y[-1]])
        points[:, 0] += np.where(ends, 0.0, noise[:, 0])
        points[:, 1] += np.where(rims, 0.0, noise[:, 1])
    if config.hole is not None:
        points -= [0.5 * length, 0.0]
        rim = _circle(config.hole, edge, random)
        beyond = np.linalg.norm(points, axis=1) > config.hole + INSET * edge
        points = np.concatenate([rim, points[beyond]])
        return points, _without_hole(_without_degenerate(points, triangulate(points), edge), len(rim))
    if config.layout == "irregular":
        return points, _without_degenerate(points, triangulate(points), edge)
    row, column = (each.reshape(-1) for each in np.mgrid[: len(x) - 1, :across])
    a = row * (across + 1) + column
    b, c, d = a + across + 1, a + across + 2, a + 1
    flipped = (config.layout == "crossed") & ((row + column) % 2 == 1)
    first = np.where(flipped[:, None], np.column_stack([a, b, d]), np.column_stack([a, b, c]))
    second = np.where(flipped[:, None], np.column_stack([b, c, d]), np.column_stack([a, c, d]))
    return points, np.concatenate([first, second]).astype(np.int32)


def _disc(config: SwatchConfig, seed: int) -> tuple[Float, Int]:
    """Mesh a disc, with points on its rim and round its clamp or hole."""
    edge, radius, hole = config.edge, float(config.radius or 0.0), config.hole
    random = np.random.default_rng(seed)
    circles = [radius, *([inner] if (inner := config.hold or hole) else [])]
    rims = [_circle(size, edge, random) for size in circles]
    irregular = config.layout == "irregular"
    steps = edge, edge * np.sqrt(0.75) if irregular else edge
    across, down = (np.arange(-np.ceil(radius / step), radius / step + 1.0) * step for step in steps)
    grid = np.stack(np.meshgrid(across, down), axis=-1)
    if irregular:
        grid[1::2, :, 0] += 0.5 * edge
        grid += THROWN * edge * random.uniform(-1.0, 1.0, grid.shape)
    inside = grid.reshape(-1, 2)
    far = np.linalg.norm(inside, axis=1)
    clear: Bool = (far < radius) & (far > (hole or 0.0))
    for size in circles:
        clear &= np.abs(far - size) > INSET * edge
    if hole is None:
        points = np.concatenate([*rims, inside[clear]])
        return points, triangulate(points)
    points = np.concatenate([*rims[::-1], inside[clear]])
    return points, _without_hole(triangulate(points), len(rims[1]))


def _circle(radius: float, edge: float, random: np.random.Generator) -> Float:
    """Return points (k, 2) on a circle, about an edge apart, turned by a random angle [m]."""
    around = max(12, round(2.0 * np.pi * radius / edge))
    turned = 2.0 * np.pi * (np.arange(around) + random.uniform()) / around
    return np.asarray(radius * np.stack([np.cos(turned), np.sin(turned)], axis=1))


def _without_hole(faces: Int, rim: int) -> Int:
    """Leave out triangles (f, 3) in the hole, whose corners are all among the first `rim` points, those on its rim."""
    return np.asarray(faces[(faces >= rim).any(axis=1)])


def _without_degenerate(points: Float, faces: Int, edge: float) -> Int:
    """Return the triangles (f, 3) that have an area; some along a straight border have none."""
    corners = points[faces]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
    return np.asarray(faces[area > 1e-6 * edge**2])
