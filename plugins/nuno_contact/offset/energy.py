"""The energy of contacts whose forces are in nuno_contact.offset.force."""

from __future__ import annotations

import math

from nuno_contact.offset.bodies import copy_part
from nuno_contact.offset.contact_state import ContactState
from nuno_contact.offset.force import STEEPEST, across, corners_of, faces_of, touch
from nuno_contact.offset.places import NEAR
from nuno_contact.offset.proximity import weigh
from nuno_kernels import forced_inline, kernel
from nuno_kernels.lanes.triples import dot
from nuno_schemas.fabric import Float


@forced_inline
def stored(k: float, h: float, distance: float) -> float:
    """Return the energy [J] of nuno_contact.offset.force.push."""
    if distance >= 0.5 * h:
        return 0.5 * k * (h - distance) * (h - distance)
    d = max(distance, STEEPEST * h)
    deeper = (d - distance) / d
    return k * h * h * (0.125 + 0.25 * (math.log(0.5 * h / d) + deeper + 0.5 * deeper * deeper))


@kernel
def measure_pairs(m: ContactState, x: Float) -> float:
    """Return the energy [J] of all contacts at x (3, n), with that of friction's springs, and bodies as they are."""
    if m.local.shape[0] > 0:
        copy_part(x, m.whole, 0, x.shape[1])
        x = m.whole
    pair, of, reach, stiffness, mesh, total = m.pair, m.of, m.reach, m.pair_stiffness, faces_of(m), 0.0
    for q in range(m.number[NEAR]):
        p = m.near[q]
        i, j, k, l = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]  # noqa: E741
        corners = corners_of(x, i, j, k, l)
        at = touch(x, i, of[p], corners, reach[p], mesh)
        if at.distance < reach[p]:
            total += stored(stiffness[p], reach[p], at.distance)
            if m.anchored[p]:
                a = (m.anchor[p, 0], m.anchor[p, 1], m.anchor[p, 2], m.anchor[p, 3])
                e = across(weigh(a, corners), at.normal)
                total += 0.5 * stiffness[p] * dot(e, e)
    return total
