"""A skirt: a tube or cone of quads whose top row follows a body's waist.

The cloth is cut as a ring: row r, at the slant distance s from the waist, is 2 pi waist_radius long at the waist, 2 pi
hem_radius fullness at the hem, linear between. It starts on a cone from waist_radius to hem_radius; cloth that is
longer than the cone's circle (fullness > 1) goes into `pleats` folds, whose depth follows row by row from the length.
So the folds are real cloth, not a texture, and they stay when the skirt swings.

A circle skirt is cut from a flat ring (see `lay_ring`) and starts as an equally flat cone, where it has
room. On a body (nuno_cloth.models.skirt_over) waist and hips are the body's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, Field, field_validator, model_validator

from nuno_cloth.fabrics.constants import Lattice
from nuno_cloth.fabrics.material import FABRIC, FabricChoice, HandSet, resolve
from nuno_cloth.models.grid import Grid
from nuno_cloth.models.membrane import Elements, OfTriangles, build_triangles
from nuno_cloth.models.placement import (
    STILL,
    TEXTURE,
    VELOCITY,
    Attach,
    Point,
    Rotation,
    Velocity,
    Wearable,
    find_texture,
    require_bare,
)
from nuno_cloth.models.sheet import CELLS, CellKind, build_grid, bytes_of_grid
from nuno_cloth.models.skirt_over import AtWaist, Wearing, drape, ellipses, measure, rings
from nuno_cloth.models.triangles import find_edges
from nuno_cloth.models.wearer import check_stance, require_outside
from nuno_cloth.quantities import EdgeLength, Flatness, Fullness, Length
from nuno_cloth.sewing.draw import draw_together
from nuno_geometry.tree import Tree, build_tree
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Binding, Bool, Corners, Fabric, Float, Int
from nuno_schemas.plugin import Config, Files
from nuno_schemas.vectors import turn

# A circle skirt: a ring of flat cloth, or half or a quarter of one, sewn to itself and worn by its inner rim.
#
# The cloth lies flat between two circles about one centre. The skirt takes the share f of the inner circle, which is as
# long as the waist: W = 2 pi f r. Vertices are on circles, evenly round each, with half a step between neighbouring
# ones; triangles join each circle to the next. So no seam shows: a cone is as flat as a plane, and only the yarns,
# which run one way in the plane, meet at an angle at the seam, on the left.

Cut = Literal["cone", "circle", "half", "quarter"]
SHARES = {"circle": 1.0, "half": 0.5, "quarter": 0.25}
"""Share of a full circle of each cut."""
STANDARD = 0.7
"""A skirt that is cut to a body has the triangles that it would have round a waist of this girth [m]."""
LEAST = 12
"""The fewest vertices round each circle."""
FRONT = 0.75
"""Where the middle of the front is, as a share of the way round from the left side by the back."""


class Ring(NamedTuple):
    """A piece of a flat ring.

    row (n,) circle of each vertex; share (n,) its share of the way round, from the left side by the back; faces (f, 3)
    counter-clockwise seen from outside; corners (f, 3, 3) of each triangle in the flat ring about the centre [m]; warp
    (3,) direction of the yarns there: down the middle of the front
    """

    row: Int
    share: Float
    faces: Int
    corners: Float
    warp: Float


def count_round(length: float, waist: float, part: float, edge: float) -> Int:
    """Return the numbers (rows,) of vertices round each circle of a ring cut `length` wide round a `waist` [m]."""
    rows = max(2, round(length / (np.sqrt(0.75) * edge)) + 1)
    girth = waist + 2.0 * np.pi * part * length * np.linspace(0.0, 1.0, rows)
    return np.maximum(LEAST, np.round(girth / edge)).astype(np.int32)


def lay_ring(around: Int, length: float, waist: float, part: float) -> Ring:
    """Return a ring `length` wide round a `waist` [m], the share `part` of a circle, of `around` (rows,) vertices."""
    radius = waist / (2.0 * np.pi * part) + np.linspace(0.0, length, len(around))
    first = np.concatenate([[0], np.cumsum(around)])
    row = np.repeat(np.arange(len(around), dtype=np.int32), around)
    share = (np.arange(first[-1]) - first[row] + 0.5 * (row % 2)) / around[row]
    joined = [_join(i, *around[i : i + 2].tolist()) for i in range(len(around) - 1)]
    circle, place = (np.concatenate(each) for each in zip(*joined, strict=True))
    faces = first[circle] + place % around[circle]
    angle = 2.0 * np.pi * part * (share[faces] + place // around[circle])
    corners = radius[circle][..., None] * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=2)
    front = 2.0 * np.pi * part * FRONT
    return Ring(row, share, faces.astype(np.int32), corners, np.array([np.cos(front), np.sin(front), 0.0]))


def _join(row: int, above: int, below: int) -> tuple[Int, Int]:
    """Return triangles between a circle of `above` vertices and the next, of `below`: the circle (t, 3) of each corner
    and its place on it (t, 3), which counts on beyond the last.
    """
    up, down = np.arange(above), np.arange(below)
    upper, lower = (up + 1 + 0.5 * (row % 2)) / above, (down + 1 + 0.5 * ((row + 1) % 2)) / below
    opposite_upper, opposite_lower = (
        np.searchsorted(lower, upper, side="left"),
        np.searchsorted(upper, lower, side="right"),
    )
    place = np.concatenate([np.stack([up, opposite_upper, up + 1], 1), np.stack([opposite_lower, down, down + 1], 1)])
    circle = np.repeat([[row, row + 1, row], [row, row + 1, row + 1]], [above, below], axis=0)
    return circle, place


def place_ring(ring: Ring, position: Float) -> Float:
    """Return places (n, 3) of a ring's vertices between points of their rows (rows, columns, 3) [m], even on each."""
    columns = position.shape[1]
    at = ring.share * columns
    i = at.astype(np.int64) % columns
    part = (at - np.floor(at))[:, None]
    return np.asarray((1.0 - part) * position[ring.row, i] + part * position[ring.row, (i + 1) % columns])


