"""What a vertex meets and how the body answers: the deepest primitive, forces, anchors.

Indices that address arrays per vertex are unsigned, as in nuno_contact.penalty.distance: numba then leaves the
test for negative indices out. Loops see arrays, never the Contact tuple: reading a field of a
tuple counts a reference, atomically, each time round.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_contact.penalty.distance import BOX, CAPSULE, FIELD, are_apart, lower_box, lower_capsule, lower_plane
from nuno_contact.penalty.field_distance import lower_field, primitive_distance
from nuno_kernels import forced_inline, kernel
from nuno_kernels.bodies.poses import Index
from nuno_schemas.fabric import Float, Int

Response = tuple[float, float, float, float, float, float, float, float, float, float, float, int]


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
    near: NDArray[np.bool_],
    body: int,
    head: Any,
    cells: Any,
    corners: Any,
) -> bool:
    """Deepest of primitives [first, last) for vertices [low, high), into row `body` of deepest
    (-1 where a vertex is inside of none), and near[body, block]: whether any can be inside.

    A block that stays out of reach is not written again.
    """
    was_near = near[body, block]
    near[body, block] = False
    for p in range(first, last):
        if are_apart(kind[p], posed, p, bounds, block):
            continue
        if not near[body, block]:
            near[body, block] = True
            for i in range(np.uint64(low), np.uint64(high)):
                distance[i], deepest[body, i] = 0.0, -1
        if kind[p] == CAPSULE:
            lower_capsule(x, low, high, posed, p, distance, deepest, body)
        elif kind[p] == BOX:
            lower_box(x, low, high, posed, p, frames, frame[p], distance, deepest, body)
        elif kind[p] != FIELD:
            lower_plane(x, low, high, posed, p, distance, deepest, body)
        elif head is not None:
            lower_field(x, low, high, posed, p, frames, frame[p], head, cells, corners, distance, deepest, body)
    if was_near and not near[body, block]:
        for i in range(np.uint64(low), np.uint64(high)):
            deepest[body, i] = -1
    return bool(near[body, block])


@forced_inline
def respond(
    x: Float,
    v: Float,
    i: Index,
    body: int,
    p: Index,
    kind: int,
    f: Index,
    k: float,
    c: float,
    posed: Float,
    frames: Float,
    anchor: Float,
    anchor_frame: Int,
    rate: float,
    head: Any,
    cells: Any,
    corners: Any,
) -> Response:
    """Contact of vertex i with primitive p, which moves with frame f.

    The dashpot sees an approach of depth times `rate` [1/s] at most: see Contact.rate.

    Returns the signed distance [m], N [N], the elongation of the friction spring in the tangent
    plane [m], the normal, the tangential velocity relative to the body [m/s], the on-axis mark.
    """
    px, py, pz = x[0, i], x[1, i], x[2, i]
    distance, nx, ny, nz, on_axis = primitive_distance(px, py, pz, kind, posed, p, frames, f, head, cells, corners)
    rx, ry, rz = px - frames[f, 9], py - frames[f, 10], pz - frames[f, 11]
    ux = v[0, i] - frames[f, 12] - (frames[f, 16] * rz - frames[f, 17] * ry)
    uy = v[1, i] - frames[f, 13] - (frames[f, 17] * rx - frames[f, 15] * rz)
    uz = v[2, i] - frames[f, 14] - (frames[f, 15] * ry - frames[f, 16] * rx)
    un = ux * nx + uy * ny + uz * nz
    normal = max(0.0, -k * distance - c * max(un, rate * distance))
    ex, ey, ez = 0.0, 0.0, 0.0
    if anchor_frame[body, i] >= 0:
        g = np.uint64(anchor_frame[body, i])
        ax, ay, az = anchor[body, 0, i], anchor[body, 1, i], anchor[body, 2, i]
        ex = px - (frames[g, 9] + frames[g, 0] * ax + frames[g, 1] * ay + frames[g, 2] * az)
        ey = py - (frames[g, 10] + frames[g, 3] * ax + frames[g, 4] * ay + frames[g, 5] * az)
        ez = pz - (frames[g, 11] + frames[g, 6] * ax + frames[g, 7] * ay + frames[g, 8] * az)
        en = ex * nx + ey * ny + ez * nz
        ex, ey, ez = ex - en * nx, ey - en * ny, ez - en * nz
    return distance, normal, ex, ey, ez, nx, ny, nz, ux - un * nx, uy - un * ny, uz - un * nz, on_axis


@forced_inline
def place_anchor(
    x: Float,
    i: Index,
    body: int,
    f: Index,
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
        anchor[body, c, i] = frames[f, c] * ax + frames[f, 3 + c] * ay + frames[f, 6 + c] * az
    anchor_frame[body, i] = f


@kernel
def add_body(
    x: Float,
    v: Float,
    low: int,
    high: int,
    body: int,
    kind: NDArray[np.int8],
    frame: Int,
    stiffness: Float,
    damping: Float,
    friction: Float,
    posed: Float,
    frames: Float,
    deepest: NDArray[np.int64],
    anchor: Float,
    anchor_frame: Int,
    rate: float,
    head: Any,
    cells: Any,
    corners: Any,
    force: Float,
) -> int:
    """Add one body's force [N] on vertices [low, high); returns how many lay on a capsule's axis."""
    on_axis = 0
    mu = friction[body]
    for i in range(np.uint64(low), np.uint64(high)):
        if deepest[body, i] < 0:
            continue
        p = np.uint64(deepest[body, i])
        k, c = stiffness[body, i], damping[body, i]
        _, normal, ex, ey, ez, nx, ny, nz, tx, ty, tz, mark = respond(
            x, v, i, body, p, kind[p], np.uint64(frame[p]), k, c, posed, frames, anchor, anchor_frame, rate,
            head, cells, corners,
        )  # fmt: skip
        fx, fy, fz = -k * ex - c * tx, -k * ey - c * ty, -k * ez - c * tz
        size, limit = math.sqrt(fx * fx + fy * fy + fz * fz), mu * normal
        share = limit / size if size > limit else 1.0
        force[0, i] += normal * nx + share * fx
        force[1, i] += normal * ny + share * fy
        force[2, i] += normal * nz + share * fz
        on_axis += mark
    return on_axis


@kernel
def commit_body(
    x: Float,
    v: Float,
    low: int,
    high: int,
    body: int,
    kind: NDArray[np.int8],
    frame: Int,
    stiffness: Float,
    damping: Float,
    friction: Float,
    posed: Float,
    frames: Float,
    deepest: NDArray[np.int64],
    anchor: Float,
    anchor_frame: Int,
    rate: float,
    head: Any,
    cells: Any,
    corners: Any,
) -> int:
    """Set, drag along or drop the anchors of vertices [low, high); returns how many touch."""
    touching = 0
    mu = friction[body]
    for i in range(np.uint64(low), np.uint64(high)):
        kept = anchor_frame[body, i]
        anchor_frame[body, i] = kept if deepest[body, i] >= 0 else np.int32(-1)
    for i in range(np.uint64(low), np.uint64(high)):
        if deepest[body, i] < 0:
            continue
        p = np.uint64(deepest[body, i])
        f, k = np.uint64(frame[p]), stiffness[body, i]
        distance, normal, ex, ey, ez, _, _, _, _, _, _, _ = respond(
            x, v, i, body, p, kind[p], f, k, damping[body, i], posed, frames, anchor, anchor_frame, rate, head, cells,
            corners,
        )  # fmt: skip
        if distance >= 0.0:
            anchor_frame[body, i] = -1
            continue
        touching += 1
        stretch, limit = k * math.sqrt(ex * ex + ey * ey + ez * ez), mu * normal
        place_anchor(x, i, body, f, ex, ey, ez, stretch, limit, frames, anchor, anchor_frame)
    return touching


@kernel
def drop_anchors(low: int, high: int, body: int, anchor_frame: Int) -> None:
    """Forget the anchors of vertices [low, high)."""
    for i in range(np.uint64(low), np.uint64(high)):
        anchor_frame[body, i] = -1
