"""Sliding contact: vertices never enter moving triangle meshes, slide on them, and rub.

After a step every vertex has made a movement in each body's frame, where the body stands still, however it
moves in the world. The movement goes unchanged unless it enters the body, or ends nearer to its surface than
`gap`; it is then held off by the plane of the triangle it meets, by the next one it meets then, and so on
(nuno_kernels.slide_planes). The velocity relative to the body is held off by the same planes.

A vertex whose distance from the surface was found once cannot meet it before it has moved as far: `clear`
keeps what is left, and until that is used up nothing is searched. Where the movement is shorter than `clear`
it cannot have crossed the body, so that only fast vertices and thin bodies cost a search for crossings.

A vertex that is still inside after ROUNDS stays where it was relative to the body, which was outside:
in no step does one enter. Not chosen: a force that grows with the depth, which no tight stocking leaves at
rest on the surface, and which limits the step; contact as a constraint of every solver, for then each of
them would need one of its own.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from nuno_kernels import kernel, parallel_kernel
from nuno_kernels.acceleration import provide
from nuno_kernels.closest_point import DEPTH, closest
from nuno_kernels.contact_poses import pose_frame, write_interval
from nuno_kernels.slide_planes import hold_off
from nuno_kernels.surface_crossing import first_crossing
from nuno_kernels.surface_tree import Tree
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Float, Int

BLOCK = 64
"""Vertices handled together."""
ROUNDS = 12
"""Times that a movement is looked at: the last two planes it meets hold it off together."""
NEAR_ENOUGH = 0.01
"""A movement may end nearer to the surface than the gap by this share of it."""


class Slides(NamedTuple):
    """b bodies, their motion over one frame of animation, and n vertices in B blocks.

    The trees of all bodies are one after the other in boxes ... edge_normals (nuno_kernels.surface_tree).
    """

    root: NDArray[np.int64]
    """(b,) root of each body's tree"""
    frame: Int
    """(b,) frame that carries the body"""
    friction: Float
    """(b,) Coulomb coefficient"""
    gap: Float
    """(1,) distance from the surface at which vertices rest [m]"""
    mass: Float
    """(n,) [kg], 0 for vertices that are held or carried: they are left alone"""
    rotation0: Float
    origin0: Float
    spin: Float
    shift: Float
    frames: Float
    """(f, 18) and the rest as in nuno_kernels.contact"""
    boxes: Float
    child: NDArray[np.int64]
    corners: Float
    face: Int
    faces: Int
    edges: Int
    vertex_normals: Float
    edge_normals: Float
    before: Float
    """(b, 3, n) where vertices were after the last step, in the body's frame [m]; NaN at first"""
    clear: Float
    """(b, n) how far they may move without meeting the surface [m]; negative inside"""
    place: NDArray[np.int64]
    """(b, n) the triangle that was nearest"""
    impulse: Float
    """(B, b, 3) what the vertices of each block have given to the body so far [N s]"""
    tally: NDArray[np.int64]
    """(B, 2) vertices touching after the last step; vertices that were put back so far"""


@kernel
def to_body(px: float, py: float, pz: float, frames: Any, f: int) -> tuple[float, float, float]:
    """A place in the world in the axes of frame f."""
    ex, ey, ez = px - frames[f, 9], py - frames[f, 10], pz - frames[f, 11]
    return (
        frames[f, 0] * ex + frames[f, 3] * ey + frames[f, 6] * ez,
        frames[f, 1] * ex + frames[f, 4] * ey + frames[f, 7] * ez,
        frames[f, 2] * ex + frames[f, 5] * ey + frames[f, 8] * ez,
    )


@kernel
def turn_out(v: Any, frames: Any, f: int) -> tuple[float, float, float]:
    """A vector in the axes of frame f in those of the world."""
    return (
        frames[f, 0] * v[0] + frames[f, 1] * v[1] + frames[f, 2] * v[2],
        frames[f, 3] * v[0] + frames[f, 4] * v[1] + frames[f, 5] * v[2],
        frames[f, 6] * v[0] + frames[f, 7] * v[1] + frames[f, 8] * v[2],
    )


