"""A mesh as a body by its signed distance, sampled once: faster to ask than the mesh, and holes are no hindrance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import ClassVar, cast

import numpy as np
from pydantic import BaseModel, Field

from nuno_contact.colliders.mesh import MeshCollider, MeshConfig, find_mesh, mesh_shape
from nuno_contact.fields.build import build_field
from nuno_contact.fields.cache import cached_field
from nuno_contact.fields.sample import sample_field
from nuno_contact.quantities import Size
from nuno_kernels.meshes.check import check_closed, check_crossings, volume
from nuno_kernels.meshes.file import read_mesh
from nuno_kernels.meshes.normals import face_normals
from nuno_schemas.bodies import FIELD
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.field import DistanceField
from nuno_schemas.plugin import BodyShape, Files, Mover

LARGEST = 1 << 30
"""Bytes of a field at most."""
FINEST = 1e-5
"""Least tolerance, as a share of the body's size: numbers are kept in single precision."""
THIN = 1e-3
"""Share of the surface that may be thinner than the field can tell, before the user is told."""


class SdfConfig(MeshConfig):
    """A surface as for `mesh`, which may have holes, and how exact its distance is."""

    tolerance: Size = Field(default=1e-3, description="largest error of the distance near the surface [m]")
    band: Size | None = Field(
        default=None,
        description="how far from the surface the tolerance holds [m], five times as much unless given; farther away "
        "the error grows with the distance",
    )


class SdfCollider:
    """A rigid body on a joint of its motion, by a distance field (nuno_contact.fields.build). Contact is `penalty`."""

    name: ClassVar[str] = "sdf"
    Config: ClassVar[type[BaseModel]] = SdfConfig

    def heights(self, config: BaseModel) -> dict[str, float]:
        """The heights of the mesh that the field is made of: see MeshCollider."""
        return MeshCollider().heights(config)

    def field(self, vertices: Float, faces: Int, tolerance: float) -> DistanceField:
        """The field of a closed mesh, made anew: see nuno_contact.fields.build."""
        return build_field(vertices, faces, tolerance)

    def sampler(self, field: DistanceField) -> Callable[[Float], Float]:
        """A function (points (n, 3)) -> (n, 4) distance [m] and gradient, for others than the contact."""
        return partial(sample_field, field)

    def build(self, config: BaseModel, mover: Mover | None, files: Files) -> BodyShape:
        """Raises BadInput for a mesh that cannot be read, is inside out or encloses nothing, and for a tolerance
        that is larger than the body, or takes too much memory.
        """
        c = cast(SdfConfig, config)
        x, faces = find_mesh(c, files, read_mesh)
        check_tolerance(x, c.tolerance)
        fault = find_fault(x, faces)
        field = cached_field(x, faces, c.tolerance, c.band, fault is None, LARGEST)
        check_inside(field, x, faces)
        notes = (*(() if fault is None else (fault,)), *thin_parts(field, x, faces))
        return replace(mesh_shape(c, mover, x, faces, FIELD), fields=(field,), notes=notes)


def check_tolerance(x: Float, tolerance: float) -> None:
    """Raises BadInput for one that makes no sense for vertices (n, 3)."""
    size = np.ptp(x, axis=0)
    if tolerance >= 0.5 * float(size.min()):
        raise BadInput(
            "the tolerance is larger than the body", field="tolerance", value=f"{tolerance:g} m",
            limit=f"half of {' x '.join(f'{edge:.3g}' for edge in size)} m",
        )  # fmt: skip
    if tolerance < FINEST * float(size.max()):
        raise BadInput(
            "the tolerance is finer than a field can be", field="tolerance", value=f"{tolerance:g} m",
            limit=f">= {FINEST * float(size.max()):.2g} m", remedy="collider: {plugin: mesh, ...} is exact",
        )  # fmt: skip


def find_fault(x: Float, faces: Int) -> str | None:
    """What keeps a mesh from having an inside of its own, in words with the place; None of a closed one.

    Raises BadInput for one that is closed, but inside out.
    """
    try:
        check_closed(x, faces)
        check_crossings(x, faces)
    except BadInput as error:
        if error.problem == "the mesh is inside out":
            raise
        return f"{error.problem}: {error.field} {error.value}; inside is where its winding number says"
    return None


def check_inside(field: DistanceField, x: Float, faces: Int) -> None:
    """Raises BadInput for a field without an inside deeper than its tolerance."""
    deepest = -float(field.corners[:, ::4].min())
    if deepest <= field.tolerance:
        raise BadInput(
            "the mesh encloses nothing that its distance field could tell",
            value=f"{max(deepest, 0.0):.3g} m deep at most, a volume of {volume(x, faces):.3g} m^3",
            limit=f"deeper than the tolerance of {field.tolerance:g} m",
            remedy="lower the tolerance; a mesh that is flat, or faces inwards, has no inside: mend: true turns it",
        )


def thin_parts(field: DistanceField, x: Float, faces: Int) -> tuple[str, ...]:
    """A word about parts so thin that the field there faces away from the surface."""
    normals = face_normals(x, faces)
    corners = x[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    gradient = sample_field(field, corners.mean(axis=1))[:, 1:]
    away = (gradient * normals).sum(axis=1) < 0.0
    share = float(area[away].sum() / area.sum())
    if share <= THIN:
        return ()
    worst = corners[away][int(np.argmax(area[away]))].mean(axis=0)
    return (
        f"{share:.1%} of the surface is thinner than a tolerance of {field.tolerance:g} m can tell, first at "
        f"[{', '.join(f'{value:.4g}' for value in worst)}] m: lower it",
    )
