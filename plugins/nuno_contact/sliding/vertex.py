"""One vertex's movement constrained by one body: planes as it meets them, with Coulomb friction on each."""

from __future__ import annotations

import math
from typing import NamedTuple

from nuno_geometry.closest_point import Answer, closest, take_nearest
from nuno_geometry.poses import Vector, turn_out
from nuno_geometry.tree import Room, Tree
from nuno_kernels import forced_inline, kernel
from nuno_kernels.lanes import Lanes, first_lane, higher, lanes_up_to, load, lower, splat, where_not_negative
from nuno_schemas.fabric import Float

# A movement constrained by planes, with Coulomb friction: the motion of a vertex that meets a surface.
#
# The movement m that a vertex would make is changed by the least that keeps it out of up to two planes
# with normals n1 and n2,
#
#     m' = m + a n1 + b n2,   a, b >= 0,   m'. n1 >= h1,   m'. n2 >= h2,
#
# each of a and b 0 or its condition met exactly (a linear complementarity problem of two unknowns, solved by
# cases). This is the sliding projection of the stocking paper: what would enter is projected onto the plane, or
# onto the line where two planes meet. Friction then takes mu (a + b) off the movement along the plane, or along
# the line, at most all of it. The same acts on velocities, where a + b is the impulse per mass: a vertex sticks
# where the force along the plane is no more than mu times that into it, at any step.

PARALLEL = 1e-6
"""squared sine between normals below which two planes are one"""


@kernel
def share_planes(g1: float, g2: float, cosine: float) -> tuple[float, float]:
    """Return the least a, b >= 0 with a + b cosine >= g1 and a cosine + b >= g2."""
    if g1 <= 0.0 and g2 <= 0.0:
        return 0.0, 0.0
    if g1 > 0.0 and g1 * cosine >= g2:
        return g1, 0.0
    if g2 > 0.0 and g2 * cosine >= g1:
        return 0.0, g2
    square = 1.0 - cosine * cosine
    if square < PARALLEL:
        return (g1, 0.0) if g1 >= g2 else (0.0, g2)
    return max(0.0, (g1 - cosine * g2) / square), max(0.0, (g2 - cosine * g1) / square)


@kernel
def hold_off(m: Vector, n1: Vector, h1: float, n2: Vector, h2: float, two: bool, mu: float) -> Vector:
    """Return the movement m constrained by one plane, or by `two`, with friction mu; h1 and h2 are the least movement
    along the unit normals n1 and n2.
    """
    g1 = h1 - (m[0] * n1[0] + m[1] * n1[1] + m[2] * n1[2])
    a, b = max(g1, 0.0), 0.0
    if two:
        cosine = n1[0] * n2[0] + n1[1] * n2[1] + n1[2] * n2[2]
        a, b = share_planes(g1, h2 - (m[0] * n2[0] + m[1] * n2[1] + m[2] * n2[2]), cosine)
    x = m[0] + a * n1[0] + b * n2[0]
    y = m[1] + a * n1[1] + b * n2[1]
    z = m[2] + a * n1[2] + b * n2[2]
    if mu == 0.0 or a + b == 0.0:
        return x, y, z
    if a > 0.0 and b > 0.0:
        tx, ty, tz = n1[1] * n2[2] - n1[2] * n2[1], n1[2] * n2[0] - n1[0] * n2[2], n1[0] * n2[1] - n1[1] * n2[0]
        along = (x * tx + y * ty + z * tz) / (tx * tx + ty * ty + tz * tz)
        tx, ty, tz = along * tx, along * ty, along * tz
    else:
        nx, ny, nz = n1 if a > 0.0 else n2
        along = x * nx + y * ny + z * nz
        tx, ty, tz = x - along * nx, y - along * ny, z - along * nz
    size = math.sqrt(tx * tx + ty * ty + tz * tz)
    friction = 1.0 if size <= mu * (a + b) else mu * (a + b) / size
    return x - friction * tx, y - friction * ty, z - friction * tz