# The configuration of a skirt, and checks that it can be made.

ROUNDING = 1e-9


class SkirtConfig(Config):
    """A cone, or a ring that is cut flat, whose top row is pinned. Columns start at +x and run towards -z.

    Texture: u runs from 0 to 1 around the waist, to the right as seen from outside, so that an image goes round once
    and its sides meet where columns begin, at the left side; v is 1 at the waist and 0 at the hem.
    """

    over: AtWaist | None = Field(
        default=None, description="the body that wears it, from which waist, place and width follow; none: as if in air"
    )
    cut: Cut = Field(
        default="cone",
        description="cone: as wide as hem_radius and fullness say; circle, half, quarter: that part of a flat ring, "
        "whose inner rim is the waist, in triangles",
    )
    waist_radius: Length = Field(default=0.13, description="of the circle that is as long as the waist [m]")
    hem_radius: Length = Field(
        default=0.28,
        description="of the circle as long as that on which the hem starts [m]; not given, over a body: as wide as "
        "hips and legs need; of a ring: as wide as it is cut, if there is room",
    )
    length: Length = Field(default=0.5, description="along the cloth, from waist to hem [m]")
    columns: int = Field(default=128, ge=4, le=16384, description="vertices around, an even number")
    rows: int = Field(default=64, ge=2, le=16384, description="vertices from waist to hem")
    fullness: Fullness = Field(default=1.0, description="the cloth's length at the hem over the circle it starts on")
    pleats: int = Field(default=12, ge=2, le=200, description="folds around with which it starts, where it has any")
    edge: EdgeLength = Field(default=0.015, description="length of a ring's triangles' edges [m]")
    ratio: Flatness = Field(default=1.0, description="the waist's depth over its width, z over x")
    centre: Point = Field(default=(0.0, 0.0, 0.0), description="middle of the waist [m]")
    rotate: Rotation | None = Field(
        default=None, description="a turn about the centre; before it the axis points down (-y)"
    )
    velocity: Velocity = Field(default=STILL, description=VELOCITY)
    cells: CellKind = Field(default="quads", description=CELLS)
    attach: Attach | None = Field(
        default=None,
        description="the body and frame that the waist moves with; not given: the body that it is over, else it stands",
    )
    fabric: FabricChoice = Field(default="denim", description=FABRIC)
    texture: str | None = Field(default=None, description=TEXTURE)

    @field_validator("columns")
    @classmethod
    def _even(cls, columns: int) -> int:
        if columns % 2:
            raise ValueError("must be even, so that alternating diagonals close around the tube")
        return columns

    @model_validator(mode="after")
    def _of_one_kind(self) -> SkirtConfig:
        placed = {"waist_radius", "ratio", "centre", "rotate"} & self.model_fields_set
        if self.over is not None and placed:
            raise ValueError(f"a skirt over a body takes its waist from it: leave {', '.join(sorted(placed))} out")
        if self.cut == "cone" and "edge" in self.model_fields_set:
            raise ValueError("a cone has columns and rows: leave edge out, or choose cut: circle, half or quarter")
        rows = {"columns", "rows", "cells", "fullness"} & self.model_fields_set
        if self.cut != "cone" and rows:
            raise ValueError(
                f"a ring has its fullness and triangles by cut and edge: leave {', '.join(sorted(rows))} out"
            )
        return self


