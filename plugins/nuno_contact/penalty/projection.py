"""Contact and friction as compliant constraints of an XPBD step, one vertex at a time.

The penalty force on a vertex is linear in its displacement while it touches: N = -k s - c ds/dt along the
normal (s the signed distance), -k xi - c u_t across, to the spring of Coulomb friction. Backward Euler
for the vertex alone is therefore solved in one go. With the mobility h^2 / m' (nuno_kernels.forces.constraints),
and both forces taken where the vertex is without them,

    N' = max(0, N / (1 + (k + c / h) mobility)),    F' = F_t / (1 + (k + c / h) mobility), |F'| <= mu N',

(without k across before there is an anchor), and the displacement grows by mobility times both. Where
the dashpot is bounded (Contact.rate = 1 / h) its force is c / h times the depth, so that the quotient is
the same. A vertex at rest sinks m g / k at any step. The cone takes N' of the step's end, so that nothing
that sticks creeps. Not chosen: a 3 x 3 block a vertex from differences, as in nuno_integrators.implicit.newton, takes
four evaluations where this takes one; an explicit force limits the step by its stiffness.

Where sweeps are repeated, what the vertex was moved by contact is taken back first: it lets go of what
it left. Bodies that a vertex touches together follow each other, as constraints do.
"""

from __future__ import annotations

import numpy as np

from nuno_contact.penalty.contact import (
    BLOCK,
    BodyContact,
    Contact,
    bodies_of,
    body_contact,
    find_deepest,
    limit_friction,
    pose_bodies,
    respond,
    rub,
)  # fmt: skip
from nuno_contact.penalty.distance import Bodies, Fields, find_bounds
from nuno_kernels import block_kernel, kernel
from nuno_kernels.terms import Displaced, over_blocks
from nuno_schemas.fabric import Float


@block_kernel
def place_block(low: int, high: int, moved: Displaced, held: Float | None) -> None:
    """Compute y = x + u and w = u / h on vertices [low, high), contact's part taken back from u first."""
    x, u, y, w = moved.x, moved.u, moved.y, moved.w
    for row in range(3):
        for i in range(np.uint64(low), np.uint64(high)):
            if held is not None:
                u[row, i] -= held[row, i]
                held[row, i] = 0.0
            y[row, i] = x[row, i] + u[row, i]
            w[row, i] = u[row, i] * moved.inverse_step


@kernel
def push_body(
    low: int, high: int, moved: Displaced, held: Float | None, touch: BodyContact, bodies: Bodies, fields: Fields | None
) -> int:
    """Solve one body's contact with vertices [low, high); return how many lay on a capsule's axis."""
    u, y, w, mobility, inverse_step = moved.u, moved.y, moved.w, moved.mobility, moved.inverse_step
    on_axis, deepest, stiffness, damping, anchor_frame = (
        0, touch.deepest, touch.stiffness, touch.damping, touch.anchor_frame
    )  # fmt: skip
    for i in range(np.uint64(low), np.uint64(high)):
        if deepest[i] < 0:
            continue
        k, c = stiffness[i], damping[i]
        found = respond(y, w, i, touch, bodies, fields)
        on_axis += found.mark
        push = found.push * (1.0 / (1.0 + (k + c * inverse_step) * mobility[0, i]))
        # A vertex without anchor is held by the dashpot alone.
        across = k if anchor_frame[i] >= 0 else 0.0
        share = 1.0 / (1.0 + (across + c * inverse_step) * mobility[0, i])
        fx, fy, fz = rub(k, c, found)
        force = limit_friction(found, (share * fx, share * fy, share * fz), push, touch.friction * push)
        for row in range(3):
            step = mobility[0, i] * force[row]
            u[row, i] += step
            y[row, i] += step
            w[row, i] += step * inverse_step
            if held is not None:
                held[row, i] += step
    return on_axis


@block_kernel
def push_block(block: int, contact: Contact, moved: Displaced, held: Float | None) -> None:
    """Solve the contact of one block's vertices; bodies are posed already."""
    y, bodies, fields = moved.y, bodies_of(contact), contact.fields
    low, high = block * BLOCK, min((block + 1) * BLOCK, y.shape[1])
    place_block(low, high, moved, held)
    find_bounds(y, low, high, contact.bounds, block)
    for body in range(contact.friction.shape[0]):
        if find_deepest(y, low, high, block, body, contact, fields):
            on_axis = push_body(low, high, moved, held, body_contact(contact, body, moved.inverse_step), bodies, fields)
            contact.tally[block, 1] += on_axis


push_blocks = over_blocks(push_block, "contact, moved, held")


@kernel
def project(contact: Contact, moved: Displaced, s: float, held: Float | None, threads: int | None) -> None:
    """Solve all contact with the bodies as they are at fraction s, in place in `moved`.

    The same bits with any number of threads; None is for one. `held` (3, n) keeps contact's displacements [m] if sweeps
    are repeated, and is None if not.
    """
    pose_bodies(s, contact)
    push_blocks(contact, moved, held, contact.bounds.shape[0], threads)