# One vertex's movement constrained by one body, iterated as it meets further planes (nuno_contact.sliding.slides).
#
# `frames` (f, 18) is as in nuno_contact.penalty.distance.

# The first entry of a straight movement into a triangle mesh.

OVERLAP = 1e-9
"""share by which triangles are enlarged, so that nothing slips through between two of them"""
BEYOND = 1.0 + 2.0**-40
"""a share of the movement that is no longer part of it"""


@forced_inline
def leaf_crossings(p: Vector, d: Vector, corners: Float, leaf: int) -> Lanes:
    """Return the shares of the movement from p by d after which it enters a leaf's eight triangles; 2 for no entry."""
    (px, py, pz), (dx, dy, dz), row = p, d, 9 * leaf
    ax, ay, az = px - load(corners, row, 0), py - load(corners, row + 1, 0), pz - load(corners, row + 2, 0)
    bx, by, bz = load(corners, row + 3, 0), load(corners, row + 4, 0), load(corners, row + 5, 0)
    cx, cy, cz = load(corners, row + 6, 0), load(corners, row + 7, 0), load(corners, row + 8, 0)
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    towards = splat(0.0) - (nx * dx + ny * dy + nz * dz)
    share = (nx * ax + ny * ay + nz * az) / towards
    x, y, z = ax + share * dx, ay + share * dy, az + share * dz
    det = nx * nx + ny * ny + nz * nz
    u = nx * (y * cz - z * cy) + ny * (z * cx - x * cz) + nz * (x * cy - y * cx)
    v = nx * (by * z - bz * y) + ny * (bz * x - bx * z) + nz * (bx * y - by * x)
    within = lower(lower(u, v), det - u - v) + OVERLAP * det
    no_entry = splat(2.0)
    # A movement along the plane has a share that is infinite or NaN: `within` is NaN then.
    return where_not_negative(lower(lower(towards, share), within), share, no_entry)


@kernel
def first_crossing(p: Vector, d: Vector, root: int, tree: Tree, room: Room) -> tuple[float, int]:
    """Return (share of the movement, place of the triangle) where the movement from p by d first enters the mesh
    through the outside of a triangle; (2, -1) if it does not.

    Boxes are tested against the box of the movement, which is short.
    """
    (px, py, pz), (dx, dy, dz) = p, d
    boxes, child, corners, face, waiting = tree.boxes, tree.child, tree.corners, tree.face, room.waiting
    x0, x1 = min(px, px + dx), max(px, px + dx)
    y0, y1 = min(py, py + dy), max(py, py + dy)
    z0, z1 = min(pz, pz + dz), max(pz, pz + dz)
    best, which = BEYOND, 0
    waiting[0] = root
    top = 1
    while top > 0:
        top -= 1
        node = waiting[top]
        if node < 0:
            leaf = -1 - node
            best, which = take_nearest(leaf_crossings(p, d, corners, leaf), leaf, face, best, which)
            continue
        row = 6 * node
        x = higher(load(boxes, row, 0) - x1, x0 - load(boxes, row + 3, 0))
        y = higher(load(boxes, row + 1, 0) - y1, y0 - load(boxes, row + 4, 0))
        z = higher(load(boxes, row + 2, 0) - z1, z0 - load(boxes, row + 5, 0))
        bits, first = lanes_up_to(higher(higher(x, y), z), 0.0), child[node]
        while bits != 0:
            j = first_lane(bits)
            bits &= bits - 1
            waiting[top] = first + j if first >= 0 else first - j
            top += 1
    return (best, which) if best < BEYOND else (2.0, -1)


ROUNDS = 12
"""iterations of a movement: the last two planes it meets constrain it together"""
TOUCHING = 1.0 - 1e-6
"""share of the gap at which a movement that planes have changed may end at least

One that none has changed yet meets the surface as soon as it ends nearer than the gap, by however little: a vertex that
could fall through a part of the gap unseen would feel no friction on the way, which at short steps is several of them.
"""


