"""Contacts as compliant constraints of an XPBD step, one pair after another in the list's order.

A pair's force (nuno_contact.offset.force) acts on the way between its closest points, r = sum w_i x_i. Where the pair
were alone, backward Euler has

    d' = d + W N',    W = sum w_i^2 mobility_i,    mobility = h^2 / m'  (nuno_kernels.forces.constraints),
    N' = N(d') - c / h (s + W N')  and not negative,

d the distance along the normal and s the way gone along it in the step, both without the pair's force. The law N is of
three pieces, each solved in one go: a line, a hyperbola (a quadratic equation) and a line. Friction is solved as
against bodies (nuno_contact.penalty.projection): F' = F / (1 + (k + c / h) W), and |F'| <= mu N'. This is the
inequality constraint of XPBD (Macklin, Mueller & Chentanez 2016) with the compliance of the force law, so that the
limit of short steps is what explicit and implicit methods have.

Pairs that would still be nearer than a quarter of the thickness, and nearer than before the step, are stopped there
without compliance, as in an inelastic encounter: other methods have nuno_contact.offset.impulse for that.

Each pair's force is kept and taken back before it is found anew, so that the limit of repeated sweeps is the step
itself. It acts where the pair is closest at the end of the way without it; of a pair that has passed through itself by
then, where it first comes near on that way: each step of conservative advancement (Mirtich 1996) goes as far as a plane
across the closest points allows.

How much of its anchor's way a pair that slides keeps follows from the force that it asked for and the one that it got,
not from the law's at the step's end: sweeps that have not converged leave them a little apart, and what sticks crept.

One thread does it, forth and back through the list, so that the bits are the same whatever the threads. Not chosen:
colours, as springs have, since pairs change from step to step; the tensions of the last step as a start, which would
have to be part of the state.
"""

from __future__ import annotations

import math

import numpy as np

from nuno_contact.offset.bodies import copy_part, keep_all, limit_ways, pose_solids
from nuno_contact.offset.contact_state import CLOSE, NEAR, ContactState
from nuno_contact.offset.force import RAMP, STEEPEST, Touch, across, corners_of, faces_of, touch
from nuno_contact.offset.impulse import IMPULSE_RANGE, LEVER
from nuno_contact.offset.proximity import Corners, between, closest, unit, weigh
from nuno_contact.offset.separating_plane import cover, on_the_way
from nuno_kernels import block_kernel, forced_inline
from nuno_kernels.lanes import dot, minus
from nuno_kernels.step.blocks import all_finite, copy_rows
from nuno_kernels.terms import Displaced
from nuno_schemas.fabric import Float

SWEEPS = 8
"""sweeps over all pairs that may touch, at most, for each sweep over the springs"""
SETTLED = 1e-4
"""share of the thickness; sweeps end after one in which no pair moves its vertices by more, over that before"""
TURNS = 32
"""steps of conservative advancement at most"""


@block_kernel
def project(m: ContactState, moved: Displaced, s: float, held: Float | None, threads: int | None) -> None:
    """Solve all cloth contacts for a step that ends at fraction s, in place in `moved`."""
    if m.bodies.local.shape[0] == 0:
        project_whole(m, moved, s, threads)
        return
    keep_all(m)
    n, all_of = moved.x.shape[1], m.goal.shape
    x, u, y, mobility = np.empty(all_of), np.empty(all_of), np.empty(all_of), np.zeros((1, all_of[1]))
    copy_part(moved.x, x, 0, n)
    copy_part(moved.u, u, 0, n)
    copy_rows(moved.mobility, mobility)
    pose_solids(m, s)
    limit_ways(m, n, 1.0 / moved.inverse_step)
    copy_part(m.last, x, n, all_of[1])
    for row in range(3):
        for i in range(n, all_of[1]):
            u[row, i] = m.goal[row, i] - x[row, i]
    project_whole(m, Displaced(x, u, y, y, mobility, moved.inverse_step), s, threads)
    copy_part(u, moved.u, 0, n)


