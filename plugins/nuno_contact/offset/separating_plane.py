"""The plane that keeps a pair apart along its vertices' ways, and the limits that it sets to a step of Newton's."""

from __future__ import annotations

import numpy as np

from nuno_contact.offset.bodies import copy_part, keep_all, pose_solids
from nuno_contact.offset.candidate_pairs import CHOSEN, LEAST, LIST, MOST, WINDOW, allow, holds, learn, set_out
from nuno_contact.offset.contact_state import (
    CHOICES,
    LACKING,
    LEFT_OUT,
    LISTED,
    NEAR,
    NEAR_BEGUN,
    NEAR_WINDOW,
    NOW,
    ContactState,
)
from nuno_contact.offset.force import corners_of, faces_of, touch
from nuno_contact.offset.proximity import Corners, Four, between, closest, unit, weigh
from nuno_geometry.poses import Vector
from nuno_kernels import block_kernel, forced_inline
from nuno_kernels.lanes import dot, plus
from nuno_kernels.step.blocks import all_finite, same_rows, sum_rows
from nuno_schemas.fabric import Float

# The plane that keeps a pair apart all along its vertices' straight ways, if any across one direction does; and how
# far vertices can go so that every pair has one.
#
# Along n the primitives are apart at a time if n.(p - q) > 0 for all vertices p of the first and q of the second; all
# the while, if they are at both ends. The best n is along the shortest vector to the convex hull of these differences,
# six or eight at both ends, which Gilbert's algorithm finds (1966, SIAM J. Control 4, 61-80).

ITERATIONS = 1000
"""iterations of Gilbert's algorithm, which takes few where there is room, and many past the ends of long edges"""
SWEEPS = 16
"""sweeps over all pairs, after which pairs without a plane are left so"""


@block_kernel
def plane_along(of_edges: bool, here: Corners, there: Corners, enough: float) -> tuple[Vector, float]:
    """Return a plane's direction, and the gap between the primitives along it [m], the smaller of both ends: `enough`
    or more if such a plane was found.
    """
    ways, number = np.empty((8, 3)), 0
    for i in range(2 if of_edges else 1):
        for j in range(2 if of_edges else 1, 4):
            for axis in range(3):
                ways[number, axis] = here[i][axis] - here[j][axis]
                ways[number + 1, axis] = there[i][axis] - there[j][axis]
            number += 2
    x, y, z = ways[0, 0], ways[0, 1], ways[0, 2]
    length, gap = 0.0, -np.inf
    for _ in range(ITERATIONS):
        square, least, at = x * x + y * y + z * z, np.inf, 0
        for k in range(number):
            along = x * ways[k, 0] + y * ways[k, 1] + z * ways[k, 2]
            if along < least:
                least, at = along, k
        length = np.sqrt(square)
        gap = least / length if length > 0.0 else 0.0
        if gap >= enough or length <= enough:
            break
        a, b, c = ways[at, 0] - x, ways[at, 1] - y, ways[at, 2] - z
        share = min(1.0, -(x * a + y * b + z * c) / (a * a + b * b + c * c))
        if not share > 0.0:
            break
        x, y, z = x + share * a, y + share * b, z + share * c
    return (x / length, y / length, z / length), gap


@forced_inline
def on_the_way(here: Corners, there: Corners, share: Four) -> Corners:
    """Return four vertices, each after a share of its way."""
    return partly(here[0], there[0], share[0]), partly(here[1], there[1], share[1]), partly(
        here[2], there[2], share[2]), partly(here[3], there[3], share[3])  # fmt: skip


@forced_inline
def partly(a: Vector, b: Vector, share: float) -> Vector:
    """Return the point after a share of the way from a to b, b itself where that is 1."""
    if share == 1.0:
        return b
    return a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2])