@kernel
def outward(p: Vector, near: Answer) -> Vector:
    """Return the unit direction out of the surface at the closest point of p; the pseudonormal if p lies on it."""
    x, y, z, distance = p[0] - near.point[0], p[1] - near.point[1], p[2] - near.point[2], near.distance
    if abs(distance) < 1e-9 * (abs(p[0]) + abs(p[1]) + abs(p[2])):
        x, y, z = near.normal
        distance = math.sqrt(x * x + y * y + z * z)
    return x / distance, y / distance, z / distance


class Slid(NamedTuple):
    """Result of a constrained movement: what is left of it [m], the normals of the last planes that held it off and
    their number, the distance that is left [m], the nearest triangle's place, and whether the vertex was put back.
    """

    made: Vector
    n1: Vector
    n2: Vector
    planes: int
    distance: float
    place: int
    back: bool


@kernel
def slide(
    start: Vector, m: Vector, clear: float, place: int, root: int, gap: float, mu: float, tree: Tree, room: Room
) -> Slid:
    """Constrain a vertex's movement m from `start`, in the body's frame, that would enter or come nearer than `gap`.

    `clear` is the distance at the start, or less; `place` that of a triangle which may be near.
    """
    n1 = n2 = (0.0, 0.0, 0.0)
    h1 = h2 = 0.0
    planes = 0
    made = m
    distance = clear
    corners = tree.corners
    for turn in range(ROUNDS):
        length = math.sqrt(made[0] * made[0] + made[1] * made[1] + made[2] * made[2])
        share, at = 2.0, -1
        if clear > 0.0 and length >= clear:
            share, at = first_crossing(start, made, root, tree, room)
        if share <= 1.0:
            row, j = 9 * (at // 8), at % 8
            bx, by, bz = corners[row + 3, j], corners[row + 4, j], corners[row + 5, j]
            cx, cy, cz = corners[row + 6, j], corners[row + 7, j], corners[row + 8, j]
            x, y, z = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
            size = math.sqrt(x * x + y * y + z * z)
            n2 = (x / size, y / size, z / size)
            h2 = gap + share * (made[0] * n2[0] + made[1] * n2[1] + made[2] * n2[2])
            place, distance = at, -1.0
        else:
            p = (start[0] + made[0], start[1] + made[1], start[2] + made[2])
            near = closest(p, place, root, tree, room)
            place, distance = near.place, near.distance
            if distance >= (gap if planes == 0 else TOUCHING * gap):
                return Slid(made, n1, n2, planes, distance, place, False)
            n2 = outward(p, near)
            x, y, z = near.point
            h2 = gap + (x - start[0]) * n2[0] + (y - start[1]) * n2[1] + (z - start[2]) * n2[2]
        if turn == ROUNDS - 1:
            break
        planes = min(planes + 1, 2)
        made = hold_off(m, n2, h2, n1, h1, planes == 2, mu)
        n1, h1, n2, h2 = n2, h2, n1, h1
    if distance > 0.0 or clear <= 0.0:
        return Slid(made, n1, n2, planes, distance, place, False)
    return Slid((0.0, 0.0, 0.0), n1, n2, planes, clear, place, True)


@kernel
def slow_down(
    v: Float, i: int, at: Vector, n1: Vector, n2: Vector, planes: int, mu: float, frames: Float, f: int
) -> Vector:
    """Hold the velocity of vertex i at `at` off the body's planes; return the change of velocity [m/s]."""
    a, b = turn_out(n1, frames, f), turn_out(n2, frames, f)
    rx, ry, rz = at[0] - frames[f, 9], at[1] - frames[f, 10], at[2] - frames[f, 11]
    bx = frames[f, 12] + frames[f, 16] * rz - frames[f, 17] * ry
    by = frames[f, 13] + frames[f, 17] * rx - frames[f, 15] * rz
    bz = frames[f, 14] + frames[f, 15] * ry - frames[f, 16] * rx
    u = (v[0, i] - bx, v[1, i] - by, v[2, i] - bz)
    w = hold_off(u, a, 0.0, b, 0.0, planes == 2, mu)
    return w[0] - u[0], w[1] - u[1], w[2] - u[2]
