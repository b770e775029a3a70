"""Bodies and yarns as checked arrays for the kernels of rays, and the crossings of yarns along a ray."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_geometry.poses import Vector
from nuno_kernels import kernel
from nuno_render.rays.hits import (
    Buffers,
    RayTree,
    capsule_tree,
    make_buffers,
    meet_capsules,
    meet_triangle,
    triangle_tree,
)
from nuno_render.scene import join_meshes, join_rows, vertex_normals
from nuno_render.shading.lighting import unit
from nuno_schemas.colour import parse_hex
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.operation import YarnCurves
from nuno_schemas.pictures import Camera, Mesh, axes
from nuno_schemas.vectors import unit_rows

# Bodies and yarns as checked arrays for the kernels of rays.


class Skin(NamedTuple):
    """Bodies: a tree, vertices x (n, 3) [m] from the origin, faces (f, 3), unit normals and albedo (n, 3)."""

    tree: RayTree
    x: Float
    faces: Int
    normals: Float
    albedo: Float


class Hues(NamedTuple):
    """Colours of yarns (y, 3), linear, their absorption per radius, and the shares of light that pass straight through
    and that go back.
    """

    colour: Float
    absorption: Float
    passed: Float
    back: Float


class Threads(NamedTuple):
    """Pieces of yarns: a tree, start, end, and tangents there first, last (i, 3) [m] from the origin, radius (i,) [m],
    the yarn (i,) int64 of each, and the yarns' hues.
    """

    tree: RayTree
    start: Float
    end: Float
    first: Float
    last: Float
    radius: Float
    yarn: NDArray[np.int64]
    hues: Hues


def gather_skin(bodies: tuple[Mesh, ...], origin: Float, colour: str, keep_faces: bool = False) -> Skin:
    """Return all bodies as one, in `colour` by default.

    Faces with a vertex that is not finite are left out, or, to `keep_faces` with their numbers, become points. Raises
    BadInput for arrays of the wrong shape and for face indices out of range.
    """
    x, faces = join_meshes(bodies, origin, "bodies")
    finite: Bool = np.logical_and.reduce(np.isfinite(x), axis=1)
    drawn: Bool = np.logical_and.reduce(finite[faces], axis=1)
    faces = np.where(drawn[:, None], faces, 0) if keep_faces else np.ascontiguousarray(faces[drawn])
    x = np.where(finite[:, None], x, 0.0)
    plain = parse_hex(colour)
    colours = [np.tile(plain, (len(m.vertices), 1)) if m.colours is None else np.asarray(m.colours) for m in bodies]
    albedo = join_rows(colours, 3).astype(np.float64)
    normals = vertex_normals(x, faces, np.arange(len(x), dtype=np.int32))
    return Skin(triangle_tree(x, faces), np.ascontiguousarray(x), faces, normals, albedo)


def gather_threads(yarns: YarnCurves, origin: Float, radius: float | tuple[float, ...] | None, hues: Hues) -> Threads:
    """Return pieces of yarns between finite points; `radius` [m] of all or of each kind, by default their own.

    Raises BadInput for a yarn without thickness, and for radii of another number of kinds.
    """
    thick = _thickness(yarns, radius)
    bad = ~((thick > 0.0) & np.isfinite(thick))
    if bad.any():
        first = int(np.argmax(bad))
        raise BadInput(
            "a yarn without thickness cannot be seen", field=f"yarns.radius[{first}]", value=float(thick[first]),
            limit="more than 0 m", remedy="give yarns a radius, or the picture one for all: radius: 0.1 mm",
        )  # fmt: skip
    points = np.asarray(yarns.points, np.float64) - origin
    pieces = yarns.segments()
    pieces = pieces[np.isfinite(points[pieces]).all(axis=1) & np.isfinite(points[pieces + 1]).all(axis=1)]
    tangents, yarn = tangents_along(points, yarns), yarns.yarn()[pieces]
    start, end = np.ascontiguousarray(points[pieces]), np.ascontiguousarray(points[pieces + 1])
    tree = capsule_tree(start, end, thick[yarn])
    first_tangent, last_tangent = (np.ascontiguousarray(tangents[pieces + k]) for k in (0, 1))
    return Threads(
        tree, start, end, first_tangent, last_tangent, np.ascontiguousarray(thick[yarn]), yarn.astype(np.int64),
        Hues(*map(np.ascontiguousarray, hues)),
    )  # fmt: skip


def _thickness(yarns: YarnCurves, radius: float | tuple[float, ...] | None) -> Float:
    """Return radii (y,) [m]. Raises BadInput for radii of another number of kinds."""
    if radius is None:
        return np.asarray(yarns.radius, np.float64)
    if not isinstance(radius, tuple):
        return np.full(yarns.number, radius)
    if len(radius) != len(yarns.names):
        kinds = f"{len(yarns.names)}: {', '.join(yarns.names)}"
        raise BadInput(
            "one radius for each kind of yarn, or one for all", field="yarns.radius", value=len(radius), limit=kinds
        )
    return np.array(radius)[yarns.kind]


def tangents_along(points: Float, yarns: YarnCurves) -> Float:
    """Return unit tangents (n, 3) at the points, along the chord between the adjacent ones; a ring is closed."""
    previous, following = np.arange(-1, len(points) - 1), np.arange(1, len(points) + 1)
    held = np.diff(yarns.ptr) > 1
    first, last = yarns.ptr[:-1][held], yarns.ptr[1:][held] - 1
    closed = (last > first + 1) & (yarns.points[first] == yarns.points[last]).all(axis=1)
    previous[first], following[last] = np.where(closed, last - 1, first), np.where(closed, first + 1, last)
    lone = yarns.ptr[:-1][np.diff(yarns.ptr) == 1]
    previous[lone] = following[lone] = lone
    return unit_rows(points[following] - points[previous])


def check_eye(bodies: tuple[Mesh, ...], camera: Camera) -> None:
    """Raise BadInput if the eye is inside of a closed body: the first face ahead then shows its back."""
    x, y, z = axes(camera)[2]
    closed = tuple(mesh for mesh in bodies if not mesh.two_sided)
    eye = np.asarray(camera.eye, np.float64)
    skin = gather_skin(closed, eye, "#000000")
    face, _ = meet_triangle((0.0, 0.0, 0.0), (float(x), float(y), float(z)), skin.tree, make_buffers(1))
    if face >= 0:
        a, b, c = skin.x[skin.faces[face]]
        if float(unit(np.cross(b - a, c - a)) @ (x, y, z)) > 0.0:
            raise BadInput(
                "the camera's eye is inside a body", field="camera.eye", value=[round(float(v), 4) for v in eye],
                remedy="give a larger view.distance, or another target",
            )  # fmt: skip


# Yarns along a ray: each crossing counts once, however many of a yarn's capsules it passes.


@kernel
def join_crossings(count: int, items: NDArray[np.int64], enters: Float, leaves: Float, yarn: NDArray[np.int64]) -> int:
    """Merge hits of capsules of one yarn that overlap along the ray. Return the number left, nearest first."""
    kept = 0
    for i in range(count):
        whole = True
        for j in range(kept):
            if yarn[items[j]] == yarn[items[i]] and leaves[j] >= enters[i]:
                leaves[j] = max(leaves[j], leaves[i])
                whole = False
                break
        if whole:
            items[kept], enters[kept], leaves[kept] = items[i], enters[i], leaves[i]
            kept += 1
    return kept


@kernel
def cross_yarns(p: Vector, d: Vector, most: float, threads: Threads, keep: int, buffers: Buffers) -> int:
    """Write crossings of yarns from p along d up to a distance into the buffers. Return their number."""
    count = meet_capsules(p, d, most, threads.tree, keep, buffers)
    if count < 2:
        return count
    return join_crossings(count, buffers.items, buffers.enters, buffers.leaves, threads.yarn)


@kernel
def free_way(p: Vector, d: Vector, skin: Skin, threads: Threads, flat: bool, keep: int, buffers: Buffers) -> float:
    """Return the share of light that reaches p from direction d: 0 through bodies, and what yarns let
    through, all of it if they are `flat`; the mean of all colours.
    """
    face, _ = meet_triangle(p, d, skin.tree, buffers)
    if face >= 0:
        return 0.0
    through, passed = 1.0, threads.hues.passed
    for i in range(0 if flat else cross_yarns(p, d, np.inf, threads, keep, buffers)):
        yarn = threads.yarn[buffers.items[i]]
        through *= (passed[yarn, 0] + passed[yarn, 1] + passed[yarn, 2]) / 3.0
    return through
