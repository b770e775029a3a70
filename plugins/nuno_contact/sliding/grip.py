"""Sliding contact for implicit steps: the vertices that they hold on bodies, and the force that is left on them."""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from nuno_contact.sliding.slides import BLOCK, Slides, pose_slides
from nuno_contact.sliding.vertex import PARALLEL, outward, slide
from nuno_geometry.closest_point import closest
from nuno_geometry.poses import Vector, to_frame, turn_in, turn_out
from nuno_geometry.tree import make_room
from nuno_kernels import block_kernel, kernel, parallel_kernel
from nuno_kernels.step.blocks import Long
from nuno_schemas.fabric import Float

# The force that is left on a vertex after the reaction of surfaces and friction: how far cloth is from rest.
#
# On a vertex that touches a body the surface takes the part of the force that points into it, and friction up to mu
# times that of the rest: nuno_contact.sliding.slides does this to a movement, and here to a short one along the force.
# So the force that is left is the share of it by which a vertex at rest would begin to move, whatever grooves and edges
# of the mesh it lies at.

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
    room, tree = make_room(), s.tree
    for body in range(s.root.shape[0]):
        f = s.frame[body]
        for i in range(block * BLOCK, min((block + 1) * BLOCK, x.shape[1])):
            g = (force[0, i], force[1, i], force[2, i])
            size, gap = math.sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2]), s.gap[body, i]
            length = TRIAL * gap
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


# Vertices that an implicit step holds on bodies while it is solved, so that it ends at rest there.
#
# Contact that acts after a step, of which the solver knows nothing, would put the solution back each time. Here a
# vertex that touches has its movement along the surface's normal n prescribed, and all of its movement where it sticks:
# Newton's steps and residuals are projected by I - n n^T, or to nothing (Baraff & Witkin 1998, SIGGRAPH, "Large steps
# in cloth simulation"). The force that is missing in the equation of motion there is the contact's, N along n and t
# along the surface:
#
#     N < 0                    the vertex is released, and held again if it then enters
#     it sticks, |t| > mu N    it slides, against friction mu N along t
#     it slides along t        friction has stopped it: it sticks
#     a free one comes nearer than the gap: it is held there, and sticks
#
# The sets change between solutions only, each way once a step, so that Newton's method meets a smooth equation.
# Friction on a sliding vertex follows N and the movement of the step before, and once N of its own solution where
# it differs by more than MISSED, as when a vertex strikes a body: else the impact's friction would act twice.
#
# Not chosen: a penalty or an augmented Lagrangian within Newton's method. Its active set and the direction of friction
# alternate between iterations, and a sheet on a ball does not converge.

MISSED = 0.5
"""Share of the larger by which friction and mu N may differ in a step."""
RIGID = 1e6
"""Stiffness of a held vertex, as a multiple of its inertia and of the cloth's largest stiffness."""


@block_kernel
def find_touching(x: Float, body: Long, s: Slides, found: Float) -> None:
    """Write, for vertices x (3, n) that body (n,) holds, into found (7, n): position in the body's frame, normal, and
    distance beyond the gap [m].
    """
    room, tree = make_room(), s.tree
    for i in range(x.shape[1]):
        b = body[i]
        if b >= 0:
            p = to_frame(x[0, i], x[1, i], x[2, i], s.frames, s.frame[b])
            near = closest(p, s.nearest[b, i], s.root[b], tree, room)
            n = outward(p, near)
            for c in range(3):
                found[c, i], found[3 + c, i] = p[c], n[c]
            found[6, i] = near.distance - s.gap[b, i]


