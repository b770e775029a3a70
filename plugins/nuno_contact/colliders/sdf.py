"""A mesh as a body by its sampled signed distance: faster than the mesh itself, and holes do no harm."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np
from pydantic import BaseModel, Field

from nuno_contact.colliders.mesh import MeshCollider, MeshConfig, find_mesh, mesh_shape
from nuno_contact.distance_fields.build import build_field
from nuno_contact.distance_fields.sample import sample_field
from nuno_contact.quantities import Size
from nuno_geometry.check import check_closed, check_crossings, volume
from nuno_geometry.mesh_files.mesh import read_mesh
from nuno_geometry.normals import face_normals
from nuno_kernels import CACHE
from nuno_schemas.bodies import FIELD, DistanceField
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.plugin import BodyShape, Files, Mover
from nuno_schemas.vectors import face_areas

# Distance fields on disk, by a hash of their input: a body is sampled once, not at every start.

MOST_FILES = 24
"""files in the cache: the ones last used"""
ARRAYS = ("low", "shape", "child", "corners")


def cache_folder() -> Path:
    """Return the folder of cached fields, beside the compiled kernels."""
    return CACHE.parents[1] / "fields"


def field_key(x: Float, faces: Int, tolerance: float, band: float | None, closed: bool) -> str:
    """Return a field's name by all that it depends on, the sources of the kernels that make it among them."""
    digest = hashlib.sha256(repr((CACHE.name, x.shape, faces.shape, tolerance, band, closed)).encode())
    digest.update(np.ascontiguousarray(x, np.float64).tobytes())
    digest.update(np.ascontiguousarray(faces, np.int32).tobytes())
    return digest.hexdigest()[:32]


def cached_field(
    x: Float, faces: Int, tolerance: float, band: float | None, closed: bool, most_bytes: int
) -> DistanceField:
    """Return `nuno_contact.distance_fields.build.build_field`, from disk if it has been made before: the same bits.

    A file that cannot be read is made anew; a folder that cannot be written to is not used.
    """
    path = cache_folder() / f"{field_key(x, faces, tolerance, band, closed)}.npz"
    with contextlib.suppress(OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        field = load_field(path)
        path.touch()
        return field
    field = build_field(x, faces, tolerance, band, closed, most_bytes)
    with contextlib.suppress(OSError):
        save_field(path, field)
    return field


def load_field(path: Path) -> DistanceField:
    """Load a field. Raises what numpy raises for a missing or broken file: its parts have checksums."""
    with np.load(path, allow_pickle=False) as file:
        size, tolerance, band = file["numbers"].tolist()
        low, shape, child, corners = (file[name] for name in ARRAYS)
    return DistanceField(low, size, shape, tolerance, band, child, corners)


def save_field(path: Path, field: DistanceField) -> None:
    """Write a file atomically, and delete the least recently used ones. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            numbers = np.array([field.size, field.tolerance, field.band])
            np.savez(file, numbers=numbers, **{key: getattr(field, key) for key in ARRAYS})
        Path(name).replace(path)
    finally:
        Path(name).unlink(missing_ok=True)
    kept = sorted(path.parent.glob("*.npz"), key=lambda one: one.stat().st_mtime, reverse=True)
    for old in kept[MOST_FILES:]:
        old.unlink(missing_ok=True)


LARGEST = 1 << 30
"""most bytes of a field"""
FINEST = 1e-5
"""least tolerance, as a share of the body's size: numbers are in single precision"""
THIN = 1e-3
"""share of the surface that may be thinner than the field resolves, without a warning"""


class SdfConfig(MeshConfig):
    """A surface as for `mesh`, which may have holes, and the accuracy of its distance."""

    tolerance: Size = Field(default=1e-3, description="largest error of the distance near the surface [m]")
    band: Size | None = Field(
        default=None,
        description="how far from the surface the tolerance holds [m], five times as much unless given; farther away "
        "the error grows with the distance",
    )


class SdfCollider:
    """A rigid body on a joint of its motion, by a distance field (nuno_contact.distance_fields): penalty contact."""

    name: ClassVar[str] = "sdf"
    Config: ClassVar[type[BaseModel]] = SdfConfig

    def heights(self, config: SdfConfig) -> dict[str, float]:
        """Return the heights of the mesh that the field is made of: see MeshCollider."""
        return MeshCollider().heights(config)

    def field(self, vertices: Float, faces: Int, tolerance: float) -> DistanceField:
        """Build the field of a closed mesh, without the cache: see nuno_contact.distance_fields.build."""
        return build_field(vertices, faces, tolerance)

    def sampler(self, field: DistanceField) -> Callable[[Float], Float]:
        """Return a function (points (n, 3)) -> (n, 4) distance [m] and gradient, for callers other than contact."""
        return partial(sample_field, field)

    def build(self, config: SdfConfig, mover: Mover | None, files: Files) -> BodyShape:
        """Build the body. Raises BadInput for a mesh that cannot be read, is inside out or encloses nothing, and for a
        tolerance that is larger than the body, or takes too much memory.
        """
        mended: list[str] = []
        x, faces = find_mesh(config, files, partial(read_mesh, notes=mended))
        check_tolerance(x, config.tolerance)
        fault = find_fault(x, faces)
        field = cached_field(x, faces, config.tolerance, config.band, fault is None, LARGEST)
        check_inside(field, x, faces)
        notes = (*mended, *(() if fault is None else (fault,)), *thin_parts(field, x, faces))
        return replace(mesh_shape(config, mover, x, faces, FIELD), fields=(field,), notes=notes)


def check_tolerance(x: Float, tolerance: float) -> None:
    """Raise BadInput for a tolerance that makes no sense for vertices (n, 3)."""
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
    """Describe, with its place, why a mesh has no inside of its own; None for a closed one.

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
    """Raise BadInput for a field without an inside deeper than its tolerance."""
    deepest = -float(field.corners[:, ::4].min())
    if deepest <= field.tolerance:
        raise BadInput(
            "the mesh encloses nothing that its distance field could tell",
            value=f"{max(deepest, 0.0):.3g} m deep at most, a volume of {volume(x, faces):.3g} m^3",
            limit=f"deeper than the tolerance of {field.tolerance:g} m",
            remedy="lower the tolerance; a mesh that is flat, or faces inwards, has no inside: mend: true turns it",
        )


def thin_parts(field: DistanceField, x: Float, faces: Int) -> tuple[str, ...]:
    """Describe parts so thin that the field there faces away from the surface."""
    normals, corners = face_normals(x, faces), x[faces]
    area = face_areas(corners)
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
