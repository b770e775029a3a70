"""Quaternions (w, x, y, z) in arrays (..., 4), and skeletons posed from joint rotations.

Weighed: SciPy's Rotation, of whose products, matrices and interpolations fewer than one in ten has the same bits.
"""

from __future__ import annotations

import numpy as np

from nuno_schemas.bodies import rotation_matrices
from nuno_schemas.fabric import Float, Int
from nuno_schemas.vectors import compose, dot, norm, turn

AXES = np.eye(3)


def ease(s: float) -> float:
    """Rise from 0 to 1 over s in [0, 1], with first and second derivative 0 at both ends."""
    return s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)


def multiply(p: Float, q: Float) -> Float:
    """Return the product p q: first q turns, then p."""
    w0, x0, y0, z0 = (p[..., i] for i in range(4))
    w1, x1, y1, z1 = (q[..., i] for i in range(4))
    w = w0 * w1 - x0 * x1 - y0 * y1 - z0 * z1
    product = np.empty((*np.shape(w), 4))
    product[..., 0] = w
    product[..., 1] = w0 * x1 + x0 * w1 + y0 * z1 - z0 * y1
    product[..., 2] = w0 * y1 - x0 * z1 + y0 * w1 + z0 * x1
    product[..., 3] = w0 * z1 + x0 * y1 - y0 * x1 + z0 * w1
    return product


def invert(q: Float) -> Float:
    """Return the inverse of unit quaternions."""
    return np.asarray(q * np.array([1.0, -1.0, -1.0, -1.0]))


def from_axis_angle(axis: Float, angle: float) -> Float:
    """Return the rotation (4,) by `angle` [rad] about `axis` (3,), which may have any length but 0."""
    half = 0.5 * angle
    return np.concatenate([[np.cos(half)], np.sin(half) * axis / norm(axis)])


def from_euler(angles: Float) -> Float:
    """Return the rotation (4,) by angles[0] about world x, then angles[1] about world y, then angles[2] about world z
    [rad]: R = Rz Ry Rx.
    """
    x, y, z = (from_axis_angle(axis, float(angle)) for axis, angle in zip(AXES, angles, strict=True))
    return multiply(z, multiply(y, x))


def from_matrices(m: Float) -> Float:
    """Return the unit quaternions q (..., 4) of rotation matrices (..., 3, 3).

    4 q q^T is linear in the matrix; its row with the largest diagonal, normalised, is q (Shepperd).
    """
    outer = np.empty((*m.shape[:-2], 4, 4))
    trace = np.trace(m, axis1=-2, axis2=-1)
    outer[..., 0, 0] = 1.0 + trace
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        outer[..., i + 1, i + 1] = 1.0 + 2.0 * m[..., i, i] - trace
        outer[..., 0, i + 1] = outer[..., i + 1, 0] = m[..., k, j] - m[..., j, k]
        outer[..., i + 1, j + 1] = outer[..., j + 1, i + 1] = m[..., i, j] + m[..., j, i]
    row = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(outer, row[..., None, None], axis=-2)[..., 0, :]
    return np.asarray(q / norm(q)[..., None])


def slerp(p: Float, q: Float, s: float | Float) -> Float:
    """Interpolate between unit quaternions p (s = 0) and q (s = 1), (..., 4), the shorter way."""
    cosine = dot(p, q)[..., None]
    q = np.where(cosine < 0.0, -q, q)
    angle = np.arccos(np.minimum(np.abs(cosine), 1.0))
    sine = np.sin(angle)
    near = sine < 1e-6
    safe = np.where(near, 1.0, sine)
    left = np.where(near, 1.0 - s, np.sin((1.0 - s) * angle) / safe)
    right = np.where(near, s, np.sin(s * angle) / safe)
    mixed = left * p + right * q
    return np.asarray(mixed / norm(mixed)[..., None])


def rest_positions(parents: Int, offsets: Float) -> Float:
    """Return joints' positions (j, 3) with all rotations zero [m], the first at its own offset; parents come first."""
    position = offsets.copy()
    for j, parent in enumerate(parents):
        if parent >= 0:
            position[j] += position[parent]
    return position


def pose_skeleton(parents: Int, offsets: Float, local: Float, root: Float) -> tuple[Float, Float]:
    """Return world rotation (j, 4) and translation (j, 3) of joints with `local` rotations (j, 4).

    Parents come before their children; `root` (3,) [m] is where the first joint is.
    """
    matrix, translation = rotation_matrices(local), np.zeros_like(offsets)
    for j, parent in enumerate(parents):
        if parent < 0:
            translation[j] = root
            continue
        translation[j] = translation[parent] + turn(matrix[parent], offsets[j])
        matrix[j] = compose(matrix[parent], matrix[j])
    return from_matrices(matrix), translation