@kernel
def outward(p: Any, near: Any, distance: float, normal: Any) -> tuple[float, float, float]:
    """Unit direction out of the surface at the closest point `near` of p; the pseudonormal where p lies on it."""
    x, y, z = p[0] - near[0], p[1] - near[1], p[2] - near[2]
    if abs(distance) < 1e-9 * (abs(p[0]) + abs(p[1]) + abs(p[2])):
        x, y, z = normal
        distance = math.sqrt(x * x + y * y + z * z)
    return x / distance, y / distance, z / distance


@kernel
def slide(
    start: Any, m: Any, clear: float, place: int, root: int, gap: float, mu: float, boxes: Any, child: Any,
    corners: Any, face: Any, faces: Any, edges: Any, vertex_normals: Any, edge_normals: Any,
    waiting: Any, bound: Any,
) -> Any:  # fmt: skip
    """A vertex's movement m from `start`, in the body's frame, where it would enter or come nearer than `gap`.

    `clear` is the distance at the start, or less. Returns the movement it makes, the planes' normals n1 and n2,
    how many of them there are, the distance left, the nearest triangle's place, and whether it was put back.
    """
    n1 = n2 = (0.0, 0.0, 0.0)
    h1 = h2 = 0.0
    planes = 0
    made = m
    distance = clear
    for turn in range(ROUNDS):
        length = math.sqrt(made[0] * made[0] + made[1] * made[1] + made[2] * made[2])
        share, at = 2.0, -1
        if clear > 0.0 and length >= clear:
            share, at = first_crossing(
                start[0], start[1], start[2], made[0], made[1], made[2], root, boxes, child, corners, face, waiting
            )
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
            place, _, _, x, y, z, distance, nx, ny, nz = closest(
                p[0], p[1], p[2], place, root, boxes, child, corners, face, faces, edges, vertex_normals,
                edge_normals, waiting, bound,
            )  # fmt: skip
            if distance >= (1.0 - NEAR_ENOUGH) * gap:
                return made, n1, n2, planes, distance, place, False
            n2 = outward(p, (x, y, z), distance, (nx, ny, nz))
            h2 = gap + (x - start[0]) * n2[0] + (y - start[1]) * n2[1] + (z - start[2]) * n2[2]
        if turn == ROUNDS - 1:
            break
        planes = min(planes + 1, 2)
        made = hold_off(m, n2, h2, n1, h1, planes == 2, mu)
        n1, h1, n2, h2 = n2, h2, n1, h1
    if distance > 0.0 or clear <= 0.0:
        return made, n1, n2, planes, distance, place, False
    return (0.0, 0.0, 0.0), n1, n2, planes, clear, place, True


@kernel
def slow_down(v: Any, i: int, at: Any, n1: Any, n2: Any, planes: int, mu: float, frames: Any, f: int) -> Any:
    """Hold the velocity of vertex i at `at` off the body's planes; returns the change of velocity [m/s]."""
    a, b = turn_out(n1, frames, f), turn_out(n2, frames, f)
    rx, ry, rz = at[0] - frames[f, 9], at[1] - frames[f, 10], at[2] - frames[f, 11]
    bx = frames[f, 12] + frames[f, 16] * rz - frames[f, 17] * ry
    by = frames[f, 13] + frames[f, 17] * rx - frames[f, 15] * rz
    bz = frames[f, 14] + frames[f, 15] * ry - frames[f, 16] * rx
    u = (v[0, i] - bx, v[1, i] - by, v[2, i] - bz)
    w = hold_off(u, a, 0.0, b, 0.0, planes == 2, mu)
    return w[0] - u[0], w[1] - u[1], w[2] - u[2]


