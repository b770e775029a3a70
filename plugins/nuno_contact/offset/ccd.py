"""Collision detection: every step is checked before it counts, so that cloth never passes through itself.

A step takes vertices from `last`, where no primitives meet, to x, in straight lines. Each listed pair has a plane that
keeps its primitives apart at `last`; where the plane does so at x as well, it has done so all the while (see
nuno_contact.offset.tree). Where it does not, the closest points at `last` give another. Where that does not
either, the pair may have met: none of its vertices may then go farther than a quarter of the distance short of the
plane midway between. A vertex' step is shortened as a whole, to the shortest of what its pairs allow, and then
its other pairs are looked at again, until all are apart. Pairs that are not listed are too far away to meet.

The proof needs nothing of the solver, the step or the forces. A vertex whose step is cut short, which forces prevent
from happening often, is counted, and its velocity shortened as much, which takes momentum and energy: to keep the
velocity of what does not move stretches the springs to those that do, and throws it off later. Not chosen: bounds on
how far a vertex may move at all (half of its least distance), which cloth that moves along together uses up many times
a frame; continuous collision detection, whose cubic equations need care with rounding and which says where paths meet,
but not what to do then.
"""

from __future__ import annotations

import numpy as np

from nuno_contact.offset.bodies import (
    PLACED,
    catch_up,
    copy_active,
    copy_part,
    find_behind,
    limit_ways,
    pose_others,
    pose_solids,
)
from nuno_contact.offset.candidate_pairs import CHOSEN, LIST, holds, plan, set_out, strays
from nuno_contact.offset.contact_state import (
    CHOICES,
    CLOSE,
    CUT,
    HELD_CUT,
    IN_TURN,
    LACKING,
    LAST_STEP,
    LIST_BEGUN,
    LIST_WINDOW,
    NEAR,
    NEAR_WINDOW,
    NOW,
    PARTS,
    STEPS,
    STILL,
    WORTH,
    ContactState,
    close_up,
)
from nuno_contact.offset.force import corners_of, drag_anchors, find_touching
from nuno_contact.offset.impulse import (
    IMPULSE_RANGE,
    SWEEPS,
    apply_impulses,
    credit_change,
    find_gaps,
    lay_ways,
    push_cloth_ahead,
)
from nuno_contact.offset.proximity import between, closest, unit, weigh
from nuno_contact.offset.separating_plane import find_shares, on_the_way, plane_along
from nuno_contact.offset.tree import more
from nuno_geometry.poses import Vector
from nuno_kernels import block_kernel, forced_inline, kernel
from nuno_kernels.lanes import WIDTH, dot
from nuno_kernels.step.blocks import Long, all_finite, copy_rows, sum_rows
from nuno_kernels.terms import over_blocks
from nuno_schemas.fabric import Float

CLOSEST, FLOOR = 0.02, 0.001
"""A pair may come as near as the first share of its thickness; below it, half as near in a step; below the second
share, no nearer."""


@forced_inline
def nearest(reach: float, distance: float) -> float:
    """Return how near a pair may come in a step that begins at a distance [m]."""
    return min(CLOSEST * reach, max(0.5 * distance, min(FLOOR * reach, distance)))


@forced_inline
def is_thorough(m: ContactState) -> bool:
    """Whether all planes are tried before a step is cut short: for long steps, and for bodies, which go far in one."""
    return bool(m.solver.step[0] > 0.0) or m.bodies.local.shape[0] > 0


@block_kernel
def pass_part(part: int, m: ContactState, x: Float, number: Long, failed: Long) -> None:
    """Do pass_by for a part of the near pairs: write the close ones into `close` from the part's first place on, their
    number, and the number of pairs that no plane keeps apart.
    """
    pairs = m.pairs
    pair, of, reach, normal = pairs.vertices, pairs.face, pairs.reach, pairs.normal
    last, near, close = m.last, pairs.near, pairs.close
    thorough, fails = is_thorough(m), 0
    first, end = part * m.counts[NEAR] // PARTS, (part + 1) * m.counts[NEAR] // PARTS
    at, gaps = first, np.empty((3, end - first + WIDTH))
    find_gaps(m, near[first:end], gaps)
    for q in range(first, end):
        p, apart = near[q], gaps[0, q - first]
        if apart > more(reach[p], IMPULSE_RANGE * reach[p] + 2.0 * gaps[2, q - first]):
            m.anchored[p] = False
            continue
        close[at] = p
        at += 1
        if apart >= CLOSEST * reach[p]:
            continue
        i, j, k, l = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]  # noqa: E741
        here, there, of_edges = corners_of(last, i, j, k, l), corners_of(x, i, j, k, l), of[p] < 0
        n, distance = unit(weigh(closest(of_edges, here).weights, here))
        normal[p, 0], normal[p, 1], normal[p, 2] = n
        low, high = between(of_edges, n, there)
        gap = low - high
        if thorough and gap < nearest(reach[p], distance):
            n, gap = plane_along(of_edges, here, there, nearest(reach[p], distance))
            if gap >= nearest(reach[p], distance):
                normal[p, 0], normal[p, 1], normal[p, 2] = n
        fails += 0 if gap >= nearest(reach[p], distance) else 1
    number[part], failed[part] = at - first, fails


