"""Sliding contact with a skin that bends: vertices and the middles of edges are kept off its closest points.

At each frame's start the nearest triangle of every point is searched for, and within the frame it is walked on from
there (nuno_geometry.moving_mesh). A point off the skin is searched for again at the frame's end, as if it went with the
skin meanwhile: another limb may come to it. The closest point has a plane, which goes with that point of the skin until
the cloth has slid along it or a third of a frame is over. A point that is nearer to its plane than its margin, which
goes by how round the skin is there, is put back, PUSH faster than it comes at most; its velocity into the skin is
taken, and friction of that along it. The middle of an edge moves both ends.

Nothing is proven: a triangle may enter between its points, and a second limb may come to a point on the first within a
frame. It is measured instead (nuno.collision). Inside of two parts of a skin that passes through itself, a point is put
out of the nearer one, into the other. What a frame's start finds depends on nothing before: there is no state.

Not chosen: tracks that go on from frame to frame, which hang on the wrong leg, and belong to the state; and a second
track for each point, on whatever faces it from the other side: its search took as long as all else, and cloth of a walk
was no farther inside without it, at twice its pace in 2 of 55 frames and not in 1.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from nuno_contact.margins import local_roundness, round_margin
from nuno_geometry.closest_point import find_place
from nuno_geometry.moving_mesh import MovingMesh, fit_tree, make_moving_mesh, normal_at, walk
from nuno_geometry.poses import Vector
from nuno_geometry.skinning import bend_skin
from nuno_geometry.tree import make_room
from nuno_kernels import block_kernel, forced_inline, kernel
from nuno_kernels.step.blocks import Long
from nuno_kernels.terms import over_blocks, register
from nuno_schemas.bodies import Geometry, Poses, Skin
from nuno_schemas.fabric import Fabric, Float, Int

BLOCK = 256
"""points handled together"""
FASTEST = 4.0
"""Points are not looked at until they could be near the skin at this speed [m/s]."""
NEAR, SLID, PARTS = 4e-3, 2e-3, 3.0
"""planes of points no farther from their margin [m] are found anew after such a way along them [m], and so many times a
frame; those of others after half of their distance"""
PUSH = 1.0
"""speed at which what lies beyond a plane is put back [m/s]"""
RESTS = 1.02
"""Points within so many margins rest on the skin."""


class SkinSlides(NamedTuple):
    """A skin, its motion over one frame of animation, and p points of cloth of n vertices: these, then the middles of
    edges.
    """

    mesh: MovingMesh
    local: Float
    """(v, 3) vertices in the bind pose [m]"""
    place: Float
    joint: Int
    weight: Float
    """as in Skin"""
    carrier: Int
    """(q,) its frames among all"""
    ends: Int
    """(p, 2) vertices of each point, twice the same for a vertex"""
    gap: float
    """distance from the surface at which cloth rests [m]"""
    margin: Float
    """(p,) least distance at which each point is kept [m], by the whole skin; larger where it is sharper"""
    spread: Float
    """(p,) S of the triangles at each point [m^2] (nuno_contact.margins)"""
    round: Float
    """(v, 2) 1 / radius [1/m] and 1 - cosine of each vertex of the skin, in the bind pose, for its round_margin"""
    friction: float
    body: int
    """number of its body"""
    mobility: Float
    """(n,) 1 / mass [1/kg], 0 for vertices that are held or carried"""
    time: Float
    """(3,) the interval's length [s], its inverse, or 0 for a body that stands still, and the fraction at the last
    step's end"""
    face: Long
    """(p,) triangle that each point was nearest to, when last looked for"""
    plane: Float
    """(p, 12) closest point [m], its velocity [m/s], the unit normal, and the fraction of the interval, as of when they
    were found; the fraction until which the point is left alone; and the distance at which it is kept [m]"""
    touching: Int
    """(1,) points touching after the last step"""


@forced_inline
def middle(x: Float, i: int, j: int) -> Vector:
    """Return the middle of two columns of x (3, n)."""
    return 0.5 * (x[0, i] + x[0, j]), 0.5 * (x[1, i] + x[1, j]), 0.5 * (x[2, i] + x[2, j])


