"""Penalty contact between vertices and moving bodies, with friction that truly sticks.

A body is the union of its primitives: of those that a vertex is inside of, the deepest acts (a
sum would double the force where bone capsules overlap). Different bodies add up.

Normal force  N = max(0, k depth - c u_n), u the velocity relative to the body, c = 2 zeta sqrt(k m)
with zeta the ratio of critical damping; it never attracts. A resting vertex sinks m g / k.

Friction (Cundall & Strack 1979): a spring from the vertex to an anchor fixed to the body, in the
tangent plane, F = -k_t xi - c_t u_t, no longer than mu N. After each step the anchor of a vertex
that slides is dragged along so that k_t |xi| = mu N; that of a vertex that sticks stays. A force
that only opposes velocity would creep on an incline; this one holds for good if tan(alpha) <= mu.
k_t = k and c_t = c: normal and tangent are orthogonal, so a sticking contact is the isotropic
oscillator k, c and limits the step exactly as much as the normal spring alone, and the elastic
give before sliding is mu times the depth. A larger k_t would cost step size, a smaller one only
adds give; elastic spheres have 2/3 <= k_t/k <= 1 (Mindlin 1949).

An anchor remembers the frame that carries it. When the deepest primitive changes frame (from
thigh to shin) the anchor passes over at its present world position, so friction does not jump.

Blocks of BLOCK vertices are fixed and each vertex is written by its own block only: the same bits
for any number of threads. All scratch is in `Contact`; nothing is allocated in a step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from nuno_kernels import kernel, parallel_kernel
from nuno_kernels.contact_distance import (
    BOX,
    CAPSULE,
    LANES,
    are_apart,
    find_bounds,
    inlined,
    lower_box,
    lower_capsule,
    lower_plane,
    primitive_distance,
)
from nuno_kernels.contact_poses import pose_bodies, set_poses
from nuno_schemas.bodies import Geometry
from nuno_schemas.fabric import Float, Int

__all__ = [
    "Contact", "add_contact", "add_contact_parallel", "commit_contact", "commit_contact_parallel",
    "count_contacts", "make_contact", "set_poses",
]  # fmt: skip

BLOCK = 64
"""Vertices handled together: small enough for tight bounds, large enough to vectorise."""


class Contact(NamedTuple):
    """Bodies, their motion over one frame of animation, and the friction of n vertices.

    p primitives in the order of their bodies, f frames, b bodies, n vertices, B blocks.
    """

    kind: NDArray[np.int8]
    """(p,) as in nuno_schemas.bodies"""
    frame: Int
    """(p,)"""
    first: Int
    """(b + 1,) first primitive of each body"""
    a: Float
    """(p, 3), b (p, 3) and radius (p,) [m] in the frame, as in Geometry"""
    b: Float
    radius: Float
    stiffness: Float
    """(b, n) k of each vertex on each body [N/m]"""
    damping: Float
    """(b, n) c = 2 zeta sqrt(k m) [N s/m]"""
    friction: Float
    """(b,) Coulomb coefficient"""
    rotation0: Float
    """(f, 9) rotation matrix by rows at the start of the interval"""
    origin0: Float
    """(f, 3) [m] at the start"""
    spin: Float
    """(f, 3) rotation vector over the interval [rad], world axes"""
    shift: Float
    """(f, 3) [m] over the interval"""
    anchor: Float
    """(3 b, n) friction anchors in their frame [m], three rows a body: part of the state"""
    anchor_frame: Int
    """(b, n) frame that carries the anchor, -1 where there is none: part of the state"""
    frames: Float
    """(f, 18) frames posed, and their velocities; see contact_distance"""
    posed: Float
    """(p, 14) primitives posed"""
    distance: Float
    """(n,) scratch: least distance to the primitives of one body, 0 where none is negative"""
    deepest: NDArray[np.int64]
    """(n,) scratch: the primitive that has it, -1 where none is"""
    lanes: Float
    """(B, 16) scratch"""
    bounds: Float
    """(B, 6) scratch: bounds of a block's vertices"""
    tally: NDArray[np.int64]
    """(B, 2) vertices touching after the last step; evaluations on a capsule's axis so far"""


def count_contacts(contact: Contact) -> dict[str, int]:
    """Counts for a step report: contacts after the last step, evaluations without a normal so far."""
    touching, on_axis = (int(total) for total in contact.tally.sum(axis=0))
    return {"touching": touching, "on_capsule_axis": on_axis}


