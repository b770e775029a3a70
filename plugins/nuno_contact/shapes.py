"""Single shapes: capsule, sphere, plane and box, standing in the world or riding on a joint."""

from __future__ import annotations

from typing import ClassVar, cast

import numpy as np
from pydantic import BaseModel

from nuno_schemas.bodies import BOX, CAPSULE, PLANE
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import BodyShape, Config, Mover
from nuno_schemas.units import quantity

Length = quantity("m")
Size = quantity("m", gt=0)
Number = quantity("")
Point = tuple[Length, Length, Length]  # type: ignore[valid-type]
Direction = tuple[Number, Number, Number]  # type: ignore[valid-type]
ORIGIN = (0.0, 0.0, 0.0)


class OnJoint(Config):
    """Where a shape rides: a joint of the body's motion (its first one unless named)."""

    joint: str | None = None


class CapsuleConfig(OnJoint):
    """All points within `radius` [m] of the segment from a to b, in the joint's frame [m]."""

    a: Point
    b: Point
    radius: Size  # type: ignore[valid-type]


class SphereConfig(OnJoint):
    """All points within `radius` [m] of `centre`, in the joint's frame [m]."""

    centre: Point = ORIGIN
    radius: Size  # type: ignore[valid-type]


class PlaneConfig(OnJoint):
    """The half space below a plane through `point` [m] whose `normal` (any length) points out."""

    point: Point = ORIGIN
    normal: Direction = (0.0, 1.0, 0.0)


class BoxConfig(OnJoint):
    """A box of edge lengths `size` [m] round `centre` [m], along the axes of the joint's frame."""

    centre: Point = ORIGIN
    size: tuple[Size, Size, Size]  # type: ignore[valid-type]


def find_frame(joint: str | None, mover: Mover | None) -> tuple[tuple[str, ...], int]:
    """All frames of a body and the index of the one named `joint`.

    Raises BadInput for a joint that the motion does not have.
    """
    frames = mover.joints if mover else ("world",)
    if joint is None:
        return frames, 0
    if joint not in frames:
        raise BadInput("no such joint", field="joint", value=joint, remedy=nearest(joint, frames))
    return frames, frames.index(joint)


def one_primitive(config: OnJoint, mover: Mover | None, kind: int, a: object, b: object, radius: float) -> BodyShape:
    """A body of one primitive (Geometry's layout) on the joint that `config` names."""
    frames, frame = find_frame(config.joint, mover)
    return BodyShape(
        frames=frames,
        kind=np.array([kind], np.int8),
        frame=np.array([frame], np.int32),
        a=np.array([a], np.float64),
        b=np.array([b], np.float64),
        radius=np.array([radius]),
    )


class Capsule:
    """A capsule; a = b is a sphere."""

    name: ClassVar[str] = "capsule"
    Config: ClassVar[type[BaseModel]] = CapsuleConfig

    def build(self, config: BaseModel, mover: Mover | None) -> BodyShape:
        c = cast(CapsuleConfig, config)
        return one_primitive(c, mover, CAPSULE, c.a, c.b, c.radius)


class Sphere:
    """A sphere."""

    name: ClassVar[str] = "sphere"
    Config: ClassVar[type[BaseModel]] = SphereConfig

    def build(self, config: BaseModel, mover: Mover | None) -> BodyShape:
        c = cast(SphereConfig, config)
        return one_primitive(c, mover, CAPSULE, c.centre, c.centre, c.radius)


class Plane:
    """A half space."""

    name: ClassVar[str] = "plane"
    Config: ClassVar[type[BaseModel]] = PlaneConfig

    def build(self, config: BaseModel, mover: Mover | None) -> BodyShape:
        c = cast(PlaneConfig, config)
        normal: Float = np.array(c.normal, np.float64)
        length = float(np.linalg.norm(normal))
        if length == 0.0:
            raise BadInput("a plane needs a normal", field="normal", value=c.normal, limit="not all zero")
        return one_primitive(c, mover, PLANE, c.point, normal / length, 0.0)


class Box:
    """A box."""

    name: ClassVar[str] = "box"
    Config: ClassVar[type[BaseModel]] = BoxConfig

    def build(self, config: BaseModel, mover: Mover | None) -> BodyShape:
        c = cast(BoxConfig, config)
        return one_primitive(c, mover, BOX, c.centre, [0.5 * size for size in c.size], 0.0)
