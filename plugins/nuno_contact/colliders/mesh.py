"""A closed triangle mesh as a body: from a file, or one of the shapes that come with nuno."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import ClassVar, cast

import numpy as np
from pydantic import BaseModel, Field

from nuno_contact.colliders.shapes import OnJoint, find_frame
from nuno_contact.colliders.surface import Surface
from nuno_contact.motions.rotations import from_axis_angle
from nuno_contact.quantities import Angle, Direction
from nuno_kernels.meshes.check import crossing_notes
from nuno_kernels.meshes.closest_point import Closest, closest_points
from nuno_kernels.meshes.file import read_closed
from nuno_kernels.meshes.tree import build_tree
from nuno_schemas.bodies import MESH, rotation_matrices
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.plugin import BodyShape, Config, Files, Mover
from nuno_schemas.vectors import turn

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
        """Return a mesh's closest-point search, for callers other than contact: nuno_kernels.meshes.closest_point."""
        tree = build_tree(vertices, faces)

        def ask(points: Float, start: Int | None = None) -> Closest:
            return closest_points(tree, points, start)

        return ask

    def heights(self, config: BaseModel) -> dict[str, float]:
        """Return the heights in the joint's frame [m] of named places, of a built-in shape as it stands."""
        c = cast(MeshConfig, config)
        upright = c.rotate is None or c.rotate.axis[0] == c.rotate.axis[2] == 0.0
        return {name: c.centre[1] + c.scale * y for name, y in c.heights().items()} if upright else {}

    def build(self, config: BaseModel, mover: Mover | None, files: Files) -> BodyShape:
        """Build the body. Raises BadInput for a mesh that is not closed, or cannot be read; one that passes through
        itself is noted, and refused by contact that must know its inside.
        """
        c = cast(MeshConfig, config)
        mended: list[str] = []
        x, faces = find_mesh(c, files, partial(read_closed, notes=mended))
        return replace(mesh_shape(c, mover, x, faces, MESH), notes=(*mended, *crossing_notes(x, faces)))


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


def turn_of(rotation: Rotation | None) -> Float:
    """Return the matrix (3, 3) of a turn. Raises BadInput for an axis without direction."""
    if rotation is None:
        return np.eye(3)
    if not any(rotation.axis):
        raise BadInput("a turn needs an axis", field="rotate.axis", value=rotation.axis, limit="not all zero")
    return np.asarray(rotation_matrices(from_axis_angle(np.asarray(rotation.axis), rotation.angle)[None])[0])
