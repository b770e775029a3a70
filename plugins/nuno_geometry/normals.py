"""Pseudonormals of a closed mesh: which side of it a point lies on.

A point whose closest point on the mesh is x lies outside just if (p - x) . n > 0, with n the face's normal
inside of a triangle, the sum of both faces' normals on an edge, and the sum of the faces' normals weighted
by their angles at a vertex. J. A. Baerentzen, H. Aanaes: Signed distance computation using the angle weighted
pseudonormal. IEEE Transactions on Visualization and Computer Graphics 11(3), 2005.
"""

from __future__ import annotations

import math

import numpy as np

from nuno_geometry.poses import blend, row_at
from nuno_kernels import kernel
from nuno_kernels.lanes import dot, over
from nuno_schemas.fabric import Float, Int
from nuno_schemas.vectors import unit_rows


def face_normals(x: Float, faces: Int) -> Float:
    """Return unit normals (f, 3) of triangles (f, 3); zero for a triangle without area."""
    a, b, c = (x[faces[:, k]] for k in range(3))
    return unit_rows(np.cross(b - a, c - a))


def edge_numbers(faces: Int) -> tuple[Int, Int]:
    """Return edge numbers (f, 3) int32 of triangles' sides a-b, b-c, c-a, and edges' vertices (e, 2), lower first."""
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1).astype(np.int64)
    span = int(faces.max(initial=0)) + 1
    keys, numbers = np.unique(ends[:, 0] * span + ends[:, 1], return_inverse=True)
    pairs = np.stack(np.divmod(keys, span), axis=1).astype(np.int32)
    return numbers.reshape(-1, 3).astype(np.int32), pairs


def edge_normals(x: Float, faces: Int, numbers: Int, count: int) -> Float:
    """Return the sums (e, 3) of the unit normals of the faces at each of `count` edges."""
    normals = np.repeat(face_normals(x, faces), 3, axis=0)
    flat = numbers.reshape(-1)
    return np.stack([np.bincount(flat, normals[:, k], count) for k in range(3)], axis=1)


def vertex_normals(x: Float, faces: Int) -> Float:
    """Return the sums (n, 3) of the faces' unit normals, weighted by the faces' angles at the vertex."""
    corner = x[faces]
    forward, back = np.roll(corner, -1, axis=1) - corner, np.roll(corner, 1, axis=1) - corner
    sine = np.linalg.norm(np.cross(forward, back), axis=-1)
    angle = np.arctan2(sine, np.einsum("fij,fij->fi", forward, back))
    weighted = (angle[:, :, None] * face_normals(x, faces)[:, None]).reshape(-1, 3)
    flat = faces.reshape(-1)
    return np.stack([np.bincount(flat, weighted[:, k], len(x)) for k in range(3)], axis=1)


@kernel
def blend_normals(normals: Float, faces: Int, face: Int, weights: Float, out: Float) -> None:
    """Write unit normals (m, 3) at barycentric weights (m, 3) in triangles face (m,), from vertices' (n, 3)."""
    for i in range(face.shape[0]):
        corners = faces[face[i], 0], faces[face[i], 1], faces[face[i], 2]
        n = blend(row_at(weights, i), normals, corners)
        size = math.sqrt(dot(n, n))
        out[i, 0], out[i, 1], out[i, 2] = over(n, size) if size > 0.0 else n
