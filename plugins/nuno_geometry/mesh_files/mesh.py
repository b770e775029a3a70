"""Triangle meshes from OBJ, PLY, STL and GLB files, checked, and mended if requested."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_geometry.check import check_closed, place_of
from nuno_geometry.mesh_files.glb import read_glb
from nuno_geometry.mesh_files.polygons import RawMesh, plain, read_obj, read_ply, triangulate
from nuno_geometry.normals import edge_numbers, face_normals
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.reading import read_as

# Triangles of STL files, binary and ASCII (M. Burns, Automated fabrication, 1993, section 6.5).

HEADER, TRIANGLE = 84, 50
"""bytes before the first triangle of a binary file, and of each"""


def read_stl(data: bytes) -> RawMesh:
    """Read an STL file's surface: each triangle has vertices of its own.

    Bytes after the last triangle of a binary file are ignored if fewer than a triangle, and `endsolid` may be missing.
    Raises ValueError for another file, or one whose triangles are not as many as its header says.
    """
    room = max(len(data) - HEADER, 0) // TRIANGLE
    count = struct.unpack_from("<I", data, HEADER - 4)[0] if len(data) >= HEADER else -1
    if count == room:
        kind = np.dtype([("normal", "<f4", 3), ("points", "<f4", (3, 3)), ("attribute", "<u2")])
        points = np.frombuffer(data, kind, room, HEADER)["points"].astype(np.float64).reshape(-1, 3)
    elif (text := plain(data)).lstrip()[:5].lower() == b"solid" and b"\0" not in text[:1024]:
        words = re.findall(rb"(?i)\bvertex\s+(\S+)\s+(\S+)\s+(\S+)(?=\s+(?:vertex|endloop|endfacet))", text)
        if len(words) != 3 * len(re.findall(rb"(?i)\bendfacet\b", text)):
            raise ValueError("it ends within a triangle, or has polygons or vertices of other than three numbers")
        points = np.array(words, dtype="S").astype(np.float64).reshape(-1, 3)
    elif count < 0:
        raise ValueError("it is shorter than a header")
    else:
        raise ValueError(f"its header says that it has {count} triangles, and there is room for {room}")
    return RawMesh(points, np.arange(len(points), dtype=np.int32).reshape(-1, 3))


READERS = {"obj": read_obj, "ply": read_ply, "stl": read_stl, "glb": read_glb}
KINDS = tuple(READERS)
LARGEST_FILE = 1 << 30
Load = Callable[[Path], tuple[Float, Int]]
SEAM = 1e-6
"""largest distance of the two sides of a seam, as a share of the extent: files keep seven digits"""


def load_surface(path: Path) -> tuple[Float, Int]:
    """Return vertices (n, 3) and triangles (f, 3) of a file as they stand there. Raises BadInput."""
    mesh = load_mesh(path)
    return mesh.points, mesh.faces


def material_images(path: Path) -> list[str]:
    """Return the names of the images (`map_Kd`) of an OBJ file's materials, if their files are next to it. Raises
    BadInput for one that cannot be read.
    """
    images = list[str]()
    for library in (path.parent / name for name in _names_after("mtllib", path)):
        if library.is_file():
            images += _names_after("map_Kd", library)
    return list(dict.fromkeys(images))


def _names_after(statement: str, path: Path) -> list[str]:
    """Return the names of the files, without folders, that follow a statement in a text."""
    text = read_as(path, "text", plain, LARGEST_FILE).decode("utf-8", "replace")
    return re.findall(rf"(?im)^[ \t]*{statement}[ \t](?:.*[/\\])?[ \t]*([^/\\\n]*[^/\\\s])", text)


def read_closed(
    path: Path, scale: float = 1.0, mend: bool = False, load: Load = load_surface, notes: list[str] | None = None
) -> tuple[Float, Int]:
    """Return vertices (n, 3) [m] and triangles (f, 3) of a file whose unit is `scale` [m], counter-clockwise from
    outside.

    Vertices at the same place become one where the file's own numbers leave the surface open (STL has no other way to
    share them), triangles without area and vertices without triangle are left out. To `mend` also turns triangles that
    face the wrong way and fills holes, and appends which to `notes`. Raises BadInput, with the edge and its place, for
    a file that cannot be read, or is not a closed surface. It may pass through itself, as scanned bodies do at mouth
    and armpits: `check_crossings` tells.
    """
    x, faces = read_mesh(path, scale, mend, load, notes)
    try:
        check_closed(x, faces, scale)
    except BadInput as error:
        error.file = str(path)
        if mend and error.remedy is not None and error.remedy.startswith("mend:"):
            error.remedy = "mending it was not enough: repair it there in a mesh editor"
        raise
    return x, faces


def read_mesh(
    path: Path, scale: float = 1.0, mend: bool = False, load: Load = load_surface, notes: list[str] | None = None
) -> tuple[Float, Int]:
    """Read as `read_closed` a file whose surface may have holes."""
    try:
        points, triangles = load(path)
        x, faces = clean_mesh(points, triangles, scale)
        if not mend:
            return x, faces
        x, faces, rims = mend_mesh(x, faces)
        if rims and notes is not None:
            largest, many = max(rims, key=len), "hole" if len(rims) == 1 else "holes"
            place = place_of(largest.mean(axis=0), scale)
            notes.append(f"mended: {len(rims)} {many} filled, the largest, of {len(largest)} edges, {place}")
        return x, faces
    except BadInput as error:
        error.file = str(path)
        raise


def load_mesh(path: Path, kinds: tuple[str, ...] = KINDS) -> RawMesh:
    """Read a file as it stands. Raises BadInput for another kind of file, and one that cannot be read."""
    kind = path.suffix.lower().removeprefix(".")
    if kind not in kinds:
        limit = ", ".join(f".{name}" for name in kinds)
        raise BadInput("unknown kind of mesh", str(path), field="file", value=path.name, limit=limit)
    mesh = read_as(path, kind.upper(), READERS[kind], LARGEST_FILE)
    if not mesh.faces.size:
        raise BadInput("the mesh has no triangles", str(path), field="file")
    return mesh


def clean_mesh(x: Float, faces: Int, scale: float = 1.0) -> tuple[Float, Int]:
    """Return the surface, `scale` times as large, without repeated and unused vertices and triangles without area.

    Raises BadInput where nothing is left, and for a vertex without a place.
    """
    vertices, faces = find_vertices(x, faces)
    return np.ascontiguousarray(x[vertices] * scale), faces


def find_vertices(x: Float, faces: Int) -> tuple[Int, Int]:
    """Return the vertices (m,) of x (n, 3) that remain, ascending, and the faces (f, 3). Raises BadInput."""
    if len(faces) == 0:
        raise BadInput("the mesh has no triangles", field="file")
    bad = ~np.isfinite(x).all(axis=1)
    if bad.any():
        raise BadInput("not a finite position", field=f"vertex {int(np.argmax(bad))}", value=place_of(x[bad][0]))
    remaining, joined = join_vertices(x, faces)
    triangles = remaining[joined[faces]].astype(np.int32)
    triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]
    triangles = triangles[(face_normals(x, triangles) != 0.0).any(axis=1)]
    if len(triangles) == 0:
        raise BadInput("no triangle of the mesh has an area", field="file")
    used, numbers = np.unique(triangles, return_inverse=True)
    return used, numbers.reshape(-1, 3).astype(np.int32)


def join_vertices(x: Float, faces: Int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the vertices that stay, ascending, and which (n,) of these each becomes.

    Those at one place become one on the surface's rim alone, as where a file cuts it along the seams of its texture,
    or into single triangles; and the ends of an edge without length. Where the surface is closed by its own numbers,
    what touches stays apart: lips, fingers, the two sides of a slit.
    """
    _, first, place = np.unique(x, axis=0, return_index=True, return_inverse=True)
    place = place.reshape(-1)
    target = np.arange(len(x))
    if len(first) < len(x):
        numbers, pairs = edge_numbers(faces)
        short = pairs[place[pairs[:, 0]] == place[pairs[:, 1]]]
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components  # slow to import, for files that repeat places alone

        links = coo_array((np.ones(len(short)), (short[:, 0], short[:, 1])), shape=(len(x), len(x)))
        _, group = connected_components(links, directed=False)
        target = np.unique(group, return_index=True)[1][group]
        whole = target[faces][(target[faces] != np.roll(target[faces], 1, axis=1)).all(axis=1)]
        numbers, pairs = edge_numbers(whole)
        rim = pairs[np.bincount(numbers.reshape(-1), minlength=len(pairs)) == 1].reshape(-1)
        alone = np.setdiff1d(target, whole)  # of no triangle, or of those without area
        loose = np.isin(target, np.concatenate([rim, alone]))
        lowest = np.full(len(first), len(x))
        np.minimum.at(lowest, place[loose], target[loose])
        target = np.where(loose, lowest[place], target)
    remaining, joined = np.unique(target, return_inverse=True)
    return remaining, joined.reshape(-1)


