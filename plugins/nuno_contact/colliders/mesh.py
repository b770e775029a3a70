"""A closed triangle mesh as a body: from a file, or the leg or the torso that come with nuno."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import ClassVar, Literal, cast

import numpy as np
from pydantic import BaseModel, Field, model_validator

from nuno_contact.colliders.shapes import ORIGIN, OnJoint, find_frame
from nuno_contact.figures.leg import LANDMARKS, leg_mesh
from nuno_contact.figures.torso import GIRTHS, HEIGHTS, torso_mesh
from nuno_contact.motions.rotations import from_axis_angle
from nuno_contact.quantities import Angle, Direction, Point, Size
from nuno_kernels.meshes.check import crossing_notes
from nuno_kernels.meshes.closest_point import Closest, closest_points
from nuno_kernels.meshes.file import read_closed
from nuno_kernels.meshes.tree import build_tree
from nuno_schemas.bodies import MESH, rotation_matrices
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.plugin import BodyShape, Config, Files, Mover
from nuno_schemas.vectors import turn

ARMS = (math.radians(40.0), math.radians(80.0))
"""Between these angles the torso's arms part from its trunk, and end below its shoulders [rad]."""
RANGE = (0.7, 1.4)
"""Shares of the average girths that a torso may have."""
Search = Callable[..., Closest]
"""A function (points (n, 3), start (n,) or None) -> Closest."""


class Rotation(Config):
    """A right-handed turn about an axis."""

    axis: Direction = Field(default=(0.0, 1.0, 0.0), description="of any length but zero")
    angle: Angle = Field(description="[rad]")


class Girths(Config):
    """Girths of the torso [m]; what is not given keeps the average."""

    bust: Size | None = Field(default=None, description="round the breasts, 90 cm unless given [m]")
    waist: Size | None = Field(default=None, description="at its narrowest, 69.8 cm unless given [m]")
    hip: Size | None = Field(default=None, description="at its widest, 95.7 cm unless given [m]")
    neck: Size | None = Field(default=None, description="of the stump, 33 cm unless given [m]")
    arm: Size | None = Field(default=None, description="over the biceps, 28.1 cm unless given [m]")


class MeshConfig(OnJoint):
    """A closed surface: a file's, else a built-in one, scaled, turned about its origin, then moved by `centre`."""

    file: str | None = Field(default=None, description="a mesh beside the scene: OBJ, PLY, STL or GLB")
    shape: Literal["leg", "torso"] | None = Field(
        default=None,
        description="where no file is given, one that comes with nuno: an average leg; a torso with stumps of arms and "
        "neck",
    )
    resolution: int = Field(default=96, ge=12, le=2048, description="of the shape: vertices round the leg or the waist")
    girths: Girths | None = Field(default=None, description="of the torso, where they are to be others")
    arms: Angle = Field(default=0.25 * math.pi, description="of the torso: between upper arms and the plumb line [rad]")
    scale: Size = Field(default=1.0, description="length of one of the file's units [m]; 1 leaves a shape its size")
    up: Literal["y", "z"] = Field(default="y", description="which of the file's axes points up; z is turned to y")
    rotate: Rotation | None = Field(default=None, description="a turn about the mesh's origin")
    centre: Point = Field(default=ORIGIN, description="where the mesh's origin comes to lie, in the joint's frame [m]")
    mend: bool = Field(default=False, description="turn triangles that face the wrong way and fill holes")

    @model_validator(mode="after")
    def _one_source(self) -> MeshConfig:
        if self.file is None and self.shape is None:
            raise ValueError("a mesh needs a file or a shape")
        if self.up == "z" and self.file is None:
            raise ValueError("what comes with nuno has y up: up is for files")
        given = {"girths", "arms"} & self.model_fields_set
        if given and self.shape != "torso":
            raise ValueError(f"only the torso has {' and '.join(sorted(given))} to choose")
        if not ARMS[0] <= self.arms <= ARMS[1]:
            limits = " to ".join(f"{math.degrees(angle):g}" for angle in ARMS)
            raise ValueError(f"arms at {math.degrees(self.arms):g} deg: the torso's may be raised by {limits} deg")
        return self


