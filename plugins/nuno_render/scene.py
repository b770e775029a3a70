"""Meshes and the images on them as checked, plain arrays for the kernels."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_kernels import kernel
from nuno_schemas.colour import parse_hex, to_linear
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.pictures import Mesh
from nuno_schemas.vectors import unit_rows

# Images on cloth: mip maps in linear light, and trilinear look-up with a few taps along the slant.

TAPS = 8
"""The most look-ups along the longer axis of a pixel's footprint."""


class Textures(NamedTuple):
    """Mip maps of the images of meshes: texels (t, 3) float32 linear, all levels of all images; levels (m, l, 3) int64
    per mesh: first texel, height, width; number (m,) int64 of levels, 0 for a mesh without image.
    """

    texels: NDArray[np.float32]
    levels: NDArray[np.int64]
    number: NDArray[np.int64]


def gather_textures(images: list[NDArray[np.uint8] | None]) -> Textures:
    """Return mip maps of the images, one per mesh or None."""
    pyramids = [_pyramid(image.tobytes(), image.shape) if image is not None else () for image in images]
    count = np.array([len(p) for p in pyramids], np.int64)
    levels = np.zeros((len(images), max([1, *map(len, pyramids)]), 3), np.int64)
    parts, start = [np.zeros((1, 3), np.float32)], 1
    for m, pyramid in enumerate(pyramids):
        for level, picture in enumerate(pyramid):
            levels[m, level] = start, picture.shape[0], picture.shape[1]
            parts.append(picture.reshape(-1, 3))
            start += picture.shape[0] * picture.shape[1]
    return Textures(np.concatenate(parts), levels, count)


@functools.lru_cache(maxsize=4)
def _pyramid(data: bytes, shape: tuple[int, ...]) -> tuple[NDArray[np.float32], ...]:
    """Return levels from full size to one texel. Cached, since an animation has the same image in every frame."""
    table = to_linear(np.arange(256) / 255.0).astype(np.float32)
    picture = table[np.frombuffer(data, np.uint8).reshape(shape)]
    levels = [picture]
    while max(picture.shape[:2]) > 1:
        picture = _halve(_halve(picture, 0), 1)
        levels.append(picture)
    return tuple(levels)


