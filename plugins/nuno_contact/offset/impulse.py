"""Impulses that slow cloth down that comes too fast for forces to stop it.

A method whose step is long sees what arrives at 3 m/s for the first time when it has gone through the thickness. What
would be nearer than a quarter of it after the next step gets an impulse along the line between the closest points, as
in an inelastic encounter, just large enough; a few sweeps in the list's order, each of which keeps momentum and takes
energy ("speculative contacts" in games). Steps are then seldom cut short. xpbd does without: it has them in its
constraints (nuno_contact.offset.projection).
"""

from __future__ import annotations

import math

import numpy as np

from nuno_contact.offset.contact_state import CLOSE, IN_TURN, PARTS, WORTH, ContactState, close_up
from nuno_contact.offset.force import corners_of
from nuno_contact.offset.proximity import Corners, between, closest, unit, weigh
from nuno_kernels import block_kernel, forced_inline, kernel
from nuno_kernels.lanes import WIDTH, dot, higher, lane, read_triple, splat
from nuno_kernels.step.blocks import Long, sum_rows
from nuno_kernels.terms import over_blocks
from nuno_schemas.fabric import Float, Int

IMPULSE_RANGE, SWEEPS = 0.25, (4, 32)
"""A pair that would come nearer than this share of the thickness in the next step is slowed down, in so many sweeps;
the second number is for bodies, which do not give way, and have many vertices below a triangle of cloth."""

LEVER = 0.25
"""Beside a held vertex an impulse at the closest point would need a long lever: a vertex whose share of that point is w
would get the speed over w, without bound. A pair moves at least as easily as a point of this share, in the square, of
its heaviest vertex: in all sweeps together no vertex is made more than eight times as fast as what comes. Triangles and
edges that are free have a third and more: for them nothing changes."""


@block_kernel
def farthest_way(v: Float, dt: float) -> float:
    """Return how far the fastest vertex goes in dt [s] at v (3, n) [m]."""
    fastest, most = splat(0.0), 0.0
    for i in range(0, v.shape[1], WIDTH):
        lanes = read_triple(v, 0, i, min(WIDTH, v.shape[1] - i))
        fastest = higher(dot(lanes, lanes), fastest)
    for k in range(WIDTH):
        most = max(most, lane(fastest, k))
    return dt * math.sqrt(most)


@block_kernel
def fast_part(part: int, m: ContactState, v: Float, dt: float, fast: Int, number: Long) -> None:
    """Find which of a part of the close pairs would come too near: into `fast` from the part's first place on."""
    pairs = m.pairs
    pair, of, reach, normal, last, close = pairs.vertices, pairs.face, pairs.reach, pairs.normal, m.last, pairs.close
    first, end = part * m.counts[CLOSE] // PARTS, (part + 1) * m.counts[CLOSE] // PARTS
    at = first
    for q in range(first, end):
        p = close[q]
        i, j, k, l = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]  # noqa: E741
        here, go = corners_of(last, i, j, k, l), corners_of(v, i, j, k, l)
        low, high = between(of[p] < 0, (normal[p, 0], normal[p, 1], normal[p, 2]), ahead(here, go, dt))
        if low - high < IMPULSE_RANGE * reach[p]:
            fast[at] = p
            at += 1
    number[part] = at - first


fast_parts = over_blocks(fast_part, "m, v, dt, fast, number", WORTH, IN_TURN)


