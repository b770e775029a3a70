"""Primitives of bodies posed at a moment of a frame, by the frames that carry them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from nuno_contact.penalty.distance import BOX, CAPSULE, FIELD
from nuno_kernels import block_kernel, kernel
from nuno_kernels.bodies.poses import pose_frame, write_interval
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Float

if TYPE_CHECKING:
    from nuno_contact.penalty.contact import Contact

SHORTEST = 1e-300
"""A capsule with at most this squared length [m^2] is a sphere: the reciprocal would overflow."""


def set_poses(contact: Contact, poses0: Poses, poses1: Poses) -> None:
    """Write the interval into `contact`, in place; see `write_interval`."""
    write_interval(contact, poses0, poses1)
    contact.posed_at[0] = np.nan


@kernel
def pose_primitive(p: int, kind: int, f: int, a: Float, b: Float, radius: Float, frames: Float, posed: Float) -> None:
    """Fill row p of `posed` (see nuno_contact.penalty.distance) from the primitive in its frame."""
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


@block_kernel
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
