"""Poses of the bodies' frames within a frame of animation, and their velocities.

Over an interval of duration T a frame turns by the rotation vector `spin` (world axes) and moves
by `shift`, both at constant rate: R(s) = exp(s spin) R(0), o(s) = o(0) + s shift. This is the slerp
of the two ends with the linear path of the origin, and a point p fixed to the frame has exactly
the velocity shift/T + (spin/T) x (p - o(s)).
"""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np

from nuno_kernels import forced_inline, kernel
from nuno_kernels.lanes import cross, dot, plus, times
from nuno_schemas.bodies import Poses, rotation_matrices
from nuno_schemas.fabric import Float

Index = int | np.uint64
Vector = tuple[float, float, float]


@forced_inline
def row_at(x: Float, i: Index) -> Vector:
    """Return row i of x (n, 3)."""
    return x[i, 0], x[i, 1], x[i, 2]


@forced_inline
def vector(a: Float) -> Vector:
    """Return an array (3,) as a vector."""
    return a[0], a[1], a[2]


@kernel
def blend(weights: Any, rows: Float, corners: Any) -> Vector:
    """Return the mean of rows of (n, 3), those of three corners, by weights."""
    first, second = times(weights[0], row_at(rows, corners[0])), times(weights[1], row_at(rows, corners[1]))
    return plus(plus(first, second), times(weights[2], row_at(rows, corners[2])))


class Frames(Protocol):
    """Arrays of f frames and their motion over an interval.

    rotation0 (f, 9) and origin0 (f, 3) [m] at the start, spin (f, 3) [rad], shift (f, 3) [m] over all of it; frames
    (f, 18): rotation, origin, velocity [m/s] and angular velocity [rad/s] as they are at the moment.
    """

    @property
    def rotation0(self) -> Float: ...
    @property
    def origin0(self) -> Float: ...
    @property
    def spin(self) -> Float: ...
    @property
    def shift(self) -> Float: ...
    @property
    def frames(self) -> Float: ...


def rotation_between(q0: Float, q1: Float) -> Float:
    """Return rotation vectors (f, 3) [rad], world axes, of the shorter way from q0 to q1 (f, 4)."""
    w0, v0 = q0[:, :1], -q0[:, 1:]
    w1, v1 = q1[:, :1], q1[:, 1:]
    w = w1 * w0 - np.sum(v1 * v0, axis=1, keepdims=True)
    v = w1 * v0 + w0 * v1 + np.cross(v1, v0)
    v = np.where(w < 0.0, -v, v)
    sine = np.linalg.norm(v, axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, np.abs(w))
    return np.asarray(v * np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 2.0))


def write_interval(moved: Frames, poses0: Poses, poses1: Poses) -> None:
    """Write the interval from poses0.t to poses1.t in place, of as many frames as there is room for; one without
    duration stands still at its start.
    """
    duration, used = poses1.t - poses0.t, len(moved.frames)
    poses0, poses1 = (Poses(p.t, p.rotation[:used], p.translation[:used]) for p in (poses0, poses1))
    moving = duration > 0.0
    moved.rotation0[:] = rotation_matrices(poses0.rotation).reshape(-1, 9)
    moved.origin0[:] = poses0.translation
    moved.spin[:] = rotation_between(poses0.rotation, poses1.rotation) if moving else 0.0
    moved.shift[:] = poses1.translation - poses0.translation if moving else 0.0
    moved.frames[:, 12:15] = moved.shift / duration if moving else 0.0
    moved.frames[:, 15:18] = moved.spin / duration if moving else 0.0


@kernel
def pose_frame(s: float, f: int, rotation0: Float, origin0: Float, spin: Float, shift: Float, frames: Float) -> None:
    """Fill rotation and origin of frames[f]: exp(s spin) rotation0 by Rodrigues' formula."""
    turn = row_at(spin, f)
    angle = math.sqrt(dot(turn, turn))
    axis = times(1.0 / angle if angle > 0.0 else 0.0, turn)
    sine, rest = math.sin(s * angle), 2.0 * math.sin(0.5 * s * angle) ** 2
    for c in range(3):
        m = rotation0[f, c], rotation0[f, 3 + c], rotation0[f, 6 + c]
        across = cross(axis, m)
        turned = plus(plus(m, times(sine, across)), times(rest, cross(axis, across)))
        frames[f, c], frames[f, 3 + c], frames[f, 6 + c] = turned
        frames[f, 9 + c] = origin0[f, c] + s * shift[f, c]


@forced_inline
def turn_in(v: Vector, frames: Float, f: Index) -> tuple[float, float, float]:
    """Return a vector of the world in the axes of frame f."""
    return (
        frames[f, 0] * v[0] + frames[f, 3] * v[1] + frames[f, 6] * v[2],
        frames[f, 1] * v[0] + frames[f, 4] * v[1] + frames[f, 7] * v[2],
        frames[f, 2] * v[0] + frames[f, 5] * v[1] + frames[f, 8] * v[2],
    )


@forced_inline
def turn_out(v: Vector, frames: Float, f: Index) -> tuple[float, float, float]:
    """Return a vector in the axes of frame f in those of the world."""
    return (
        frames[f, 0] * v[0] + frames[f, 1] * v[1] + frames[f, 2] * v[2],
        frames[f, 3] * v[0] + frames[f, 4] * v[1] + frames[f, 5] * v[2],
        frames[f, 6] * v[0] + frames[f, 7] * v[1] + frames[f, 8] * v[2],
    )


@forced_inline
def carry(local: Float, b: Index, frames: Float, f: Index, x: Float, v: Float, p: Index) -> None:
    """Set column p of x, v (3, n) to place b of local (b, 3), fixed to frame f, as posed at present."""
    r, spin = turn_out(row_at(local, b), frames, f), (frames[f, 15], frames[f, 16], frames[f, 17])
    x[0, p], x[1, p], x[2, p] = plus((frames[f, 9], frames[f, 10], frames[f, 11]), r)
    v[0, p], v[1, p], v[2, p] = plus((frames[f, 12], frames[f, 13], frames[f, 14]), cross(spin, r))


@forced_inline
def to_frame(px: float, py: float, pz: float, frames: Float, f: Index) -> tuple[float, float, float]:
    """Return a place in the world in the axes of frame f, from its origin."""
    return turn_in((px - frames[f, 9], py - frames[f, 10], pz - frames[f, 11]), frames, f)
