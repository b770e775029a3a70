"""Quaternions (w, x, y, z) in arrays (..., 4), and skeletons posed from joint rotations."""

from __future__ import annotations

import numpy as np
from nuno_schemas.bodies import rotation_matrices
from nuno_schemas.fabric import Float, Int

AXES = np.eye(3)


def multiply(p: Float, q: Float) -> Float:
    """Product p q: first q turns, then p."""
    w0, x0, y0, z0 = np.moveaxis(p, -1, 0)
    w1, x1, y1, z1 = np.moveaxis(q, -1, 0)
    return np.stack(
        [
            w0 * w1 - x0 * x1 - y0 * y1 - z0 * z1,
            w0 * x1 + x0 * w1 + y0 * z1 - z0 * y1,
            w0 * y1 - x0 * z1 + y0 * w1 + z0 * x1,
            w0 * z1 + x0 * y1 - y0 * x1 + z0 * w1,
        ],
        axis=-1,
    )


def from_axis_angle(axis: Float, angle: float) -> Float:
    """(4,) turn by `angle` [rad] about `axis` (3,), which may have any length but 0."""
    half = 0.5 * angle
    return np.concatenate([[np.cos(half)], np.sin(half) * axis / np.linalg.norm(axis)])


def from_euler(angles: Float) -> Float:
    """(4,) turn by angles[0] about world x, then angles[1] about world y, then angles[2] about
    world z [rad]: R = Rz Ry Rx."""
    x, y, z = (from_axis_angle(axis, float(angle)) for axis, angle in zip(AXES, angles, strict=True))
    return multiply(z, multiply(y, x))


def from_matrix(m: Float) -> Float:
    """(4,) unit quaternion of a rotation matrix (3, 3), from its largest component (Shepperd)."""
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    square = np.array([trace, m[0, 0], m[1, 1], m[2, 2]])
    k = int(np.argmax(square))
    if k == 0:
        q = np.array([1.0 + trace, m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    elif k == 1:
        q = np.array([m[2, 1] - m[1, 2], 1.0 + 2 * m[0, 0] - trace, m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]])
    elif k == 2:
        q = np.array([m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], 1.0 + 2 * m[1, 1] - trace, m[1, 2] + m[2, 1]])
    else:
        q = np.array([m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], 1.0 + 2 * m[2, 2] - trace])
    unit: Float = q / np.linalg.norm(q)
    return unit


def slerp(p: Float, q: Float, s: float) -> Float:
    """Between unit quaternions p (s = 0) and q (s = 1), (..., 4), the shorter way."""
    dot = np.sum(p * q, axis=-1, keepdims=True)
    q = np.where(dot < 0.0, -q, q)
    angle = np.arccos(np.minimum(np.abs(dot), 1.0))
    sine = np.sin(angle)
    near = sine < 1e-6
    safe = np.where(near, 1.0, sine)
    mixed = np.where(near, 1.0 - s, np.sin((1.0 - s) * angle) / safe) * p + np.where(near, s, np.sin(s * angle) / safe) * q
    unit: Float = mixed / np.linalg.norm(mixed, axis=-1, keepdims=True)
    return unit


def pose_skeleton(parents: Int, offsets: Float, local: Float, root: Float) -> tuple[Float, Float]:
    """World rotation (j, 4) and translation (j, 3) of joints with `local` rotations (j, 4).

    Parents come before their children; `root` (3,) [m] is where the first joint is.
    """
    rotation, translation = local.copy(), np.zeros_like(offsets)
    for j, parent in enumerate(parents):
        if parent < 0:
            translation[j] = root
            continue
        rotation[j] = multiply(rotation[parent], local[j])
        translation[j] = translation[parent] + rotation_matrices(rotation[parent : parent + 1])[0] @ offsets[j]
    return rotation, translation