@kernel
def find_deepest(
    x: Float,
    low: int,
    high: int,
    first: int,
    last: int,
    kind: NDArray[np.int8],
    frame: Int,
    posed: Float,
    frames: Float,
    bounds: Float,
    block: int,
    distance: Float,
    deepest: NDArray[np.int64],
) -> bool:
    """Deepest of primitives [first, last) for vertices [low, high); False if none can be inside."""
    near = False
    for p in range(first, last):
        if are_apart(kind[p], posed, p, bounds, block):
            continue
        if not near:
            near = True
            for i in range(low, high):
                distance[i], deepest[i] = 0.0, -1
        if kind[p] == CAPSULE:
            lower_capsule(x, low, high, posed, p, distance, deepest)
        elif kind[p] == BOX:
            lower_box(x, low, high, posed, p, frames, frame[p], distance, deepest)
        else:
            lower_plane(x, low, high, posed, p, distance, deepest)
    return near


@inlined
def respond(
    x: Float,
    v: Float,
    i: int,
    body: int,
    p: int,
    kind: int,
    f: int,
    k: float,
    c: float,
    posed: Float,
    frames: Float,
    anchor: Float,
    anchor_frame: Int,
) -> tuple[float, float, float, float, float, float, float, float, float, float, int]:
    """Contact of vertex i with primitive p, which moves with frame f.

    Returns the normal, N [N], the elongation of the friction spring in the tangent plane [m], the
    tangential velocity relative to the body [m/s], and the on-axis mark.
    """
    px, py, pz = x[0, i], x[1, i], x[2, i]
    distance, nx, ny, nz, on_axis = primitive_distance(px, py, pz, kind, posed, p, frames, f)
    rx, ry, rz = px - frames[f, 9], py - frames[f, 10], pz - frames[f, 11]
    ux = v[0, i] - frames[f, 12] - (frames[f, 16] * rz - frames[f, 17] * ry)
    uy = v[1, i] - frames[f, 13] - (frames[f, 17] * rx - frames[f, 15] * rz)
    uz = v[2, i] - frames[f, 14] - (frames[f, 15] * ry - frames[f, 16] * rx)
    un = ux * nx + uy * ny + uz * nz
    normal = max(0.0, -k * distance - c * un)
    ex, ey, ez = 0.0, 0.0, 0.0
    g = anchor_frame[body, i]
    if g >= 0:
        ax, ay, az = anchor[3 * body, i], anchor[3 * body + 1, i], anchor[3 * body + 2, i]
        ex = px - (frames[g, 9] + frames[g, 0] * ax + frames[g, 1] * ay + frames[g, 2] * az)
        ey = py - (frames[g, 10] + frames[g, 3] * ax + frames[g, 4] * ay + frames[g, 5] * az)
        ez = pz - (frames[g, 11] + frames[g, 6] * ax + frames[g, 7] * ay + frames[g, 8] * az)
        en = ex * nx + ey * ny + ez * nz
        ex, ey, ez = ex - en * nx, ey - en * ny, ez - en * nz
    return nx, ny, nz, normal, ex, ey, ez, ux - un * nx, uy - un * ny, uz - un * nz, on_axis


@inlined
def place_anchor(
    x: Float,
    i: int,
    body: int,
    f: int,
    ex: float,
    ey: float,
    ez: float,
    stretch: float,
    limit: float,
    frames: Float,
    anchor: Float,
    anchor_frame: Int,
) -> None:
    """Anchor of a touching vertex after a step: left alone while it sticks, else dragged along
    until the spring's force `stretch` [N] is `limit` [N].
    """
    if anchor_frame[body, i] == f and stretch <= limit:
        return
    share = limit / stretch if stretch > limit else 1.0
    ax = x[0, i] - share * ex - frames[f, 9]
    ay = x[1, i] - share * ey - frames[f, 10]
    az = x[2, i] - share * ez - frames[f, 11]
    for c in range(3):
        anchor[3 * body + c, i] = frames[f, c] * ax + frames[f, 3 + c] * ay + frames[f, 6 + c] * az
    anchor_frame[body, i] = f


@kernel
def add_block(block: int, x: Float, v: Float, contact: Contact, force: Float) -> None:
    """Add the contact force [N] on the vertices of one block; bodies are posed already."""
    q = contact
    low, high = block * BLOCK, min((block + 1) * BLOCK, x.shape[1])
    find_bounds(x, low, high, q.lanes, q.bounds, block)
    for body in range(q.first.shape[0] - 1):
        if not find_deepest(
            x, low, high, q.first[body], q.first[body + 1], q.kind, q.frame, q.posed, q.frames, q.bounds, block,
            q.distance, q.deepest,
        ):  # fmt: skip
            continue
        for i in range(low, high):
            p = q.deepest[i]
            if p < 0:
                continue
            k, c = q.stiffness[body, i], q.damping[body, i]
            nx, ny, nz, normal, ex, ey, ez, tx, ty, tz, on_axis = respond(
                x, v, i, body, p, q.kind[p], q.frame[p], k, c, q.posed, q.frames, q.anchor, q.anchor_frame
            )
            fx, fy, fz = -k * ex - c * tx, -k * ey - c * ty, -k * ez - c * tz
            size, limit = math.sqrt(fx * fx + fy * fy + fz * fz), q.friction[body] * normal
            share = limit / size if size > limit else 1.0
            force[0, i] += normal * nx + share * fx
            force[1, i] += normal * ny + share * fy
            force[2, i] += normal * nz + share * fz
            q.tally[block, 1] += on_axis


