"""Contact of a vertex with a body: the deepest primitive, forces, anchors.

Indices that address arrays per vertex are unsigned, as in nuno_contact.penalty.distance: numba then leaves the
test for negative indices out. Loops over vertices read the arrays of tuples before they begin: reading a field of a
tuple counts a reference, atomically, each time round, wherever the compiler cannot tell that it need not.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_contact.fields.sample import Fields
from nuno_contact.penalty.distance import (
    BOX,
    CAPSULE,
    FIELD,
    Deepest,
    are_apart,
    lower_box,
    lower_capsule,
    lower_plane,
)  # fmt: skip
from nuno_contact.penalty.field_distance import Bodies, lower_field, primitive_distance
from nuno_kernels import forced_inline, kernel
from nuno_kernels.bodies.poses import Index, Vector
from nuno_schemas.fabric import Float, Int

if TYPE_CHECKING:
    from nuno_contact.penalty.contact import Contact


class Touch(NamedTuple):
    """Contact data of n vertices and one body: the rows of Contact's arrays of these names for it."""

    stiffness: Float
    damping: Float
    friction: float
    rate: float
    deepest: NDArray[np.int64]
    anchor: Float
    """(3, n)"""
    anchor_frame: Int


class Response(NamedTuple):
    """Response of a primitive to a vertex."""

    distance: float
    """signed distance from the primitive [m]"""
    push: float
    """N, the force along the normal [N]"""
    stretch: Vector
    """elongation of the friction spring in the tangent plane [m]"""
    normal: Vector
    slip: Vector
    """tangential velocity relative to the body [m/s]"""
    mark: int
    """1 if the point has no normal of its own, else 0"""


@forced_inline
def fields_of(contact: Contact) -> Fields | None:
    """Return the distance fields of bodies, None without any: the code that reads them is then not compiled."""
    return join_parts(contact.field_head, contact.field_child, contact.field_corners)


@forced_inline
def join_parts(head: Float | None, child: Int | None, corners: NDArray[np.float32] | None) -> Fields | None:
    """Return fields of three arrays, None of three None: numba prunes by arguments."""
    if head is None or child is None or corners is None:
        return None
    return Fields(head, child, corners)


@forced_inline
def touch_of(contact: Contact, body: int, rate: float) -> Touch:
    """Return the contact data of one body, dashpots bounded by `rate` [1/s] (see Contact.rate)."""
    return Touch(
        contact.stiffness[body], contact.damping[body], contact.friction[body], rate, contact.deepest[body],
        contact.anchor[body], contact.anchor_frame[body],
    )  # fmt: skip


@forced_inline
def bodies_of(contact: Contact) -> Bodies:
    """Return the posed bodies."""
    return Bodies(contact.kind, contact.frame, contact.posed, contact.frames)


@kernel
def find_deepest(x: Float, low: int, high: int, block: int, body: int, contact: Contact, fields: Fields | None) -> bool:
    """Find the body's deepest primitive for vertices [low, high), contact.deepest[body] (-1 for a vertex outside), and
    whether any can be inside, contact.near[body, block], which is returned.

    A block that stays out of reach is not written again.
    """
    kind, posed, frames, bounds, near = contact.kind, contact.posed, contact.frames, contact.bounds, contact.near
    deepest = Deepest(contact.distance, contact.deepest[body])
    was_near = near[body, block]
    near[body, block] = False
    for p in range(contact.first[body], contact.first[body + 1]):
        if are_apart(kind[p], posed, p, bounds, block):
            continue
        if not near[body, block]:
            near[body, block] = True
            for i in range(np.uint64(low), np.uint64(high)):
                deepest.distance[i], deepest.primitive[i] = 0.0, -1
        if kind[p] == CAPSULE:
            lower_capsule(x, low, high, posed, p, deepest)
        elif kind[p] == BOX:
            lower_box(x, low, high, posed, p, frames, contact.frame[p], deepest)
        elif kind[p] != FIELD:
            lower_plane(x, low, high, posed, p, deepest)
        elif fields is not None:
            lower_field(x, low, high, posed, p, frames, contact.frame[p], fields, deepest)
    if was_near and not near[body, block]:
        for i in range(np.uint64(low), np.uint64(high)):
            deepest.primitive[i] = -1
    return bool(near[body, block])


