"""Impulses that slow cloth down that comes too fast for forces to stop it.

A method whose step is long sees what arrives at 3 m/s for the first time when it has gone through the thickness. What
would be nearer than a quarter of it after the next step gets an impulse along the line between the closest points, as
in an inelastic encounter, just large enough; a few sweeps in the list's order, each of which keeps momentum and takes
energy ("speculative contacts" in games). Steps are then seldom cut short. xpbd does without: it has them in its
constraints (nuno_contact.offset.projection).
"""

from __future__ import annotations

import numpy as np

from nuno_contact.offset.bodies import copy_part
from nuno_contact.offset.contact_state import CLOSE, IN_TURN, PARTS, WORTH, ContactState, close_up
from nuno_contact.offset.force import corners_of
from nuno_contact.offset.proximity import closest, unit, weigh
from nuno_kernels import block_kernel, forced_inline, kernel
from nuno_kernels.lanes import (
    WIDTH,
    Lanes,
    Seven,
    Triple,
    dot,
    gather_rows,
    higher,
    load,
    load_triple,
    lower,
    root,
    store,
    where_not_negative,
)
from nuno_kernels.step.blocks import Long
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
def lay_ways(m: ContactState, x: Float, v: Float, dt: float) -> None:
    """Write into m.plan.ways where cloth and active vertices of bodies are, x (3, n), and their ways in dt [s] at v
    (3, n): one cache line for each.
    """
    ways, first = m.plan.ways, x.shape[1] - m.bodies.local.shape[0]
    for q in range(first + m.bodies.number[0]):
        i = q if q < first else first + m.bodies.active[q - first]
        for row in range(3):
            ways[i, row], ways[i, 3 + row] = x[row, i], dt * v[row, i]


@block_kernel
def find_gaps(m: ContactState, chosen: Int, gap: Float) -> None:
    """Write into gap (3, c + 8) [m] how far apart chosen pairs (c,) are across their planes, by m.plan.ways: where they
    are, at the end of their ways, and how far any vertex goes relative to the last one, half of what they may come
    nearer by.
    """
    pair, of, normal, ways = m.pairs.vertices, m.pairs.face, m.pairs.normal, m.plan.ways
    four, across, count = np.zeros((WIDTH, 4), np.int32), np.zeros((4, WIDTH)), chosen.shape[0]
    for c in range(0, count, WIDTH):
        for k in range(min(WIDTH, count - c)):
            p = chosen[c + k]
            for corner in range(4):
                four[k, corner] = pair[p, corner]
            for row in range(3):
                across[row, k] = normal[p, row]
            across[3, k] = of[p]
        first, second = gather_rows(ways, four, 0), gather_rows(ways, four, 1)
        w = first, second, gather_rows(ways, four, 2), gather_rows(ways, four, 3)
        n, of_face = load_triple(across, 0, 0), load(across, 3, 0)
        begin, end = (apart(of_face, n, w, 0.0), apart(of_face, n, w, 1.0))
        p, q, r = relative(w[0], w[3]), relative(w[1], w[3]), relative(w[2], w[3])
        store(gap, 0, c, begin)
        store(gap, 1, c, end)
        store(gap, 2, c, root(higher(higher(dot(p, p), dot(q, q)), dot(r, r))))


@forced_inline
def apart(of_face: Lanes, n: Triple, w: tuple[Seven, Seven, Seven, Seven], share: float) -> Lanes:
    """Return how far apart planes across n keep eight pairs after a share of their way."""
    a, b, c, d = along(n, w[0], share), along(n, w[1], share), along(n, w[2], share), along(n, w[3], share)
    second = higher(c, d)
    return where_not_negative(of_face, a, lower(a, b)) - where_not_negative(of_face, higher(b, second), second)


@forced_inline
def along(n: Triple, w: Seven, share: float) -> Lanes:
    """Return how far along n eight vertices are after a share of their way."""
    return dot(n, (w[0], w[1], w[2])) if share == 0.0 else dot(n, (w[0] + w[3], w[1] + w[4], w[2] + w[5]))


@forced_inline
def relative(w: Seven, other: Seven) -> Triple:
    """Return the ways of eight vertices relative to those of others."""
    return w[3] - other[3], w[4] - other[4], w[5] - other[5]


@block_kernel
def fast_part(part: int, m: ContactState, fast: Int, number: Long) -> None:
    """Find which of a part of the close pairs would come too near: into `fast` from the part's first place on."""
    close, reach = m.pairs.close, m.pairs.reach
    first, end = part * m.counts[CLOSE] // PARTS, (part + 1) * m.counts[CLOSE] // PARTS
    at, gap = first, np.empty((3, end - first + WIDTH))
    find_gaps(m, close[first:end], gap)
    for q in range(first, end):
        if gap[1, q - first] < IMPULSE_RANGE * reach[close[q]]:
            fast[at] = close[q]
            at += 1
    number[part] = at - first


fast_parts = over_blocks(fast_part, "m, fast, number", WORTH, IN_TURN)


@block_kernel
def apply_impulses(m: ContactState, v: Float, dt: float, sweeps: int, threads: int | None) -> None:
    """Slow down, in v (3, n), pairs that would come nearer in the next step, of dt [s], than forces can answer."""
    pairs = m.pairs
    pair, of, reach, mass, last = pairs.vertices, pairs.face, pairs.reach, m.surface.mass, m.last
    piece, cloth = m.surface.piece, m.surface.meets.shape[0] - m.push.shape[0]
    fast, counts = np.empty(m.counts[CLOSE], np.int32), np.empty(PARTS, np.int64)
    lay_ways(m, last, v, dt)
    fast_parts(m, fast, counts, PARTS, m.counts[CLOSE], threads)
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
        if not slowed or m.leave[0] != 0:
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
    mean, last, first = m.way, m.last, x.shape[1] - m.bodies.local.shape[0]
    before = np.empty((3, first))
    for q in range(first + m.bodies.number[0]):
        i = q if q < first else first + m.bodies.active[q - first]
        for row in range(3):
            mean[row, i] = (x[row, i] - last[row, i]) / dt
    copy_part(mean, before, 0, first)
    apply_impulses(m, mean, dt, SWEEPS[1], threads)
    for i in range(first):
        for row in range(3):
            if mean[row, i] != before[row, i]:
                x[row, i] = m.last[row, i] + dt * mean[row, i]
                v[row, i] += mean[row, i] - before[row, i]
