"""The force that is left on a vertex after the reaction of surfaces and friction: how far cloth is from rest.

On a vertex that touches a body the surface takes the part of the force that points into it, and friction up to mu times
that of the rest: nuno_contact.sliding.slides does this to a movement, and here to a short one along the force. So the
force that is left is the share of it by which a vertex at rest would begin to move, whatever grooves and edges of the
mesh it lies at.
"""

from __future__ import annotations

import math

from numba import prange

from nuno_contact.sliding.planes import PARALLEL
from nuno_contact.sliding.slides import BLOCK, Slides, pose_slides, tree_of
from nuno_contact.sliding.vertex import slide
from nuno_geometry.closest_point import closest
from nuno_geometry.poses import Vector, to_frame, turn_in, turn_out
from nuno_geometry.tree import make_room
from nuno_kernels import block_kernel, kernel, parallel_kernel
from nuno_schemas.fabric import Float

TRIAL = 1e-3
"""length of the trial movement, as a share of the gap: it turns by no more than that round an edge"""
NEAR = 1.02
"""A vertex within so many gaps touches. A step that ends at an edge ends a little beyond the gap, by half the square of
the angle that the surface's normal turned by on the way."""


@kernel
def along_planes(m: Vector, n1: Vector, n2: Vector, planes: int) -> Vector:
    """Return the part of a movement along one plane, or along the line where two meet."""
    if planes == 2:
        x, y, z = n1[1] * n2[2] - n1[2] * n2[1], n1[2] * n2[0] - n1[0] * n2[2], n1[0] * n2[1] - n1[1] * n2[0]
        square = x * x + y * y + z * z
        if square > PARALLEL:
            share = (m[0] * x + m[1] * y + m[2] * z) / square
            return share * x, share * y, share * z
    share = m[0] * n1[0] + m[1] * n1[1] + m[2] * n1[2]
    return m[0] - share * n1[0], m[1] - share * n1[1], m[2] - share * n1[2]


@block_kernel
def hold_block(block: int, x: Float, force: Float, s: Slides) -> None:
    """Hold the forces (3, n) on a block's vertices off all bodies, in place."""
    room, tree = make_room(), tree_of(s)
    for body in range(s.root.shape[0]):
        f, gap = s.frame[body], s.gap[body]
        length = TRIAL * gap
        for i in range(block * BLOCK, min((block + 1) * BLOCK, x.shape[1])):
            g = (force[0, i], force[1, i], force[2, i])
            size = math.sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2])
            if s.mass[i] == 0.0 or s.clear[body, i] > NEAR * gap or not 0.0 < size < math.inf:
                continue
            px, py, pz = to_frame(x[0, i], x[1, i], x[2, i], s.frames, f)
            g = turn_in(g, s.frames, f)
            m = (length / size * g[0], length / size * g[1], length / size * g[2])
            distance = closest((px, py, pz), s.nearest[body, i], s.root[body], tree, room).distance
            if distance > NEAR * gap:
                continue
            # From where it is: moving it back to the gap takes no force, and makes no friction.
            clear, near, root, mu = s.clear[body, i], s.nearest[body, i], s.root[body], s.friction[body]
            end = slide((px, py, pz), m, clear, near, root, distance, mu, tree, room)
            if end.planes == 0:
                continue
            g = turn_out(along_planes(end.made, end.n1, end.n2, end.planes), s.frames, f)
            for c in range(3):
                force[c, i] = size / length * g[c]


@parallel_kernel
def hold_forces(s: Slides, x: Float, force: Float) -> None:
    """Hold the forces (3, n) on vertices x (3, n) off the bodies as they are at the end of the interval, in place."""
    pose_slides(1.0, s)
    for block in prange(s.tally.shape[0]):
        hold_block(block, x, force, s)
