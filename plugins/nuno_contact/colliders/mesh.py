"""A closed triangle mesh as a body: from a file, or one of the figures and solids that come with nuno."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from pydantic import BaseModel, Field, model_validator

from nuno_contact.body_shapes.leg import LANDMARKS, leg_mesh
from nuno_contact.body_shapes.person import GIRTHS, HEIGHTS, person_mesh, torso_mesh
from nuno_contact.colliders.shapes import ORIGIN, OnJoint, one_primitive
from nuno_contact.motions.rotations import from_axis_angle
from nuno_contact.quantities import Angle, Direction, Point, Reach, Size
from nuno_geometry.check import crossing_notes
from nuno_geometry.closest_point import Closest, closest_points
from nuno_geometry.mesh_files.mesh import read_closed
from nuno_geometry.tree import build_tree
from nuno_schemas.bodies import MESH, rotation_matrices
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.plugin import BodyShape, Config, Files, Mover
from nuno_schemas.vectors import turn

# Boxes, cylinders and cones with rounded edges.

CORNER = 4
"""least number of sides round a quarter of a rounded edge"""


def box_mesh(size: tuple[float, float, float], rounding: float, resolution: int) -> tuple[Float, Int]:
    """Return vertices (n, 3) [m] and triangles (f, 3), seen counter-clockwise from outside.

    size [m] along x, y and z; rounding [m] is the radius of edges and corners; sides of triangles are about as long as
    the longest way round over `resolution`.
    """
    half = 0.5 * np.asarray(size)
    step = 8.0 * float(np.sort(half)[1:].sum()) / 2.0 / resolution
    corner = max(CORNER, math.ceil(0.5 * math.pi * rounding / step)) if rounding > 0.0 else 0
    # Along each axis; in a rounded edge the points of a cube that map to even angles of a circle.
    bent = rounding * np.tan(np.linspace(0.0, 0.25 * math.pi, corner + 1)[1:]) if corner else np.zeros(0)
    axes = []
    for one in half:
        flat = one - rounding
        middle = np.linspace(-flat, flat, max(1, math.ceil(2.0 * flat / step)) + 1) if flat > 0.0 else np.zeros(1)
        axes.append(np.concatenate([-(flat + bent[::-1]), middle, flat + bent]))
    points, faces, number = [], [], 0
    for axis in range(3):
        one, other = (axis + 1) % 3, (axis + 2) % 3
        u, v = np.meshgrid(axes[one], axes[other], indexing="ij")
        for sign in (-1.0, 1.0):
            side = np.empty((u.size, 3))
            side[:, axis], side[:, one], side[:, other] = sign * half[axis], u.reshape(-1), v.reshape(-1)
            points.append(side)
            faces.append(number + _grid(len(axes[one]), len(axes[other]), sign < 0.0))
            number += u.size
    x = np.concatenate(points)
    inner = np.clip(x, rounding - half, half - rounding)
    out = x - inner
    length = np.linalg.norm(out, axis=1, keepdims=True)
    if rounding > 0.0:
        x = inner + rounding * out / length
    return _welded(x, np.concatenate(faces), 1e-9 * float(half.max()))


def cone_mesh(size: tuple[float, float, float], top: float, rounding: float, resolution: int) -> tuple[Float, Int]:
    """Return a cone whose top is this share of its base as wide: 1 is a cylinder, 0 has a tip. Else as `box_mesh`.

    size [m] is the base's width, the height, and the base's depth; round it go `resolution` vertices.
    """
    radius, height = 0.5 * size[0], size[1]
    step = max(2.0 * math.pi * radius, 4.0 * radius + 2.0 * height) / resolution
    outline = _outline(radius, top * radius, height, rounding, step)
    turn = 2.0 * math.pi * np.arange(resolution) / resolution
    ring = np.stack([np.sin(turn), np.zeros(resolution), np.cos(turn)], axis=1)
    inside = outline[1:-1]
    x = np.concatenate([
        [[0.0, outline[0, 1], 0.0]],
        (inside[:, :1, None] * ring + inside[:, 1:, None] * [0.0, 1.0, 0.0]).reshape(-1, 3),
        [[0.0, outline[-1, 1], 0.0]],
    ])  # fmt: skip
    k, after = np.arange(resolution), np.roll(np.arange(resolution), -1)
    rows = 1 + resolution * np.arange(len(inside))
    faces = [np.stack([np.zeros(resolution, np.int64), 1 + after, 1 + k], axis=1)]
    for below, above in pairwise(rows):
        faces += [np.stack([below + k, below + after, above + after], axis=1),
                  np.stack([below + k, above + after, above + k], axis=1)]  # fmt: skip
    faces.append(np.stack([rows[-1] + k, rows[-1] + after, np.full(resolution, len(x) - 1)], axis=1))
    x[:, 1] -= 0.5 * height
    x[:, 2] *= size[2] / size[0]
    return x, np.concatenate(faces).astype(np.int32)


def _outline(base: float, top: float, height: float, rounding: float, step: float) -> Float:
    """Return radius and height (k, 2) of an outline from the middle of the base to that of the top."""
    corners = np.array([[0.0, 0.0], [base, 0.0], [top, height], [0.0, height]])
    if top == 0.0:
        corners = np.array([[0.0, 0.0], [base, 0.0], [0.0, height], [-base, 0.0]])
    parts, at = list[Float](), corners[0]
    for i in (1, 2):
        before, corner, after = corners[i - 1 : i + 2]
        arc = _fillet(before, corner, after, rounding, step)
        if top == 0.0 and i == 2:
            arc = arc[: len(arc) // 2 + 1]  # up to the axis
            arc[-1, 0] = 0.0
        parts += [_between(at, arc[0], step), arc]
        at = arc[-1]
    if top > 0.0:
        parts.append(_between(at, corners[3], step))
    found = np.concatenate([corners[:1], *parts])
    keep = np.concatenate([[True], np.linalg.norm(np.diff(found, axis=0), axis=1) > 1e-9 * height])
    return np.asarray(found[keep])


def _fillet(before: Float, corner: Float, after: Float, radius: float, step: float) -> Float:
    """Return an arc that rounds a corner on the way, an odd number of points; the corner itself for no radius."""
    if radius == 0.0:
        return corner[None].copy()
    one, other = before - corner, after - corner
    one, other = one / np.linalg.norm(one), other / np.linalg.norm(other)
    half = 0.5 * math.acos(float(np.clip(one @ other, -1.0, 1.0)))
    bisector = (one + other) / np.linalg.norm(one + other)
    centre = corner + bisector * radius / math.sin(half)
    sweep = math.pi - 2.0 * half
    number = 2 * max(CORNER // 2, math.ceil(0.5 * radius * sweep / step))
    angles = np.linspace(-0.5 * sweep, 0.5 * sweep, number + 1)
    across = np.array([bisector[1], -bisector[0]])
    across *= np.sign(across @ other)
    return np.asarray(centre + radius * (np.sin(angles)[:, None] * across - np.cos(angles)[:, None] * bisector))


def _between(start: Float, end: Float, step: float) -> Float:
    """Return points between two, about a step apart, without the ends."""
    number = max(1, math.ceil(float(np.linalg.norm(end - start)) / step))
    share = np.arange(1, number)[:, None] / number
    return np.asarray(start + share * (end - start))


def _grid(rows: int, columns: int, turned: bool) -> Int:
    """Return two triangles for each cell of a grid of vertices."""
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1)
    b, c, d = a + columns, a + columns + 1, a + 1
    found = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return np.asarray(found[:, ::-1] if turned else found)


def _welded(x: Float, faces: Int, near: float) -> tuple[Float, Int]:
    """Merge vertices at the same place, and drop triangles with fewer than three."""
    _, first, which = np.unique(np.rint(x / near).astype(np.int64), axis=0, return_index=True, return_inverse=True)
    sewn = which.reshape(-1)[faces].astype(np.int32)
    return x[first], sewn[(sewn != np.roll(sewn, 1, axis=1)).all(axis=1)]


# Closed surfaces of colliders: from a file, or the figures and solids that come with nuno.

ARMS = (math.radians(40.0), math.radians(80.0))
"""range of angles in which a mannequin's arms are clear of its trunk, and end below its shoulders [rad]"""
RANGE = (0.7, 1.4)
"""range of a mannequin's girths, as shares of the average"""
PERSON = {name: height for name, height in (HEIGHTS | LANDMARKS).items() if name != "neck"}
"""heights of a person's girths [m]; that of the neck is behind the chin"""
MANNEQUINS, SOLIDS = ("torso", "person"), ("box", "cylinder", "cone")