def mend_mesh(x: Float, faces: Int) -> tuple[Float, Int, list[Float]]:
    """Close the mesh's seams, turn its triangles outwards and fill its holes; return the filled rims (k, 3), too."""
    import trimesh

    x, faces = join_seams(x, faces)
    mesh: Any = trimesh.Trimesh(x, faces, process=False)
    trimesh.repair.fix_winding(mesh)
    faces = np.asarray(mesh.faces, np.int32)
    rims = find_rims(faces)
    mesh = trimesh.Trimesh(*fill_rims(x, faces, rims), process=False)
    trimesh.repair.fix_normals(mesh, multibody=True)
    filled = clean_mesh(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32))
    return *filled, [x[rim] for rim in rims]


def find_rims(faces: Int) -> list[Int]:
    """Return the vertices round each hole, against the triangles' sense; holes that touch at a vertex are apart."""
    numbers, pairs = edge_numbers(faces)
    single = (np.bincount(numbers.reshape(-1), minlength=len(pairs)) == 1)[numbers]
    following: dict[int, list[int]] = {}
    for start, end in np.stack([np.roll(faces, -1, axis=1), faces], axis=2)[single].tolist():
        following.setdefault(start, []).append(end)
    rims = []
    for start in following:
        path, place = [start], {start: 0}
        while following.get(path[-1]):
            vertex = following[path[-1]].pop()
            if vertex not in place:
                place[vertex] = len(path)
                path.append(vertex)
                continue
            rims.append(np.array(path[place[vertex] :], np.int32))
            for passed in path[place[vertex] + 1 :]:
                del place[passed]
            del path[place[vertex] + 1 :]
    return rims


