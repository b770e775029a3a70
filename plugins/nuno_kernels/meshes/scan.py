"""The closest triangles of a mesh without a tree."""

from __future__ import annotations

import math

import numpy as np

from nuno_kernels import kernel
from nuno_kernels.lanes.simd import WIDTH
from nuno_kernels.meshes.closest_point import leaf_distances, read_triangle, take_nearest
from nuno_kernels.meshes.tree import in_eights
from nuno_schemas.fabric import Float, Int


@kernel
def scan(points: Float, corners: Float, face: Int, triangle: Int, weights: Float, distance: Float) -> None:
    """Look at every triangle for each point: see `scan_triangles`."""
    for i in range(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        best, which = math.inf, 0
        for leaf in range(corners.shape[0] // 9):
            best, which = take_nearest(leaf_distances(px, py, pz, corners, leaf), leaf, face, best, which)
        s, t, _ = read_triangle(px, py, pz, which, corners)
        weights[i, 0], weights[i, 1], weights[i, 2] = 1.0 - s - t, s, t
        triangle[i], distance[i] = face[which], math.sqrt(best)


def scan_triangles(points: Float, vertices: Float, faces: Int) -> tuple[Int, Float, Float]:
    """Triangle (n,) nearest to each of points (n, 3) [m], barycentric coordinates (n, 3) in it, and distance (n,) [m].

    For a few points of a mesh that moves: to build the tree of 20,000 triangles takes as long as to look at all of them
    for a thousand points. Of equally near triangles that of the lowest number is taken.
    """
    filled = np.minimum(np.arange(-(-len(faces) // WIDTH) * WIDTH), len(faces) - 1)
    a, b, c = (vertices.take(faces[filled, k], axis=0) for k in range(3))
    corners = in_eights(np.concatenate([a, b - a, c - a], axis=1), 0.0)
    triangle, weights, distance = np.empty(len(points), np.int32), np.empty((len(points), 3)), np.empty(len(points))
    scan(np.ascontiguousarray(points), corners, filled.astype(np.int32), triangle, weights, distance)
    return triangle, weights, distance