@block_kernel
def find_shares(m: ContactState, y: Float, d: Float, stop: float) -> bool:
    """Find the shares m.share of d (3, n) that vertices can go from y (3, n) so that pairs come as near as `stop` of
    their thickness, and half as near as they were at most; return whether any is less than 1.

    Each pair is to have a plane that keeps it apart at y and at the end. If it has none, a side that comes nearer stops
    at the other's end, or, if both come nearer, between them in proportion. A side that goes away does not stop the
    other where it is now, so that layers that fall together go on together; and as shares only get smaller, each pair's
    demand can be met whatever the others do. Pairs left after SWEEPS over all pairs stay as they are, and so does held
    cloth; bodies do not.
    """
    pairs = m.pairs
    pair, of, reach, normal, share, near = pairs.vertices, pairs.face, pairs.reach, pairs.normal, m.share, pairs.near
    cloth = share.shape[0] - m.bodies.local.shape[0]
    share[:] = 1.0
    hindered = False
    for _ in range(SWEEPS):
        again = False
        for q in range(m.counts[NEAR]):
            p = near[q]
            i, j, k, l = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]  # noqa: E741
            here, of_edges = corners_of(y, i, j, k, l), of[p] < 0
            go = corners_of(d, i, j, k, l)
            there = moved_by(here, go)
            end = on_the_way(here, there, (share[i], share[j], share[k], share[l]))
            n, room = (normal[p, 0], normal[p, 1], normal[p, 2]), stop * reach[p]
            low, high = between(of_edges, n, end)
            if low - high >= room:
                low, high = between(of_edges, n, here)
                if low - high >= room:
                    continue
            n, distance = unit(weigh(closest(of_edges, here).weights, here))
            room = min(room, 0.5 * distance)
            low, high = between(of_edges, n, end)
            if low - high >= room or plane_along(of_edges, here, end, room)[1] >= room:
                continue
            first, second = between(of_edges, n, here)
            down, up = first - low, high - second
            level = (
                first - (first - second - room) * down / (down + up)
                if down > 0.0 and up > 0.0
                else (high + room if down > 0.0 else low)
            )
            for corner in range(4):
                v = pair[p, corner]
                if m.surface.mass[v] == 0.0 and v < cloth:
                    continue
                upper = corner == 0 or (of_edges and corner == 1)
                least = level if upper else room - level
                allowed = share_above(dot(n, here[corner]), dot(n, go[corner]), 1.0 if upper else -1.0, least, share[v])
                if allowed < share[v]:
                    share[v], again = allowed, True
        hindered = hindered or again
        if not again or m.leave[0] != 0:
            break
    return hindered


@forced_inline
def moved_by(x: Corners, d: Corners) -> Corners:
    """Return four vertices moved."""
    return plus(x[0], d[0]), plus(x[1], d[1]), plus(x[2], d[2]), plus(x[3], d[3])


@forced_inline
def share_above(start: float, way: float, side: float, least: float, share: float) -> float:
    """Return the share of its way that a vertex goes: side times start + share times way is not below `least`."""
    height, down = side * start, -side * way
    if height - share * down >= least or down <= 0.0:
        return share
    return max(0.0, (1.0 - 1e-12) * (height - least) / down)


# Limits on a step of Newton's method, so that no iterate of cloth has passed through cloth.
#
# An iterate that has gone through cloth would be pushed on by it. From iterate y the step d is shortened vertex by
# vertex, until each pair has a plane that keeps its primitives apart at y and at y + d
# (see plane_along).
#
# Not chosen: one share for all vertices, as Incremental Potential Contact has (Li et al. 2020, ACM Trans. Graph. 39,
# 49), which keeps the direction, but lets the first to touch stop all; and the rule of nuno_contact.offset.ccd, half
# way to a plane at rest, which holds for whatever the vertices have done before, where a step of Newton's only needs to
# get there in the end.

FREEZE, REFREEZE = 4, 10
"""Features are frozen after so many iterates that nothing shortened, and again after so many more; see freeze."""
FROZEN_WITHIN = 2.0
"""features of pairs nearer than so many times the thickness are frozen"""
SHORTER = 40
"""A step so long that its contacts exceed the lists is taken to a quarter, at most so often."""
STOP = 0.25
"""An iterate's pairs come as near as this share of their thickness, and at most half as near as they were."""


