"""The contacts' part in the matrix of an implicit step: for each pair that touches w_a w_b S, S a 3 x 3 block.

With n the direction between the closest points and w their weights a pair pulls with N n + t at w_a on each of its
vertices, and S is the derivative of that by the closest points' way,

    S = (dN/dd + c / g) n n^T + K (I - n n^T),    K = k + c / g,

1 / g being the method's dv/dx. A sliding pair, whose friction keeps its size mu N and turns with the way, has K only
across the direction in which it slides, as mu N / |t| of it. Terms without sign or negative ones are left out: the
changes of weights and n, and the growth of friction with N. Which vertices are touched changes from step to step, so
that no order of elimination is planned for it: where a factorisation solves, it is the preconditioner of what these add
(nuno_integrators.implicit.linear_solve).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_contact.offset.bodies import copy_part
from nuno_contact.offset.contact_state import NEAR, ContactState
from nuno_contact.offset.force import RAMP, STEEPEST, across, corners_of, faces_of, frozen_touch, press, touch
from nuno_contact.offset.proximity import Four, between, unit, weigh
from nuno_geometry.poses import Vector
from nuno_kernels import block_kernel, forced_inline, kernel
from nuno_kernels.compilation.reference import by_reference
from nuno_kernels.lanes import dot
from nuno_kernels.step.blocks import PADDING
from nuno_schemas.fabric import Float, Int

Six = tuple[float, float, float, float, float, float]
"""xx, yy, zz, xy, xz, yz of a symmetric matrix"""


@by_reference
class ContactMatrix(NamedTuple):
    """The matrix of each block's touching pairs, from the block's first place in Pairs.block_pair on.

    number (B,) how many they are
    which  (4 P,) their numbers in the list
    weight (4 P, 4) of their vertices
    stiff  (4 P, 6) S [N/m]
    """

    number: NDArray[np.int64]
    which: Int
    weight: Float
    stiff: Float


def make_contact_matrix(m: ContactState) -> ContactMatrix:
    """Allocate the matrix of a contact state; it takes memory as it is used."""
    pairs = m.pairs
    places, blocks = pairs.block_pair.shape[0], pairs.block_start.shape[0] - 1
    return ContactMatrix(
        np.zeros(blocks, np.int64), np.zeros(places, np.int32), np.zeros((places, 4)), np.zeros((places, 6))
    )


@forced_inline
def slope(k: float, h: float, distance: float) -> float:
    """Return - dN/dd of nuno_contact.offset.force.push [N/m]."""
    if distance >= 0.5 * h:
        return k
    d = max(distance, STEEPEST * h)
    return k * h * h / (4.0 * d * d)


@forced_inline
def spread_out(normal: float, tangent: float, slid: float, n: Vector, t: Vector) -> Six:
    """Return normal n n^T + tangent (I - n n^T) - slid t t^T."""
    a = normal - tangent
    return (
        tangent + a * n[0] * n[0] - slid * t[0] * t[0],
        tangent + a * n[1] * n[1] - slid * t[1] * t[1],
        tangent + a * n[2] * n[2] - slid * t[2] * t[2],
        a * n[0] * n[1] - slid * t[0] * t[1],
        a * n[0] * n[2] - slid * t[0] * t[2],
        a * n[1] * n[2] - slid * t[1] * t[2],
    )


@forced_inline
def write_row(rows: ContactMatrix, at: int, p: int, w: Four, s: Six) -> None:
    """Write a pair to its place."""
    rows.which[at] = p
    for corner in range(4):
        rows.weight[at, corner] = w[corner]
    for row in range(6):
        rows.stiff[at, row] = s[row]


@block_kernel
def foresee(m: ContactState, x: Float, d: Float, out: Float) -> bool:
    """Mark as `expected` the near pairs, apart at x (3, n), that touch after d (3, n) with their present closest
    points, and add to out (3, n) their pull as if they had touched; return whether they are others than before.
    """
    pairs = m.pairs
    pair, of, reach, stiffness = pairs.vertices, pairs.face, pairs.reach, pairs.stiffness
    expected, mesh, changed, n = m.solver.expected, faces_of(m), False, x.shape[1]
    if m.bodies.local.shape[0] > 0:
        copy_part(x, m.whole, 0, n)
        copy_part(d, m.way, 0, n)
        for i in range(n, m.way.shape[1]):
            for row in range(3):
                m.way[row, i] = m.goal[row, i] - m.whole[row, i]
        x, d = m.whole, m.way
    for q in range(m.counts[NEAR]):
        p = pairs.near[q]
        i, j, k, l = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]  # noqa: E741
        corners, ways, h, waits = corners_of(x, i, j, k, l), corners_of(d, i, j, k, l), reach[p], False
        here = frozen_touch(m, p, corners) if m.solver.frozen[0] else touch(x, i, of[p], corners, np.inf, mesh)
        closing = dot(here.normal, weigh(here.weights, ways))
        if here.distance >= h and here.distance < np.inf and here.distance + closing < h:
            waits, pull = True, stiffness[p] * (h - here.distance)
            for corner in range(4):
                for row in range(3 if pair[p, corner] < n else 0):
                    out[row, pair[p, corner]] += here.weights[corner] * pull * here.normal[row]
        changed = changed or waits != expected[p]
        expected[p] = waits
    return changed


@kernel
def fill_pairs(
    m: ContactState, rows: ContactMatrix, block: int, x: Float, before: Float, rate: float, floor: float, follow: float
) -> None:
    """Linearise the block's pairs at x (3, n), where forces were found last, with dv/dx = `rate` [1/s]."""
    pairs = m.pairs
    if m.bodies.local.shape[0] > 0:
        x = m.whole
    pair, of, reach, normal, mesh = pairs.vertices, pairs.face, pairs.reach, pairs.normal, faces_of(m)
    stiffness, damping, mu = pairs.stiffness, pairs.damping, pairs.friction
    anchor, anchored, v, step = m.anchor, m.anchored, m.solver.velocity, m.solver.step[0]
    expected, at = m.solver.expected, pairs.block_start[block]
    for q in range(pairs.block_start[block], pairs.block_start[block + 1]):
        p = pairs.block_pair[q]
        i, j, k, l = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]  # noqa: E741
        corners, h = corners_of(x, i, j, k, l), reach[p]
        low, high = between(of[p] < 0, (normal[p, 0], normal[p, 1], normal[p, 2]), corners)
        if low - high > h and not expected[p]:
            continue
        here = frozen_touch(m, p, corners) if m.solver.frozen[0] else touch(x, i, of[p], corners, np.inf, mesh)
        if expected[p] or not here.distance < h:
            if expected[p]:
                write_row(rows, at, p, here.weights, spread_out(stiffness[p], 0.0, 0.0, here.normal, here.normal))
                at += 1
            continue
        n, u, ks, c = here.normal, weigh(here.weights, corners_of(v, i, j, k, l)), stiffness[p], damping[p]
        pressed = press(ks, c, h, here, u)
        ramp = min(1.0, (h - here.distance) / (RAMP * h))
        steep = slope(ks, h, here.distance) + c * ramp * rate if pressed > 0.0 else 0.0
        tangent, slid = ks + c * rate, 0.0
        t, rub = across(u, n), c if anchored[p] else c + ks * step
        pull = (rub * t[0], rub * t[1], rub * t[2])
        if anchored[p]:
            e = across(weigh((anchor[p, 0], anchor[p, 1], anchor[p, 2], anchor[p, 3]), corners), n)
            pull = (pull[0] + ks * e[0], pull[1] + ks * e[1], pull[2] + ks * e[2])
        t, size = unit(pull)
        if size > mu[p] * pressed:
            tangent *= mu[p] * pressed / size
            slid = tangent
        write_row(rows, at, p, here.weights, spread_out(steep, tangent, slid, n, t))
        at += 1
    rows.number[block] = at - pairs.block_start[block]


