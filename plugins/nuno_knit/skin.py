"""The skin below a knit: how far it is, which way it faces, and how deep yarns lie in it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nuno_kernels.closest_point import Closest, closest_points
from nuno_kernels.surface_normals import face_normals
from nuno_kernels.surface_section import Joined, join_faces
from nuno_kernels.surface_tree import Tree, build_tree
from nuno_schemas.fabric import Float, Int

CHUNK = 1 << 16
"""Segments whose samples are held at once."""


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
        normal = np.einsum("nk,nki->ni", found.weights, self.tree.vertex_normals[self.faces[found.face]])
        return found, to_unit(normal)

    def raise_to(self, points: Float, height: Float, start: Int | None = None) -> tuple[Float, Closest]:
        """Points moved away from the skin to at least `height` (n,) [m] above it, and what is closest to them."""
        for _ in range(3):
            found, normal = self.look(points, start)
            low = found.distance < height * (1.0 - 1e-9)
            if not low.any():
                break
            away = points - found.point
            # Off the surface the way away from it is the distance's own gradient, on it there is only the normal.
            size = np.abs(found.distance)
            clear = (size > 1e-3 * height)[:, None]
            sign = np.sign(found.distance)[:, None]
            normal = np.where(clear, sign * to_unit(away), normal)
            points = np.where(low[:, None], found.point + height[:, None] * normal, points)
            start = found.face
        return points, found

    def depths(self, points: Float, segments: NDArray[np.int64], samples: int, face: Int | None = None) -> Float:
        """(s,) how deep the deepest of `samples` points of each piece from points[s] to points[s + 1] lies in the
        skin [m], both ends included; negative outside. `face` (n,) are faces near the points, where they are known.
        """
        share = np.linspace(0.0, 1.0, samples)[:, None]
        deepest = np.empty(len(segments))
        for at in range(0, len(segments), CHUNK):
            part = segments[at : at + CHUNK]
            a, b = points[part][:, None], points[part + 1][:, None]
            placed = (a + share * (b - a)).reshape(-1, 3)
            near = None if face is None else np.repeat(face[part], samples)
            found = closest_points(self.tree, placed, near)
            deepest[at : at + CHUNK] = -found.distance.reshape(-1, samples).min(axis=1)
        return deepest


def to_unit(vectors: Float) -> Float:
    """(n, 3) of length 1, or 0 where they were."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0))