def require_measures(config: SkirtConfig, waist: float, hem: float) -> None:
    """Raise BadInput if a skirt cannot start with circles of these radii [m], or has too few columns to fold."""
    ring = config.cut != "cone"
    widest = waist + config.length * (SHARES[config.cut] if ring else 1.0)
    if (hem > widest * (1.0 + ROUNDING)) if ring else abs(hem - waist) >= config.length:
        raise BadInput(
            "the hem would be wider than it is cut" if ring else "the hem lies further out than the cloth is long",
            field="hem_radius",
            value=hem,
            limit=f"{widest:g} m" if ring else f"less than {config.length:g} m from waist_radius {waist:g} m",
            remedy="leave it out" if ring else "make the skirt longer; for more cloth at the hem raise fullness",
        )
    if config.fullness > 1:
        require_columns(config)


def require_columns(config: SkirtConfig) -> None:
    """Raise BadInput for a cone with too few columns to fold."""
    if config.cut == "cone" and config.columns < 8 * config.pleats:
        raise BadInput(
            "too few columns to show the pleats",
            field="columns",
            value=config.columns,
            limit=f"at least 8 for each of {config.pleats} pleats",
            remedy=f"columns: {8 * config.pleats}, or fewer pleats",
        )


def require_width(config: SkirtConfig, circle: Float, wearing: Wearing, ease: float) -> None:
    """Raise BadInput if rows, cut `circle` (rows,) long [m], are too short to go round the body."""
    short = wearing.least - circle
    row = int(np.argmax(short))
    if short[row] > ROUNDING:
        most = f"{np.ceil(1e3 * (ease + short[row])) / 10.0:g} cm"
        down = 100.0 * config.length * row / (len(circle) - 1)
        raise BadInput(
            "the skirt is too narrow for the body", field="hem_radius" if config.cut == "cone" else "cut",
            value=f"{100.0 * circle[row]:.4g} cm round, {down:.3g} cm below the waist",
            limit=f"at least {100.0 * wearing.least[row]:.4g} cm there",
            remedy="leave hem_radius out" if config.cut == "cone" else f"ease: {most}, or more of a circle",
        )  # fmt: skip


FLARED = 0.35
"""Over a body a cone widens by this share of its length or more, as an A-line skirt does, if no hem_radius is given."""
OPEN = (1.0, 0.8, 0.6, 0.4, 0.2, 0.0)
"""Shares of its width at which a skirt tries to start, from the widest, until no arm is in the way."""
WIDER = "shorter, or another width; arms off the hips"
FINEST = 256
"""The fewest places round each row at which a ring's start is computed."""