def fill_rims(x: Float, faces: Int, rims: list[Int]) -> tuple[Float, Int]:
    """Return the mesh with triangles between each rim's vertices, or round its middle: if the rim, seen along its
    normal, crosses itself, or if an edge of the triangles is there already, as beside another hole.

    Rejected: trimesh.repair.fill_holes, which leaves rims of more than four edges, or spans them with overlapping fans.
    """
    points, fills, edges = [x], [faces], set(map(tuple, edge_numbers(faces)[1].tolist())) if rims else set()
    for rim in rims:
        inner = edges
        with suppress(BadInput):
            fill = rim[triangulate(x, rim.astype(np.int64), np.array([len(rim)]))]
            numbers, sides = edge_numbers(fill)
            inner = set(map(tuple, sides[np.bincount(numbers.reshape(-1)) == 2].tolist()))
        if inner & edges:
            middle = np.full(len(rim), len(x) + len(points) - 1)
            fill, inner = np.stack([rim, np.roll(rim, -1), middle], axis=1), set()
            points.append(x[rim].mean(axis=0, keepdims=True))
        edges |= inner
        fills.append(fill)
    return np.concatenate(points), np.concatenate(fills)


def join_seams(x: Float, faces: Int) -> tuple[Float, Int]:
    """Join vertices on the mesh's rim at nearly one place, that of the first."""
    numbers, pairs = edge_numbers(faces)
    rim = np.unique(pairs[np.bincount(numbers.reshape(-1), minlength=len(pairs)) == 1])
    if not rim.size:
        return x, faces
    from scipy.spatial import KDTree  # slow to import, for meshes with a rim alone

    near = KDTree(x[rim]).query_pairs(SEAM * float(np.ptp(x, axis=0).max()), output_type="ndarray")
    x = x.copy()
    for first, other in rim[near[np.argsort(near[:, 1], kind="stable")]].tolist():
        x[other] = x[first]
    return clean_mesh(x, faces)