class Girths(Config):
    """Girths of a mannequin [m]; by default the average."""

    bust: Size | None = Field(default=None, description="round the breasts, 90 cm unless given [m]")
    waist: Size | None = Field(default=None, description="at its narrowest, 69.8 cm unless given [m]")
    hip: Size | None = Field(default=None, description="at its widest, 95.7 cm unless given [m]")
    neck: Size | None = Field(default=None, description="of the stump, 33 cm unless given [m]")
    arm: Size | None = Field(default=None, description="over the biceps, 28.1 cm unless given [m]")


class Surface(Config):
    """A closed surface: a file's, else a built-in one, scaled, then moved by `centre`."""

    file: str | None = Field(default=None, description="a mesh beside the scene: OBJ, PLY, STL or GLB")
    shape: Literal["leg", "torso", "person", "box", "cylinder", "cone"] | None = Field(
        default=None,
        description="where no file is given, one that comes with nuno: an average leg; a torso with stumps of arms and "
        "neck; a whole mannequin; or a solid of this size",
    )
    size: tuple[Size, Size, Size] | None = Field(
        default=None, description="of a box, a cylinder or a cone: its width, height and depth [m]"
    )
    rounding: Reach = Field(default=0.0, description="of a solid: the radius of its edges [m]")
    top: float = Field(default=0.0, ge=0, le=1, description="of a cone: its top's width, of its base's")
    resolution: int = Field(default=96, ge=12, le=2048, description="of the shape: vertices round the leg or the waist")
    girths: Girths | None = Field(default=None, description="of a mannequin, where they are to be others")
    arms: Angle = Field(
        default=0.25 * math.pi, description="of a mannequin: between upper arms and the plumb line [rad]"
    )
    scale: Size = Field(default=1.0, description="length of one of the file's units [m]; 1 leaves a shape its size")
    up: Literal["y", "z"] = Field(default="y", description="which of the file's axes points up; z is turned to y")
    centre: Point = Field(
        default=ORIGIN,
        description="where the mesh's origin comes to lie, in the joint's frame, a skin's in the world [m]",
    )
    mend: bool = Field(default=False, description="turn triangles that face the wrong way and fill holes")

    @model_validator(mode="after")
    def _one_source(self) -> Surface:
        if self.file is None and self.shape is None:
            raise ValueError("a mesh needs a file or a shape")
        if self.up == "z" and self.file is None:
            raise ValueError("what comes with nuno has y up: up is for files")
        self._check_solid()
        given = {"girths", "arms"} & self.model_fields_set
        if given and self.shape not in MANNEQUINS:
            raise ValueError(f"only mannequins, torso and person, have {' and '.join(sorted(given))} to choose")
        if not ARMS[0] <= self.arms <= ARMS[1]:
            limits = " to ".join(f"{math.degrees(angle):g}" for angle in ARMS)
            raise ValueError(f"arms at {math.degrees(self.arms):g} deg: theirs may be raised by {limits} deg")
        return self

    def _check_solid(self) -> None:
        """Raise ValueError for an impossible solid, and for fields that only solids have."""
        given = {"size", "rounding", "top"} & self.model_fields_set
        if given and (self.shape not in SOLIDS or self.file is not None):
            raise ValueError(f"{' and '.join(sorted(given))} are for shape: {', '.join(SOLIDS)}; a file has its scale")
        if "top" in given and self.shape != "cone":
            raise ValueError(f"a {self.shape} is as wide above as below; a cone has a top")
        if self.shape not in SOLIDS or self.file is not None:
            return
        if self.size is None:
            raise ValueError(f"a {self.shape} needs its size; for example size: [40 cm, 75 cm, 40 cm]")
        most = 0.5 * min(self.size)
        if self.shape == "cone":
            # The circle that touches base and sides; half of it where the top is narrower.
            radius, height = 0.5 * self.size[0], self.size[1]
            along = radius * (1.0 - self.top)
            most = min(most, radius * height / (along + math.hypot(along, height)))
            most = min(most, self.top * radius) if self.top > 0.0 else most
        if self.rounding > 0.999 * most:
            raise ValueError(f"rounded by {self.rounding:g} m: at most {0.999 * most:.4g} m of this size")

    def heights(self) -> dict[str, float]:
        """Return the heights [m] of named places, of a built-in shape."""
        known = {"leg": LANDMARKS, "torso": HEIGHTS, "person": PERSON}
        return {} if self.file is not None or self.shape is None else known.get(self.shape, {})

    def upright(self, x: Float) -> Float:
        """Return points (n, 3) of the file with y up."""
        return x[:, [0, 2, 1]] * np.array([1.0, 1.0, -1.0]) if self.up == "z" else x

    def make(self, files: Files, read: Callable[[Path, float, bool], tuple[Float, Int]]) -> tuple[Float, Int]:
        """Return vertices (n, 3) [m] before they are moved, and triangles (f, 3); `read` reads a file's. Raises
        BadInput for a file that cannot be read, and a shape that cannot be made.
        """
        if self.file is not None:
            x, faces = read(files.resolve(self.file), self.scale, self.mend)
            return self.upright(x), faces
        if self.shape == "box" and self.size is not None:
            x, faces = box_mesh(self.size, self.rounding, self.resolution)
        elif self.shape in SOLIDS and self.size is not None:
            top = self.top if self.shape == "cone" else 1.0
            x, faces = cone_mesh(self.size, top, self.rounding, self.resolution)
        else:
            x, faces = leg_mesh(self.resolution) if self.shape == "leg" else make_mannequin(self)
        return x * self.scale, faces


