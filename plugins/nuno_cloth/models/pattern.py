"""A garment sewn from its pattern, and put on a body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Annotated, ClassVar
from unicodedata import normalize

import numpy as np
from pydantic import BaseModel, Field
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull

from nuno_cloth.fabrics.material import FABRIC, FabricChoice, HandSet, Materials, resolve
from nuno_cloth.fabrics.presets import DAMPING_RATIO, Material
from nuno_cloth.models.bending_friction import bytes_of_friction
from nuno_cloth.models.membrane import BYTES_PER_VERTEX, build_triangles
from nuno_cloth.models.placement import Wearable, find_texture
from nuno_cloth.models.triangles import Edges, find_edges
from nuno_cloth.models.wearer import check_openings, check_place, check_stance
from nuno_cloth.quantities import EdgeLength, Length
from nuno_cloth.sewing.alter import alter_pattern
from nuno_cloth.sewing.check import check_pattern
from nuno_cloth.sewing.draw import FINE, draw_together, points_between
from nuno_cloth.sewing.pattern import Pattern as Drawn
from nuno_cloth.sewing.pattern_file import PatternFile, as_written, require_sound
from nuno_cloth.sewing.refine import close_short, refine
from nuno_cloth.sewing.sew import Sewn, sew
from nuno_cloth.sewing.wrap import LESS, WIDE, flare, wrap
from nuno_geometry.check import place_of
from nuno_geometry.closest_point import closest_points
from nuno_geometry.isosurface import net_of
from nuno_geometry.sections import cut_mesh
from nuno_geometry.tree import Tree, build_tree
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import ELASTIC, Corners, Fabric, Float, Int, Panels, Springs
from nuno_schemas.pattern import Altered, Checked
from nuno_schemas.plugin import Config, Files, Rested
from nuno_schemas.units import quantity

# Elastics: bands sewn along edges that go round the body. They are shorter than it and hold a garment in place.

STIFFNESS, DENSITY = 15.0, 0.015
"""EA [N] and mass per relaxed length [kg/m] of a knitted band some 2 cm wide: assumed."""
FLATTEST = 1e-3
"""Points nearer to a line than this [m] enclose nothing."""


@dataclass(frozen=True)
class Band:
    """An elastic band: pairs (k, 2) of sewn vertices that go round, and the relaxed length (k,) of each part [m]."""

    pairs: Int
    rest: Float


def bands_along(
    label: str, share: float, sewn: Sewn, edges: Edges, x: Float, body: Float, body_faces: Int
) -> list[Band]:
    """Return bands along the edges of a label, one for each closed line that these form on the garment at its start x
    (n, 3) [m], each as long as this share of the body's girth, but no longer than the edges are cut.

    A seam's length is that of its shorter edge. Raises BadInput for a label without edges, and for edges that enclose
    nothing.
    """
    cut = np.full(len(edges.pairs), np.inf)
    np.minimum.at(cut, edges.of_face.reshape(-1), sewn.sides.reshape(-1))
    bands = []
    for sides in _lines(label, sewn, edges):
        pairs = edges.pairs[sides]
        girth = girth_inside(x[np.unique(pairs)], body, body_faces)
        if not girth:
            remedy = "an elastic goes along edges that go round the body, or round a limb"
            raise BadInput("edges of this label go round no part of the body", value=label, remedy=remedy)
        bands.append(Band(pairs, min(1.0, share * girth / float(cut[sides].sum())) * cut[sides]))
    return bands


def _lines(label: str, sewn: Sewn, edges: Edges) -> list[Int]:
    """Return the numbers of sides of each closed line along the edges of a label. Raises BadInput."""
    label = normalize("NFC", label)
    runs = [run for on_label, names in zip(sewn.edges, sewn.labels, strict=True)
            for run, name in zip(on_label, names, strict=True) if normalize("NFC", name or "") == label]  # fmt: skip
    if not runs:
        labels = sorted({name for names in sewn.labels for name in names if name is not None})
        raise BadInput("no edge of the pattern has this label", value=label, remedy=nearest(label, labels))
    n, code = sewn.number, np.array([sewn.number, 1])
    ends = np.sort(np.concatenate([sewn.merged[np.stack([run[:-1], run[1:]], axis=1)] for run in runs]), axis=1)
    on_label = np.flatnonzero(np.isin(edges.pairs @ code, ends @ code))
    a, b = edges.pairs[on_label].T
    if (np.bincount(np.concatenate([a, b]))[np.unique(np.concatenate([a, b]))] != 2).any():
        remedy = "give all edges of one opening, or of a seam round the body, the same label"
        raise BadInput("edges of this label do not go round", value=label, remedy=remedy)
    component = connected_components(coo_array((np.ones(len(on_label)), (a, b)), shape=(n, n)), directed=False)[1][a]
    return [on_label[component == part] for part in np.unique(component)]


def girth_inside(ring: Float, x: Float, faces: Int) -> float:
    """Return the girth [m] of the parts of a body x (v, 3), faces (f, 3), inside of a ring of points (k, 3), in the
    mean plane of these; 0 if it encloses nothing.
    """
    middle = ring.mean(axis=0)
    axes = np.linalg.svd(ring - middle, full_matrices=False)[2]
    flat = (ring - middle) @ axes[:2].T
    if np.ptp(flat, axis=0).min() < FLATTEST:
        return 0.0
    sides = ConvexHull(flat).equations
    inner = [
        (loop.points - middle) @ axes[:2].T
        for loop in cut_mesh(x, faces, (x - middle) @ axes[2])
        if (sides[:, :2] @ (axes[:2] @ (loop.centroid() - middle)) + sides[:, 2] <= 0.0).all()
    ]
    return float(ConvexHull(np.concatenate(inner)).area) if inner else 0.0


def springs_of(bands: Sequence[Band], mass: Float) -> tuple[Springs, Float]:
    """Return the springs of bands, and the masses (n,) [kg] of vertices that have `mass` (n,) without bands."""
    pairs, rest = (np.concatenate([getattr(band, name) for band in bands]) for name in ("pairs", "rest"))
    mass = mass + np.bincount(pairs.reshape(-1), np.repeat(0.5 * DENSITY * rest, 2), len(mass))
    k, (one, other) = STIFFNESS / rest, mass[pairs].T
    c = 2.0 * DAMPING_RATIO * np.sqrt(k * one * other / (one + other))
    return Springs.from_pairs(pairs, k, rest, c, ELASTIC), mass


# Texture coordinates of a sewn garment, by cut vertex: a print runs along the warp of each panel.


def lay_out(sewn: Sewn) -> tuple[Float, float]:
    """Return texture coordinates (m, 2) of the cut vertices, u to the right and v upwards, in [0, 1], and the length of
    their unit [m]. `sewn.faces` index them.

    Each panel lies with its outside up, turned so that its warp runs along v; panels stand side by side in their
    order, all on v = 0, and all at one scale: that of the longer side of the rectangle round them. So a stripe along v
    follows the warp on every panel. A seam's vertices are one in the cloth and differ here, as panels are cut apart.
    """
    points, start = np.empty_like(sewn.flat), 0.0
    for k, (x, y) in enumerate(sewn.warp):
        used = np.unique(sewn.faces[sewn.panel == k])
        flat = sewn.flat[used]
        # Sums of two products, and no matrix product: BLAS may round in another order.
        turned = np.stack([flat[:, 0] * y - flat[:, 1] * x, flat[:, 0] * x + flat[:, 1] * y], axis=1)
        turned -= turned.min(axis=0)
        turned[:, 0] += start
        points[used] = turned
        start = float(turned[:, 0].max())
    unit = float(points.max())
    return points / unit, unit


# The surface of a dressed body, which the next garment goes round.

CELLS, FINEST = 2.0, 8e-3
"""Grid cells per clearance, and their least size [m]."""


def enclose(x: Float, faces: Int, worn: Sequence[Fabric], clearance: float) -> tuple[Float, Int]:
    """Return vertices (v, 3) [m] and triangles (f, 3) of a closed surface about `clearance` [m] off a body with
    vertices x (n, 3) and triangles faces (m, 3) and off the cloth that it wears.

    Space between body and cloth that is narrower than twice the clearance, or closed off, is enclosed, so that a
    garment drawn round the surface does not get beneath a hem.
    """
    from scipy.ndimage import binary_fill_holes

    spacing = max(clearance / CELLS, FINEST)
    points = np.concatenate([x, *(one.position for one in worn)])
    low = points.min(axis=0) - clearance - 2.0 * spacing
    counts = np.ceil((points.max(axis=0) + clearance + 2.0 * spacing - low) / spacing).astype(int) + 1
    nodes = low + spacing * np.indices(tuple(counts)).reshape(3, -1).T
    away = np.asarray(closest_points(build_tree(x, faces), nodes).distance)
    for one in worn:
        # Cloth has two sides, and no inside.
        away = np.minimum(away, np.abs(closest_points(build_tree(one.position, one.faces), nodes).distance))
    value = away.reshape(tuple(counts)) - clearance
    value[binary_fill_holes(value < 0.0) & (value >= 0.0)] = -clearance
    return net_of(value, low, spacing)


SHORTEST, SHARE = 3e-3, 0.2
"""Sides shorter than this [m], and than this share of the intended length, are collapsed."""

UNEVEN = 1.2
"""A seam whose longer edge is more than this multiple of the shorter may join wrong edges."""
HELD = "lower_interface", "strapless_top"
"""GarmentCode's labels of edges at the waist and at the top of a strapless garment."""


