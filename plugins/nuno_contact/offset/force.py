"""Normal force and friction of two primitives that are nearer than the thickness h, the pairs that touch, and their
anchors.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_contact.offset.bodies import copy_part
from nuno_contact.offset.contact_state import (
    CHOICES,
    CLOSE,
    IN_TURN,
    LAST_STEP,
    NEAR,
    PARTS,
    SHARED,
    TOUCHING,
    WORTH,
    ContactState,
    close_up,
)
from nuno_contact.offset.proximity import (
    AT_A,
    INSIDE,
    ON_AB,
    Corners,
    Four,
    between,
    closest,
    point,
    to_triangle,
    unit,
    weigh,
)
from nuno_geometry.poses import Vector
from nuno_kernels import block_kernel, forced_inline, kernel
from nuno_kernels.lanes import EVERY, WIDTH, dot, lanes_up_to, magnitude, minus, read_triple
from nuno_kernels.step.blocks import BLOCK, PADDING, Long, copy_rows
from nuno_kernels.terms import over_blocks
from nuno_schemas.fabric import Float, Int

# The pairs of each block of cloth's vertices: blocks add forces to their own vertices, on any thread.


@forced_inline
def block_of(pair: Int, p: int, corner: int, cloth: int) -> int:
    """Return the block of a pair's corner, -1 if an earlier corner has the same, and for bodies, after the cloth."""
    block = pair[p, corner] // BLOCK if pair[p, corner] < cloth else -1
    for other in range(corner):
        if pair[p, other] < cloth and pair[p, other] // BLOCK == block:
            return -1
    return int(block)


