"""Contact and friction as compliant constraints of an XPBD step, one vertex at a time.

The penalty force on a vertex is linear in its displacement while it touches: N = -k s - c ds/dt along the
normal (s the signed distance), -k xi - c u_t across, to the spring of Coulomb friction. Backward Euler
for the vertex alone is therefore solved in one go. With the mobility h^2 / m' (nuno_integrators.xpbd.constraints),
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

import math
from typing import Any

import numpy as np
from numba import prange

from nuno_contact.penalty.contact import BLOCK
from nuno_contact.penalty.distance import find_bounds
from nuno_contact.penalty.poses import pose_bodies
from nuno_contact.penalty.response import find_deepest, respond
from nuno_kernels import kernel, parallel_kernel


@kernel
def place_block(low: int, high: int, x: Any, u: Any, inverse_step: float, held: Any, y: Any, w: Any) -> None:
    """y = x + u and w = u / h on vertices [low, high), what contact did taken back from u first."""
    for row in range(3):
        for i in range(np.uint64(low), np.uint64(high)):
            if held is not None:
                u[row, i] -= held[row, i]
                held[row, i] = 0.0
            y[row, i] = x[row, i] + u[row, i]
            w[row, i] = u[row, i] * inverse_step


@kernel
def push_body(
    low: int, high: int, body: int, u: Any, y: Any, w: Any, inverse_step: float, mobility: Any, held: Any,
    kind: Any, frame: Any, stiffness: Any, damping: Any, friction: Any, posed: Any, frames: Any,
    deepest: Any, anchor: Any, anchor_frame: Any, head: Any, cells: Any, corners: Any,
) -> int:  # fmt: skip
    """Solve one body's contact with vertices [low, high); returns how many lay on a capsule's axis."""
    on_axis, mu = 0, friction[body]
    for i in range(np.uint64(low), np.uint64(high)):
        if deepest[body, i] < 0:
            continue
        p = np.uint64(deepest[body, i])
        k, c = stiffness[body, i], damping[body, i]
        _, normal, ex, ey, ez, nx, ny, nz, tx, ty, tz, mark = respond(
            y, w, i, body, p, kind[p], np.uint64(frame[p]), k, c, posed, frames, anchor, anchor_frame, inverse_step,
            head, cells, corners,
        )  # fmt: skip
        on_axis += mark
        normal *= 1.0 / (1.0 + (k + c * inverse_step) * mobility[0, i])
        # A vertex without anchor is held by the dashpot alone.
        across = k if anchor_frame[body, i] >= 0 else 0.0
        share = 1.0 / (1.0 + (across + c * inverse_step) * mobility[0, i])
        fx, fy, fz = share * (-k * ex - c * tx), share * (-k * ey - c * ty), share * (-k * ez - c * tz)
        size, limit = math.sqrt(fx * fx + fy * fy + fz * fz), mu * normal
        kept = limit / size if size > limit else 1.0
        force = (normal * nx + kept * fx, normal * ny + kept * fy, normal * nz + kept * fz)
        for row in range(3):
            moved = mobility[0, i] * force[row]
            u[row, i] += moved
            y[row, i] += moved
            w[row, i] += moved * inverse_step
            if held is not None:
                held[row, i] += moved
    return on_axis


@kernel
def push_block(
    block: int, x: Any, u: Any, y: Any, w: Any, inverse_step: float, mobility: Any, held: Any, contact: Any
) -> None:
    """Solve the contact of one block's vertices; bodies are posed already."""
    low, high = block * BLOCK, min((block + 1) * BLOCK, x.shape[1])
    place_block(low, high, x, u, inverse_step, held, y, w)
    find_bounds(y, low, high, contact.bounds, block)
    for body in range(contact.friction.shape[0]):
        if find_deepest(
            y, low, high, contact.first[body], contact.first[body + 1], contact.kind, contact.frame, contact.posed,
            contact.frames, contact.bounds, block, contact.distance, contact.deepest, contact.near, body,
            contact.field_head, contact.field_cells, contact.field_corners,
        ):  # fmt: skip
            contact.tally[block, 1] += push_body(
                low, high, body, u, y, w, inverse_step, mobility, held, contact.kind, contact.frame,
                contact.stiffness, contact.damping, contact.friction, contact.posed, contact.frames,
                contact.deepest, contact.anchor, contact.anchor_frame, contact.field_head, contact.field_cells,
                contact.field_corners,
            )  # fmt: skip


@kernel
def push_out(
    x: Any, u: Any, y: Any, w: Any, s: float, inverse_step: float, mobility: Any, held: Any, contact: Any
) -> None:
    """Solve all contact with the bodies as they are at fraction s, in place in u (3, n); y, w (3, n) are scratch."""
    pose_bodies(s, contact)
    for block in range(contact.bounds.shape[0]):
        push_block(block, x, u, y, w, inverse_step, mobility, held, contact)


@parallel_kernel
def push_out_parallel(
    x: Any, u: Any, y: Any, w: Any, s: float, inverse_step: float, mobility: Any, held: Any, contact: Any
) -> None:
    """push_out on several threads: the same bits."""
    pose_bodies(s, contact)
    for block in prange(contact.bounds.shape[0]):
        push_block(block, x, u, y, w, inverse_step, mobility, held, contact)


@kernel
def project(
    contact: Any, x: Any, u: Any, y: Any, w: Any, s: float, inverse_step: float, mobility: Any, held: Any, threads: Any
) -> None:
    """push_out on one thread or several."""
    if threads is None:
        push_out(x, u, y, w, s, inverse_step, mobility, held, contact)
    else:
        push_out_parallel(x, u, y, w, s, inverse_step, mobility, held, contact)