class Over(Config):
    """The body that wears it."""

    body: str = Field(min_length=1, description="name of the body, which has a mesh as collider")
    clearance: Length = Field(
        default=2e-2, description="how far off the body, and off cloth that it wears already, the cloth starts [m]"
    )


class Elastic(Config):
    """An elastic band that is sewn along edges and is shorter than these."""

    along: str = Field(min_length=1, description="label of edges of the pattern that go round the body")
    girth: Annotated[float, quantity("", gt=0.2, le=1)] = Field(
        default=0.85, description="its length over the body's girth where it starts"
    )


class PatternConfig(Config):
    """A sewing pattern, and the body that its panels are placed round. docs/how-to/sewing.md shows how to use it."""

    file: str = Field(description="the pattern beside the scene: JSON as GarmentCode writes it, or YAML of that")
    over: Over | None = Field(default=None, description="the body it is put on: upright, facing +z; none: as if in air")
    edge: EdgeLength = Field(default=0.02, description="length of triangles' sides [m]")
    coarse: EdgeLength | None = Field(
        default=None,
        description="length of triangles' sides on which it comes to rest on its body before the first frame, where "
        "that is longer than edge [m]; none: it begins as it is drawn together",
    )
    fabric: FabricChoice = Field(default="interlock", description=FABRIC)
    fabrics: dict[str, FabricChoice] = Field(
        default_factory=dict, description="the fabric of panels, by name, that are cut of another one"
    )
    elastics: tuple[Elastic, ...] | None = Field(
        default=None,
        description=f"bands that hold it where it is put; not given: along edges labelled {' and '.join(HELD)} that "
        "go round, which GarmentCode's programs hold there; []: none",
    )
    texture: str | None = Field(
        default=None, description="an image beside the scene, of which all panels are cut, side by side, warp upwards"
    )