pass_parts = over_blocks(pass_part, "m, x, number, lost", WORTH, IN_TURN)


@block_kernel
def pass_by(m: ContactState, x: Float, v: Float, dt: float, threads: int | None) -> int:
    """Return the number of pairs that no plane keeps apart from `last` to x; each gets its best plane at `last`.

    Pairs that are closer at x than their thickness, or could be too near after a step of dt [s] at v (3, n), are noted
    in m.pairs.close.
    """
    lay_ways(m, x, v, dt)
    number, failed = np.empty(PARTS, np.int64), np.empty(PARTS, np.int64)
    pass_parts(m, x, number, failed, PARTS, m.counts[NEAR], threads)
    m.counts[CLOSE] = close_up(m.pairs.close, m.counts[NEAR], number)
    return int(failed.sum())


@block_kernel
def all_close(m: ContactState) -> None:
    """Note all near pairs as close."""
    pairs = m.pairs
    m.counts[CLOSE] = m.counts[NEAR]
    for q in range(m.counts[NEAR]):
        pairs.close[q] = pairs.near[q]


@forced_inline
def shortened(here: Vector, there: Vector, n: Vector, least: float, share: float) -> float:
    """Return the share of its way that a vertex goes if it may not go below `least` along n; `share` at most."""
    start, down = dot(n, here), dot(n, here) - dot(n, there)
    if share * down <= start - least:
        return share
    room: float = (1.0 - 1e-12) * (start - least) / down
    return max(0.0, room)


@block_kernel
def shorten(m: ContactState, x: Float) -> None:
    """Find the share of the way from `last` to x that each vertex can go, m.share."""
    pairs = m.pairs
    pair, of, reach, normal, last, share = pairs.vertices, pairs.face, pairs.reach, pairs.normal, m.last, m.share
    share[:] = 1.0
    again = True
    while again and m.leave[0] == 0:
        again = False
        for q in range(m.counts[NEAR]):
            p = pairs.near[q]
            i, j, k, l = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]  # noqa: E741
            here, there, of_edges = corners_of(last, i, j, k, l), corners_of(x, i, j, k, l), of[p] < 0
            n = (normal[p, 0], normal[p, 1], normal[p, 2])
            end = on_the_way(here, there, (share[i], share[j], share[k], share[l]))
            low, high = between(of_edges, n, end)
            if low - high >= CLOSEST * reach[p]:
                continue
            n, distance = unit(weigh(closest(of_edges, here).weights, here))
            normal[p, 0], normal[p, 1], normal[p, 2] = n
            low, high = between(of_edges, n, end)
            if low - high >= nearest(reach[p], distance):
                continue
            low, high = between(of_edges, n, here)
            middle, room = 0.5 * (low + high), 0.5 * nearest(reach[p], low - high)
            back = (-n[0], -n[1], -n[2])
            for corner in range(4):
                v = pair[p, corner]
                first = corner == 0 or (of_edges and corner == 1)
                least = room + (middle if first else -middle)
                allowed = shortened(here[corner], there[corner], n if first else back, least, share[v])
                if allowed < share[v]:
                    share[v], again = allowed, True


@kernel
def limit_step(m: ContactState, x: Float, v: Float, s: float, threads: int | None) -> None:
    """Shorten a step from `last` to x, v (3, n), which ends at fraction s of the interval, to where cloth meets."""
    dt = (s - m.clock[NOW]) * m.span[0]
    if m.bodies.local.shape[0] == 0:
        if limit_whole_step(m, x, v, s, threads) and m.solver.sweeps[0] == 0:
            apply_impulses(m, v, dt, SWEEPS[0], threads)
        m.solver.sweeps[0] = 0
        return
    n, goal, velocity = x.shape[1], m.goal, m.whole_velocity
    pose_solids(m, s)
    limit_ways(m, n, dt)
    copy_part(x, goal, 0, n)
    copy_part(v, velocity, 0, n)
    if limit_whole_step(m, goal, velocity, s, threads):
        copy_part(goal, x, 0, n)
        if s == 1.0:
            pose_others(m, s, s)
        if m.bodies.still[0] != PLACED:
            pose_solids(m, s)
            find_behind(m, n)
            catch_up(m, n, dt)
        apply_impulses(m, velocity, dt, SWEEPS[1], threads)
        copy_part(velocity, v, 0, n)
    m.solver.sweeps[0] = 0


@block_kernel
def list_for(m: ContactState, x: Float, s: float, threads: int | None) -> bool:
    """Make lists for a step from `last` to x (3, n), which ends at fraction s; return False if x is not finite.

    Those of bodies hold for a step more: an obstacle must be seen before, for a body cannot be slowed down then.
    """
    way = s - m.clock[NOW]
    ahead = way if m.bodies.local.shape[0] > 0 else 0.0
    renew = not holds(m, LIST, x, s, ahead)
    if renew or not holds(m, CHOSEN, x, s, ahead):
        if not all_finite(x):
            return False
        if renew:
            pose_others(m, m.clock[NOW], s)
        plan(m, sum_rows(x, -1.0, m.last), way, ahead, renew, threads)
    return True