@block_kernel
def find_entering(x: Float, body: Long, s: Slides, found: Float) -> None:
    """Add the free vertices that a step to x (3, n) brings nearer than the gap to body (n,), and write into found
    (7, n) their position before the step, the normal, and how far they are to go against it [m].
    """
    room, tree = make_room(), s.tree
    for b in range(s.root.shape[0]):
        for i in range(x.shape[1]):
            if body[i] >= 0 or s.mass[i] == 0.0:
                continue
            p, q = to_frame(x[0, i], x[1, i], x[2, i], s.frames, s.frame[b]), s.before[b, :, i]
            m = (p[0] - q[0], p[1] - q[1], p[2] - q[2])
            if s.clear[b, i] - math.sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2]) < s.gap[b, i]:
                near = closest(p, s.nearest[b, i], s.root[b], tree, room)
                if near.distance < s.gap[b, i]:
                    n = outward(p, near)
                    for c in range(3):
                        found[c, i], found[3 + c, i] = q[c], n[c]
                    found[6, i] = near.distance - (n[0] * m[0] + n[1] * m[1] + n[2] * m[2]) - s.gap[b, i]
                    body[i] = b


def rotate(a: Float, rotation: Float, back: bool = False) -> Float:
    """Vectors a (3, n) turned by rotations (n, 3, 3), or back."""
    r = rotation.transpose((2, 1, 0) if back else (1, 2, 0))
    return np.asarray(r[:, 0] * a[0] + r[:, 1] * a[1] + r[:, 2] * a[2])