class Pattern(Wearable):
    """A garment sewn from a pattern: triangles have their cut shapes at rest, warp and weft follow each panel, and
    cloth bends across seams. A seam's vertices are merged from the start; nuno_cloth.sewing.draw pulls panels together
    round the body.
    """

    name: ClassVar[str] = "pattern"
    Config: ClassVar[type[BaseModel]] = PatternConfig

    def count(self, config: PatternConfig, files: Files) -> int:
        return _sewn(config, files).number

    def memory(self, config: PatternConfig, files: Files, vertices: int) -> int:
        """Return the most memory that a run takes [bytes]."""
        rubs = max(bytes_of_friction(one) for one in (config.fabric, *config.fabrics.values()))
        return vertices * (BYTES_PER_VERTEX + rubs)

    def build(self, config: PatternConfig, files: Files, seed: int) -> Fabric:
        """Sew the pattern. Raises BadInput for one that cannot be sewn, constants per spring, a missing texture."""
        sewn = _sewn(config, files)
        texture = find_texture(config.texture, files)
        if config.elastics:
            problem, remedy = "an elastic is as long as the body is round, and there is none", "give over: {body: NAME}"
            raise BadInput(problem, field="elastics", remedy=remedy)
        return self._fabric(config, texture, sewn, _start(sewn, find_edges(sewn.sewn_faces), None, 0.0))

    def coarser(self, config: PatternConfig) -> PatternConfig | None:
        """Return the configuration with `coarse` triangles on which the garment first comes to rest, or None."""
        if config.over is None or config.coarse is None or config.coarse <= config.edge:
            return None
        return config.model_copy(update={"edge": config.coarse, "coarse": None})

    def build_over(
        self, config: PatternConfig, files: Files, seed: int, x: Float, faces: Int, worn: Sequence[Fabric] = (),
        rested: Rested | None = None,
    ) -> Fabric:  # fmt: skip
        """Sew the garment on a body's mesh x (v, 3) [m], faces (f, 3), over the garments already `worn`, or start it
        where it `rested` on fewer vertices. Raises BadInput, as `build`, and, with panel and place, where the garment
        does not close round the body.
        """
        if config.over is None:
            raise BadInput("the garment has no body to be put on", field="over")
        check_stance(x, faces, config.over.body)
        texture = find_texture(config.texture, files)
        sewn = _sewn(config, files)
        edges, clearance = find_edges(sewn.sewn_faces), config.over.clearance
        body = build_tree(x, faces)
        check_place(sewn.placed, x, config.over.body, body)
        if rested is not None:
            start, position = refine(sewn, _sewn(rested.config, files), [rested.start, rested.x])
            return self._fabric(config, texture, sewn, position, _bands(config, sewn, edges, start, (x, faces)))
        wrapped = wrap(sewn, x, faces, clearance)
        around, clear = (build_tree(*enclose(x, faces, worn, clearance)), 0.0) if worn else (body, clearance)
        # A flared panel that is laid through a hand starts narrower, in waves, and opens.
        for wide in (WIDE, LESS):
            sewn = replace(sewn, placed=flare(sewn, wrapped, x, faces, clearance, wide))
            position = _start(sewn, edges, around, clear)
            try:
                _require_outside(position, edges, sewn, body, config.over.body)
                break
            except BadInput:
                if wide == LESS:
                    raise
        bands = _bands(config, sewn, edges, position, (x, faces))
        check_openings(position, edges, body, config.over.body)
        return self._fabric(config, texture, sewn, position, bands)

    def _fabric(
        self, config: PatternConfig, texture: str | None, sewn: Sewn, x: Float, bands: Sequence[Band] = ()
    ) -> Fabric:
        material = _materials(config, sewn)
        held = np.zeros(len(x), np.bool_)
        flat, warp = _level(sewn.flat)[sewn.faces], _level(sewn.warp)[sewn.panel]
        elements = build_triangles(material, flat, sewn.sewn_faces, warp, held)
        if bands:
            springs, mass = springs_of(bands, elements.mass)
            elements = elements._replace(springs=springs, mass=mass)
        return elements.fabric(self.name, x, held, corners=_corners(sewn), texture=texture)

    def check_pattern(self, files: Files, name: str, gather: float) -> Checked:
        """Check a sewing pattern before it is sewn: `gather` is the ratio of a seam's edges from which the check warns.
        Raises BadInput for a file that is not a pattern.
        """
        return check_pattern(files, name, gather)

    def alter_pattern(self, files: Files, name: str, side: tuple[str, int], length: float) -> Altered:
        """Return a pattern's file in which an edge, by its panel and number, is `length` [m] long. Raises BadInput."""
        return alter_pattern(files, name, side, length)


