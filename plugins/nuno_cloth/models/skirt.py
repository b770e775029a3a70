"""A skirt: a tube or cone of quads whose top row follows a body's waist.

The cloth is cut as a ring: row r, at the slant distance s from the waist, is 2 pi waist_radius long at the waist, 2 pi
hem_radius fullness at the hem, linear between. It starts on a cone from waist_radius to hem_radius; cloth that is
longer than the cone's circle (fullness > 1) goes into `pleats` folds, whose depth follows row by row from the length.
So the folds are real cloth, not a texture, and they stay when the skirt swings.

A circle skirt is cut from a flat ring (nuno_cloth.models.skirt_cut) and starts as an equally flat cone, where it has
room. On a body (nuno_cloth.models.skirt_over) waist and hips are the body's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
from pydantic import BaseModel

from nuno_cloth.fabrics.constants import Lattice
from nuno_cloth.fabrics.material import HandSet, resolve
from nuno_cloth.models.bending_friction import bytes_of_friction
from nuno_cloth.models.grid import Grid
from nuno_cloth.models.membrane import BYTES_PER_VERTEX, Elements, build_triangles
from nuno_cloth.models.outside import require_outside
from nuno_cloth.models.placement import Attach, Wearable, find_texture, require_bare
from nuno_cloth.models.sheet import build_grid, bytes_of_grid
from nuno_cloth.models.skirt_config import ROUNDING, SkirtConfig, require_columns, require_measures, require_width
from nuno_cloth.models.skirt_cut import SHARES, STANDARD, count_round, lay_ring, place_ring
from nuno_cloth.models.skirt_over import Wearing, measure, rings
from nuno_cloth.models.skirt_rows import drape, ellipses
from nuno_cloth.models.stance import check_stance
from nuno_cloth.models.triangles import find_edges
from nuno_cloth.sewing.draw import draw_together
from nuno_geometry.tree import Tree, build_tree
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Binding, Bool, Corners, Fabric, Float, Int
from nuno_schemas.plugin import Files
from nuno_schemas.vectors import turn

FLARED = 0.35
"""Over a body a cone widens by this share of its length or more, as an A-line skirt does, if no hem_radius is given."""
OPEN = (1.0, 0.8, 0.6, 0.4, 0.2, 0.0)
"""Shares of its width at which a skirt tries to start, from the widest, until no arm is in the way."""
WIDER = "shorter, or another width; arms off the hips"
FINEST = 256
"""The fewest places round each row at which a ring's start is computed."""


class Skirt(Wearable):
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
            return vertices * (BYTES_PER_VERTEX + bytes_of_friction(config.fabric))
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
        return Fabric(
            name=self.name,
            position=x,
            velocity=np.tile(np.asarray(config.velocity, np.float64), (len(x), 1)),
            pinned=held,
            corners=corners,
            bindings=() if attach is None else (Binding(waist, attach.body, attach.frame),),
            texture=find_texture(config.texture, files),
            **elements._asdict(),
        )


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