def _halve(picture: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Halve the size along an axis, rounded up; an odd last line is repeated."""
    size = picture.shape[axis]
    if size == 1:
        return picture
    first = picture.take(range(0, size, 2), axis)
    second = picture.take([min(i + 1, size - 1) for i in range(0, size, 2)], axis)
    return np.asarray((first + second) * np.float32(0.5))


@kernel
def _bilinear(
    texels: NDArray[np.float32], level: NDArray[np.int64], u: float, v: float, weight: float, out: Float
) -> None:
    """Add weight times the image at (u, v): repeats beyond [0, 1], (0, 0) is the upper left corner."""
    start, height, width = level[0], level[1], level[2]
    x, y = (u - np.floor(u)) * width - 0.5, (v - np.floor(v)) * height - 0.5
    x0, y0 = np.floor(x), np.floor(y)
    fx, fy = x - x0, y - y0
    left, right = int(x0) % width, int(x0 + 1.0) % width
    top, bottom = int(y0) % height, int(y0 + 1.0) % height
    for k in range(3):
        above = texels[start + top * width + left, k] * (1.0 - fx) + texels[start + top * width + right, k] * fx
        below = texels[start + bottom * width + left, k] * (1.0 - fx) + texels[start + bottom * width + right, k] * fx
        out[k] += weight * (above * (1.0 - fy) + below * fy)


@kernel
def look_up(textures: Textures, mesh: int, place: Any, change: Any, out: Float) -> None:
    """Write the mean of a mesh's image over a pixel's footprint about (u, v) into out (3,).

    change: of (u, v) over one pixel to the right, and down. Taps cover the longer of the two and the shorter chooses
    the mip level, so that slanted cloth is sharp along its short axis without aliasing along the long one.
    """
    texels, levels, count = textures.texels, textures.levels[mesh], textures.number[mesh]
    (u, v), (ux, vx, uy, vy), height, width = place, change, levels[0, 1], levels[0, 2]
    a = np.sqrt((ux * width) ** 2 + (vx * height) ** 2)
    b = np.sqrt((uy * width) ** 2 + (vy * height) ** 2)
    long_u, long_v = (ux, vx) if a >= b else (uy, vy)
    long, short = max(a, b), min(a, b)
    taps = 1
    if long > 1.0:
        taps = int(min(np.ceil(long / max(short, 1.0)), TAPS))
    level = np.log2(max(long / taps, 1.0))
    coarse = int(min(level, count - 1.0))
    blend = min(level - coarse, 1.0)
    out[0] = out[1] = out[2] = 0.0
    for tap in range(taps):
        place = (tap + 0.5) / taps - 0.5
        tu, tv = u + place * long_u, v + place * long_v
        _bilinear(texels, levels[coarse], tu, tv, (1.0 - blend) / taps, out)
        if blend > 0.0 and coarse + 1 < count:
            _bilinear(texels, levels[coarse + 1], tu, tv, blend / taps, out)
        elif blend > 0.0:
            _bilinear(texels, levels[coarse], tu, tv, blend / taps, out)


# Meshes as checked, plain arrays for the kernels.

CLOTH, BODY = "#3a5a8c", "#cfc8bd"
"""Default colours of meshes: indigo for cloth, warm plaster for closed bodies."""

FAR = 1e12
"""Vertices farther out than this [m] are treated like those that are not finite."""


class DrawnScene(NamedTuple):
    """All meshes as one, around an origin.

    positions (n, 3) [m] from the origin; normals (n, 3) unit; albedo (n, 3) linear;
    uv (n, 2); faces (f, 3) int32; mesh (f,) int32 into two_sided (m,); centre (3,) and
    radius [m] of a sphere that holds every drawn vertex; lowest: least height along `up` [m].
    """

    positions: Float
    normals: Float
    albedo: Float
    uv: Float
    faces: Int
    mesh: Int
    two_sided: Bool
    textures: Textures
    centre: Float
    radius: float
    lowest: float


def gather(meshes: list[Mesh], origin: Float, up: Float) -> DrawnScene:
    """Return one scene from several meshes, without faces that have a vertex that is not finite: a run that diverged
    can be drawn.

    Raises BadInput for arrays of the wrong shape and for face indices out of range.
    """
    positions, faces = join_meshes(meshes, origin, "meshes")
    owner = np.repeat(np.arange(len(meshes), dtype=np.int32), [len(m.faces) for m in meshes])
    finite: Bool = np.logical_and.reduce(np.abs(positions) <= FAR, axis=1)
    kept = finite[faces].all(axis=1)
    positions[~finite] = 0.0
    faces = np.ascontiguousarray(faces[kept], np.int32)
    used = np.zeros(len(positions), np.bool_)
    used[faces] = True
    used |= finite & np.repeat([m.yarns is not None for m in meshes], [len(m.vertices) for m in meshes]).astype(bool)
    drawn = positions[used] if used.any() else np.array([[-0.5, -0.5, -0.5], [0.5, 0.5, 0.5]])
    own = join_rows([np.full((len(m.vertices), 3), np.nan) if m.normals is None else m.normals for m in meshes], 3)
    centre = (drawn.min(axis=0) + drawn.max(axis=0)) / 2.0
    radius = float(np.sqrt(((drawn - centre) ** 2).sum(axis=1).max()))
    return DrawnScene(
        positions,
        np.where(np.isfinite(own), own, vertex_normals(positions, faces, np.arange(len(positions), dtype=np.int32))),
        join_rows([albedo_of(m) for m in meshes], 3),
        join_rows(
            [np.zeros((len(m.vertices), 2)) if m.uv is None else np.asarray(m.uv, np.float64) for m in meshes], 2
        ),
        faces,
        np.ascontiguousarray(owner[kept]),
        np.array([m.two_sided for m in meshes], np.bool_),
        gather_textures([m.image if m.uv is not None else None for m in meshes]),
        centre,
        radius if radius > 0.0 else 1.0,
        float((drawn @ up).min()),
    )


def join_meshes(meshes: Sequence[Mesh], origin: Float, name: str) -> tuple[Float, Int]:
    """Return vertices (n, 3) [m] from the origin and faces (f, 3) of all meshes, named `name` in errors.

    Raises BadInput for arrays of the wrong shape and for face indices out of range.
    """
    for number, mesh in enumerate(meshes):
        check_mesh(mesh, f"{name}[{number}]")
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    moved = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    faces = np.concatenate([np.zeros((0, 3), np.int32), *moved]).astype(np.int32)
    return join_rows([np.asarray(mesh.vertices, np.float64) for mesh in meshes], 3) - origin, faces


def join_rows(parts: list[Float], width: int) -> Float:
    """Return rows (n, width) of several arrays, or none."""
    return np.ascontiguousarray(np.concatenate([np.zeros((0, width)), *parts]))


def check_mesh(mesh: Mesh, name: str) -> None:
    """Raise BadInput for arrays of the wrong shape and for face indices out of range."""
    count = len(mesh.vertices)
    shapes: dict[str, tuple[NDArray[np.generic] | None, tuple[int, int]]] = {
        "vertices": (mesh.vertices, (count, 3)),
        "faces": (mesh.faces, (len(mesh.faces), 3)),
        "colours": (mesh.colours, (count, 3)),
        "uv": (mesh.uv, (count, 2)),
        "normals": (mesh.normals, (count, 3)),
    }
    for field, (array, shape) in shapes.items():
        if array is not None and np.shape(array) != shape:
            raise BadInput("array of the wrong shape", field=f"{name}.{field}", value=np.shape(array), limit=str(shape))
    if len(mesh.faces) and not (np.min(mesh.faces) >= 0 and np.max(mesh.faces) < count):
        bad = int(np.max(mesh.faces)) if np.max(mesh.faces) >= count else int(np.min(mesh.faces))
        raise BadInput("face index out of range", field=f"{name}.faces", value=bad, limit=f"0 to {count - 1}")
    image = mesh.image
    if image is not None and (image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or image.size == 0):
        limit = "(h, w, 3) uint8, h and w at least 1"
        raise BadInput("not an RGB image", field=f"{name}.image", value=(image.shape, str(image.dtype)), limit=limit)


def albedo_of(mesh: Mesh) -> Float:
    """Return linear albedo (n, 3): the mesh's colours, white under an image, or the default."""
    if mesh.colours is not None:
        return np.clip(np.nan_to_num(np.asarray(mesh.colours, np.float64)), 0.0, 1.0)
    if mesh.image is not None and mesh.uv is not None:
        return np.ones((len(mesh.vertices), 3))
    return np.tile(parse_hex(CLOTH if mesh.two_sided else BODY), (len(mesh.vertices), 1))


def find_twins(x: Float) -> Int:
    """Return for each of the points x (n, 3) one of those at its place. Cloth with a texture seam has pairs of vertices
    at one place, whose normals are shared: else the seam would show as a crease. A box is made of such pairs, too.
    """
    _, first, back = np.unique(x, axis=0, return_index=True, return_inverse=True)
    return first[back.reshape(-1)].astype(np.int32)


def vertex_normals(x: Float, faces: Int, twins: Int) -> Float:
    """Return unit normals (n, 3): the mean of the faces around a vertex, weighted by their angles there, which do not
    depend on the way in which squares are halved, as areas do.

    twins (n,) maps a vertex to the one that collects its faces. A vertex without faces, or whose faces cancel, gets
    (0, 0, 1).
    """
    p = x[faces]
    ahead, behind = unit_rows(np.roll(p, -1, axis=1) - p), unit_rows(np.roll(p, 1, axis=1) - p)
    flat = unit_rows(np.cross(ahead[:, 0], behind[:, 0]))
    angle = np.arccos(np.clip((ahead * behind).sum(axis=2), -1.0, 1.0))
    at, weighted = twins[faces].reshape(-1), (angle[..., None] * flat[:, None]).reshape(-1, 3)
    total = np.stack([np.bincount(at, weighted[:, k], len(x)) for k in range(3)], axis=1)[twins]
    return np.asarray(np.where((total != 0.0).any(axis=1, keepdims=True), unit_rows(total), [0.0, 0.0, 1.0]))
