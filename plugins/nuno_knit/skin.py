"""The skin below a knit: how far it is, which way it faces, and how deep yarns lie in it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nuno_kernels.meshes.closest_point import Closest, closest_points
from nuno_kernels.meshes.normals import blend_normals, face_normals
from nuno_kernels.meshes.section import Joined, join_faces
from nuno_kernels.meshes.tree import Tree, build_tree
from nuno_schemas.fabric import Float, Int

CHUNK = 1 << 16
"""Segments whose samples are held at once."""
RAISES = 8
"""How often a point is raised that in a hollow comes too near to the skin on its other side."""


@dataclass(frozen=True)
class Skin:
    """Closed surfaces: vertices (v, 3) [m], faces (f, 3)."""

    vertices: Float
    faces: Int

    @cached_property
    def tree(self) -> Tree:
        return build_tree(self.vertices, self.faces)

    @cached_property
    def joined(self) -> Joined:
        return join_faces(self.vertices, self.faces)

    @cached_property
    def facing(self) -> Float:
        """(f, 3) unit normals of the faces."""
        return face_normals(self.vertices, self.faces)

    def look(self, points: Float, start: Int | None = None) -> tuple[Closest, Float]:
        """Closest points of the skin to points (n, 3) [m], and unit normals (n, 3) there, interpolated over faces."""
        found = closest_points(self.tree, points, start)
        normal = np.empty_like(found.point)
        blend_normals(self.tree.vertex_normals, self.tree.faces, found.face, found.weights, normal)
        return found, normal

    def raise_to(self, points: Float, height: Float, start: Int | None = None) -> tuple[Float, Int]:
        """Points moved away from the skin to at least `height` (n,) [m] above it, and faces (n,) closest to them."""
        points, found = points.copy(), closest_points(self.tree, points, start)
        foot, face, distance = found.point, found.face, found.distance
        for _ in range(RAISES):
            low = np.flatnonzero(distance < height * (1.0 - 1e-9))
            if not len(low):
                break
            # Off the surface the way away is the distance's own gradient, on it there is only the face's normal.
            away = np.sign(distance[low])[:, None] * to_unit(points[low] - foot[low])
            clear = np.abs(distance[low]) > 1e-3 * height[low]
            points[low] = foot[low] + height[low, None] * np.where(clear[:, None], away, self.facing[face[low]])
            found = closest_points(self.tree, points[low], face[low])
            foot[low], face[low], distance[low] = found.point, found.face, found.distance
        return points, face

    def deepest(self, points: Float, ptr: NDArray[np.int64], samples: int, face: Int) -> tuple[int, float]:
        """How many places of polylines were looked at, `samples` (at least two) of every piece with both its ends,
        and how deep the deepest lies in the skin [m], negative outside. `face` (n,) are faces near the points.
        """
        last = np.zeros(len(points), bool)
        last[ptr[1:] - 1] = True
        first = np.flatnonzero(~last)
        share = np.linspace(0.0, 1.0, samples)[:-1, None]
        depth = -float(closest_points(self.tree, points[last], face[last]).distance.min(initial=np.inf))
        for at in range(0, len(first), CHUNK):
            part = first[at : at + CHUNK]
            a, b = points[part][:, None], points[part + 1][:, None]
            near = np.repeat(face[part], samples - 1)
            found = closest_points(self.tree, (a + share * (b - a)).reshape(-1, 3), near)
            depth = max(depth, -float(found.distance.min()))
        return (samples - 1) * len(first) + len(ptr) - 1, depth


def to_unit(vectors: Float) -> Float:
    """(n, 3) of length 1, or 0 where they were."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0))