@block_kernel
def limit_whole_step(m: ContactState, x: Float, v: Float, s: float, threads: int | None) -> bool:
    """Do so for cloth and bodies together; return False, with nothing done, if x is not finite."""
    if m.leave[0] != 0:
        return False
    m.so_far[STEPS] += 1
    dt = (s - m.clock[NOW]) * m.span[0]
    # Bodies push on with the present lists, and if new ones show more contacts, with those.
    passes, pushed = False, m.surface.law[3] > 0.0
    for _ in range(3 if pushed else 0):
        passes = m.counts[LACKING] == 0 and pass_by(m, x, v, dt, threads) == 0
        if m.counts[LACKING] == 0 and not passes:
            push_cloth_ahead(m, x, v, dt, threads)
        lists = m.counts[CHOICES]
        if not list_for(m, x, s, threads):
            return False
        if m.counts[CHOICES] == lists:
            break
        passes = False
    if not pushed and not list_for(m, x, s, threads):
        return False
    if not passes and (m.counts[LACKING] > 0 or pass_by(m, x, v, dt, threads) > 0):
        before = v.copy()
        cut_short(m, x, v, s, threads)
        credit_change(m, sum_rows(v, -1.0, before))
        all_close(m)
    else:
        m.share[:] = 1.0
    copy_active(m, x, m.last)
    m.clock[NOW], m.clock[LAST_STEP] = s, dt if m.solver.step[0] == 0.0 else 0.0
    find_touching(m, threads)
    drag_anchors(m, v, threads)
    return True


@block_kernel
def cut_short(m: ContactState, x: Float, v: Float, s: float, threads: int | None) -> None:
    """Shorten vertices' ways to x, at fraction s of the interval, in place, and their velocities v (3, n) as much."""
    last, share, spread, farthest = m.last, m.share, m.plan.spread[1], 0.0
    for i in range(x.shape[1]):
        a, b, c = x[0, i] - last[0, i], x[1, i] - last[1, i], x[2, i] - last[2, i]
        farthest = max(farthest, np.sqrt(a * a + b * b + c * c))
    if 2.0 * farthest > 0.9 * m.surface.law[0]:
        if m.counts[LACKING] == 0:
            # A pair that is not listed stays apart as long as vertices are where the plans allow. Where shortened ways
            # end there, they lead there: all that could be met is listed.
            to, at, counts = x.copy(), v.copy(), m.so_far.copy()
            shorten_to_near(m, x, v, threads)
            if holds(m, LIST, x, s, 0.0) and holds(m, CHOSEN, x, s, 0.0):
                return
            copy_rows(to, x)
            copy_rows(at, v)
            for i in range(len(counts)):  # an array assigned to another takes two seconds to compile
                m.so_far[i] = counts[i]
        # The list does where it holds for what stays where it is, as for what goes on: it then does between the two.
        renew = strays(m, LIST, last, (s - m.clock[LIST_BEGUN]) / m.clock[LIST_WINDOW])
        if renew:
            pose_others(m, m.clock[NOW], s)
        # A vertex that stays behind strays by its way: whatever it could meet thereby is listed.
        for i in range(x.shape[1]):
            a, b, c = x[0, i] - last[0, i], x[1, i] - last[1, i], x[2, i] - last[2, i]
            spread[i] = max(spread[i], np.sqrt(a * a + b * b + c * c))
        set_out(m, m.plan.zeros, 1.0, m.clock[NEAR_WINDOW], renew, threads)
    if m.counts[LACKING] > 0:
        # Unlisted pairs might meet: nothing moves.
        m.so_far[STILL] += 1
        share[:] = 0.0
        apply_shares(m, x, v)
        return
    shorten_to_near(m, x, v, threads)


@block_kernel
def shorten_to_near(m: ContactState, x: Float, v: Float, threads: int | None) -> None:
    """Shorten ways to x and velocities v (3, n) in place, by the near pairs."""
    if is_thorough(m) and find_shares(m, m.last, sum_rows(x, -1.0, m.last), CLOSEST):
        apply_shares(m, x, v)
        if pass_by(m, x, v, 0.0, threads) == 0:
            return
    shorten(m, x)
    apply_shares(m, x, v)


@block_kernel
def apply_shares(m: ContactState, x: Float, v: Float) -> None:
    """Apply the shares of ways to x and, but for bodies, to velocities v (3, n), in place, and count them."""
    last, share, cloth = m.last, m.share, x.shape[1] - m.bodies.local.shape[0]
    m.bodies.posed[0] = np.nan
    for i in range(x.shape[1]):
        if share[i] < 1.0:
            if i < cloth:  # bodies' vertices have no mass either, and hold nothing
                m.so_far[CUT if m.surface.mass[i] > 0.0 else HELD_CUT] += 1
            for row in range(3):
                x[row, i] = last[row, i] + share[i] * (x[row, i] - last[row, i])
                if i < cloth:
                    v[row, i] *= share[i]
