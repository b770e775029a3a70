"""A person's mesh as a body that moves with its skin: its joints and weights are found, a motion is carried over."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar, Literal, cast

import numpy as np
from pydantic import BaseModel, Field

from nuno_contact.colliders.mesh import MeshCollider, Search
from nuno_contact.colliders.shapes import ORIGIN
from nuno_contact.quantities import Angle, Point, Size, Span
from nuno_contact.skin.bones import bones_of
from nuno_contact.skin.figure import find_figure
from nuno_contact.skin.gait import find_lift, fit_gait
from nuno_contact.skin.roles import find_roles
from nuno_contact.skin.weights import find_weights
from nuno_kernels.meshes.check import crossing_notes
from nuno_kernels.meshes.file import read_closed
from nuno_schemas.bodies import SKIN
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.plugin import BodyShape, Config, Files, Mover
from nuno_schemas.skin import Skin


class SkinConfig(Config):
    """A person in a file, upright and facing +z, feet and arms apart, as in a T-pose or an A-pose."""

    file: str = Field(description="a closed mesh beside the scene: OBJ, PLY, STL or GLB")
    scale: Size = Field(default=1.0, description="length of one of the file's units [m]")
    up: Literal["y", "z"] = Field(default="y", description="which of the file's axes points up; z is turned to y")
    centre: Point = Field(default=ORIGIN, description="where the mesh's origin comes to lie [m]; it begins there")
    mend: bool = Field(default=False, description="turn triangles that face the wrong way and fill holes")
    spread: Angle = Field(
        default=math.radians(20.0),
        description="how much more the arms are held off the trunk than in the motion, of a body slimmer perhaps [rad]",
    )
    stand: Span = Field(default=0.0, description="how long it stands in its own pose before it begins to move [s]")
    blend: Span = Field(
        default=1.0, description="over how long it goes from its own pose into the motion, which runs on meanwhile [s]"
    )


class SkinCollider:
    """A person's mesh whose vertices go with the joints of a motion. It is met by cloth_contact.bodies."""

    name: ClassVar[str] = "skin"
    Config: ClassVar[type[BaseModel]] = SkinConfig

    def search(self, vertices: Float, faces: Int) -> Search:
        """The closest point of its mesh where that is, for others than the contact: see MeshCollider."""
        return MeshCollider().search(vertices, faces)

    def build(self, config: BaseModel, mover: Mover | None, files: Files) -> BodyShape:
        """Raises BadInput without a motion that has a body's joints, and for a mesh that is not closed, cannot be read,
        or is of no one who stands so; one that passes through itself is noted.
        """
        c = cast(SkinConfig, config)
        if mover is None or len(mover.joints) < 2:
            raise BadInput(
                "a skin needs a motion with joints", field="motion",
                remedy="add a motion, bvh or hula, or give the body collider: {plugin: mesh, ...}, which stands still",
            )  # fmt: skip
        roles = find_roles(mover)
        x, faces = read_closed(files.resolve(c.file), c.scale, c.mend)
        x = x[:, [0, 2, 1]] * np.array([1.0, 1.0, -1.0]) if c.up == "z" else x
        x = np.ascontiguousarray(x + np.asarray(c.centre))
        figure, parts = find_figure(x, faces), list(roles)
        part, weight = find_weights(x, faces, *bones_of(figure, parts))
        gait = fit_gait(mover, roles, figure, c.spread, c.stand, c.blend)
        feet = {number: part[:, 0] == number for number, name in enumerate(parts) if name.endswith("_foot")}
        gait = replace(gait, lift=find_lift(gait, x, feet))
        joint, place = np.array(list(roles.values()), np.int32), gait.place[gait.follows]
        skin = Skin(np.ascontiguousarray(place), np.ascontiguousarray(joint[part]), weight)
        return replace(skin_shape(mover, x, faces, skin), pose=gait.pose, notes=crossing_notes(x, faces))


def skin_shape(mover: Mover, x: Float, faces: Int, skin: Skin) -> BodyShape:
    """A body of one skin on all joints of its motion."""
    return BodyShape(
        frames=mover.joints,
        kind=np.array([SKIN], np.int8),
        frame=np.zeros(1, np.int32),
        a=x.min(axis=0)[None],
        b=x.max(axis=0)[None],
        radius=np.zeros(1),
        vertices=x,
        faces=faces,
        owner=np.zeros(len(faces), np.int32),
        skins=(skin,),
    )
