"""Closed triangle meshes from OBJ, PLY, STL and GLB files, read by trimesh, checked, and mended where asked to."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_kernels.meshes.check import check_closed, place_of
from nuno_kernels.meshes.normals import face_normals
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int

KINDS = ("obj", "ply", "stl", "glb")
LARGEST_FILE = 1 << 30


def load_surface(path: Path) -> tuple[Float, NDArray[np.int64]]:
    """Vertices (n, 3) and triangles (f, 3) of a file as they stand there. Raises BadInput."""
    return load_mesh(path, KINDS)[:2]


def read_closed(
    path: Path, scale: float = 1.0, mend: bool = False, load: Callable[[Path], tuple[Float, Any]] = load_surface
) -> tuple[Float, Int]:
    """Vertices (n, 3) [m] and triangles (f, 3) of a file whose unit is `scale` [m], seen from outside
    counter-clockwise.

    Vertices at the same place become one (STL has no other way to share them), triangles without area and
    vertices without triangle are left out. To `mend` also turns triangles that face the wrong way and fills holes.
    Raises BadInput, with the edge and its place, for a file that cannot be read, or is not a closed surface. It may
    pass through itself, as scanned bodies do at mouth and armpits: `check_crossings` tells.
    """
    x, faces = read_mesh(path, scale, mend, load)
    try:
        check_closed(x, faces)
    except BadInput as error:
        error.file = str(path)
        if mend and error.remedy is not None and error.remedy.startswith("mend:"):
            error.remedy = "mending it was not enough: repair it there in a mesh editor"
        raise
    return x, faces


def read_mesh(
    path: Path, scale: float = 1.0, mend: bool = False, load: Callable[[Path], tuple[Float, Any]] = load_surface
) -> tuple[Float, Int]:
    """As `read_closed`, of a file whose surface may have holes."""
    try:
        points, triangles = load(path)
        x, faces = clean_mesh(points, triangles.astype(np.int32), scale)
        return mend_mesh(x, faces) if mend else (x, faces)
    except BadInput as error:
        error.file = str(path)
        raise


def load_mesh(path: Path, kinds: tuple[str, ...], **how: bool) -> tuple[Float, NDArray[np.int64], Any]:
    """Vertices (n, 3) and triangles (f, 3) of a file as they stand there, and trimesh's mesh with all else.

    `how` goes to the library's reader. Raises BadInput for another kind of file, one that cannot be read, and
    triangles of vertices that are not there.
    """
    import trimesh

    kind = path.suffix.lower().removeprefix(".")
    if kind not in kinds:
        limit = ", ".join(f".{name}" for name in kinds)
        raise BadInput("unknown kind of mesh", field="file", value=path.name, limit=limit)
    size = path.stat().st_size
    if size > LARGEST_FILE:
        raise BadInput("too large for a mesh", value=size, limit=f"{LARGEST_FILE} bytes")
    if kind == "obj":
        _check_numbers(path.read_bytes())
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # it logs traces of what is refused in words here
    try:
        with path.open("rb") as stream:
            mesh: Any = trimesh.load(stream, file_type=kind, force="mesh", process=False, skip_materials=True, **how)
        x = np.asarray(getattr(mesh, "vertices", np.zeros((0, 3))), np.float64).reshape(-1, 3)
        faces = np.asarray(getattr(mesh, "faces", np.zeros((0, 3))), np.int64).reshape(-1, 3)
        if faces.size and not 0 <= faces.min() <= faces.max() < len(x):
            raise ValueError(f"triangles of vertices {faces.min()} to {faces.max()}, and there are {len(x)}")
    except Exception as error:  # whatever a broken file makes of the decoder
        raise BadInput(f"cannot be read as {kind.upper()}: {error}", field="file") from None
    if not faces.size:
        raise BadInput("the mesh has no triangles", field="file")
    return x, faces, mesh


def _check_numbers(data: bytes) -> None:
    """Refuse triangles of vertices far beyond those of an OBJ file: trimesh would make room for all up to them.

    There are fewer vertices than lines, and numbers with as many digits as that are left to be compared.
    """
    data = data.replace(b"\r\n", b"\n").replace(b"\\\n", b"")  # as trimesh reads it
    lines = data.count(b"\n") + 1
    most = len(str(lines))
    for found in re.finditer(rb"(?m)^f[^\n]*?\d{%d}[^\n]*" % (most + 1), data):
        largest = max((digits.lstrip(b"0") for digits in re.findall(rb"\d+", found[0])), key=len)
        if len(largest) > most:
            raise BadInput(
                "cannot be read as OBJ: a triangle of a vertex that is not there", field="file",
                line=data.count(b"\n", 0, found.start()) + 1, value=largest.decode(),
                limit=f"the file has {lines} lines",
            )  # fmt: skip


def clean_mesh(x: Float, faces: Int, scale: float = 1.0) -> tuple[Float, Int]:
    """The same surface, `scale` times as large, without repeated and unused vertices and triangles without area.

    Raises BadInput where nothing is left, and for a vertex without a place.
    """
    if len(faces) == 0:
        raise BadInput("the mesh has no triangles", field="file")
    bad = ~np.isfinite(x).all(axis=1)
    if bad.any():
        raise BadInput("not a finite position", field=f"vertex {int(np.argmax(bad))}", value=place_of(x[bad][0]))
    _, kept, joined = np.unique(x, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(np.argsort(kept))
    faces = order[joined.reshape(-1)][faces].astype(np.int32)
    x = x[np.sort(kept)] * scale
    apart = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    faces = faces[apart]
    faces = faces[(face_normals(x, faces) != 0.0).any(axis=1)]
    if len(faces) == 0:
        raise BadInput("no triangle of the mesh has an area", field="file")
    used, numbers = np.unique(faces, return_inverse=True)
    return np.ascontiguousarray(x[used]), numbers.reshape(-1, 3).astype(np.int32)


def mend_mesh(x: Float, faces: Int) -> tuple[Float, Int]:
    """The mesh with its normals outwards and its holes filled, as far as trimesh can."""
    import trimesh

    mesh: Any = trimesh.Trimesh(x, faces, process=False)
    trimesh.repair.fix_winding(mesh)
    mesh.fill_holes()
    trimesh.repair.fix_normals(mesh, multibody=True)
    return clean_mesh(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32))
