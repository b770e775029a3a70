"""Single shapes: capsule, sphere, plane and box, standing in the world or riding on a joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
from pydantic import BaseModel, Field

from nuno_contact.quantities import Direction, Point, Size
from nuno_geometry.isosurface import find_isosurface
from nuno_schemas.bodies import BOX, CAPSULE, FIELD, PLANE, ClosedForm
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import BodyShape, Config, Files, Mover
from nuno_schemas.vectors import norm

ORIGIN = (0.0, 0.0, 0.0)


class OnJoint(Config):
    """A shape that rides on a joint of its body's motion."""

    joint: str | None = Field(
        default=None, description="joint of the motion that carries it; its first one unless given"
    )


class CapsuleConfig(OnJoint):
    """All points within `radius` of the segment from a to b."""

    a: Point = Field(description="one end of its axis, in the joint's frame [m]")
    b: Point = Field(description="the other end [m]; the same place makes a sphere")
    radius: Size = Field(description="[m]")


class SphereConfig(OnJoint):
    """All points within `radius` of `centre`."""

    centre: Point = Field(default=ORIGIN, description="in the joint's frame [m]")
    radius: Size = Field(description="[m]")


class PlaneConfig(OnJoint):
    """The half space below a plane."""

    point: Point = Field(default=ORIGIN, description="any point of the plane, in the joint's frame [m]")
    normal: Direction = Field(default=(0.0, 1.0, 0.0), description="direction out of the body, of any length")


class BoxConfig(OnJoint):
    """A box along the axes of the joint's frame."""

    centre: Point = Field(default=ORIGIN, description="in the joint's frame [m]")
    size: tuple[Size, Size, Size] = Field(description="whole edge lengths along x, y and z [m]")


def find_frame(joint: str | None, mover: Mover | None) -> tuple[tuple[str, ...], int]:
    """Return all frames of a body and the index of the one named `joint`.

    Raises BadInput for a joint that the motion does not have.
    """
    frames = mover.joints if mover else ("world",)
    if joint is None:
        return frames, 0
    if joint not in frames:
        raise BadInput("no such joint", field="joint", value=joint, remedy=nearest(joint, frames))
    return frames, frames.index(joint)


def one_primitive(config: OnJoint, mover: Mover | None, kind: int, a: object, b: object, radius: float) -> BodyShape:
    """Return a body of one primitive (Geometry's layout) on the joint that `config` names."""
    frames, frame = find_frame(config.joint, mover)
    return BodyShape(
        frames=frames,
        kind=np.array([kind], np.int8),
        frame=np.array([frame], np.int32),
        a=np.array([a], np.float64),
        b=np.array([b], np.float64),
        radius=np.array([radius]),
    )


FINE, COARSE, THIN = 160, 48, 16
"""Cells of a closed form's mesh: along its longest side from COARSE to FINE, so that the shortest one has THIN."""


def closed_form(config: OnJoint, mover: Mover | None, form: ClosedForm, half: Sequence[float]) -> BodyShape:
    """Return a body by its signed distance in the joint's frame (nuno_kernels.formula), which reaches at most `half`
    [m] from the origin along x, y and z. Penalty contact goes by the distance; `sliding`, contact as cloth and pictures
    go by a mesh of it.

    Raises BadInput for a form that encloses nothing, or that goes on beyond `half`.
    """
    reach = np.array(half, np.float64)
    spacing = float(np.clip(2.0 * reach.min() / THIN, 2.0 * reach.max() / FINE, 2.0 * reach.max() / COARSE))
    wide = reach + 1.5 * spacing
    value = form.distance(*np.meshgrid(*(np.linspace(-r, r, COARSE) for r in wide), sparse=True))
    inside = value <= 0.0
    if not inside.any() or inside.sum() != inside[1:-1, 1:-1, 1:-1].sum():
        where = "beyond these bounds" if inside.any() else "nowhere within these bounds"
        problem, limit = f"a closed form's distance is negative {where}", "negative inside of the body alone"
        raise BadInput(problem, field="half", value=reach.tolist(), limit=limit)
    x, faces = find_isosurface(form.distance, -wide, wide, spacing)
    low, high = np.minimum(x.min(axis=0), -reach), np.maximum(x.max(axis=0), reach)
    shape = one_primitive(config, mover, FIELD, low, high, 0.0)
    return replace(shape, vertices=x, faces=faces, owner=np.zeros(len(faces), np.int32), fields=(form,))


class Capsule:
    """A capsule; a = b is a sphere."""

    name: ClassVar[str] = "capsule"
    Config: ClassVar[type[BaseModel]] = CapsuleConfig

    def build(self, config: CapsuleConfig, mover: Mover | None, files: Files) -> BodyShape:
        return one_primitive(config, mover, CAPSULE, config.a, config.b, config.radius)


class Sphere:
    """A sphere."""

    name: ClassVar[str] = "sphere"
    Config: ClassVar[type[BaseModel]] = SphereConfig

    def build(self, config: SphereConfig, mover: Mover | None, files: Files) -> BodyShape:
        return one_primitive(config, mover, CAPSULE, config.centre, config.centre, config.radius)


class Plane:
    """A half space."""

    name: ClassVar[str] = "plane"
    Config: ClassVar[type[BaseModel]] = PlaneConfig

    def build(self, config: PlaneConfig, mover: Mover | None, files: Files) -> BodyShape:
        normal: Float = np.array(config.normal, np.float64)
        length = float(norm(normal))
        if length == 0.0:
            raise BadInput("a plane needs a normal", field="normal", value=config.normal, limit="not all zero")
        return one_primitive(config, mover, PLANE, config.point, normal / length, 0.0)


class Box:
    """A box."""

    name: ClassVar[str] = "box"
    Config: ClassVar[type[BaseModel]] = BoxConfig

    def build(self, config: BoxConfig, mover: Mover | None, files: Files) -> BodyShape:
        return one_primitive(config, mover, BOX, config.centre, [0.5 * size for size in config.size], 0.0)
