"""The first entry of a straight movement into a triangle mesh."""

from __future__ import annotations

from nuno_kernels import forced_inline, kernel
from nuno_kernels.bodies.poses import Vector
from nuno_kernels.lanes.choose import first_lane, higher, lanes_up_to, lower, where_not_negative
from nuno_kernels.lanes.simd import Lanes, load, splat
from nuno_kernels.meshes.closest_point import take_nearest
from nuno_kernels.meshes.tree import Room, Tree
from nuno_schemas.fabric import Float

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
