"""Distance fields on disk, by what they were made of: a body is sampled once, not at every start."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
import zipfile
from pathlib import Path

import numpy as np

from nuno_contact.fields.build import build_field
from nuno_kernels import CACHE
from nuno_schemas.fabric import Float, Int
from nuno_schemas.field import DistanceField

KEPT = 24
"""Files that are kept, the ones last used."""
ARRAYS = ("low", "shape", "child", "corners")


def cache_folder() -> Path:
    """Where fields are kept, beside the compiled kernels."""
    return CACHE.parents[1] / "fields"


def field_key(x: Float, faces: Int, tolerance: float, band: float | None, closed: bool) -> str:
    """Name of a field by all that it depends on, the sources of the kernels that make it among them."""
    digest = hashlib.sha256(repr((CACHE.name, x.shape, faces.shape, tolerance, band, closed)).encode())
    digest.update(np.ascontiguousarray(x, np.float64).tobytes())
    digest.update(np.ascontiguousarray(faces, np.int32).tobytes())
    return digest.hexdigest()[:32]


def cached_field(
    x: Float, faces: Int, tolerance: float, band: float | None, closed: bool, most_bytes: int
) -> DistanceField:
    """`nuno_contact.fields.build.build_field`, from disk where it has been made before: the same bits.

    A file that cannot be read is made anew, and a folder that cannot be written to is done without.
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
    """The field in a file. Raises what numpy raises of one that is missing or broken: its parts have checksums."""
    with np.load(path, allow_pickle=False) as file:
        size, tolerance, band = file["numbers"].tolist()
        low, shape, child, corners = (file[name] for name in ARRAYS)
    return DistanceField(low, size, shape, tolerance, band, child, corners)


def save_field(path: Path, field: DistanceField) -> None:
    """Write a whole file or none, and forget the ones that were not used for longest. Raises OSError."""
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
    for old in kept[KEPT:]:
        old.unlink(missing_ok=True)