@kernel
def add_diagonal(m: ContactState, rows: ContactMatrix, block: int, origin: int, out: Float) -> None:
    """Add the diagonal blocks to out (6, w), whose last columns take those of other blocks."""
    pairs = m.pairs
    pair, which, weight, stiff = pairs.vertices, rows.which, rows.weight, rows.stiff
    width = out.shape[1] - PADDING
    for q in range(pairs.block_start[block], pairs.block_start[block] + rows.number[block]):
        for corner in range(4):
            local = pair[which[q], corner] - origin
            if 0 <= local < width:
                square = weight[q, corner] * weight[q, corner]
                for row in range(6):
                    out[row, local] += square * stiff[q, row]


@forced_inline
def way_of(u: Float, i: int, n: int) -> Vector:
    """Return column i of u (3, n), 0 for columns after it."""
    return (u[0, i], u[1, i], u[2, i]) if i < n else (0.0, 0.0, 0.0)


@kernel
def multiply_pairs(m: ContactState, rows: ContactMatrix, block: int, origin: int, u: Float, out: Float) -> None:
    """Add the product with u (3, n) to out (3, w), whose last columns take those of other blocks. Bodies stay."""
    pairs = m.pairs
    pair, which, weight, s = pairs.vertices, rows.which, rows.weight, rows.stiff
    width, n = out.shape[1] - PADDING, u.shape[1]
    for q in range(pairs.block_start[block], pairs.block_start[block] + rows.number[block]):
        p = which[q]
        w = (weight[q, 0], weight[q, 1], weight[q, 2], weight[q, 3])
        i, j, k, l = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]  # noqa: E741
        x, y, z = weigh(w, (way_of(u, i, n), way_of(u, j, n), way_of(u, k, n), way_of(u, l, n)))
        fx = s[q, 0] * x + s[q, 3] * y + s[q, 4] * z
        fy = s[q, 3] * x + s[q, 1] * y + s[q, 5] * z
        fz = s[q, 4] * x + s[q, 5] * y + s[q, 2] * z
        for corner in range(4):
            local = pair[p, corner] - origin
            if 0 <= local < width:
                out[0, local] += w[corner] * fx
                out[1, local] += w[corner] * fy
                out[2, local] += w[corner] * fz
