"""One vertex's movement constrained by one body, iterated as it meets further planes (nuno_contact.sliding.slides).

`frames` (f, 18) is as in nuno_contact.penalty.distance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from nuno_contact.sliding.planes import hold_off
from nuno_geometry.closest_point import Answer, closest, take_nearest
from nuno_geometry.poses import Vector, turn_out
from nuno_geometry.tree import Room, Tree
from nuno_kernels import forced_inline, kernel
from nuno_kernels.lanes.simd import Lanes, first_lane, higher, lanes_up_to, load, lower, splat, where_not_negative
from nuno_schemas.fabric import Float

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
