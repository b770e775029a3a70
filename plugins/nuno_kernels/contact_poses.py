"""Poses of the bodies' frames within a frame of animation, and their velocities.

Over an interval of duration T a frame turns by the rotation vector `spin` (world axes) and moves
by `shift`, both at constant rate: R(s) = exp(s spin) R(0), o(s) = o(0) + s shift. This is the slerp
of the two ends with the linear path of the origin, and a point p fixed to the frame has exactly
the velocity shift/T + (spin/T) x (p - o(s)).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from nuno_kernels import kernel
from nuno_kernels.contact_distance import BOX, CAPSULE, FIELD
from nuno_schemas.bodies import Poses, rotation_matrices
from nuno_schemas.fabric import Float

SHORTEST = 1e-300
"""A capsule whose squared length [m^2] is no more is a sphere: the reciprocal would overflow."""

if TYPE_CHECKING:
    from nuno_kernels.bindings import Bindings
    from nuno_kernels.contact import Contact
    from nuno_kernels.slides import Slides


def rotation_between(q0: Float, q1: Float) -> Float:
    """(f, 3) rotation vectors [rad], world axes, of the shorter way from q0 to q1 (f, 4)."""
    w0, v0 = q0[:, :1], -q0[:, 1:]
    w1, v1 = q1[:, :1], q1[:, 1:]
    w = w1 * w0 - np.sum(v1 * v0, axis=1, keepdims=True)
    v = w1 * v0 + w0 * v1 + np.cross(v1, v0)
    v = np.where(w < 0.0, -v, v)
    sine = np.linalg.norm(v, axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, np.abs(w))
    turn: Float = v * np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 2.0)
    return turn


def write_interval(moved: Contact | Slides | Bindings, poses0: Poses, poses1: Poses) -> None:
    """Write the interval from poses0.t to poses1.t in place; one without duration stands still at its start."""
    duration = poses1.t - poses0.t
    moving = duration > 0.0
    moved.rotation0[:] = rotation_matrices(poses0.rotation).reshape(-1, 9)
    moved.origin0[:] = poses0.translation
    moved.spin[:] = rotation_between(poses0.rotation, poses1.rotation) if moving else 0.0
    moved.shift[:] = poses1.translation - poses0.translation if moving else 0.0
    moved.frames[:, 12:15] = moved.shift / duration if moving else 0.0
    moved.frames[:, 15:18] = moved.spin / duration if moving else 0.0


def set_poses(contact: Contact, poses0: Poses, poses1: Poses) -> None:
    """Write the interval into `contact`, in place; see `write_interval`."""
    write_interval(contact, poses0, poses1)
    contact.posed_at[0] = np.nan


@kernel
def pose_frame(s: float, f: int, rotation0: Float, origin0: Float, spin: Float, shift: Float, frames: Float) -> None:
    """Fill rotation and origin of frames[f]: exp(s spin) rotation0 by Rodrigues' formula."""
    angle = math.sqrt(spin[f, 0] * spin[f, 0] + spin[f, 1] * spin[f, 1] + spin[f, 2] * spin[f, 2])
    scale = 1.0 / angle if angle > 0.0 else 0.0
    kx, ky, kz = spin[f, 0] * scale, spin[f, 1] * scale, spin[f, 2] * scale
    sine, rest = math.sin(s * angle), 2.0 * math.sin(0.5 * s * angle) ** 2
    for c in range(3):
        mx, my, mz = rotation0[f, c], rotation0[f, 3 + c], rotation0[f, 6 + c]
        cx, cy, cz = ky * mz - kz * my, kz * mx - kx * mz, kx * my - ky * mx
        frames[f, c] = mx + sine * cx + rest * (ky * cz - kz * cy)
        frames[f, 3 + c] = my + sine * cy + rest * (kz * cx - kx * cz)
        frames[f, 6 + c] = mz + sine * cz + rest * (kx * cy - ky * cx)
        frames[f, 9 + c] = origin0[f, c] + s * shift[f, c]


@kernel
def pose_primitive(p: int, kind: int, f: int, a: Float, b: Float, radius: Float, frames: Float, posed: Float) -> None:
    """Fill row p of `posed` (see contact_distance) from the primitive in its frame."""
    square = 0.0
    for c in range(3):
        m0, m1, m2 = frames[f, 3 * c], frames[f, 3 * c + 1], frames[f, 3 * c + 2]
        start = frames[f, 9 + c] + m0 * a[p, 0] + m1 * a[p, 1] + m2 * a[p, 2]
        if kind == CAPSULE:
            along = m0 * (b[p, 0] - a[p, 0]) + m1 * (b[p, 1] - a[p, 1]) + m2 * (b[p, 2] - a[p, 2])
            square += along * along
            low, high = min(start, start + along) - radius[p], max(start, start + along) + radius[p]
        elif kind in (BOX, FIELD):
            along = b[p, c]
            size = abs(m0) * b[p, 0] + abs(m1) * b[p, 1] + abs(m2) * b[p, 2]
            low, high = start - size, start + size
        else:
            along = m0 * b[p, 0] + m1 * b[p, 1] + m2 * b[p, 2]
            low, high = -math.inf, math.inf
        posed[p, c], posed[p, 3 + c], posed[p, 8 + c], posed[p, 11 + c] = start, along, low, high
    posed[p, 6] = 1.0 / square if square > SHORTEST else 0.0
    posed[p, 7] = radius[p]


@kernel
def pose_bodies(s: float, contact: Contact) -> None:
    """Pose all frames and primitives at fraction s in [0, 1] of the interval.

    A step's end is the next one's start: where s is what it was, they stand there already.
    """
    if contact.posed_at[0] == s:
        return
    contact.posed_at[0] = s
    for f in range(contact.frames.shape[0]):
        pose_frame(s, f, contact.rotation0, contact.origin0, contact.spin, contact.shift, contact.frames)
    for p in range(contact.posed.shape[0]):
        f = contact.frame[p]
        pose_primitive(p, contact.kind[p], f, contact.a, contact.b, contact.radius, contact.frames, contact.posed)