@dataclass(frozen=True)
class _Drawing:
    """A pattern that is cached by the text of its file."""

    text: str
    pattern: Drawn = field(compare=False)


def _sewn(config: PatternConfig, files: Files) -> Sewn:
    written = files.read(config.file, PatternFile)
    return _cut(_Drawing(written.said.model_dump_json(), require_sound(written)), config.edge)


@lru_cache(maxsize=8)
def _cut(drawing: _Drawing, edge: float) -> Sewn:
    """Sew a pattern in triangles. Cached, since a scene sews the same pattern three times at each edge length."""
    return close_short(sew(drawing.pattern, edge), min(SHORTEST, SHARE * edge))


def _materials(config: PatternConfig, sewn: Sewn) -> Materials:
    """Return the fabric of each triangle. Raises BadInput for constants per spring and unknown panels."""
    each: list[Material] = []
    for place, choice in {
        "fabric": config.fabric,
        **{f"fabrics.{k}": one for k, one in config.fabrics.items()},
    }.items():
        if isinstance(material := resolve(choice), HandSet):
            remedy = "give a preset or measured values"
            raise BadInput("constants per spring make no membrane", field=place, remedy=remedy)
        each.append(material)
    choice_of_panel = np.zeros(len(sewn.names), np.int32)
    for k, panel in enumerate(config.fabrics, 1):
        if (name := as_written(panel, sewn.names)) not in sewn.names:
            raise BadInput("the pattern has no such panel", field="fabrics", value=panel,
                           remedy=nearest(panel, sewn.names))  # fmt: skip
        choice_of_panel[sewn.names.index(name)] = k
    return Materials(tuple(each), choice_of_panel[sewn.panel])