@kernel
def slide_block(
    block: int, x: Any, v: Any, body: int, root: int, f: int, mu: float, gap: float, mass: Any, frames: Any,
    boxes: Any, child: Any, corners: Any, face: Any, faces: Any, edges: Any, vertex_normals: Any, edge_normals: Any,
    before: Any, clear: Any, place: Any, impulse: Any, tally: Any,
) -> None:  # fmt: skip
    """Hold the vertices of one block off one body, in place in x and v (3, n)."""
    waiting, bound = np.empty(DEPTH, np.int64), np.empty(DEPTH)
    for i in range(block * BLOCK, min((block + 1) * BLOCK, x.shape[1])):
        if mass[i] == 0.0:
            continue
        px, py, pz = to_body(x[0, i], x[1, i], x[2, i], frames, f)
        start = (before[body, 0, i], before[body, 1, i], before[body, 2, i])
        m = (px - start[0], py - start[1], pz - start[2])
        free = clear[body, i]
        left = free - (1.0 + 1e-9) * math.sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2])
        before[body, 0, i], before[body, 1, i], before[body, 2, i] = px, py, pz
        clear[body, i] = left
        if left > gap or not (abs(px) + abs(py) + abs(pz) < math.inf):
            continue
        made, n1, n2, planes, distance, at, back = slide(
            start, m, free, place[body, i], root, gap, mu, boxes, child, corners, face, faces, edges,
            vertex_normals, edge_normals, waiting, bound,
        )  # fmt: skip
        clear[body, i], place[body, i] = distance, at
        if planes == 0:
            continue
        p = (start[0] + made[0], start[1] + made[1], start[2] + made[2])
        before[body, 0, i], before[body, 1, i], before[body, 2, i] = p
        moved = turn_out(p, frames, f)
        x[0, i], x[1, i], x[2, i] = moved[0] + frames[f, 9], moved[1] + frames[f, 10], moved[2] + frames[f, 11]
        change = slow_down(v, i, (x[0, i], x[1, i], x[2, i]), n1, n2, planes, mu, frames, f)
        for c in range(3):
            v[c, i] += change[c]
            impulse[block, body, c] -= mass[i] * change[c]
        tally[block, 0] += 1
        tally[block, 1] += 1 if back else 0


@kernel
def slide_bodies(block: int, x: Any, v: Any, s: Any) -> None:
    """Hold the vertices of one block off all bodies, one after the other."""
    s.tally[block, 0] = 0
    for body in range(s.root.shape[0]):
        slide_block(
            block, x, v, body, s.root[body], s.frame[body], s.friction[body], s.gap[0], s.mass, s.frames, s.boxes,
            s.child, s.corners, s.face, s.faces, s.edges, s.vertex_normals, s.edge_normals, s.before, s.clear,
            s.place, s.impulse, s.tally,
        )  # fmt: skip


@kernel
def pose_slides(at: float, s: Any) -> None:
    """Pose all frames at a fraction of the interval."""
    for f in range(s.frames.shape[0]):
        pose_frame(at, f, s.rotation0, s.origin0, s.spin, s.shift, s.frames)


@kernel
def commit_slides(x: Any, v: Any, at: float, s: Any) -> None:
    """Hold all vertices x, v (3, n) off the bodies after a step that ends at fraction `at` of the interval."""
    pose_slides(at, s)
    for block in range(s.tally.shape[0]):
        slide_bodies(block, x, v, s)


@parallel_kernel
def commit_slides_parallel(x: Any, v: Any, at: float, s: Any) -> None:
    """commit_slides on several threads: the same bits."""
    pose_slides(at, s)
    for block in prange(s.tally.shape[0]):
        slide_bodies(block, x, v, s)


@kernel
def find_block_room(block: int, x: Any, s: Any) -> None:
    """`find_room` for the vertices of one block."""
    waiting, bound = np.empty(DEPTH, np.int64), np.empty(DEPTH)
    for body in range(s.root.shape[0]):
        for i in range(block * BLOCK, min((block + 1) * BLOCK, x.shape[1])):
            px, py, pz = to_body(x[0, i], x[1, i], x[2, i], s.frames, s.frame[body])
            ex, ey, ez = px - s.before[body, 0, i], py - s.before[body, 1, i], pz - s.before[body, 2, i]
            s.before[body, 0, i], s.before[body, 1, i], s.before[body, 2, i] = px, py, pz
            left = s.clear[body, i] - (1.0 + 1e-9) * math.sqrt(ex * ex + ey * ey + ez * ez)
            if not left > s.gap[0] and abs(px) + abs(py) + abs(pz) < math.inf:
                place, _, _, _, _, _, left, _, _, _ = closest(
                    px, py, pz, s.place[body, i], s.root[body], s.boxes, s.child, s.corners, s.face, s.faces,
                    s.edges, s.vertex_normals, s.edge_normals, waiting, bound,
                )  # fmt: skip
                s.place[body, i] = place
            s.clear[body, i] = left


