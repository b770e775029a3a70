"""Surfaces of a scene's bodies, from their geometry alone and wherever its frames are, and normals of any: for all that
draws them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nuno.collision.primitives import box_mesh, capsule_mesh, plane_mesh
from nuno_schemas.bodies import BOX, CAPSULE, OF_TRIANGLES, PLANE, Geometry, Poses, rotation_matrices
from nuno_schemas.fabric import Float, Int
from nuno_schemas.skin import Skin


@dataclass(frozen=True)
class Surfaces:
    """Triangles of all bodies in their frames: vertices (n, 3) [m], faces (f, 3) counter-clockwise seen from outside,
    and the frame (n,) that each vertex is in; and of skins, whose vertices go with several frames, the number of the
    first vertex and what carries them.
    """

    vertices: Float
    faces: Int
    frame: Int
    skins: tuple[tuple[int, Skin], ...] = ()

    def at(self, poses: Poses) -> Float:
        """(n, 3) vertices in the world [m]. Raises IndexError for poses of fewer frames."""
        turned = np.einsum("nij,nj->ni", rotation_matrices(poses.rotation)[self.frame], self.vertices)
        placed = np.asarray(turned + poses.translation[self.frame])
        for first, skin in self.skins:
            own = slice(first, first + len(skin.joint))
            placed[own] = poses.bend(skin, int(self.frame[first]), self.vertices[own])
        return placed


NO_SURFACES = Surfaces(np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros(0, np.int32))


def surface(geometry: Geometry, inset: float = 0.0, plane_size: float = 4.0) -> Surfaces:
    """The surfaces of all primitives, one after the other.

    `inset` [m] draws bodies thinner by so much: between its vertices cloth cuts through round bodies that its vertices
    rest on. Meshes and skins are as they are. Planes, which have no end, are patches of `plane_size` [m].
    """
    parts = [_primitive(geometry, i, inset, plane_size) for i in range(len(geometry.kind))]
    if not parts:
        return NO_SURFACES
    sizes = [len(x) for x, _ in parts]
    faces = [own + at for (_, own), at in zip(parts, np.cumsum([0, *sizes]), strict=False)]
    frame = np.repeat(geometry.frame, sizes).astype(np.int32)
    skins = tuple(
        (int(at), skin) for i, at in enumerate(np.cumsum([0, *sizes[:-1]])) if (skin := geometry.skin(i)) is not None
    )
    return Surfaces(np.concatenate([x for x, _ in parts]), np.concatenate(faces).astype(np.int32), frame, skins)


def _primitive(geometry: Geometry, i: int, inset: float, plane_size: float) -> tuple[Float, Int]:
    """Vertices (n, 3) [m] and faces (f, 3) of one primitive in its frame."""
    kind, a, b, radius = geometry.kind[i], geometry.a[i], geometry.b[i], float(geometry.radius[i])
    if kind in OF_TRIANGLES:
        return geometry.mesh(i)
    if kind == BOX:
        return box_mesh(a, np.maximum(b - inset, 0.1 * b))
    if kind == PLANE:
        return plane_mesh(a - inset * b, b, plane_size)
    if kind == CAPSULE:
        return capsule_mesh(a, b, max(radius - inset, 0.1 * radius))
    raise ValueError(f"unknown primitive kind {int(kind)}")


def vertex_normals(x: Float, faces: Int) -> Float:
    """(n, 3) unit normals of vertices at (n, 3): means of their triangles' by area, 0 where there is none."""
    a, b, c = np.take(x, faces.T, axis=0)
    u, v, corners = (b - a).T, (c - a).T, faces.reshape(-1)
    twice = (u[i - 2] * v[i - 1] - u[i - 1] * v[i - 2] for i in range(3))  # the cross product, by axes
    normal = np.stack([np.bincount(corners, np.repeat(area, 3), len(x)) for area in twice], axis=1)
    size = np.sqrt(normal[:, 0] ** 2 + normal[:, 1] ** 2 + normal[:, 2] ** 2)
    unit: Float = normal / np.where(size > 0.0, size, 1.0)[:, None]
    return unit


def outlines(faces: Int) -> list[list[int]]:
    """Points round triangles (f, 3), along their sides, loop by loop."""
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2).tolist()
    inner = {(b, a) for a, b in sides}
    after: dict[int, list[int]] = {}
    for a, b in sides:
        if (a, b) not in inner:
            after.setdefault(a, []).append(b)
    loops = []
    while any(after.values()):
        loop = [next(point for point, others in after.items() if others)]
        while (point := after[loop[-1]].pop()) != loop[0]:
            loop.append(point)
        loops.append(loop)
    return loops
