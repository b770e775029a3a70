"""The skin below a knit: its distance and normals, and the depth of yarns in it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nuno_geometry.closest_point import Closest, closest_points
from nuno_geometry.normals import blend_normals, face_normals
from nuno_geometry.sections import Joined, join_faces
from nuno_geometry.tree import Tree, build_tree
from nuno_schemas.fabric import Float, Int
from nuno_schemas.operation import first_of_pieces
from nuno_schemas.vectors import unit_rows

CHUNK = 1 << 16
"""Segments whose samples are in memory at once."""
RAISES = 8
"""The most times that a point is raised, which in a hollow may approach the skin on the other side."""


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
        """Unit normals (f, 3) of the faces."""
        return face_normals(self.vertices, self.faces)

    def look(self, points: Float, start: Int | None = None) -> tuple[Closest, Float]:
        """Return the skin's closest points to points (n, 3) [m], and interpolated unit normals (n, 3) there."""
        nearest = closest_points(self.tree, points, start)
        normal = np.empty_like(nearest.point)
        blend_normals(self.tree.vertex_normals, self.tree.faces, nearest.face, nearest.weights, normal)
        return nearest, normal

    def raise_to(self, points: Float, height: Float, start: Int | None = None) -> tuple[Float, Int]:
        """Return points moved to at least `height` (n,) [m] above the skin, and the faces (n,) closest to them."""
        points, nearest = points.copy(), closest_points(self.tree, points, start)
        foot, face, distance = nearest.point, nearest.face, nearest.distance
        for _ in range(RAISES):
            low = np.flatnonzero(distance < height * (1.0 - 1e-9))
            if not len(low):
                break
            # Off the surface the direction is the distance's gradient, on it the face's normal.
            away = np.sign(distance[low])[:, None] * unit_rows(points[low] - foot[low])
            clear = np.abs(distance[low]) > 1e-3 * height[low]
            points[low] = foot[low] + height[low, None] * np.where(clear[:, None], away, self.facing[face[low]])
            nearest = closest_points(self.tree, points[low], face[low])
            foot[low], face[low], distance[low] = nearest.point, nearest.face, nearest.distance
        return points, face

    def deepest(self, points: Float, ptr: NDArray[np.int64], samples: int, face: Int) -> tuple[int, float]:
        """Return the number of checked places of polylines, `samples` (at least two) of every piece with both its ends,
        and the depth of the deepest in the skin [m], negative outside. `face` (n,) are faces near the points.
        """
        last, first = ptr[1:] - 1, first_of_pieces(ptr)
        share = np.linspace(0.0, 1.0, samples)[:-1, None]
        depth = -float(closest_points(self.tree, points[last], face[last]).distance.min(initial=np.inf))
        for at in range(0, len(first), CHUNK):
            part = first[at : at + CHUNK]
            a, b = points[part][:, None], points[part + 1][:, None]
            near = np.repeat(face[part], samples - 1)
            nearest = closest_points(self.tree, (a + share * (b - a)).reshape(-1, 3), near)
            depth = max(depth, -float(nearest.distance.min()))
        return (samples - 1) * len(first) + len(ptr) - 1, depth