@block_kernel
def apply_impulses(m: ContactState, v: Float, dt: float, sweeps: int, threads: int | None) -> None:
    """Slow down, in v (3, n), pairs that would come nearer in the next step, of dt [s], than forces can answer."""
    pairs = m.pairs
    pair, of, reach, mass, last = pairs.vertices, pairs.face, pairs.reach, m.surface.mass, m.last
    piece, cloth = m.surface.piece, m.surface.meets.shape[0] - m.push.shape[0]
    fast, counts = np.empty(m.counts[CLOSE], np.int32), np.empty(PARTS, np.int64)
    fast_parts(m, v, dt, fast, counts, PARTS, m.counts[CLOSE], threads)
    number = close_up(fast, m.counts[CLOSE], counts)
    weights, normal, lacks, mobility = np.empty((number, 4)), np.empty((number, 3)), np.empty(number), np.zeros(number)
    for q in range(number):
        p = fast[q]
        here = corners_of(last, pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3])
        w = closest(of[p] < 0, here).weights
        n, distance = unit(weigh(w, here))
        weights[q, 0], weights[q, 1], weights[q, 2], weights[q, 3] = w
        normal[q, 0], normal[q, 1], normal[q, 2] = n
        lacks[q] = min(0.0, IMPULSE_RANGE * reach[p] - distance)
        heaviest = 0.0
        for corner in range(4):
            i = pair[p, corner]
            mobility[q] += w[corner] * w[corner] / mass[i] if mass[i] > 0.0 else 0.0
            heaviest = max(heaviest, mass[i])
        mobility[q] = max(mobility[q], LEVER / heaviest if heaviest > 0.0 else 0.0)
    for _ in range(sweeps):
        slowed = False
        for q in range(number):
            p, n = fast[q], (normal[q, 0], normal[q, 1], normal[q, 2])
            w = (weights[q, 0], weights[q, 1], weights[q, 2], weights[q, 3])
            go = corners_of(v, pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3])
            lacking = lacks[q] - dt * dot(n, weigh(w, go))
            if lacking > 0.0 and mobility[q] > 0.0:
                slowed, impulse, of_body = True, lacking / (mobility[q] * dt), 0
                for corner in range(4):
                    of_body = max(of_body, piece[pair[p, corner]] - cloth)
                for corner in range(4):
                    i = pair[p, corner]
                    if mass[i] > 0.0:
                        for row in range(3):
                            v[row, i] += w[corner] / mass[i] * impulse * n[row]
                            m.push[of_body, i, row] += w[corner] * impulse * n[row] / m.span[0]
        if not slowed:
            break


@kernel
def credit_change(m: ContactState, change: Float) -> None:
    """Count a change of velocities (3, n) among the impulses, of what has pushed each vertex most in the interval."""
    for i in range(m.push.shape[1]):
        if change[0, i] == 0.0 and change[1, i] == 0.0 and change[2, i] == 0.0:
            continue
        most, strongest = 0, 0.0
        for part in range(m.push.shape[0]):
            size = m.push[part, i, 0] ** 2 + m.push[part, i, 1] ** 2 + m.push[part, i, 2] ** 2
            most, strongest = (part, size) if size > strongest else (most, strongest)
        for row in range(3):
            m.push[most, i, row] += m.surface.mass[i] * change[row, i] / m.span[0]


@block_kernel
def push_cloth_ahead(m: ContactState, x: Float, v: Float, dt: float, threads: int | None) -> None:
    """Let bodies push cloth that they would meet in a step of dt [s] from `last` to x (3, n), in place: the effect of
    forces in the step is known by now.
    """
    mean = sum_rows(x, -1.0, m.last)
    for row in range(3):
        for i in range(x.shape[1]):
            mean[row, i] /= dt
    before = mean.copy()
    apply_impulses(m, mean, dt, SWEEPS[1], threads)
    for i in range(x.shape[1] - m.bodies.local.shape[0]):
        for row in range(3):
            if mean[row, i] != before[row, i]:
                x[row, i] = m.last[row, i] + dt * mean[row, i]
                v[row, i] += mean[row, i] - before[row, i]


@forced_inline
def ahead(x: Corners, v: Corners, dt: float) -> Corners:
    """Return four vertices after dt."""
    a, b, c, d = x
    e, f, g, h = v
    return (
        (a[0] + dt * e[0], a[1] + dt * e[1], a[2] + dt * e[2]),
        (b[0] + dt * f[0], b[1] + dt * f[1], b[2] + dt * f[2]),
        (c[0] + dt * g[0], c[1] + dt * g[1], c[2] + dt * g[2]),
        (d[0] + dt * h[0], d[1] + dt * h[1], d[2] + dt * h[2]),
    )