@block_kernel
def restrain(m: ContactState, y: Float, d: Float, s: float, threads: int | None) -> bool:
    """Shorten d (3, n), which leads from iterate y (3, n) to another for fraction s of the interval; return whether it
    was. Bodies go on to their places at that time, as far as cloth lets them.
    """
    if not all_finite(d):
        return False
    if m.bodies.local.shape[0] == 0:
        return restrain_whole(m, y, d, s, threads)
    keep_all(m)
    n, whole, way, goal = y.shape[1], m.whole, m.way, m.goal
    pose_solids(m, s)
    if same_rows(y, m.last):
        copy_part(m.last, whole, n, way.shape[1])
    copy_part(y, whole, 0, n)
    copy_part(d, way, 0, n)
    for i in range(n, way.shape[1]):
        for row in range(3):
            way[row, i] = goal[row, i] - whole[row, i]
    shortened = restrain_whole(m, whole, way, s, threads)
    copy_part(way, d, 0, n)
    for i in range(n, way.shape[1]):
        for row in range(3):
            whole[row, i] += way[row, i]
    return shortened


@block_kernel
def restrain_whole(m: ContactState, y: Float, d: Float, s: float, threads: int | None) -> bool:
    """Do so for cloth and bodies together."""
    lists = m.counts[CHOICES]
    cover(m, sum_rows(y, 1.0, d), s, threads)
    shortened = m.counts[LACKING] > 0
    for _ in range(SHORTER):
        if m.counts[LACKING] == 0:
            break
        d *= 0.25
        cover(m, sum_rows(y, 1.0, d), s, threads)
    m.solver.expected[:] = False
    if not find_shares(m, y, d, STOP) and not shortened:
        m.solver.calm[0] += 1
        if m.solver.calm[0] % REFREEZE == FREEZE or (m.solver.frozen[0] and m.counts[CHOICES] > lists):
            freeze(m, y)
        return False
    m.solver.calm[0], m.solver.frozen[0] = 0, False
    for i in range(d.shape[1]):
        for row in range(3):
            d[row, i] *= m.share[i]
    return True


@block_kernel
def freeze(m: ContactState, y: Float) -> None:
    """Keep from here on the features that meet, with their closest points and directions, as at y (3, n).

    If features change, or the set of pairs, forces jump, and Newton's method may alternate between the two.
    Frozen contacts are as smooth as springs.
    """
    pairs = m.pairs
    mesh = faces_of(m)
    m.solver.kept[: m.counts[LISTED]] = False
    for q in range(m.counts[NEAR]):
        p = pairs.near[q]
        i, j, k, l = pairs.vertices[p, 0], pairs.vertices[p, 1], pairs.vertices[p, 2], pairs.vertices[p, 3]  # noqa: E741
        at = touch(y, i, pairs.face[p], corners_of(y, i, j, k, l), FROZEN_WITHIN * pairs.reach[p], mesh)
        m.solver.kept[p] = at.distance < FROZEN_WITHIN * pairs.reach[p]
        m.solver.kept_normal[p, 0], m.solver.kept_normal[p, 1], m.solver.kept_normal[p, 2] = at.normal
        for corner in range(4):
            m.solver.kept_weights[p, corner] = at.weights[corner]
    m.solver.frozen[0] = True


@block_kernel
def cover(m: ContactState, end: Float, s: float, threads: int | None) -> None:
    """Make lists for a step from `last` to `end` (3, n) and its surroundings."""
    clock, last, spread = m.clock, m.last, m.plan.spread[1]
    renew = not holds(m, LIST, end, s, 0.0)
    if not renew and holds(m, CHOSEN, end, s, 0.0):
        return
    way, gone = s - clock[NOW], clock[NOW] - clock[NEAR_BEGUN]
    if gone > 0.0:
        learn(m, 1, last, gone, gone / clock[NEAR_WINDOW])
    window = max(way, WINDOW)
    allow(m, spread, m.plan.unrest[1], window, LEAST[1], MOST[1])
    for i in range(end.shape[1]):
        a, b, c = end[0, i] - last[0, i], end[1, i] - last[1, i], end[2, i] - last[2, i]
        spread[i] = max(spread[i], min(MOST[1] * m.surface.law[0], np.sqrt(a * a + b * b + c * c)))
    left_out = m.so_far[LEFT_OUT]
    set_out(m, sum_rows(end, -1.0, last), way, window, renew, threads)
    m.so_far[LEFT_OUT] = left_out  # The number of steps counts only committed ones.
