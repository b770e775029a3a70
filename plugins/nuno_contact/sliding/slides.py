"""Sliding contact: vertices never enter moving triangle meshes, slide on them, and rub.

After a step every vertex has made a movement in each body's frame, where the body stands still, however it
moves in the world. The movement goes unchanged unless it enters the body, or ends nearer to its surface than
`gap`; it is then held off by the plane of the triangle it meets, by the next one it meets then, and so on
(nuno_contact.sliding.vertex). The velocity relative to the body is held off by the same planes.

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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_contact.sliding.vertex import slide, slow_down
from nuno_geometry.closest_point import closest
from nuno_geometry.poses import pose_frame, to_frame, turn_out, write_interval
from nuno_geometry.tree import Tree, make_room
from nuno_kernels import block_kernel, kernel
from nuno_kernels.terms import over_blocks, register
from nuno_schemas.fabric import Float, Int

BLOCK = 64
"""vertices handled together"""


class Slides(NamedTuple):
    """b bodies, their motion over one frame of animation, and n vertices in B blocks."""

    root: NDArray[np.int64]
    """(b,) root of each body's tree"""
    frame: Int
    """(b,) frame that carries the body"""
    friction: Float
    """(b,) Coulomb coefficient"""
    gap: Float
    """(b, n) distance from the surface at which each vertex rests [m]"""
    mass: Float
    """(n,) [kg], 0 for vertices that are held or carried: contact leaves them alone"""
    rotation0: Float
    origin0: Float
    spin: Float
    shift: Float
    frames: Float
    """(f, 18) and the rest as in nuno_contact.penalty.contact"""
    tree: Tree
    """the trees of all bodies one after the other, as one"""
    before: Float
    """(b, 3, n) vertices after the last step, in the body's frame [m]; NaN at first"""
    clear: Float
    """(b, n) how far they may move without meeting the surface [m]; negative inside"""
    nearest: NDArray[np.int64]
    """(b, n) place of the nearest triangle"""
    planes: Float
    """(b, 7, n) normals, in the body's frame, of the planes that held vertices off in the last step; their number"""
    impulse: Float
    """(B, b, 3) impulse of the vertices of each block on the body so far [N s]"""
    tally: NDArray[np.int64]
    """(B, 2) vertices touching after the last step; vertices that were put back so far"""


@block_kernel
def slide_block(block: int, x: Float, v: Float, body: int, s: Slides) -> None:
    """Hold the vertices of one block off one body, in place in x and v (3, n)."""
    room, tree, f, mu, root, mass = make_room(), s.tree, s.frame[body], s.friction[body], s.root[body], s.mass
    gaps, frames, before, clear, nearest = s.gap[body], s.frames, s.before[body], s.clear[body], s.nearest[body]
    held, impulse, tally = s.planes[body], s.impulse[block, body], s.tally
    for i in range(block * BLOCK, min((block + 1) * BLOCK, x.shape[1])):
        held[6, i] = 0.0
        if mass[i] == 0.0:
            continue
        px, py, pz = to_frame(x[0, i], x[1, i], x[2, i], frames, f)
        start = (before[0, i], before[1, i], before[2, i])
        m = (px - start[0], py - start[1], pz - start[2])
        free, gap = clear[i], gaps[i]
        left = free - (1.0 + 1e-9) * math.sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2])
        before[0, i], before[1, i], before[2, i] = px, py, pz
        clear[i] = left
        if left > gap or not (abs(px) + abs(py) + abs(pz) < math.inf):
            continue
        end = slide(start, m, free, nearest[i], root, gap, mu, tree, room)
        clear[i], nearest[i] = end.distance, end.place
        if end.planes == 0:
            continue
        p = (start[0] + end.made[0], start[1] + end.made[1], start[2] + end.made[2])
        before[0, i], before[1, i], before[2, i] = p
        for c in range(3):
            held[c, i], held[3 + c, i] = end.n1[c], end.n2[c]
        held[6, i] = end.planes
        moved = turn_out(p, frames, f)
        x[0, i], x[1, i], x[2, i] = moved[0] + frames[f, 9], moved[1] + frames[f, 10], moved[2] + frames[f, 11]
        change = slow_down(v, i, (x[0, i], x[1, i], x[2, i]), end.n1, end.n2, end.planes, mu, frames, f)
        for c in range(3):
            v[c, i] += change[c]
            impulse[c] -= mass[i] * change[c]
        tally[block, 0] += 1
        tally[block, 1] += 1 if end.back else 0