class MeshCollider:
    """A rigid closed mesh on a joint of its body's motion. Contact with it is `sliding`."""

    name: ClassVar[str] = "mesh"
    Config: ClassVar[type[BaseModel]] = MeshConfig

    def search(self, vertices: Float, faces: Int) -> Search:
        """The closest point of a mesh, for others than the contact: see nuno_kernels.meshes.closest_point."""
        tree = build_tree(vertices, faces)

        def ask(points: Float, start: Int | None = None) -> Closest:
            return closest_points(tree, points, start)

        return ask

    def heights(self, config: BaseModel) -> dict[str, float]:
        """Heights in the joint's frame [m] of places that have a name: of a shape that stands as it comes."""
        c = cast(MeshConfig, config)
        upright = c.rotate is None or c.rotate.axis[0] == c.rotate.axis[2] == 0.0
        known = {"leg": LANDMARKS, "torso": HEIGHTS}.get(c.shape or "", {}) if c.file is None else {}
        return {name: c.centre[1] + c.scale * y for name, y in known.items()} if upright else {}

    def build(self, config: BaseModel, mover: Mover | None, files: Files) -> BodyShape:
        """Raises BadInput for a mesh that is not closed, or cannot be read; one that passes through itself is noted,
        and refused by contact that has to know its inside.
        """
        c = cast(MeshConfig, config)
        x, faces = find_mesh(c, files, read_closed)
        return replace(mesh_shape(c, mover, x, faces, MESH), notes=crossing_notes(x, faces))


def find_mesh(
    config: MeshConfig, files: Files, read: Callable[[Path, float, bool], tuple[Float, Int]]
) -> tuple[Float, Int]:
    """Vertices (n, 3) [m] in the joint's frame and triangles (f, 3) of a scene's mesh; `read` reads a file's.

    Raises BadInput for one that cannot be read or made, and for a turn without axis.
    """
    if config.file is not None:
        x, faces = read(files.resolve(config.file), config.scale, config.mend)
        x = x[:, [0, 2, 1]] * np.array([1.0, 1.0, -1.0]) if config.up == "z" else x
    else:
        x, faces = leg_mesh(config.resolution) if config.shape == "leg" else make_torso(config)
        x = x * config.scale
    return np.ascontiguousarray(turn(turn_of(config.rotate), x) + np.asarray(config.centre)), faces


def mesh_shape(config: OnJoint, mover: Mover | None, x: Float, faces: Int, kind: int) -> BodyShape:
    """A body of one primitive that has a mesh. Raises BadInput for a joint that the motion does not have."""
    frames, frame = find_frame(config.joint, mover)
    return BodyShape(
        frames=frames,
        kind=np.array([kind], np.int8),
        frame=np.array([frame], np.int32),
        a=x.min(axis=0)[None],
        b=x.max(axis=0)[None],
        radius=np.zeros(1),
        vertices=x,
        faces=faces,
        owner=np.zeros(len(faces), np.int32),
    )


def make_torso(config: MeshConfig) -> tuple[Float, Int]:
    """The torso of a configuration. Raises BadInput for girths so far from the average that parts would meet."""
    given = {} if config.girths is None else config.girths.model_dump(exclude_none=True)
    for name, girth in given.items():
        low, high = (share * GIRTHS[name] for share in RANGE)
        if not low <= girth <= high:
            raise BadInput(
                "no torso is made with this girth", field=f"girths.{name}", value=f"{girth:g} m",
                limit=f"{low:.3g} to {high:.3g} m", remedy="scale the whole torso, or bring a mesh of your own",
            )  # fmt: skip
    return torso_mesh(config.resolution, given, config.arms)


def turn_of(rotation: Rotation | None) -> Float:
    """(3, 3) matrix of a turn. Raises BadInput for an axis without direction."""
    if rotation is None:
        return np.eye(3)
    if not any(rotation.axis):
        raise BadInput("a turn needs an axis", field="rotate.axis", value=rotation.axis, limit="not all zero")
    return np.asarray(rotation_matrices(from_axis_angle(np.asarray(rotation.axis), rotation.angle)[None])[0])
