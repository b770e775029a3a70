"""Touching pairs after a step, the damping that a step can follow, and the anchors of friction."""

from __future__ import annotations

import numpy as np

from nuno_contact.offset.contact_state import IN_TURN, PARTS, WORTH, ContactState, close_up
from nuno_contact.offset.force import Touch, across, corners_of, faces_of, press, touch
from nuno_contact.offset.places import CLOSE, LAST_STEP, TOUCHING
from nuno_contact.offset.proximity import between, unit, weigh
from nuno_contact.offset.sharing import share_out
from nuno_kernels import block_kernel
from nuno_kernels.step.blocks import BLOCK, Long
from nuno_kernels.terms import over_blocks
from nuno_schemas.fabric import Float

MOST = 1.5
"""greatest rate of damping by contact times the step"""


@block_kernel
def touch_part(part: int, m: ContactState, number: Long) -> None:
    """Find which of a part of the close pairs touch at `last`: into m.touching from the part's first place on."""
    pair, of, reach, normal, anchored, mesh, x = m.pair, m.of, m.reach, m.normal, m.anchored, faces_of(m), m.last
    close, touching, weights, gap = m.close, m.touching, m.weights, m.distance
    first, end = part * m.number[CLOSE] // PARTS, (part + 1) * m.number[CLOSE] // PARTS
    at_end = first
    for q in range(first, end):
        p = close[q]
        i, j, k, l = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]  # noqa: E741
        corners, h = corners_of(x, i, j, k, l), reach[p]
        low, high = between(of[p] < 0, (normal[p, 0], normal[p, 1], normal[p, 2]), corners)
        if low - high > h:
            anchored[p] = False
            continue
        at = touch(x, i, of[p], corners, reach[p], mesh)
        normal[p, 0], normal[p, 1], normal[p, 2] = at.normal
        if at.distance < h:
            touching[at_end], gap[p] = p, at.distance
            at_end += 1
            for corner in range(4):
                weights[p, corner] = at.weights[corner]
        else:
            anchored[p] = False
    number[part] = at_end - first


@block_kernel
def rate_block(block: int, m: ContactState) -> None:
    """Find the greatest rate at which dashpots slow the block's vertices down, m.rate [1/s]; see ease_part."""
    rate, mass, first, end = m.rate, m.mass, block * BLOCK, min((block + 1) * BLOCK, m.rate.shape[0])
    for i in range(first, end):
        rate[i] = 0.0
    for q in range(m.touch_start[block], m.touch_start[block + 1]):
        p = m.touch_pair[q]
        for corner in range(4):
            i = m.pair[p, corner]
            if first <= i < end and mass[i] > 0.0:
                rate[i] += 2.0 * m.pair_damping[p] * abs(m.weights[p, corner]) / mass[i]


@block_kernel
def ease_part(part: int, m: ContactState, dt: float) -> None:
    """Limit the damping of each touching pair in a step of dt [s] to what the step can follow.

    A vertex amid twenty contacts would be thrown to and fro by all their dashpots, each of which alone is slow enough.
    The rates at which they slow cloth down are the eigenvalues of M^-1 sum_p c_p w_p w_p^T, at most the greatest sum
    over a row, max_i sum_p 2 c_p |w_pi| / m_i (Gershgorin); an explicit step throws to and fro what is above 2 / dt.
    """
    for q in range(part * m.number[TOUCHING] // PARTS, (part + 1) * m.number[TOUCHING] // PARTS):
        p, fastest = m.touching[q], 0.0
        for corner in range(4):
            fastest = max(fastest, m.rate[m.pair[p, corner]])
        m.eased[p] = MOST / (dt * fastest) if dt * fastest > MOST else 1.0


touch_parts = over_blocks(touch_part, "m, number", WORTH, IN_TURN)
rate_blocks = over_blocks(rate_block, "m", WORTH)
ease_parts = over_blocks(ease_part, "m, dt", WORTH, IN_TURN)


@block_kernel
def find_touching(m: ContactState, threads: int | None) -> None:
    """Find which close pairs touch at `last`, where, and the planes across them; others lose their anchors."""
    number, dt = np.empty(PARTS, np.int64), m.clock[LAST_STEP] if m.swept[0] == 0 else 0.0
    touch_parts(m, number, PARTS, m.number[CLOSE], threads)
    m.number[TOUCHING] = close_up(m.touching, m.number[CLOSE], number)
    share_out(m, m.touching, m.number[TOUCHING], m.touch_start, m.touch_pair, threads)
    if dt > 0.0:
        rate_blocks(m, m.touch_start.shape[0] - 1, m.number[TOUCHING], threads)
    ease_parts(m, dt, PARTS, m.number[TOUCHING], threads)


@block_kernel
def drag_part(part: int, m: ContactState, v: Float) -> None:
    """Set the anchors of a part of the pairs that touch at `last` and move at v (3, n), or drag them along."""
    pair, reach, normal, anchor, anchored, weights, eased = (
        m.pair, m.reach, m.normal, m.anchor, m.anchored, m.weights, m.eased
    )  # fmt: skip
    stiffness, damping, mu, x, touching, gap = (
        m.pair_stiffness, m.pair_damping, m.pair_friction, m.last, m.touching, m.distance
    )  # fmt: skip
    for q in range(part * m.number[TOUCHING] // PARTS, (part + 1) * m.number[TOUCHING] // PARTS):
        p = touching[q]
        i, j, k, l = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]  # noqa: E741
        w, n = (weights[p, 0], weights[p, 1], weights[p, 2], weights[p, 3]), (normal[p, 0], normal[p, 1], normal[p, 2])
        share = 0.0
        if anchored[p]:
            a = (anchor[p, 0], anchor[p, 1], anchor[p, 2], anchor[p, 3])
            if m.swept[0] > 0 and m.kept[p]:
                share = m.pulled[p, 3]
            else:
                _, size = unit(across(weigh(a, corners_of(x, i, j, k, l)), n))
                u = weigh(w, corners_of(v, i, j, k, l))
                limit = mu[p] * press(stiffness[p], eased[p] * damping[p], reach[p], Touch(w, n, gap[p]), u)
                share = 1.0 if stiffness[p] * size <= limit else limit / (stiffness[p] * size)
        anchored[p] = True
        for corner in range(4):
            anchor[p, corner] = w[corner] + share * (anchor[p, corner] - w[corner]) if share > 0.0 else w[corner]


drag_parts = over_blocks(drag_part, "m, v", WORTH, IN_TURN)


@block_kernel
def drag_anchors(m: ContactState, v: Float, threads: int | None) -> None:
    """Do so for all touching pairs."""
    drag_parts(m, v, PARTS, m.number[TOUCHING], threads)