def _corners(sewn: Sewn) -> Corners:
    points, unit = lay_out(sewn)
    pairs = np.concatenate([np.empty((0, 2), np.int32), *(one.pairs for one in sewn.seams)])
    seam = np.repeat(np.arange(len(sewn.seams), dtype=np.int32), [len(one.pairs) for one in sewn.seams])
    panels = Panels(sewn.names, sewn.panel, sewn.side_edges(), np.full(len(sewn.names), unit), pairs, seam)
    return Corners(points.astype(np.float32), sewn.merged.astype(np.int32), sewn.faces, panels)


def _level(flat: Float) -> Float:
    return np.column_stack([flat, np.zeros(len(flat))])


def _start(sewn: Sewn, edges: Edges, body: Tree | None, clearance: float) -> Float:
    """Return the start (n, 3) of the garment [m]. Vertices of a seam begin midway between the placed panels."""
    share = np.bincount(sewn.merged)
    x = np.stack([np.bincount(sewn.merged, along) / share for along in sewn.placed.T], axis=1)
    number = edges.of_face.reshape(-1)
    # Gathers: a side's rest length is the mean of its lengths in both panels.
    rest = np.bincount(number, sewn.sides.reshape(-1)) / np.bincount(number)
    return draw_together(x, edges, rest, body, clearance)


def _bands(config: PatternConfig, sewn: Sewn, edges: Edges, x: Float, body: tuple[Float, Int]) -> list[Band]:
    """Return the elastic bands of a garment that starts at x (n, 3) [m]. Raises BadInput for labels that name no closed
    edge.
    """
    configured, bands = config.elastics, list[Band]()
    for i, one in enumerate([Elastic(along=label) for label in HELD] if configured is None else configured):
        try:
            bands += bands_along(one.along, one.girth, sewn, edges, x, *body)
        except BadInput as error:
            if configured is not None:
                raise error.at(f"elastics.{i}.along") from None
    return bands


def _require_outside(x: Float, edges: Edges, sewn: Sewn, body: Tree, name: str) -> None:
    """Raise BadInput with the panel and the place for a garment that starts inside of the body."""
    a, b, part = points_between(x, edges.pairs, np.zeros(len(x)), 0.0, FINE)
    vertices = np.arange(len(x))
    a, b, part = np.concatenate([vertices, a]), np.concatenate([vertices, b]), np.concatenate([0.0 * vertices, part])
    there = (1.0 - part)[:, None] * x[a] + part[:, None] * x[b]
    distance = np.asarray(closest_points(body, there).distance)
    deepest = int(distance.argmin())
    if distance[deepest] >= 0.0:
        return
    panel = sewn.names[sewn.panel[(sewn.sewn_faces == a[deepest]).any(axis=1)][0]]
    uneven = [f"stitch {one.seam.stitch} ({one.seam.names})" for one in sewn.seams
              if panel in dict(one.seam.sides) and max(one.lengths) > UNEVEN * min(one.lengths)]  # fmt: skip
    stitches = f", or look whether {', '.join(uneven)} joins edges that belong together" if uneven else ""
    raise BadInput(
        f"panel {panel} cannot be put round {name}, and starts in it ({np.count_nonzero(distance < 0.0):,} places)",
        field="over.body", value=f"{-1e3 * distance[deepest]:.3g} mm deep, {place_of(there[deepest])}",
        remedy="place the panel so that with those it is sewn to it encloses what it is worn on, and no hand beside "
        f"it, or cut it wider{stitches}",
    )  # fmt: skip