@kernel
def find_plane(at: Vector, p: int, s: float, m: SkinSlides) -> float:
    """Walk to the closest point of a point of the cloth, lay its plane there, and return its distance [m]."""
    foot, mesh, plane = walk(at, m.face[p], s, m.mesh), m.mesh, m.plane
    n, way, distance = normal_at(foot, s, mesh), foot.way, math.sqrt(foot.square)
    if way[0] * n[0] + way[1] * n[1] + way[2] * n[2] < 0.0:
        distance = -distance
    size = distance
    if abs(distance) < 1e-9 * (abs(at[0]) + abs(at[1]) + abs(at[2])):
        way, size = n, math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    i, j, k = mesh.tree.faces[foot.face, 0], mesh.tree.faces[foot.face, 1], mesh.tree.faces[foot.face, 2]
    a, x, y = 1.0 - foot.s - foot.t, mesh.start, mesh.end
    m.face[p], plane[p, 9] = foot.face, s
    for c in range(3):
        moved = a * (y[i, c] - x[i, c]) + foot.s * (y[j, c] - x[j, c]) + foot.t * (y[k, c] - x[k, c])
        plane[p, c], plane[p, 3 + c] = at[c] - foot.way[c], m.time[1] * moved
        plane[p, 6 + c] = way[c] / size if size != 0.0 else 0.0
    bent = a * m.round[i, 0] + foot.s * m.round[j, 0] + foot.t * m.round[k, 0]
    turned = a * m.round[i, 1] + foot.s * m.round[j, 1] + foot.t * m.round[k, 1]
    local = round_margin(m.spread[p], 1.0 / bent, 1.0 - turned) if bent > 0.0 else 0.0
    plane[p, 11] = max(m.margin[p], m.gap + local)
    return distance


@block_kernel
def begin_block(block: int, x: Float, m: SkinSlides) -> None:
    """Find the planes of a block's points at the interval's start."""
    room, tree, face, span = make_room(), m.mesh.tree, m.face, m.time[0]
    for p in range(block * BLOCK, min((block + 1) * BLOCK, m.ends.shape[0])):
        at = middle(x, m.ends[p, 0], m.ends[p, 1])
        reach = FASTEST * span + m.margin[p] + math.sqrt(m.spread[p]) + NEAR
        m.plane[p, 10] = math.inf
        if abs(at[0]) + abs(at[1]) + abs(at[2]) < math.inf:
            face[p] = tree.face[find_place(at, tree.place[face[p]], 0, tree, room, reach * reach)]
            m.plane[p, 10] = max(0.0, find_plane(at, p, 0.0, m) - m.plane[p, 11] - NEAR) / (FASTEST * span)


@block_kernel
def look_ahead(block: int, x: Float, m: SkinSlides) -> None:
    """Let points of a block that are off the skin at the interval's start follow what is nearest at its end."""
    room, tree, face, plane, span = make_room(), m.mesh.tree, m.face, m.plane, m.time[0]
    for p in range(block * BLOCK, min((block + 1) * BLOCK, m.ends.shape[0])):
        if not 0.0 < plane[p, 10] < 1.0:
            continue
        at, known = middle(x, m.ends[p, 0], m.ends[p, 1]), face[p]
        gone = at[0] + span * plane[p, 3], at[1] + span * plane[p, 4], at[2] + span * plane[p, 5]
        face[p] = tree.face[find_place(gone, tree.place[known], 0, tree, room, math.inf)]
        if face[p] != known:
            find_plane(at, p, 0.0, m)


@forced_inline
def from_plane(at: Vector, p: int, s: float, span: float, plane: Float) -> tuple[float, float]:
    """Return the distance of a point from its plane [m], and the square of its way along it [m^2], at fraction s."""
    gone = span * (s - plane[p, 9])
    x = at[0] - plane[p, 0] - gone * plane[p, 3]
    y = at[1] - plane[p, 1] - gone * plane[p, 4]
    z = at[2] - plane[p, 2] - gone * plane[p, 5]
    distance = x * plane[p, 6] + y * plane[p, 7] + z * plane[p, 8]
    return distance, x * x + y * y + z * z - distance * distance


@block_kernel
def put_back(x: Float, v: Float, s: float, h: float, share: float, m: SkinSlides) -> None:
    """Keep points at a share of their margins, one after the other, in place in x and v (3, n), in a step of h [s]."""
    ends, plane, mobility = m.ends, m.plane, m.mobility
    friction, span, touching = m.friction, m.time[0], 0
    for p in range(ends.shape[0]):
        if s < plane[p, 10]:
            continue
        i, j = ends[p, 0], ends[p, 1]
        at, both = middle(x, i, j), mobility[i] + mobility[j]
        distance, slid = from_plane(at, p, s, span, plane)
        free = distance - plane[p, 11]
        far, old = max(SLID, 0.5 * free), free < NEAR and PARTS * (s - plane[p, 9]) >= 1.0
        if old or not slid < far * far:
            distance = find_plane(at, p, s, m)
        plane[p, 10] = s + max(0.0, distance - plane[p, 11] - NEAR) / (FASTEST * span)
        if not distance < share * plane[p, 11] or both == 0.0:
            continue
        u, n = middle(v, i, j), (plane[p, 6], plane[p, 7], plane[p, 8])
        r = u[0] - plane[p, 3], u[1] - plane[p, 4], u[2] - plane[p, 5]
        along = r[0] * n[0] + r[1] * n[1] + r[2] * n[2]
        taken = max(0.0, -along)
        lift = min(plane[p, 11] - distance, h * (taken + PUSH))
        t = r[0] - along * n[0], r[1] - along * n[1], r[2] - along * n[2]
        size = math.sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2])
        slow = min(1.0, friction * taken / size) if size > 0.0 else 0.0
        # The ends move as an impulse on their middle moves them, so that it goes as far.
        first, second = 2.0 * mobility[i] / both, 2.0 * mobility[j] / both if j != i else 0.0
        for c in range(3):
            way, change = lift * n[c] - h * slow * t[c], taken * n[c] - slow * t[c]
            x[c, i] += first * way
            v[c, i] += first * change
            x[c, j] += second * way
            v[c, j] += second * change
        touching += 1
    m.touching[0] = touching