def make_mannequin(config: Surface) -> tuple[Float, Int]:
    """Make the torso or the person of a configuration. Raises BadInput for girths so far from the average that its
    parts would meet.
    """
    given = {} if config.girths is None else config.girths.model_dump(exclude_none=True)
    for name, girth in given.items():
        low, high = (share * GIRTHS[name] for share in RANGE)
        if not low <= girth <= high:
            raise BadInput(
                "no mannequin is made with this girth", field=f"girths.{name}", value=f"{girth:g} m",
                limit=f"{low:.3g} to {high:.3g} m", remedy="scale the whole, or bring a mesh of your own",
            )  # fmt: skip
    make = {"torso": torso_mesh, "person": person_mesh}[config.shape or ""]
    return make(config.resolution, given, config.arms)


# A closed triangle mesh as a body: from a file, or one of the shapes that come with nuno.

Search = Callable[..., Closest]
"""A function (points (n, 3), start (n,) or None) -> Closest."""


class Rotation(Config):
    """A right-handed turn about an axis."""

    axis: Direction = Field(default=(0.0, 1.0, 0.0), description="of any length but zero")
    angle: Angle = Field(description="[rad]")


class MeshConfig(OnJoint, Surface):
    """A closed surface: a file's, else a built-in one, scaled, turned about its origin, then moved by `centre`."""

    rotate: Rotation | None = Field(default=None, description="a turn about the mesh's origin")