@block_kernel
def count_part(part: int, pair: Int, chosen: Int, number: int, cloth: int, at: NDArray[np.int64]) -> None:
    """Count how many of a part of the chosen pairs each block has, at[part]."""
    for q in range(part * number // PARTS, (part + 1) * number // PARTS):
        for corner in range(4):
            block = block_of(pair, chosen[q], corner, cloth)
            if block >= 0:
                at[part, block] += 1


@block_kernel
def fill_part(part: int, pair: Int, chosen: Int, number: int, cloth: int, at: NDArray[np.int64], shared: Int) -> None:
    """Write a part of the chosen pairs to the places from at[part] on, for each block."""
    for q in range(part * number // PARTS, (part + 1) * number // PARTS):
        for corner in range(4):
            block = block_of(pair, chosen[q], corner, cloth)
            if block >= 0:
                shared[at[part, block]] = chosen[q]
                at[part, block] += 1


count_parts = over_blocks(count_part, "pair, chosen, number, cloth, at", WORTH, IN_TURN)
fill_parts = over_blocks(fill_part, "pair, chosen, number, cloth, at, shared", WORTH, IN_TURN)


@block_kernel
def share_out(m: ContactState, chosen: Int, number: int, start: Int, shared: Int, threads: int | None) -> None:
    """Assign `number` chosen pairs to the blocks of cloth of their vertices, in order: bounds of each block's, and the
    pairs.
    """
    pair, cloth, blocks = m.pairs.vertices, m.surface.mass.shape[0] - m.bodies.local.shape[0], start.shape[0] - 1
    at = np.zeros((PARTS, blocks), np.int64)
    count_parts(pair, chosen, number, cloth, at, PARTS, number, threads)
    total = 0
    for block in range(blocks):
        start[block] = total
        for part in range(PARTS):
            count = at[part, block]
            at[part, block] = total
            total += count
    start[blocks] = total
    fill_parts(pair, chosen, number, cloth, at, shared, PARTS, number, threads)


# Normal force and friction of two primitives that are nearer than the thickness h.
#
# Along the line between their closest points, at a distance d,
#
#     N = k (h - d)            for d >= h / 2
#     N = k h^2 / (4 d)        below,
#
# which is smooth to its second derivative (Offset Geometric Contact, Chen et al., SIGGRAPH 2025). From h / 4 on it goes
# on as steeply as it is there: a barrier without bound would be stiffer than any step of an explicit method can follow,
# throw apart what has come that near, and is not needed, since steps are cut short (nuno_contact.offset.ccd). And a
# dashpot that takes hold over the first quarter of h. It never attracts. Vertices of a pair share N by the
# weights of the closest points, so that momentum and its moment are kept.
#
# Contacts that meet in one feature count once: a vertex above the inside of a triangle; above an edge, where it is
# above neither of the edge's triangles, by the lower-numbered one; above a vertex, where it is above none of that one's
# edges; two edges that cross inside of both. With every pair counted a vertex over a vertex would feel six triangles
# and thirty-six pairs of edges. Two parallel layers then still have about two vertices and seven crossing edges for
# each vertex, so that edges have the share EDGES of the stiffness.
#
# Friction is a spring between the points of both primitives that touched first (Cundall & Strack 1979), in the tangent
# plane and no longer than mu N: an anchor is the weights of those points, which go along with the cloth however it
# moves and turns. What slides drags it along, so that the spring stays at mu N; what sticks does not creep. A vertex
# that slides on to the next triangle begins with a slack spring: the way that it takes to load, mu times the depth, is
# the share of a triangle's width by which friction is too small, some thousandths of a hundredth.

STEEPEST = 0.25
"""share of the thickness below which N grows no more steeply: four times as stiff as at the surface"""
RAMP = 0.25
"""share of the thickness over which the dashpot rises: at once it would jump at the surface"""


class Faces(NamedTuple):
    """The arrays of the tree and the surface of these names."""

    faces: Int
    adjacent: Int
    ring_start: Int
    ring: Int
    first_face: Int


class Touch(NamedTuple):
    """Contact of two primitives: weights of their vertices, the direction from the second to the first, and the
    distance [m]; infinite if another pair counts for the place.
    """

    weights: Four
    normal: Vector
    distance: float


@forced_inline
def faces_of(m: ContactState) -> Faces:
    """Return the arrays that identify features of the mesh."""
    surface = m.surface
    return Faces(m.tree.faces, surface.adjacent, surface.ring_start, surface.ring, surface.first_face)


@forced_inline
def stands_for_edge(x: Float, v: int, f: int, side: int, mesh: Faces) -> bool:
    """Whether triangle f is the one to count vertex v above its edge number `side`, to which v is closest."""
    faces, other = mesh.faces, mesh.adjacent[f, side]
    if other < 0:
        return True
    i, j, k = faces[other, 0], faces[other, 1], faces[other, 2]
    if v in (i, j, k):
        return True
    found = to_triangle(point(x, v), point(x, i), point(x, j), point(x, k))
    a, b = faces[f, side], faces[f, (side + 1) % 3]
    third = found.weights[1] if i != a and i != b else found.weights[2] if j != a and j != b else found.weights[3]
    return found.where >= ON_AB and found.where < AT_A and third == 0.0 and f < other


@forced_inline
def stands_for_vertex(x: Float, v: int, f: int, w: int, mesh: Faces) -> bool:
    """Whether triangle f is the one to count vertex v above vertex w, to which v is closest on f."""
    if mesh.first_face[w] != f:
        return False
    at = point(x, w)
    way = minus(point(x, v), at)
    for q in range(mesh.ring_start[w], mesh.ring_start[w + 1]):
        r = mesh.ring[q]
        if r == v or dot(way, minus(point(x, r), at)) > 0.0:
            return False
    return True


@forced_inline
def touch(x: Float, i: int, f: int, corners: Corners, h: float, mesh: Faces) -> Touch:
    """Return the contact of a pair within h: of vertex i and triangle f, or of two edges if f is negative."""
    found = closest(f < 0, corners)
    n, distance = unit(weigh(found.weights, corners))
    if distance >= h:
        return Touch(found.weights, n, math.inf)
    counts = found.where == INSIDE
    if f >= 0 and found.where >= AT_A:
        counts = stands_for_vertex(x, i, f, mesh.faces[f, found.where - AT_A], mesh)
    elif f >= 0 and found.where >= ON_AB:
        counts = stands_for_edge(x, i, f, found.where - ON_AB, mesh)
    return Touch(found.weights, n, distance if counts else math.inf)


@forced_inline
def frozen_touch(m: ContactState, p: int, corners: Corners) -> Touch:
    """Return the contact of a pair whose features are frozen; see nuno_contact.offset.separating_plane.freeze."""
    w = (
        m.solver.kept_weights[p, 0],
        m.solver.kept_weights[p, 1],
        m.solver.kept_weights[p, 2],
        m.solver.kept_weights[p, 3],
    )
    n = (m.solver.kept_normal[p, 0], m.solver.kept_normal[p, 1], m.solver.kept_normal[p, 2])
    return Touch(w, n, dot(n, weigh(w, corners)) if m.solver.kept[p] else math.inf)


@forced_inline
def push(k: float, h: float, distance: float) -> float:
    """Return the force [N] at a distance below h."""
    if distance >= 0.5 * h:
        return k * (h - distance)
    d = max(distance, STEEPEST * h)
    return k * h * h / (4.0 * d) * (1.0 + (d - distance) / d)


@forced_inline
def press(k: float, c: float, h: float, at: Touch, u: Vector) -> float:
    """Return the normal force N [N] of primitives that move at u [m/s] relative to each other."""
    ramp = min(1.0, (h - at.distance) / (RAMP * h))
    pressed: float = max(0.0, push(k, h, at.distance) - c * ramp * dot(u, at.normal))
    return pressed


@forced_inline
def across(v: Vector, n: Vector) -> Vector:
    """Return the part of v across the unit vector n."""
    along = dot(v, n)
    return v[0] - along * n[0], v[1] - along * n[1], v[2] - along * n[2]


@forced_inline
def corners_of(x: Float, i: int, j: int, k: int, l: int) -> Corners:  # noqa: E741
    """Return the four vertices of a pair."""
    return point(x, i), point(x, j), point(x, k), point(x, l)


@block_kernel
def in_place(x: Float, last: Float, mass: Float) -> bool:
    """Whether x (3, n) are as in `last`, but for massless vertices."""
    for i in range(0, x.shape[1], WIDTH):
        count = min(WIDTH, x.shape[1] - i)
        a, b, c = minus(read_triple(x, 0, i, count), read_triple(last, 0, i, count))
        if lanes_up_to(magnitude(a) + magnitude(b) + magnitude(c), 0.0) != EVERY:
            for k in range(i, i + count):
                if mass[k] > 0.0 and not (x[0, k] == last[0, k] and x[1, k] == last[1, k] and x[2, k] == last[2, k]):
                    return False
    return True


@kernel
def is_fresh(m: ContactState, x: Float, v: Float) -> None:
    """Note whether x (3, n) are the vertices after the last step, whose contacts are known, but for carried ones, which
    are a step ahead. If not, and if a matrix is made, assign near pairs to blocks. Append bodies, if any.
    """
    pairs = m.pairs
    m.fresh[0] = m.counts[NEAR] == 0 or in_place(x, m.last, m.surface.mass)
    if m.bodies.local.shape[0] > 0:
        copy_part(x, m.whole, 0, x.shape[1])
        copy_part(v, m.whole_velocity, 0, x.shape[1])
        if m.solver.step[0] > 0.0:
            copy_rows(m.whole_velocity, m.solver.velocity)
    elif m.solver.step[0] > 0.0:
        copy_rows(v, m.solver.velocity)
    if (not m.fresh[0] or m.solver.step[0] > 0.0) and m.counts[SHARED] != m.counts[CHOICES]:
        share_out(m, pairs.near, m.counts[NEAR], pairs.block_start, pairs.block_pair, None)
        m.counts[SHARED] = m.counts[CHOICES]


@kernel
def add_pairs(m: ContactState, block: int, origin: int, x: Float, v: Float, force: Float) -> None:
    """Add the forces [N] of the block's pairs to its vertices."""
    pairs, fresh, step = m.pairs, m.fresh[0], m.solver.step[0]
    if m.bodies.local.shape[0] > 0:
        x, v = m.whole, m.whole_velocity
    pair, of, reach, normal, mesh = pairs.vertices, pairs.face, pairs.reach, pairs.normal, faces_of(m)
    stiffness, damping, mu, weights, eased = (
        pairs.stiffness, pairs.damping, pairs.friction, pairs.weights, pairs.eased
    )  # fmt: skip
    anchor, anchored = m.anchor, m.anchored
    start, chosen = (pairs.touch_start, pairs.touch_pair) if fresh else (pairs.block_start, pairs.block_pair)
    width, frozen = force.shape[1] - PADDING, m.solver.frozen[0]
    for q in range(start[block], start[block + 1]):
        p = chosen[q]
        i, j, k, l = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]  # noqa: E741
        corners, h, n = corners_of(x, i, j, k, l), reach[p], (normal[p, 0], normal[p, 1], normal[p, 2])
        if fresh:
            at = Touch((weights[p, 0], weights[p, 1], weights[p, 2], weights[p, 3]), n, pairs.distance[p])
        else:
            low, high = between(of[p] < 0, n, corners)
            if low - high > h:
                continue
            at = frozen_touch(m, p, corners) if frozen else touch(x, i, of[p], corners, reach[p], mesh)
            if not at.distance < h:
                continue
        c = damping[p] * (eased[p] if step == 0.0 and (fresh or anchored[p]) else 1.0)
        law, held = Law(stiffness[p], c, mu[p]), (anchor[p, 0], anchor[p, 1], anchor[p, 2], anchor[p, 3])
        fx, fy, fz = rub(corners, corners_of(v, i, j, k, l), at, h, law, anchored[p], held, step)
        for corner in range(4):
            local = pair[p, corner] - origin
            if 0 <= local < width:
                w = at.weights[corner]
                force[0, local] += w * fx
                force[1, local] += w * fy
                force[2, local] += w * fz


class Law(NamedTuple):
    """Stiffness [N/m], damping [N s/m] and Coulomb coefficient of a pair."""

    stiffness: float
    damping: float
    friction: float


@forced_inline
def rub(
    x: Corners, v: Corners, at: Touch, h: float, law: Law, anchored: bool, anchor: Four, step: float
) -> Vector:  # fmt: skip
    """Return the force [N] of friction on the first of two primitives that touch.

    A contact that is new at the end of an implicit step has friction for its way in that step.
    """
    k, c, mu = law.stiffness, law.damping, law.friction
    u = weigh(at.weights, v)
    n = press(k, c, h, at, u)
    t = across(u, at.normal)
    if not anchored:
        c += k * step
    fx, fy, fz = -c * t[0], -c * t[1], -c * t[2]
    if anchored:
        e = across(weigh(anchor, x), at.normal)
        fx, fy, fz = fx - k * e[0], fy - k * e[1], fz - k * e[2]
    size = math.sqrt(fx * fx + fy * fy + fz * fz)
    share = mu * n / size if size > mu * n else 1.0
    return share * fx + n * at.normal[0], share * fy + n * at.normal[1], share * fz + n * at.normal[2]


# Touching pairs after a step, the damping that a step can follow, and the anchors of friction.

MOST = 1.5
"""greatest rate of damping by contact times the step"""


@block_kernel
def touch_part(part: int, m: ContactState, number: Long) -> None:
    """Find which of a part of the close pairs touch at `last`: into `touching` from the part's first place on."""
    pairs, anchored, mesh, x = m.pairs, m.anchored, faces_of(m), m.last
    pair, of, reach, normal = pairs.vertices, pairs.face, pairs.reach, pairs.normal
    close, touching, weights, gap = pairs.close, pairs.touching, pairs.weights, pairs.distance
    first, end = part * m.counts[CLOSE] // PARTS, (part + 1) * m.counts[CLOSE] // PARTS
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
    pairs, rate, mass = m.pairs, m.rate, m.surface.mass
    pair, damping, weights = pairs.vertices, pairs.damping, pairs.weights
    first, end = block * BLOCK, min((block + 1) * BLOCK, rate.shape[0])
    for i in range(first, end):
        rate[i] = 0.0
    for q in range(pairs.touch_start[block], pairs.touch_start[block + 1]):
        p = pairs.touch_pair[q]
        for corner in range(4):
            i = pair[p, corner]
            if first <= i < end and mass[i] > 0.0:
                rate[i] += 2.0 * damping[p] * abs(weights[p, corner]) / mass[i]


@block_kernel
def ease_part(part: int, m: ContactState, dt: float) -> None:
    """Limit the damping of each touching pair in a step of dt [s] to what the step can follow.

    A vertex amid twenty contacts would be thrown to and fro by all their dashpots, though each alone is slow enough.
    The rates at which they slow cloth down are the eigenvalues of M^-1 sum_p c_p w_p w_p^T, at most the greatest sum
    over a row, max_i sum_p 2 c_p |w_pi| / m_i (Gershgorin); an explicit step throws to and fro what is above 2 / dt.
    """
    for q in range(part * m.counts[TOUCHING] // PARTS, (part + 1) * m.counts[TOUCHING] // PARTS):
        p, fastest = m.pairs.touching[q], 0.0
        for corner in range(4):
            fastest = max(fastest, m.rate[m.pairs.vertices[p, corner]])
        m.pairs.eased[p] = MOST / (dt * fastest) if dt * fastest > MOST else 1.0


touch_parts = over_blocks(touch_part, "m, number", WORTH, IN_TURN)
rate_blocks = over_blocks(rate_block, "m", WORTH)
ease_parts = over_blocks(ease_part, "m, dt", WORTH, IN_TURN)


@block_kernel
def find_touching(m: ContactState, threads: int | None) -> None:
    """Find which close pairs touch at `last`, where, and the planes across them; others lose their anchors."""
    pairs = m.pairs
    number, dt = np.empty(PARTS, np.int64), m.clock[LAST_STEP] if m.solver.sweeps[0] == 0 else 0.0
    touch_parts(m, number, PARTS, m.counts[CLOSE], threads)
    m.counts[TOUCHING] = close_up(pairs.touching, m.counts[CLOSE], number)
    share_out(m, pairs.touching, m.counts[TOUCHING], pairs.touch_start, pairs.touch_pair, threads)
    if dt > 0.0:
        rate_blocks(m, pairs.touch_start.shape[0] - 1, m.counts[TOUCHING], threads)
    ease_parts(m, dt, PARTS, m.counts[TOUCHING], threads)


@block_kernel
def drag_part(part: int, m: ContactState, v: Float) -> None:
    """Set the anchors of a part of the pairs that touch at `last` and move at v (3, n), or drag them along."""
    pairs, x, anchor, anchored = m.pairs, m.last, m.anchor, m.anchored
    pair, reach, normal = pairs.vertices, pairs.reach, pairs.normal
    stiffness, damping, mu = pairs.stiffness, pairs.damping, pairs.friction
    touching, weights, gap, eased = pairs.touching, pairs.weights, pairs.distance, pairs.eased
    for q in range(part * m.counts[TOUCHING] // PARTS, (part + 1) * m.counts[TOUCHING] // PARTS):
        p = touching[q]
        i, j, k, l = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]  # noqa: E741
        w, n = (weights[p, 0], weights[p, 1], weights[p, 2], weights[p, 3]), (normal[p, 0], normal[p, 1], normal[p, 2])
        share = 0.0
        if anchored[p]:
            a = (anchor[p, 0], anchor[p, 1], anchor[p, 2], anchor[p, 3])
            if m.solver.sweeps[0] > 0 and m.solver.kept[p]:
                share = m.solver.force[p, 3]
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
    drag_parts(m, v, PARTS, m.counts[TOUCHING], threads)