@block_kernel
def project_whole(m: ContactState, moved: Displaced, s: float, threads: int | None) -> None:
    """Do so for cloth and bodies, which go their way."""
    pairs = m.pairs
    x, u, y, near = moved.x, moved.u, moved.y, pairs.near
    for row in range(3):
        for i in range(x.shape[1]):
            y[row, i] = x[row, i] + u[row, i]
    if not all_finite(y):
        return
    if m.solver.sweeps[0] == 0:
        cover(m, y, s, threads)
        for q in range(m.counts[NEAR]):
            m.solver.kept[near[q]] = False
    gather(m, y)
    for _ in range(SWEEPS):
        last, forth, most = m.counts[CLOSE] - 1, m.solver.sweeps[0] % 2 == 0, 0.0
        for q in range(last + 1):
            most = max(most, solve_pair(m, pairs.close[q if forth else last - q], moved))
        m.solver.sweeps[0] += 1
        if most < SETTLED * m.surface.law[0]:
            break


@block_kernel
def gather(m: ContactState, y: Float) -> None:
    """Note as close the near pairs that touch at y (3, n), or may during the solution."""
    pairs = m.pairs
    pair, of, reach, normal = pairs.vertices, pairs.face, pairs.reach, pairs.normal
    near, close, number = pairs.near, pairs.close, 0
    for q in range(m.counts[NEAR]):
        p = near[q]
        there = corners_of(y, pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3])
        low, high = between(of[p] < 0, (normal[p, 0], normal[p, 1], normal[p, 2]), there)
        close[number] = p
        number += 1 if m.solver.kept[p] or low - high < 2.0 * reach[p] else 0
    m.counts[CLOSE] = number


@block_kernel
def solve_pair(m: ContactState, p: int, moved: Displaced) -> float:
    """Compute a pair's force anew, and move its vertices by it; return the change of their way [m]."""
    former, x, y, z = bool(m.solver.kept[p]), 0.0, 0.0, 0.0
    if former:
        x, y, z = m.solver.force[p, 0], m.solver.force[p, 1], m.solver.force[p, 2]
        add(m, p, moved, -1.0)
    m.solver.kept[p] = find_force(m, p, moved)
    if m.solver.kept[p]:
        x, y, z = x - m.solver.force[p, 0], y - m.solver.force[p, 1], z - m.solver.force[p, 2]
        add(m, p, moved, 1.0)
    elif not former:
        return 0.0
    both = 0.0
    for corner in range(4):
        w = m.solver.kept_weights[p, corner]
        both += w * w * moved.mobility[0, m.pairs.vertices[p, corner]]
    return both * math.sqrt(x * x + y * y + z * z)


