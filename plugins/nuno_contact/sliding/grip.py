"""Vertices that an implicit step holds on bodies while it is solved, so that it ends at rest there.

A solver whose velocity knows nothing of the contact is put back by every step. Here a vertex that touches has its
movement along the surface's normal n prescribed, and all of its movement where it sticks: Newton's steps and residuals
are projected by I - n n^T, or to nothing (Baraff & Witkin 1998, SIGGRAPH, "Large steps in cloth simulation"). What is
missing in the equation of motion there is the force of the contact, N along n and t along the surface:

    N < 0                    the vertex is let go, and held again if it then enters
    it sticks, |t| > mu N    it slides, against friction mu N along t
    it slides along t        friction has stopped it: it sticks
    a free one comes nearer than the gap: it is held there, and sticks

Sets change between solutions only, each way once a step, so that Newton's method meets a smooth equation. Friction on
what slides follows N and the movement of the step before.

Not chosen: a penalty or an augmented Lagrangian within Newton's method. Its active set and the direction of friction
alternate between iterations, and a sheet on a ball does not converge.
"""

from __future__ import annotations

import math

import numpy as np

from nuno_contact.sliding.slides import Slides, pose_slides, tree_of
from nuno_contact.sliding.vertex import outward
from nuno_kernels import block_kernel
from nuno_kernels.bodies.poses import to_frame
from nuno_kernels.meshes.closest_point import closest
from nuno_kernels.meshes.tree import make_room
from nuno_kernels.step.blocks import Long
from nuno_schemas.fabric import Float

RIGID = 1e6
"""Stiffness of what is held, as a multiple of its inertia and of the cloth's largest stiffness."""


@block_kernel
def find_touching(x: Float, body: Long, s: Slides, found: Float) -> None:
    """Of vertices at x (3, n) that are held, (7, n): place in the body's frame, normal, distance [m]."""
    room, tree = make_room(), tree_of(s)
    for i in range(x.shape[1]):
        b = body[i]
        if b >= 0:
            p = to_frame(x[0, i], x[1, i], x[2, i], s.frames, s.frame[b])
            near = closest(p, s.nearest[b, i], s.root[b], tree, room)
            n = outward(p, near)
            for c in range(3):
                found[c, i], found[3 + c, i] = p[c], n[c]
            found[6, i] = near.distance


@block_kernel
def find_entering(x: Float, body: Long, s: Slides, found: Float) -> None:
    """Take free vertices that a step to x (3, n) brings nearer than the gap into body (n,), and into found (7, n) their
    place before it, the normal, and how far they are to go against it [m].
    """
    room, tree = make_room(), tree_of(s)
    for b in range(s.root.shape[0]):
        for i in range(x.shape[1]):
            if body[i] >= 0 or s.mass[i] == 0.0:
                continue
            p, q = to_frame(x[0, i], x[1, i], x[2, i], s.frames, s.frame[b]), s.before[b, :, i]
            m = (p[0] - q[0], p[1] - q[1], p[2] - q[2])
            if s.clear[b, i] - math.sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2]) < s.gap[b]:
                near = closest(p, s.nearest[b, i], s.root[b], tree, room)
                if near.distance < s.gap[b]:
                    n = outward(p, near)
                    for c in range(3):
                        found[c, i], found[3 + c, i] = q[c], n[c]
                    found[6, i] = near.distance - (n[0] * m[0] + n[1] * m[1] + n[2] * m[2])
                    body[i] = b


def turned(a: Float, rotation: Float, back: bool = False) -> Float:
    """Vectors a (3, m) turned by rotations (m, 3, 3), or back."""
    r = rotation.transpose((2, 1, 0) if back else (1, 2, 0))
    return np.asarray(r[:, 0] * a[0] + r[:, 1] * a[1] + r[:, 2] * a[2])