@kernel
def commit_block(block: int, x: Float, v: Float, contact: Contact) -> None:
    """Set, drag along or drop the friction anchors of one block; bodies are posed already."""
    q = contact
    low, high = block * BLOCK, min((block + 1) * BLOCK, x.shape[1])
    find_bounds(x, low, high, q.lanes, q.bounds, block)
    touching = 0
    for body in range(q.first.shape[0] - 1):
        near = find_deepest(
            x, low, high, q.first[body], q.first[body + 1], q.kind, q.frame, q.posed, q.frames, q.bounds, block,
            q.distance, q.deepest,
        )  # fmt: skip
        for i in range(low, high):
            p = q.deepest[i] if near else -1
            if p < 0:
                q.anchor_frame[body, i] = -1
                continue
            touching += 1
            k, c = q.stiffness[body, i], q.damping[body, i]
            _, _, _, normal, ex, ey, ez, _, _, _, _ = respond(
                x, v, i, body, p, q.kind[p], q.frame[p], k, c, q.posed, q.frames, q.anchor, q.anchor_frame
            )
            stretch, limit = k * math.sqrt(ex * ex + ey * ey + ez * ez), q.friction[body] * normal
            place_anchor(x, i, body, q.frame[p], ex, ey, ez, stretch, limit, q.frames, q.anchor, q.anchor_frame)
    q.tally[block, 0] = touching


@kernel
def add_contact(x: Float, v: Float, s: float, contact: Contact, force: Float) -> None:
    """Add the contact force [N] on vertices x, v (3, n) at fraction s of the interval to force."""
    pose_bodies(s, contact)
    for block in range(contact.bounds.shape[0]):
        add_block(block, x, v, contact, force)


@kernel
def commit_contact(x: Float, v: Float, s: float, contact: Contact) -> None:
    """Update the friction anchors after a completed step that ends at fraction s."""
    pose_bodies(s, contact)
    for block in range(contact.bounds.shape[0]):
        commit_block(block, x, v, contact)


@parallel_kernel
def add_contact_parallel(x: Float, v: Float, s: float, contact: Contact, force: Float) -> None:
    """add_contact on several threads: the same bits."""
    pose_bodies(s, contact)
    for block in prange(contact.bounds.shape[0]):
        add_block(block, x, v, contact, force)


@parallel_kernel
def commit_contact_parallel(x: Float, v: Float, s: float, contact: Contact) -> None:
    """commit_contact on several threads: the same bits."""
    pose_bodies(s, contact)
    for block in prange(contact.bounds.shape[0]):
        commit_block(block, x, v, contact)


def make_contact(geometry: Geometry, stiffness: Float, damping: Float) -> Contact:
    """A Contact standing still, without anchors, for n vertices.

    `stiffness` (b, n) [N/m] and `damping` (b, n) [N s/m] are those of each vertex on each body;
    the geometry's own are not looked at. Primitives are put in the order of their bodies,
    otherwise in the order given.
    """
    g = geometry
    order = np.argsort(g.body, kind="stable")
    bodies, frames, n = len(g.bodies), len(g.frames), stiffness.shape[1]
    blocks = -(-n // BLOCK)

    def floats(array: Float) -> Float:
        return np.array(array, np.float64, order="C")

    return Contact(
        kind=np.ascontiguousarray(g.kind[order], np.int8),
        frame=np.ascontiguousarray(g.frame[order], np.int32),
        first=np.searchsorted(g.body[order], np.arange(bodies + 1)).astype(np.int32),
        a=floats(g.a[order]),
        b=floats(g.b[order]),
        radius=floats(g.radius[order]),
        stiffness=floats(stiffness),
        damping=floats(damping),
        friction=floats(g.friction),
        rotation0=np.tile(np.eye(3).ravel(), (frames, 1)),
        origin0=np.zeros((frames, 3)),
        spin=np.zeros((frames, 3)),
        shift=np.zeros((frames, 3)),
        anchor=np.zeros((3 * bodies, n)),
        anchor_frame=np.full((bodies, n), -1, np.int32),
        frames=np.zeros((frames, 18)),
        posed=np.zeros((order.shape[0], 14)),
        distance=np.zeros(n),
        deepest=np.full(n, -1, np.int64),
        lanes=np.zeros((blocks, 2 * LANES)),
        bounds=np.zeros((blocks, 6)),
        tally=np.zeros((blocks, 2), np.int64),
    )