class Skirt(Wearable, OfTriangles):
    """A ring of cloth; unstretched at the start, but for some per cent of shear that folds, and an
    elliptic waist, need.
    """

    name: ClassVar[str] = "skirt"
    Config: ClassVar[type[BaseModel]] = SkirtConfig

    def count(self, config: SkirtConfig, files: Files) -> int:
        return config.columns * config.rows if config.cut == "cone" else int(_count_columns_of_ring(config).sum())

    def memory(self, config: SkirtConfig, files: Files, vertices: int) -> int:
        """Return the most memory that a run takes [bytes]."""
        if config.cut != "cone":
            return super().memory(config, files, vertices)
        return vertices * bytes_of_grid(config.cells, config.fabric)

    def build(self, config: SkirtConfig, files: Files, seed: int) -> Fabric:
        """Build the skirt in air. Raises BadInput for impossible measures, a missing texture, elongated cells."""
        waist, hem = config.waist_radius, config.hem_radius
        if config.cut != "cone" and "hem_radius" not in config.model_fields_set:
            hem = waist + SHARES[config.cut] * config.length
        require_measures(config, waist, hem)
        circle = _lengths(config, waist, hem)
        curve = ellipses(np.linspace(waist, hem, len(circle)), config.ratio, circle, config.pleats)
        points = drape(_columns(config), config.length / (len(circle) - 1), circle, curve)
        turned = points if config.rotate is None else turn(config.rotate.matrix(), points)
        placed = turned + np.asarray(config.centre)
        if config.cut == "cone":
            return self._of_grid(config, files, circle, placed, config.attach)
        return self._of_ring(config, files, circle, placed, config.attach)

    def build_over(
        self, config: SkirtConfig, files: Files, seed: int, x: Float, faces: Int, worn: Sequence[Fabric] = ()
    ) -> Fabric:
        """Build the skirt on a body's mesh x (v, 3) [m], faces (f, 3). Raises BadInput, as `build`, and for a body that
        has no waist or wears cloth already, and for a skirt that is too narrow for it or would start inside of it.
        """
        assert config.over is not None
        require_bare(worn, self.name, config.over.body)
        check_stance(x, faces, config.over.body)
        falls = np.linspace(
            0.0, config.length, len(_count_columns_of_ring(config)) if config.cut != "cone" else config.rows
        )
        wearing = measure(config.over, x, faces, falls)
        waist = (wearing.tape + config.over.ease) / (2.0 * np.pi)
        hem = _hem(config, wearing, waist)
        require_measures(config, waist, hem)
        circle = _lengths(config, waist, hem)
        require_width(config, circle, wearing, config.over.ease)
        attach = config.attach if "attach" in config.model_fields_set else Attach(body=config.over.body)
        body = build_tree(x, faces)
        points = self._worn(config, wearing, circle, 2.0 * np.pi * hem, body)
        if config.cut == "cone":
            return self._of_grid(config, files, circle, points, attach)
        fabric = self._of_ring(config, files, circle, points, attach, (body, config.over.clearance))
        row = np.repeat(np.arange(len(falls)), _count_columns_of_ring(config))
        clear = np.interp(falls[row], falls, 0.5 * wearing.clear)
        require_outside(fabric.position, clear, body, "skirt", WIDER)
        return fabric

    def _worn(self, config: SkirtConfig, wearing: Wearing, circle: Float, hem: float, body: Tree) -> Float:
        """Return its start (rows, columns, 3) on a body [m], the hem `hem` long, or shorter to clear arms."""
        down = np.linspace(0.0, 1.0, len(circle))
        least = np.minimum(wearing.least, circle)
        for share in OPEN:
            # Evenly deepening folds take up cloth in proportion to the square of the way down.
            base = np.maximum(circle - (circle[-1] - share * hem - (1.0 - share) * circle[0]) * down**2, least)
            base = np.minimum(base, circle)
            if base[-1] < circle[-1] * (1.0 - ROUNDING):
                require_columns(config)
            curve = rings(wearing, base, circle, config.pleats)
            points = drape(_columns(config), config.length / (len(circle) - 1), circle, curve) + wearing.centre
            clear = np.repeat(0.5 * wearing.clear, points.shape[1])
            try:
                require_outside(points.reshape(-1, 3), clear, body, "skirt", WIDER)
            except BadInput as error:
                refused = error
            else:
                return points
        raise refused

    def _of_grid(
        self, config: SkirtConfig, files: Files, circle: Float, points: Float, attach: Attach | None
    ) -> Fabric:
        """Return a cone of rows that are `circle` (rows,) long, at points (rows, columns, 3) [m]."""
        grid = Grid(config.rows, config.columns, periodic=True)
        slant = np.full(config.rows - 1, config.length / (config.rows - 1))
        x, held = np.ascontiguousarray(points.reshape(-1, 3)), np.repeat(np.arange(config.rows) == 0, config.columns)
        lattice = Lattice(circle / config.columns, slant)
        try:
            elements = build_grid(grid, lattice, resolve(config.fabric), x, config.cells, held)
        except BadInput as error:  # of cells that are too elongated
            raise replace(error, field="rows") from None
        share = np.tile(np.arange(config.columns) / config.columns, config.rows)
        row = np.repeat(np.arange(config.rows, dtype=np.int32), config.columns)
        return self._fabric(config, files, x, held, lay_round(share, row, elements.faces), elements, attach)

    def _of_ring(
        self, config: SkirtConfig, files: Files, circle: Float, points: Float, attach: Attach | None,
        body: tuple[Tree, float] | None = None,
    ) -> Fabric:  # fmt: skip
        """Return a ring with circles `circle` (rows,) long, at points (rows, columns, 3) [m], on a `body` then relaxed
        to its size at least at the given clearance [m]. Raises BadInput for constants per spring.
        """
        material = resolve(config.fabric)
        if isinstance(material, HandSet):
            problem, remedy = "constants per spring make no membrane", "give a preset or measured values"
            raise BadInput(problem, field="fabric", remedy=remedy)
        ring = lay_ring(_count_columns_of_ring(config), config.length, float(circle[0]), SHARES[config.cut])
        x, held = place_ring(ring, points), ring.row == 0
        if body is not None:
            edges = find_edges(ring.faces)
            rest = np.zeros(len(edges.pairs))
            rest[edges.of_face] = np.linalg.norm(np.roll(ring.corners, -1, axis=1) - ring.corners, axis=2)
            x = draw_together(x, edges, rest, *body, worn=True, held=held)
        elements = build_triangles(material, ring.corners, ring.faces, ring.warp, held)
        return self._fabric(config, files, x, held, lay_round(ring.share, ring.row, ring.faces), elements, attach)

    def _fabric(
        self, config: SkirtConfig, files: Files, x: Float, held: Bool, corners: Corners, elements: Elements,
        attach: Attach | None,
    ) -> Fabric:  # fmt: skip
        waist = np.flatnonzero(held).astype(np.int32)
        bindings = () if attach is None else (Binding(waist, attach.body, attach.frame),)
        texture = find_texture(config.texture, files)
        return elements.fabric(self.name, x, held, config.velocity, corners=corners, bindings=bindings, texture=texture)


