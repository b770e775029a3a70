"""Pinned vertices that move rigidly with a body's frame, or with its skin.

Over an interval of duration T a frame turns at a constant rate about a fixed axis and its origin moves on a straight
line: x = o(s) + R(s) local, v = shift/T + spin/T x (x - o(s)). A vertex on a skin moves as the skin's own vertices do:
in a straight line from where it is at the interval's start to where it is at its end.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from nuno_geometry.poses import carry, pose_frame, write_interval
from nuno_geometry.skinning import bend_skin
from nuno_kernels import kernel
from nuno_kernels.step.blocks import Long
from nuno_kernels.terms import Displaced, register
from nuno_schemas.bodies import Poses, Skin, join_skins
from nuno_schemas.fabric import Float, Int
from nuno_schemas.system import Carried


class Bindings(NamedTuple):
    """b bound vertices and the motion of f frames over one interval.

    vertices (b,) int64, frame (b,) int64, local (b, 3) [m] in the frame, or as the skin is bound. Those from number
    b - s on go with a skin: from `begin` to `end` (s, 3) [m]; velocities are the way times `rate` (1,). Its joint,
    weight (s, k) and place (e, 3) are as in nuno_schemas.bodies.Skin, carrier (e,) its frames. The rest is laid out as
    nuno_geometry.poses has it: rotation0 (f, 9) and origin0 (f, 3) at the start, spin (f, 3)
    [rad] and shift (f, 3) [m] over the interval, and frames (f, 18): rotation, origin, velocity and
    angular velocity of the frames as last posed.
    """

    vertices: Long
    frame: Long
    local: Float
    begin: Float
    end: Float
    rate: Float
    joint: Int
    weight: Float
    place: Float
    carrier: Int
    rotation0: Float
    origin0: Float
    spin: Float
    shift: Float
    frames: Float


@kernel
def place_bound(bindings: Bindings, x: Float, v: Float, s: float) -> None:
    """Place the bound vertices of x, v (3, n) at fraction s of the interval."""
    for f in range(bindings.frames.shape[0]):
        pose_frame(s, f, bindings.rotation0, bindings.origin0, bindings.spin, bindings.shift, bindings.frames)
    begin, end, rigid = bindings.begin, bindings.end, bindings.vertices.shape[0] - bindings.begin.shape[0]
    for b in range(rigid):
        carry(bindings.local, b, bindings.frames, bindings.frame[b], x, v, bindings.vertices[b])
    for b in range(begin.shape[0]):
        i = bindings.vertices[rigid + b]
        for row in range(3):
            x[row, i] = (1.0 - s) * begin[b, row] + s * end[b, row]
            v[row, i] = bindings.rate[0] * (end[b, row] - begin[b, row])


@kernel
def carry_bound(bindings: Bindings, moved: Displaced, s: float) -> None:
    """Set the displacements of bound vertices from x to fraction s."""
    x, u, y = moved.x, moved.u, moved.y
    place_bound(bindings, y, moved.w, s)
    for b in range(bindings.vertices.shape[0]):
        i = bindings.vertices[b]
        for row in range(3):
            u[row, i] = y[row, i] - x[row, i]


def make_bindings(carried: Sequence[Carried]) -> Bindings:
    """Return the bindings of vertices on frames and skins; `set_binding_poses` comes before any use."""
    ordered = sorted(carried, key=lambda one: one.skin is not None)
    vertices, local, frame = (
        np.concatenate([np.asarray(getattr(one, name)) for one in ordered]) for name in ("vertices", "local", "frame")
    )
    skins = [(one.skin, int(one.frame[0])) for one in ordered if one.skin is not None and len(one.vertices)]
    skin = join_skins([bound for bound, _ in skins])
    carrier = [first + np.arange(len(bound.place)) for bound, first in skins]
    count = max(int(frame.max(initial=-1)), *(int(bound[-1]) for bound in carrier), -1) + 1
    return Bindings(
        np.ascontiguousarray(vertices, np.int64),
        np.ascontiguousarray(frame, np.int64),
        np.ascontiguousarray(local, np.float64),
        np.zeros((len(skin.joint), 3)),
        np.zeros((len(skin.joint), 3)),
        np.zeros(1),
        np.ascontiguousarray(skin.joint, np.int32),
        np.ascontiguousarray(skin.weight, np.float64),
        np.ascontiguousarray(skin.place, np.float64),
        np.concatenate([np.zeros(0, np.int32), *carrier]).astype(np.int32),
        *(np.zeros((count, width)) for width in (9, 3, 3, 3, 18)),
    )


def set_binding_poses(bindings: Bindings, start: Poses, end: Poses) -> None:
    """Write the interval into `bindings`; one without duration stands still at its start."""
    write_interval(bindings, start, end)
    if len(bindings.joint):
        skin, moving = Skin(bindings.place, bindings.joint, bindings.weight), end.t > start.t
        bound = bindings.local[len(bindings.local) - len(bindings.joint) :]
        for poses, to in ((start, bindings.begin), (end if moving else start, bindings.end)):
            to[:] = bend_skin(skin, bound, poses.rotation[bindings.carrier], poses.translation[bindings.carrier])
        bindings.rate[0] = 1.0 / (end.t - start.t) if moving else 0.0


register(Bindings, "bindings", place=place_bound, interval=set_binding_poses, carry=carry_bound)
