"""A person's mesh as a body whose skin moves: its joints and weights are found or given, and a motion is retargeted."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import ClassVar, Literal

import numpy as np
from pydantic import BaseModel, Field

from nuno_contact.colliders.body_parts import find_roles
from nuno_contact.colliders.mesh import MeshCollider, Search, Surface
from nuno_contact.quantities import Angle, Span
from nuno_contact.skinning.figure import Figure, find_figure
from nuno_contact.skinning.gait import find_lift, fit_gait
from nuno_contact.skinning.rig import Rig, fit_rig, read_rig, weights_of
from nuno_contact.skinning.weights import find_weights
from nuno_geometry.check import crossing_notes
from nuno_geometry.mesh_files.mesh import read_closed
from nuno_schemas.bodies import Skin
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.plugin import BodyShape, DrawnSkin, Files, Mover

# Lines in a body that carry its skin.

LINES = {
    "hips": (("hips", "spine"), ("hips", "left_thigh"), ("hips", "right_thigh")),
    "spine": (("spine", "chest"),),
    "chest": (("chest", "neck"), ("neck", "left_arm"), ("neck", "right_arm")),
    "neck": (("neck", "head"),),
    "head": (("head", "top"),),
    **{f"{side}_{part}": tuple((f"{side}_{a}", f"{side}_{b}") for a, b in lines) for side in ("left", "right") for
       part, lines in (
        ("arm", (("arm", "forearm"),)), ("forearm", (("forearm", "hand"),)), ("hand", (("hand", "hand_end"),)),
        ("thigh", (("thigh", "shin"),)), ("shin", (("shin", "foot"),)),
        ("foot", (("foot", "foot_end"), ("foot", "heel"))))},
}  # fmt: skip
"""start and end of the bones of each part"""


def bones_of(figure: Figure, parts: Sequence[str]) -> tuple[Float, Int]:
    """Return the ends (b, 2, 3) [m] of the bones of parts of a body, and the number (b,) of each bone's part.

    Bones of other parts, a spine or a neck, belong to the part before.
    """
    ends, of = [], []
    for part, lines in LINES.items():
        if part in parts:
            number = parts.index(part)
        ends += [np.stack([figure[a], figure[b]]) for a, b in lines]
        of += [number] * len(lines)
    return np.stack(ends), np.array(of, np.int32)


class SkinConfig(Surface):
    """A person, of a file or `shape: person`, upright and facing +z, feet and arms apart: in a T-pose or an A-pose."""

    spread: Angle = Field(
        default=math.radians(20.0),
        description="how much more the arms are held off the trunk than in the motion, of a body slimmer perhaps [rad]",
    )
    stand: Span = Field(default=0.0, description="how long it stands in its own pose before it begins to move [s]")
    weights: Literal["auto", "found"] = Field(
        default="auto",
        description="of its joints: auto, those of a GLB file that has some, else found in the mesh; found, those",
    )
    blend: Span = Field(
        default=1.0, description="over how long it goes from its own pose into the motion, which runs on meanwhile [s]"
    )


class SkinCollider:
    """A person's mesh whose vertices follow the joints of a motion. Its contact is cloth_contact.bodies."""

    name: ClassVar[str] = "skin"
    Config: ClassVar[type[BaseModel]] = SkinConfig

    def search(self, vertices: Float, faces: Int) -> Search:
        """Return a closest-point search in its mesh in place, for callers other than contact: see MeshCollider."""
        return MeshCollider().search(vertices, faces)

    def build(self, config: SkinConfig, mover: Mover | None, files: Files) -> BodyShape:
        """Build the body. Raises BadInput without a motion that has a body's joints, and for a mesh that is not closed,
        cannot be read, or is not a person standing so; one that passes through itself is noted.
        """
        if mover is None or len(mover.joints) < 2:
            raise BadInput(
                "a skin needs a motion with joints", field="motion",
                remedy="add a motion, bvh or hula, or give the body collider: {plugin: mesh, ...}, which stands still",
            )  # fmt: skip
        if mover.surface is not None:
            problem, remedy = "the motion brings its own surface", "collider: {plugin: surface}"
            raise BadInput(problem, field="plugin", value="skin", remedy=remedy)
        if mover.live is not None:
            problem, remedy = "a skin is fitted to a motion that is known beforehand", "collider: {plugin: skeleton}"
            raise BadInput(problem, field="motion", value="topic", remedy=remedy)
        roles = find_roles(mover)
        rig = _read_rig(config, files)
        mended: list[str] = []
        read = partial(read_closed, notes=mended)
        x, faces = config.make(files, read if rig is None else partial(read, load=rig.surface))
        centre = np.asarray(config.centre)
        x = np.ascontiguousarray(x + centre)
        if rig is None or config.weights == "found":
            figure = find_figure(x, faces)
            part, weight = find_weights(x, faces, *bones_of(figure, list(roles)))
        else:
            points, place = (config.upright(config.scale * at) + centre for at in (rig.points, rig.place))
            rig = replace(rig, points=points, place=place)
            figure, roles, goes = fit_rig(rig, roles)
            part, weight = weights_of(rig, goes, x)
        parts = list(roles)
        gait = fit_gait(mover, roles, figure, config.spread, config.stand, config.blend)
        feet = {number: part[:, 0] == number for number, name in enumerate(parts) if name.endswith("_foot")}
        for number, mine in feet.items():
            if not mine.any():
                problem, remedy = "a foot carries nothing of the body", "take weights: found"
                raise BadInput(problem, field="file", value=parts[number], remedy=remedy)
        gait = replace(gait, lift=find_lift(gait, x, feet))
        joint, place = np.array(list(roles.values()), np.int32), gait.place[gait.follows]
        skin = Skin(np.ascontiguousarray(place), np.ascontiguousarray(joint[part]), weight)
        shape = BodyShape.of_skin(mover.joints, DrawnSkin(x, faces, skin))
        return replace(shape, pose=gait.pose, notes=(*mended, *crossing_notes(x, faces)))


def _read_rig(config: SkinConfig, files: Files) -> Rig | None:
    """Read the file's rig, if any. Raises BadInput for one that cannot be read, if it is requested."""
    if config.file is None:
        return None
    try:
        return read_rig(files.resolve(config.file))
    except BadInput:
        if config.weights == "found":
            return None
        raise