@parallel_kernel
def find_room(x: Any, s: Any) -> None:
    """Take vertices x (3, n) as they are at the start of the interval for the start of their next movement.

    One that has not gone on from where it was, as after a jump, is looked up anew.
    """
    pose_slides(0.0, s)
    for block in prange(s.tally.shape[0]):
        find_block_room(block, x, s)


provide(commit_slides=commit_slides, commit_slides_parallel=commit_slides_parallel)


def set_slide_poses(slides: Slides, poses0: Poses, poses1: Poses) -> None:
    """Write the interval into `slides`, in place."""
    write_interval(slides, poses0, poses1)


def count_slides(slides: Slides) -> dict[str, int]:
    """Counts for a step report: vertices that touch after the last step, vertices put back so far."""
    touching, back = (int(total) for total in slides.tally.sum(axis=0))
    return {"touching": touching, "put_back": back}


def make_slides(trees: list[Tree], frame: Int, friction: Float, frames: int, gap: float, mass: Float) -> Slides:
    """Slides of bodies that stand still: a tree each, the `frame` (b,) of `frames` that carries it, friction (b,).

    `gap` [m]; mass (n,) [kg], 0 for vertices that contact leaves alone.
    """
    n, b = len(mass), len(trees)
    blocks = -(-n // BLOCK)
    nodes, leaves, triangles, corners, sides = (
        np.cumsum([0, *(len(part(tree)) // unit for tree in trees)]) for part, unit in _PARTS
    )
    return Slides(
        root=nodes[:-1].astype(np.int64),
        frame=np.ascontiguousarray(frame, np.int32),
        friction=np.array(friction, np.float64),
        gap=np.full(1, gap),
        mass=np.array(mass, np.float64),
        rotation0=np.tile(np.eye(3).ravel(), (frames, 1)),
        origin0=np.zeros((frames, 3)),
        spin=np.zeros((frames, 3)),
        shift=np.zeros((frames, 3)),
        frames=np.zeros((frames, 18)),
        boxes=np.concatenate([tree.boxes for tree in trees]),
        child=np.concatenate([moved_children(tree.child, nodes[k], leaves[k]) for k, tree in enumerate(trees)]),
        corners=np.concatenate([tree.corners for tree in trees]),
        face=np.concatenate([t.face + np.int32(triangles[k]) for k, t in enumerate(trees)]),
        faces=np.concatenate([t.faces + np.int32(corners[k]) for k, t in enumerate(trees)]),
        edges=np.concatenate([t.edges + np.int32(sides[k]) for k, t in enumerate(trees)]),
        vertex_normals=np.concatenate([tree.vertex_normals for tree in trees]),
        edge_normals=np.concatenate([tree.edge_normals for tree in trees]),
        before=np.full((b, 3, n), np.nan),
        clear=np.full((b, n), -np.inf),
        place=np.repeat((8 * leaves[:-1]).astype(np.int64)[:, None], n, axis=1),
        impulse=np.zeros((blocks, b, 3)),
        tally=np.zeros((blocks, 2), np.int64),
    )  # fmt: skip


def moved_children(child: NDArray[np.int64], nodes: int, leaves: int) -> NDArray[np.int64]:
    """A tree's children where so many nodes and leaves come before it."""
    return np.where(child >= 0, child + nodes, child - leaves)


_PARTS: tuple[Any, ...] = (
    (lambda tree: tree.child, 1),
    (lambda tree: tree.corners, 9),
    (lambda tree: tree.faces, 1),
    (lambda tree: tree.vertex_normals, 1),
    (lambda tree: tree.edge_normals, 1),
)
"""What the trees of several bodies are counted by: nodes, leaves, triangles, vertices, edges."""
