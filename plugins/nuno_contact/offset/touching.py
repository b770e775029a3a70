"""Which pairs touch after a step, how much of their damping a step can follow, and what friction holds together."""

from __future__ import annotations

from nuno_contact.offset.force import Touch, across, corners_of, faces_of, press, share_out, touch
from nuno_contact.offset.meeting import Meeting
from nuno_contact.offset.proximity import between, unit, weigh
from nuno_kernels import block_kernel
from nuno_schemas.fabric import Float

MOST = 1.5
"""Rate of damping by contact times the step, at most."""


@block_kernel
def find_touching(m: Meeting) -> None:
    """Which close pairs touch at `last`, where, and the planes across them; others have no anchor."""
    pair, of, reach, normal, anchored, mesh, x = m.pair, m.of, m.reach, m.normal, m.anchored, faces_of(m), m.last
    close, touching, weights, gap, number = m.close, m.touching, m.weights, m.distance, 0
    for q in range(m.number[6]):
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
            touching[number], gap[p] = p, at.distance
            number += 1
            for corner in range(4):
                weights[p, corner] = at.weights[corner]
        else:
            anchored[p] = False
    m.tally[0] = number
    ease(m, m.clock[7] if m.swept[0] == 0 else 0.0)
    share_out(pair, touching, number, m.touch_start, m.touch_pair)


@block_kernel
def ease(m: Meeting, dt: float) -> None:
    """How much of its damping each pair that touches has in a step of dt [s]: no more than the step can follow.

    A vertex amid twenty contacts would be thrown to and fro by all their dashpots, each of which alone is slow enough.
    The rates at which they slow cloth down are the eigenvalues of M^-1 sum_p c_p w_p w_p^T, at most the greatest sum
    over a row, max_i sum_p 2 c_p |w_pi| / m_i (Gershgorin); an explicit step throws to and fro what is above 2 / dt.
    """
    rate, mass = m.rate, m.mass
    for turn in range(2):
        for q in range(m.tally[0]):
            p = m.touching[q]
            for corner in range(4):
                i = m.pair[p, corner]
                more = 2.0 * m.pair_damping[p] * abs(m.weights[p, corner]) / mass[i] if mass[i] > 0.0 else 0.0
                rate[i] = rate[i] + more if turn == 1 else 0.0
    for q in range(m.tally[0]):
        p, fastest = m.touching[q], 0.0
        for corner in range(4):
            fastest = max(fastest, rate[m.pair[p, corner]])
        m.eased[p] = MOST / (dt * fastest) if dt * fastest > MOST else 1.0


@block_kernel
def drag_anchors(m: Meeting, v: Float) -> None:
    """Set the anchors of pairs that touch at `last` and move at v (3, n), or drag them along."""
    pair, reach, normal, anchor, anchored, weights, eased = (
        m.pair, m.reach, m.normal, m.anchor, m.anchored, m.weights, m.eased
    )  # fmt: skip
    stiffness, damping, mu, x, touching, gap = (
        m.pair_stiffness, m.pair_damping, m.pair_friction, m.last, m.touching, m.distance
    )  # fmt: skip
    for q in range(m.tally[0]):
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