class MeshCollider:
    """A rigid closed mesh on a joint of its body's motion. Its contact is `sliding`."""

    name: ClassVar[str] = "mesh"
    Config: ClassVar[type[BaseModel]] = MeshConfig

    def search(self, vertices: Float, faces: Int) -> Search:
        """Return a mesh's closest-point search, for callers other than contact: nuno_geometry.closest_point."""
        tree = build_tree(vertices, faces)

        def ask(points: Float, start: Int | None = None) -> Closest:
            return closest_points(tree, points, start)

        return ask

    def heights(self, config: MeshConfig) -> dict[str, float]:
        """Return the heights in the joint's frame [m] of named places, of a built-in shape as it stands."""
        upright = config.rotate is None or config.rotate.axis[0] == config.rotate.axis[2] == 0.0
        return {name: config.centre[1] + config.scale * y for name, y in config.heights().items()} if upright else {}

    def build(self, config: MeshConfig, mover: Mover | None, files: Files) -> BodyShape:
        """Build the body. Raises BadInput for a mesh that is not closed, or cannot be read; one that passes through
        itself is noted, and refused by contact that must know its inside.
        """
        mended: list[str] = []
        x, faces = find_mesh(config, files, partial(read_closed, notes=mended))
        return replace(mesh_shape(config, mover, x, faces, MESH), notes=(*mended, *crossing_notes(x, faces)))


def find_mesh(
    config: MeshConfig, files: Files, read: Callable[[Path, float, bool], tuple[Float, Int]]
) -> tuple[Float, Int]:
    """Return vertices (n, 3) [m] in the joint's frame and triangles (f, 3) of a scene's mesh; `read` reads a file's.

    Raises BadInput for one that cannot be read or made, and for a turn without axis.
    """
    x, faces = config.make(files, read)
    return np.ascontiguousarray(turn(turn_of(config.rotate), x) + np.asarray(config.centre)), faces


def mesh_shape(config: OnJoint, mover: Mover | None, x: Float, faces: Int, kind: int) -> BodyShape:
    """Return a body of one primitive that has a mesh. Raises BadInput for a joint that the motion does not have."""
    bare = one_primitive(config, mover, kind, x.min(axis=0), x.max(axis=0), 0.0)
    return replace(bare, vertices=x, faces=faces, owner=np.zeros(len(faces), np.int32))


def turn_of(rotation: Rotation | None) -> Float:
    """Return the matrix (3, 3) of a turn. Raises BadInput for an axis without direction."""
    if rotation is None:
        return np.eye(3)
    if not any(rotation.axis):
        raise BadInput("a turn needs an axis", field="rotate.axis", value=rotation.axis, limit="not all zero")
    return np.asarray(rotation_matrices(from_axis_angle(np.asarray(rotation.axis), rotation.angle)[None])[0])