@block_kernel
def slide_bodies(block: int, x: Float, v: Float, s: Slides) -> None:
    """Hold the vertices of one block off all bodies, one after the other."""
    s.tally[block, 0] = 0
    for body in range(s.root.shape[0]):
        slide_block(block, x, v, body, s)


@kernel
def slow_block(block: int, x: Float, v: Float, s: Slides) -> None:
    """Hold velocities v (3, n) of one block off the planes that hold its vertices."""
    for body in range(s.root.shape[0]):
        for i in range(block * BLOCK, min((block + 1) * BLOCK, x.shape[1])):
            planes = int(s.planes[body, 6, i])
            if planes == 0:
                continue
            n1 = (s.planes[body, 0, i], s.planes[body, 1, i], s.planes[body, 2, i])
            n2 = (s.planes[body, 3, i], s.planes[body, 4, i], s.planes[body, 5, i])
            at = (x[0, i], x[1, i], x[2, i])
            change = slow_down(v, i, at, n1, n2, planes, s.friction[body], s.frames, s.frame[body])
            for c in range(3):
                v[c, i] += change[c]
                s.impulse[block, body, c] -= s.mass[i] * change[c]


@kernel
def pose_slides(at: float, s: Slides) -> None:
    """Pose all frames at a fraction of the interval."""
    for f in range(s.frames.shape[0]):
        pose_frame(at, f, s.rotation0, s.origin0, s.spin, s.shift, s.frames)


slide_blocks = over_blocks(slide_bodies, "x, v, s")
slow_blocks = over_blocks(slow_block, "x, v, s")


@kernel
def hold_slides(s: Slides, x: Float, v: Float, at: float, threads: int | None) -> None:
    """Hold all vertices x, v (3, n) off the bodies after a step that ends at fraction `at` of the interval.

    The same bits with any number of threads; None is for one.
    """
    pose_slides(at, s)
    slide_blocks(x, v, s, s.tally.shape[0], threads)


@kernel
def slow_slides(s: Slides, x: Float, v: Float, threads: int | None) -> None:
    """Hold velocities v (3, n) off the planes that hold vertices x (3, n) since `hold_slides`, with friction."""
    slow_blocks(x, v, s, s.tally.shape[0], threads)


@block_kernel
def find_block_room(block: int, x: Float, s: Slides) -> None:
    """Call `find_room` for the vertices of one block."""
    room, tree, frames = make_room(), s.tree, s.frames
    for body in range(s.root.shape[0]):
        before, clear, nearest = s.before[body], s.clear[body], s.nearest[body]
        f, root, gap = s.frame[body], s.root[body], s.gap[body]
        for i in range(block * BLOCK, min((block + 1) * BLOCK, x.shape[1])):
            px, py, pz = to_frame(x[0, i], x[1, i], x[2, i], frames, f)
            ex, ey, ez = px - before[0, i], py - before[1, i], pz - before[2, i]
            before[0, i], before[1, i], before[2, i] = px, py, pz
            left = clear[i] - (1.0 + 1e-9) * math.sqrt(ex * ex + ey * ey + ez * ez)
            if not left > gap[i] and abs(px) + abs(py) + abs(pz) < math.inf:
                near = closest((px, py, pz), nearest[i], root, tree, room)
                left, nearest[i] = near.distance, near.place
            clear[i] = left


find_rooms = over_blocks(find_block_room, "x, s")


@kernel
def find_room(s: Slides, x: Float, span: float, threads: int | None) -> None:
    """Set vertices x (3, n) at the start of the interval as the start of their next movement.

    One that is not where it was left, as after a jump, is searched anew.
    """
    pose_slides(0.0, s)
    find_rooms(x, s, s.tally.shape[0], threads)


def act_alone(slides: Slides, body: int) -> Slides:
    """Return the slides with one of its bodies: vertices are infinitely far from the others."""
    chosen = (np.arange(len(slides.root)) == body)[:, None]
    return slides._replace(clear=np.where(chosen, slides.clear, np.inf))


def count_slides(slides: Slides) -> dict[str, int]:
    """Return the counts for a step report: vertices that touch after the last step, vertices put back so far."""
    touching, back = (int(total) for total in slides.tally.sum(axis=0))
    return {"touching": touching, "put_back": back}


register(
    Slides, "slides", hold=hold_slides, slow=slow_slides, begin=find_room, interval=write_interval, grip="grip:Grip",
    alone=act_alone, unbalance="grip:hold_forces", counts=count_slides,
)  # fmt: skip