@block_kernel
def find_force(m: ContactState, p: int, moved: Displaced) -> bool:
    """Compute the `force` of a pair that has none, and its `kept_weights`; return whether there is any."""
    pairs, anchor, anchored = m.pairs, m.anchor, m.anchored
    x, u, y, mobility, inverse_step, pair = (
        moved.x,
        moved.u,
        moved.y,
        moved.mobility,
        moved.inverse_step,
        pairs.vertices,
    )
    i, j, k, l = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]  # noqa: E741
    h, there = pairs.reach[p], corners_of(y, i, j, k, l)
    n = (pairs.normal[p, 0], pairs.normal[p, 1], pairs.normal[p, 2])
    low, high = between(pairs.face[p] < 0, n, there)
    if low - high >= h:
        return False
    here = corners_of(x, i, j, k, l)
    at = touch(y, i, pairs.face[p], there, h, faces_of(m))
    low, high = between(pairs.face[p] < 0, at.normal, here)
    if not low > high:
        met = encounter(pairs.face[p] < 0, here, there, IMPULSE_RANGE * h)
        at = met if met.distance < math.inf else at
    w, n = at.weights, at.normal
    both = (
        w[0] * w[0] * mobility[0, i] + w[1] * w[1] * mobility[0, j]
        + w[2] * w[2] * mobility[0, k] + w[3] * w[3] * mobility[0, l]
    )  # fmt: skip
    if not (at.distance < h and both > 0.0):
        return False
    stiff, rate, gone = pairs.stiffness[p], pairs.damping[p] * inverse_step, weigh(w, corners_of(u, i, j, k, l))
    ramp = min(1.0, (h - at.distance) / (RAMP * h))
    pressed = press_back(stiff, ramp * rate, h, at.distance, dot(n, gone), both)
    if at.distance + both * pressed < IMPULSE_RANGE * h:
        before = weigh(closest(pairs.face[p] < 0, here).weights, here)
        floor = min(IMPULSE_RANGE * h, math.sqrt(dot(before, before)))
        least = math.inf
        for corner in (i, j, k, l):
            least = min(least, mobility[0, corner] if mobility[0, corner] > 0.0 else math.inf)
        pressed = max(pressed, (floor - at.distance) / max(both, LEVER * least))
    t = across(gone, n)
    e = t
    if anchored[p]:
        e = across(
            weigh((anchor[p, 0], anchor[p, 1], anchor[p, 2], anchor[p, 3]), there),
            n,
        )
    share = -1.0 / (1.0 + (stiff + rate) * both)
    f = (
        share * (stiff * e[0] + rate * t[0]), share * (stiff * e[1] + rate * t[1]), share * (stiff * e[2] + rate * t[2])
    )  # fmt: skip
    size, most = math.sqrt(dot(f, f)), pairs.friction[p] * pressed
    share = most / size if size > most else 1.0
    m.solver.force[p, 3] = share
    for row in range(3):
        m.solver.force[p, row] = share * f[row] + pressed * n[row]
    for corner in range(4):
        m.solver.kept_weights[p, corner] = w[corner]
    return True


@forced_inline
def add(m: ContactState, p: int, moved: Displaced, sign: float) -> None:
    """Move a pair's vertices by its force, or back by it."""
    u, y, mobility = moved.u, moved.y, moved.mobility
    for corner in range(4):
        v = m.pairs.vertices[p, corner]
        scale = sign * m.solver.kept_weights[p, corner] * mobility[0, v]
        for row in range(3):
            way = scale * m.solver.force[p, row]
            u[row, v] += way
            y[row, v] += way


@forced_inline
def press_back(k: float, c: float, h: float, d: float, s: float, both: float) -> float:
    """Return N' [N] for a distance d and a way s [m] without it, k and c / h [N/m], and W [m/N]."""
    damped = 1.0 + c * both
    pressed = (k * (h - d) - c * s) / (damped + k * both)
    if d + both * pressed < 0.5 * h:
        b = damped * d - c * both * s
        end = (b + math.sqrt(b * b + damped * k * h * h * both)) / (2.0 * damped)
        pressed = (end - d) / both
        if end < STEEPEST * h:
            steep = 0.25 * k / (STEEPEST * STEEPEST)
            pressed = (steep * (2.0 * STEEPEST * h - d) - c * s) / (damped + steep * both)
    return max(0.0, pressed)


@block_kernel
def encounter(of_edges: bool, here: Corners, there: Corners, stop: float) -> Touch:
    """Return the contact of a pair that goes straight from one place to another and comes as near as `stop` [m] on its
    way, or half as near as it was; its distance is that at the end across the plane of contact, negative beyond it, and
    infinite if it never comes so near.
    """
    go = (minus(there[0], here[0]), minus(there[1], here[1]), minus(there[2], here[2]), minus(there[3], here[3]))
    share = 0.0
    for turn in range(TURNS):
        now = on_the_way(here, there, (share, share, share, share))
        w = closest(of_edges, now).weights
        n, distance = unit(weigh(w, now))
        if turn == 0:
            stop = min(stop, 0.5 * distance)
        low, high = between(of_edges, n, go)
        if (high - low) * (1.0 - share) <= distance - stop:
            return Touch(w, n, math.inf)
        if distance <= 1.001 * stop:
            break
        share += (distance - stop) / (high - low)
    return Touch(w, n, dot(n, weigh(w, there)))