def _count_columns_of_ring(config: SkirtConfig) -> Int:
    """Return the numbers (rows,) of vertices round each circle of a ring."""
    waist = STANDARD if config.over is not None else 2.0 * np.pi * config.waist_radius
    return count_round(config.length, waist, SHARES[config.cut], config.edge)


def _columns(config: SkirtConfig) -> int:
    """Return the number of places round each row at which the start is computed."""
    return config.columns if config.cut == "cone" else max(FINEST, 16 * config.pleats)


def _lengths(config: SkirtConfig, waist: float, hem: float) -> Float:
    """Return the cut lengths (rows,) of rows for these radii of the waist and of the hem's starting circle [m]."""
    if config.cut == "cone":
        return np.asarray(2 * np.pi * (waist + np.linspace(0, 1, config.rows) * (hem * config.fullness - waist)))
    down = config.length * np.linspace(0.0, 1.0, len(_count_columns_of_ring(config)))
    return np.asarray(2.0 * np.pi * (waist + SHARES[config.cut] * down))


def _hem(config: SkirtConfig, wearing: Wearing, waist: float) -> float:
    """Return the radius of a circle as long as the curve on which a hem starts round a body with a waist of this radius
    [m].
    """
    if "hem_radius" in config.model_fields_set:
        return config.hem_radius
    if config.cut != "cone":
        return waist + SHARES[config.cut] * config.length
    down = np.linspace(0.0, 1.0, config.rows)[1:]
    hips = waist + float(((wearing.least[1:] / (2.0 * np.pi) - waist) / down).max())
    return max(waist + FLARED * config.length, hips / config.fullness * (1.0 + ROUNDING))


def lay_round(share: Float, row: Int, faces: Int) -> Corners:
    """Return texture coordinates of vertices (n,) from their share of the way round and their row: u from 0 at the left
    side once round to 1, to the right as seen from outside; v from 1 at the waist to 0 at the hem. Where rows begin
    half a step apart, as in a ring, u ends at 1 for both: the image ends at the side.
    """
    around = share[faces]
    over = (around < 0.5) & (np.ptp(around, axis=1)[:, None] > 0.5)
    return Corners.of(faces, np.stack([np.minimum(around + over, 1.0), 1.0 - row[faces] / row[-1]], axis=2))
