"""Limits on a step of Newton's method, so that no iterate of cloth has passed through cloth.

An iterate that has gone through cloth would be pushed on by it. From iterate y the step d is shortened vertex by
vertex, until each pair has a plane that keeps its primitives apart at y and at y + d
(nuno_contact.offset.separating_plane).

Not chosen: one share for all vertices, as Incremental Potential Contact has (Li et al. 2020, ACM Trans. Graph. 39,
49), which keeps the direction, but lets the first to touch stop all; and the rule of nuno_contact.offset.ccd, half
way to a plane at rest, which holds for whatever the vertices have done before, where a step of Newton's only needs to
get there in the end.
"""

from __future__ import annotations

import numpy as np

from nuno_contact.offset.bodies import copy_part, pose_solids
from nuno_contact.offset.contact_state import ContactState
from nuno_contact.offset.force import corners_of, faces_of, touch
from nuno_contact.offset.places import CHOICES, LACKING, LEFT_OUT, LISTED, NEAR, NEAR_BEGUN, NEAR_WINDOW, NOW
from nuno_contact.offset.plan import CHOSEN, LEAST, LIST, MOST, WINDOW, allow, holds, learn, set_out
from nuno_contact.offset.separating_plane import find_shares
from nuno_kernels import block_kernel
from nuno_kernels.step.blocks import all_finite, same_rows, sum_rows
from nuno_schemas.fabric import Float

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
    if m.local.shape[0] == 0:
        return restrain_whole(m, y, d, s, threads)
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
    lists = m.number[CHOICES]
    cover(m, sum_rows(y, 1.0, d), s, threads)
    shortened = m.number[LACKING] > 0
    for _ in range(SHORTER):
        if m.number[LACKING] == 0:
            break
        d *= 0.25
        cover(m, sum_rows(y, 1.0, d), s, threads)
    m.expected[:] = False
    if not find_shares(m, y, d, STOP) and not shortened:
        m.calm[0] += 1
        if m.calm[0] % REFREEZE == FREEZE or (m.frozen[0] and m.number[CHOICES] > lists):
            freeze(m, y)
        return False
    m.calm[0], m.frozen[0] = 0, False
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
    mesh = faces_of(m)
    m.kept[: m.number[LISTED]] = False
    for q in range(m.number[NEAR]):
        p = m.near[q]
        i, j, k, l = m.pair[p, 0], m.pair[p, 1], m.pair[p, 2], m.pair[p, 3]  # noqa: E741
        at = touch(y, i, m.of[p], corners_of(y, i, j, k, l), FROZEN_WITHIN * m.reach[p], mesh)
        m.kept[p] = at.distance < FROZEN_WITHIN * m.reach[p]
        m.kept_normal[p, 0], m.kept_normal[p, 1], m.kept_normal[p, 2] = at.normal
        for corner in range(4):
            m.kept_weights[p, corner] = at.weights[corner]
    m.frozen[0] = True


@block_kernel
def cover(m: ContactState, end: Float, s: float, threads: int | None) -> None:
    """Make lists for a step from `last` to `end` (3, n) and its surroundings."""
    clock, last, spread = m.clock, m.last, m.spread[1]
    renew = not holds(m, LIST, end, s, 0.0)
    if not renew and holds(m, CHOSEN, end, s, 0.0):
        return
    way, gone = s - clock[NOW], clock[NOW] - clock[NEAR_BEGUN]
    if gone > 0.0:
        learn(m, 1, last, gone, gone / clock[NEAR_WINDOW])
    window = max(way, WINDOW)
    allow(m, spread, m.unrest[1], window, LEAST[1], MOST[1])
    for i in range(end.shape[1]):
        a, b, c = end[0, i] - last[0, i], end[1, i] - last[1, i], end[2, i] - last[2, i]
        spread[i] = max(spread[i], min(MOST[1] * m.law[0], np.sqrt(a * a + b * b + c * c)))
    left_out = m.so_far[LEFT_OUT]
    set_out(m, sum_rows(end, -1.0, last), way, window, renew, threads)
    m.so_far[LEFT_OUT] = left_out  # The number of steps counts only committed ones.
