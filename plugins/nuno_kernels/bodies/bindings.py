"""Pinned vertices that move rigidly with a body's frame.

Over an interval of duration T a frame turns at a constant rate about a fixed axis and its origin
moves on a straight line: x = o(s) + R(s) local, v = shift/T + spin/T x (x - o(s)).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_kernels import kernel
from nuno_kernels.bodies.poses import carry, pose_frame, write_interval
from nuno_kernels.step.blocks import Long
from nuno_kernels.terms import Displaced, register
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Float, Int


class Bindings(NamedTuple):
    """b bound vertices and the motion of f frames over one interval.

    vertices (b,) int64, frame (b,) int64, local (b, 3) [m] in the frame. The rest is laid out as
    nuno_kernels.bodies.poses has it: rotation0 (f, 9) and origin0 (f, 3) at the start, spin (f, 3)
    [rad] and shift (f, 3) [m] over the interval, and frames (f, 18): rotation, origin, velocity and
    angular velocity of the frames as last posed.
    """

    vertices: Long
    frame: Long
    local: Float
    rotation0: Float
    origin0: Float
    spin: Float
    shift: Float
    frames: Float


@kernel
def place_bound(bindings: Bindings, x: Float, v: Float, s: float) -> None:
    """Put the bound vertices of x, v (3, n) where they are at fraction s of the interval."""
    for f in range(bindings.frames.shape[0]):
        pose_frame(s, f, bindings.rotation0, bindings.origin0, bindings.spin, bindings.shift, bindings.frames)
    for b in range(bindings.vertices.shape[0]):
        carry(bindings.local, b, bindings.frames, bindings.frame[b], x, v, bindings.vertices[b])


@kernel
def carry_bound(bindings: Bindings, moved: Displaced, s: float) -> None:
    """Displacements of bound vertices, from x to where they are at fraction s."""
    x, u, y = moved.x, moved.u, moved.y
    place_bound(bindings, y, moved.w, s)
    for b in range(bindings.vertices.shape[0]):
        i = bindings.vertices[b]
        for row in range(3):
            u[row, i] = y[row, i] - x[row, i]


def make_bindings(vertices: Int, local: Float, frame: Int) -> Bindings:
    """Bindings of (b,) vertices to frames by number; `set_binding_poses` comes before any use."""
    count = int(frame.max(initial=-1)) + 1
    return Bindings(
        np.ascontiguousarray(vertices, np.int64),
        np.ascontiguousarray(frame, np.int64),
        np.ascontiguousarray(local, np.float64),
        np.zeros((count, 9)),
        np.zeros((count, 3)),
        np.zeros((count, 3)),
        np.zeros((count, 3)),
        np.zeros((count, 18)),
    )


def set_binding_poses(bindings: Bindings, start: Poses, end: Poses) -> None:
    """Write the interval into `bindings`; one without duration stands still at its start."""
    used = bindings.frames.shape[0]
    first, last = (Poses(p.t, p.rotation[:used], p.translation[:used]) for p in (start, end))
    write_interval(bindings, first, last)


register(Bindings, name="bindings", place=place_bound, carry=carry_bound, interval=set_binding_poses)
