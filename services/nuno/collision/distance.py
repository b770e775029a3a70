"""How deep points lie inside bodies, to measure what the contact force achieved.

Written apart from the kernel that computes the force, in another way (all points against one
primitive at a time, in the primitive's own frame), so that a mistake there shows up here.
"""

from __future__ import annotations

import numpy as np

from nuno_schemas.bodies import BOX, CAPSULE, PLANE, Geometry, Poses, rotation_matrices
from nuno_schemas.fabric import Float


def signed_distance(points: Float, geometry: Geometry, poses: Poses) -> Float:
    """(n,) distance [m] of (n, 3) points to the union of all bodies, negative inside.

    Points that are not finite, as in the last frame of a diverged run, are outside of everything.
    """
    nearest = np.full(len(points), np.inf)
    finite = np.asarray(np.isfinite(points).all(axis=1))
    points = np.where(finite[:, None], points, 0.0)
    turns = rotation_matrices(poses.rotation)
    for i, frame in enumerate(geometry.frame):
        local = (points - poses.translation[frame]) @ turns[frame]
        nearest = np.minimum(
            nearest, _primitive(local, int(geometry.kind[i]), geometry.a[i], geometry.b[i], float(geometry.radius[i]))
        )
    return np.where(finite, nearest, np.inf)


def _primitive(p: Float, kind: int, a: Float, b: Float, radius: float) -> Float:
    if kind == CAPSULE:
        axis = b - a
        length = float(axis @ axis)
        along = np.clip((p - a) @ axis / length, 0.0, 1.0) if length > 0.0 else np.zeros(len(p))
        return np.asarray(np.linalg.norm(p - a - along[:, None] * axis, axis=1) - radius)
    if kind == PLANE:
        return np.asarray((p - a) @ b)
    if kind == BOX:
        q = np.abs(p - a) - b
        outside = np.linalg.norm(np.maximum(q, 0.0), axis=1)
        return np.asarray(outside + np.minimum(q.max(axis=1), 0.0))
    raise ValueError(f"primitive kind {kind}")