@kernel
def hold_points(m: SkinSlides, x: Float, v: Float, s: float, threads: int | None) -> None:
    """Keep all points of cloth x, v (3, n) off the skin after a step that ends at fraction s of the interval."""
    put_back(x, v, s, m.time[0] * (s - m.time[2]), 1.0, m)
    m.time[2] = s


def set_skin_poses(m: SkinSlides, start: Poses, end: Poses) -> None:
    """Write the interval into the term."""
    skin, moving = Skin(m.place, m.joint, m.weight), end.t > start.t
    for poses, to in ((start, m.mesh.start), (end if moving else start, m.mesh.end)):
        to[:] = bend_skin(skin, m.local, poses.rotation[m.carrier], poses.translation[m.carrier])
    m.time[1] = 1.0 / (end.t - start.t) if moving else 0.0


begin_blocks, look_ahead_in_blocks = over_blocks(begin_block, "x, m"), over_blocks(look_ahead, "x, m")


@kernel
def begin_frame(m: SkinSlides, x: Float, span: float, threads: int | None) -> None:
    """Find all planes at the start of an interval of `span` [s]."""
    m.time[0], m.time[2] = span, 0.0
    fit_tree(m.mesh.start, m.mesh.tree)
    blocks = (m.ends.shape[0] + BLOCK - 1) // BLOCK
    begin_blocks(x, m, blocks, threads)
    if span * m.time[1] > 0.0:
        fit_tree(m.mesh.end, m.mesh.tree)
        look_ahead_in_blocks(x, m, blocks, threads)


def begin_interval(m: SkinSlides, x: Float, span: float, threads: int | None) -> None:
    """Do so, unless no step is to come."""
    if span > 0.0:
        begin_frame(m, x, span, threads)


def hold_forces(m: SkinSlides, x: Float, force: Float) -> None:
    """Hold the forces (3, n) on vertices x (3, n) off the skin as it is, in place, as if they were at rest on it."""
    begin_frame(m, x, 0.0, None)
    change = force * m.mobility
    put_back(x.copy(), change, 0.0, 0.0, RESTS, m)
    force[:] = np.divide(change, m.mobility, out=force, where=m.mobility > 0.0)


def act_alone(m: SkinSlides, body: int) -> SkinSlides:
    """Return the term if the body is its own, else one that holds nothing."""
    return m if body == m.body else m._replace(mobility=np.zeros_like(m.mobility))


register(
    SkinSlides, "slides", hold=hold_points, begin=begin_interval, interval=set_skin_poses, unbalance=hold_forces,
    alone=act_alone, counts=lambda term: {"touching": int(term.touching[0])}, vertices=lambda term: len(term.ends),
)  # fmt: skip


def make_skin_slides(
    geometry: Geometry, primitive: int, fabric: Fabric, gap: float, margin: Float, spread: Float
) -> SkinSlides:
    """Return the term of a skin in its bind pose; margin (n,) [m] and spread (n,) [m^2] of the vertices."""
    skin, (x, faces), body = geometry.skin(primitive), geometry.mesh(primitive), int(geometry.body[primitive])
    assert skin is not None
    sides = np.sort(fabric.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    vertices, first = np.arange(fabric.number)[:, None].repeat(2, axis=1), int(geometry.frame[primitive])
    ends = np.concatenate([vertices, np.unique(sides, axis=0)]).astype(np.int32)
    return SkinSlides(
        make_moving_mesh(x, faces), x, skin.place, skin.joint, skin.weight,
        np.arange(first, first + len(skin.place), dtype=np.int32), ends, gap, margin[ends].max(axis=1),
        spread[ends].max(axis=1), local_roundness(x, faces), float(geometry.friction[body]), body,
        np.where(fabric.pinned, 0.0, 1.0 / fabric.mass), np.zeros(3), np.zeros(len(ends), np.int64),
        np.zeros((len(ends), 12)), np.zeros(1, np.int64),
    )  # fmt: skip