def dot(a: Float, b: Float) -> Float:
    """(n,) products of vectors (3, n)."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def unit(a: Float) -> Float:
    """Directions of vectors (3, n), 0 for those without length."""
    size = np.sqrt(dot(a, a))
    return np.asarray(a / np.where(size > 0.0, size, 1.0))


class Grip:
    """The vertices, of n, that are held on bodies. In the arrays of a step free ones have normal and force 0.

    body     (n,) the body that holds each vertex after the last step, -1 for free ones: part of the state
    push     (3, n) friction [N] on sliding vertices, in the body's frame; 0 for those that stick: part of the state
    body_now (n,) the body that holds each in the step, or did before it was released
    found    (7, n) see find_touching
    """

    def __init__(self, slides: Slides) -> None:
        n = len(slides.mass)
        self.slides, self.body, self.push = slides, np.full(n, -1, np.int64), np.zeros((3, n))

    def begin(self, x: Float, start: float, end: float) -> None:
        """Find where vertices x (3, n) are held at the start of a step between two fractions of the interval."""
        pose_slides(start, self.slides)
        self.start, self.end, self.body_now = start, end, np.where(self.slides.mass > 0.0, self.body, -1)
        self.friction, self.found = self.push.copy(), np.zeros((7, x.shape[1]))
        find_touching(x, self.body_now, self.slides, self.found)
        self.free, self.sticks = self.body_now < 0, (self.mu > 0.0) & ~self.push.any(axis=0)
        self.slipped, self.returned, self.corrected = np.zeros((3, x.shape[1]), np.bool_)

    @property
    def mu(self) -> Float:
        """(n,) Coulomb coefficient of the body that holds each vertex."""
        return self.slides.friction[self.body_now]

    def pose(self, at: float) -> None:
        """Find where held vertices go by a fraction of the interval, their normals and friction, in the world."""
        pose_slides(at, self.slides)
        frames = self.slides.frames[self.slides.frame[self.body_now]]
        self.rotation = frames[:, :9].reshape(-1, 3, 3)
        self.carried = rotate(self.found[:3], self.rotation) + frames[:, 9:12].T
        self.n = rotate(self.found[3:6], self.rotation)
        self.goal = self.carried - (at - self.start) / (self.end - self.start) * self.found[6] * self.n
        self.rub = np.where(self.sticks | self.free, 0.0, rotate(self.friction, self.rotation))

    def filter(self, a: Float) -> None:
        """Remove the prescribed part of vectors a (3, n), in place."""
        a[...] = np.where(self.free, a, np.where(self.sticks, 0.0, a - dot(a, self.n) * self.n))

    def lead(self, x: Float, v: Float, span: float) -> None:
        """Let velocities v (3, n) bring held vertices from x (3, n) to their goal within `span` [s], in place."""
        change = (self.goal - x) / span - v
        left = change.copy()
        self.filter(left)
        v += change - left

    def enter(self, x: Float, v: Float, span: float) -> None:
        """Lead a step's start likewise, by an impulse that is a part of the contact's force."""
        before = v.copy()
        self.pose(self.end)
        self.lead(x, v, span)
        self.impulse = self.slides.mass * (v - before) / span

    def stiffen(self, diagonal: Float, stiffness: float) -> None:
        """Add to the diagonal blocks (6, n) of a matrix what keeps its solution from moving held vertices."""
        rigid = np.where(self.free, 0.0, RIGID * (diagonal[0] + stiffness))
        for row, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
            diagonal[row] += rigid * np.where(self.sticks, float(i == j), self.n[i] * self.n[j])

    def force(self, missing: Float) -> tuple[Float, Float]:
        """N (n,) and t (3, n) [N] of the contact, from the force that is missing (3, n) without it."""
        total = self.impulse - missing
        normal = dot(total, self.n)
        return normal, total - normal * self.n

    def along_surface(self, x: Float) -> Float:
        """(3, n) how far held vertices have moved along the surface [m]."""
        moved = x - self.carried
        return np.asarray(moved - dot(moved, self.n) * self.n)

    def revise(self, missing: Float, x: Float) -> bool:
        """Release and hold vertices as the solution x (3, n) requires; whether the step is to be solved anew."""
        normal, t = self.force(missing)
        limit = self.mu * np.maximum(normal, 0.0)
        stops = ~self.sticks & (dot(self.along_surface(x), self.rub) > 0.0)
        slips = self.sticks & ~self.free & ~self.slipped & (dot(t, t) > limit * limit)
        leaves = ~self.free & ~self.returned & (normal < 0.0)
        size = np.sqrt(dot(self.friction, self.friction))
        missed = np.abs(limit - size) > MISSED * np.maximum(limit, size)
        missed &= ~(self.sticks | self.free | self.slipped | self.corrected | stops | leaves)
        returns = self.free & (dot(x - self.goal, self.n) < 0.0)
        self.friction[:, slips] = rotate(limit * unit(t), self.rotation, back=True)[:, slips]
        self.friction[:, missed] *= (limit / np.where(missed, size, 1.0))[missed]
        self.slipped |= slips
        self.returned |= returns
        self.corrected |= missed
        before = self.body_now.copy()
        find_entering(x, self.body_now, self.slides, self.found)
        enters = self.body_now != before
        self.sticks = (self.sticks & ~slips & ~enters) | stops | (enters & (self.mu > 0.0))
        self.free = (self.free & ~returns & ~enters) | leaves
        return bool((stops | slips | missed | leaves | returns | enters).any())

    def finish(self, missing: Float, x: Float, span: float) -> None:
        """Keep for the next step what the solution x (3, n) of this one, of `span` [s], has come to."""
        normal, t = self.force(missing)
        limit = self.mu * np.maximum(normal, 0.0)
        slips = self.sticks & (dot(t, t) > limit * limit)
        way = np.where(self.sticks, np.where(slips, unit(t), 0.0), -unit(self.along_surface(x)))
        stays = ~self.free & (normal >= 0.0)
        self.body[:] = np.where(stays, self.body_now, -1)
        self.push[:] = np.where(stays, rotate(limit * way, self.rotation, back=True), 0.0)
        force = self.rub + np.where(self.free, 0.0, normal * self.n + np.where(self.sticks, t, 0.0))
        np.subtract.at(self.slides.impulse[0], self.body_now, span * force.T)

    def count(self) -> None:
        """Count held vertices as touching, except those that the contact at the step's end has counted."""
        held = np.flatnonzero(self.body >= 0)
        self.slides.tally[0, 0] += int((self.slides.planes[self.body[held], 6, held] == 0.0).sum())