def along(a: Float, b: Float) -> Float:
    """(m,) products of vectors (3, m)."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def unit(a: Float) -> Float:
    """Directions of vectors (3, m), 0 for those without length."""
    size = np.sqrt(along(a, a))
    return np.asarray(a / np.where(size > 0.0, size, 1.0))


class Grip:
    """What is held of n vertices; the m that are in a step have columns in most arrays.

    body  (n,) the body that each is held on after the last step, -1 for free ones
    push  (3, n) friction [N] on those that slide, in the body's frame; 0 for those that stick
    on    (n,) the body that each is held on in the step
    """

    def __init__(self, slides: Slides) -> None:
        n = len(slides.mass)
        self.slides, self.body, self.push = slides, np.full(n, -1, np.int64), np.zeros((3, n))

    def begin(self, x: Float, start: float, end: float) -> None:
        """Look where vertices x (3, n) are held at the start of a step between two fractions of the interval."""
        pose_slides(start, self.slides)
        self.start, self.end = start, end
        self.on = np.where(self.slides.mass > 0.0, self.body, -1)
        self.held, found = np.zeros(0, np.int64), np.zeros((7, x.shape[1]))
        self.place = self.normal = self.friction = self.impulse = np.zeros((3, 0))
        self.far, self.mu = np.zeros((2, 0))
        self.sticks = self.free = self.slipped = self.kept = np.zeros(0, np.bool_)
        find_touching(x, self.on, self.slides, found)
        self._take(np.flatnonzero(self.on >= 0), found)

    def _take(self, which: Long, found: Float) -> None:
        """Hold more vertices, as they were found."""
        s, body = self.slides, self.on[which]
        self.held = np.concatenate([self.held, which])
        self.place = np.concatenate([self.place, found[:3, which]], axis=1)
        self.normal = np.concatenate([self.normal, found[3:6, which]], axis=1)
        self.far = np.concatenate([self.far, found[6, which] - s.gap[body]])
        self.mu = np.concatenate([self.mu, s.friction[body]])
        self.friction = np.concatenate([self.friction, self.push[:, which]], axis=1)
        none = np.zeros(len(which), np.bool_)
        self.free, self.slipped, self.kept = (np.concatenate([a, none]) for a in (self.free, self.slipped, self.kept))
        self.sticks = np.concatenate([self.sticks, (s.friction[body] > 0.0) & ~self.push[:, which].any(axis=0)])

    def pose(self, at: float) -> None:
        """Where held vertices go by a fraction of the interval, their normals and friction, in the world."""
        pose_slides(at, self.slides)
        frames = self.slides.frames[self.slides.frame[self.on[self.held]]]
        self.rotation = frames[:, :9].reshape(-1, 3, 3)
        self.carried = turned(self.place, self.rotation) + frames[:, 9:12].T
        self.n = turned(self.normal, self.rotation)
        self.goal = self.carried - (at - self.start) / (self.end - self.start) * self.far * self.n
        self.rub = np.where(self.sticks | self.free, 0.0, turned(self.friction, self.rotation))

    def filter(self, a: Float) -> None:
        """Take from vectors a (3, n) what is prescribed, in place."""
        own = a[:, self.held]
        slides = np.where(self.sticks, 0.0, own - along(own, self.n) * self.n)
        a[:, self.held] = np.where(self.free, own, slides)

    def lead(self, x: Float, v: Float, span: float) -> None:
        """Let velocities v (3, n) bring held vertices from x (3, n) to where they go within `span` [s], in place."""
        change = np.zeros_like(v)
        change[:, self.held] = (self.goal - x[:, self.held]) / span - v[:, self.held]
        left = change.copy()
        self.filter(left)
        v += change - left

    def enter(self, x: Float, v: Float, span: float) -> None:
        """The same for a step's start, as an impulse that is a part of the contact's force."""
        before = v[:, self.held]
        self.pose(self.end)
        self.lead(x, v, span)
        self.impulse = self.slides.mass[self.held] * (v[:, self.held] - before) / span

    def stiffen(self, own: Float, stiffness: float) -> None:
        """Add what holds vertices to the blocks own (6, n) of a matrix: a solution then moves nothing that is held."""
        n = self.n
        rigid = np.where(self.free, 0.0, RIGID * (own[0, self.held] + stiffness))
        for row, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
            own[row, self.held] += rigid * np.where(self.sticks, float(i == j), n[i] * n[j])

    def force(self, missing: Float) -> tuple[Float, Float]:
        """N (m,) and t (3, m) [N] of the contact, from the force that is missing (3, n) without it."""
        total = self.impulse - missing[:, self.held]
        normal = along(total, self.n)
        return normal, total - normal * self.n

    def along_surface(self, x: Float) -> Float:
        """(3, m) how far held vertices have moved along the surface [m]."""
        moved = x[:, self.held] - self.carried
        return np.asarray(moved - along(moved, self.n) * self.n)

    def revise(self, missing: Float, x: Float) -> bool:
        """Let go, and hold, what the solution x (3, n) asks for; whether anything is to be solved anew."""
        normal, t = self.force(missing)
        limit = self.mu * np.maximum(normal, 0.0)
        stops = ~self.sticks & (along(self.along_surface(x), self.rub) > 0.0)
        slips = self.sticks & ~self.free & ~self.slipped & (along(t, t) > limit * limit)
        goes = ~self.free & ~self.kept & (normal < 0.0)
        back = self.free & (along(x[:, self.held] - self.goal, self.n) < 0.0)
        self.friction[:, slips] = turned(limit * unit(t), self.rotation, back=True)[:, slips]
        self.slipped |= slips
        self.sticks = (self.sticks & ~slips) | stops
        self.kept |= back
        self.free = (self.free & ~back) | goes
        changed = bool((stops | slips | goes | back).any())
        found, on = np.zeros((7, x.shape[1])), self.on.copy()
        find_entering(x, self.on, self.slides, found)
        which = np.flatnonzero(on != self.on)
        self._take(which, found)
        return changed or len(which) > 0

    def finish(self, missing: Float, x: Float, span: float) -> None:
        """Remember for the next step what the solution x (3, n) of this one, of `span` [s], has come to."""
        normal, t = self.force(missing)
        limit = self.mu * np.maximum(normal, 0.0)
        slips = self.sticks & (along(t, t) > limit * limit)
        way = np.where(self.sticks, np.where(slips, unit(t), 0.0), -unit(self.along_surface(x)))
        stays = ~self.free & (normal >= 0.0)
        self.body[:], self.push[:] = -1, 0.0
        self.body[self.held[stays]] = self.on[self.held[stays]]
        self.push[:, self.held[stays]] = turned(limit * way, self.rotation, back=True)[:, stays]
        given = self.rub + np.where(self.free, 0.0, normal * self.n + np.where(self.sticks, t, 0.0))
        np.subtract.at(self.slides.impulse[0], self.on[self.held], span * given.T)

    def count(self) -> None:
        """Count held vertices among those that touch, where the step's end has not met them."""
        held = np.flatnonzero(self.body >= 0)
        self.slides.tally[0, 0] += int((self.slides.planes[self.body[held], 6, held] == 0.0).sum())