@forced_inline
def respond(x: Float, v: Float, i: Index, touch: Touch, bodies: Bodies, fields: Fields | None) -> Response:
    """Return the contact of vertex i, of positions and velocities x, v (3, n), with its deepest primitive.

    The dashpot sees an approach of depth times `rate` [1/s] at most: see Contact.rate.
    """
    p = np.uint64(touch.deepest[i])
    f, frames = np.uint64(bodies.frame[p]), bodies.frames
    px, py, pz = x[0, i], x[1, i], x[2, i]
    distance, nx, ny, nz, mark = primitive_distance((px, py, pz), p, f, bodies, fields)
    rx, ry, rz = px - frames[f, 9], py - frames[f, 10], pz - frames[f, 11]
    ux = v[0, i] - frames[f, 12] - (frames[f, 16] * rz - frames[f, 17] * ry)
    uy = v[1, i] - frames[f, 13] - (frames[f, 17] * rx - frames[f, 15] * rz)
    uz = v[2, i] - frames[f, 14] - (frames[f, 15] * ry - frames[f, 16] * rx)
    un = ux * nx + uy * ny + uz * nz
    push = max(0.0, -touch.stiffness[i] * distance - touch.damping[i] * max(un, touch.rate * distance))
    ex, ey, ez = 0.0, 0.0, 0.0
    if touch.anchor_frame[i] >= 0:
        g = np.uint64(touch.anchor_frame[i])
        ax, ay, az = touch.anchor[0, i], touch.anchor[1, i], touch.anchor[2, i]
        ex = px - (frames[g, 9] + frames[g, 0] * ax + frames[g, 1] * ay + frames[g, 2] * az)
        ey = py - (frames[g, 10] + frames[g, 3] * ax + frames[g, 4] * ay + frames[g, 5] * az)
        ez = pz - (frames[g, 11] + frames[g, 6] * ax + frames[g, 7] * ay + frames[g, 8] * az)
        en = ex * nx + ey * ny + ez * nz
        ex, ey, ez = ex - en * nx, ey - en * ny, ez - en * nz
    slip = (ux - un * nx, uy - un * ny, uz - un * nz)
    return Response(distance, push, (ex, ey, ez), (nx, ny, nz), slip, mark)


@forced_inline
def rub(k: float, c: float, response: Response) -> Vector:
    """Return the force [N] of the friction spring k [N/m] and its dashpot c [N s/m], before Coulomb's limit."""
    e, t = response.stretch, response.slip
    return -k * e[0] - c * t[0], -k * e[1] - c * t[1], -k * e[2] - c * t[2]


@forced_inline
def limit_friction(response: Response, friction: Vector, push: float, limit: float) -> Vector:
    """Return the force [N] of `push` along the normal and of friction, no longer than `limit`."""
    n = response.normal
    size = math.sqrt(friction[0] * friction[0] + friction[1] * friction[1] + friction[2] * friction[2])
    share = limit / size if size > limit else 1.0
    return push * n[0] + share * friction[0], push * n[1] + share * friction[1], push * n[2] + share * friction[2]


@forced_inline
def place_anchor(x: Float, i: Index, response: Response, limit: float, touch: Touch, bodies: Bodies) -> None:
    """Place the anchor of a touching vertex after a step: unchanged while it sticks, else dragged along until the
    spring's force is `limit` [N].
    """
    anchor, anchor_frame, frames = touch.anchor, touch.anchor_frame, bodies.frames
    f = np.uint64(bodies.frame[np.uint64(touch.deepest[i])])
    ex, ey, ez = response.stretch
    stretch = touch.stiffness[i] * math.sqrt(ex * ex + ey * ey + ez * ez)
    if anchor_frame[i] == f and stretch <= limit:
        return
    share = limit / stretch if stretch > limit else 1.0
    ax = x[0, i] - share * ex - frames[f, 9]
    ay = x[1, i] - share * ey - frames[f, 10]
    az = x[2, i] - share * ez - frames[f, 11]
    for c in range(3):
        anchor[c, i] = frames[f, c] * ax + frames[f, 3 + c] * ay + frames[f, 6 + c] * az
    anchor_frame[i] = f


@kernel
def add_body(
    x: Float, v: Float, low: int, high: int, touch: Touch, bodies: Bodies, fields: Fields | None, force: Float
) -> int:
    """Add one body's force [N] on vertices [low, high); return how many lay on a capsule's axis."""
    on_axis, deepest, stiffness, damping = 0, touch.deepest, touch.stiffness, touch.damping
    for i in range(np.uint64(low), np.uint64(high)):
        if deepest[i] < 0:
            continue
        response = respond(x, v, i, touch, bodies, fields)
        friction = rub(stiffness[i], damping[i], response)
        fx, fy, fz = limit_friction(response, friction, response.push, touch.friction * response.push)
        force[0, i] += fx
        force[1, i] += fy
        force[2, i] += fz
        on_axis += response.mark
    return on_axis


@kernel
def commit_body(x: Float, v: Float, low: int, high: int, touch: Touch, bodies: Bodies, fields: Fields | None) -> int:
    """Set, drag along or drop the anchors of vertices [low, high); return how many touch."""
    touching, deepest, anchor_frame = 0, touch.deepest, touch.anchor_frame
    for i in range(np.uint64(low), np.uint64(high)):
        anchored_to = anchor_frame[i]
        anchor_frame[i] = anchored_to if deepest[i] >= 0 else np.int32(-1)
    for i in range(np.uint64(low), np.uint64(high)):
        if deepest[i] < 0:
            continue
        response = respond(x, v, i, touch, bodies, fields)
        if response.distance >= 0.0:
            anchor_frame[i] = -1
            continue
        touching += 1
        place_anchor(x, i, response, touch.friction * response.push, touch, bodies)
    return touching
