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

Until its spring is loaded a vertex that starts to slide feels less than mu N, and ends up faster than by Coulomb's law
by a share of mu g sqrt(m / k) at most (nuno_contact.penalty.plugin.slip_speed), twice that where it turns round:
whatever the step, for the spring's travel and time do not depend on it. Once it slides friction is mu N. Every law in
which friction grows with a way or a speed has such a loss. Not chosen: friction that cancels the other forces on a
sticking vertex, as far as mu N allows, which loses nothing. It depends on the vertex's springs, and so on its
neighbours: the matrix of implicit solvers would have to hold that, asymmetric. And forces in Python are added after it.

A commit looks only at the vertices that touched at the step's last evaluation, with the primitive
they touched: a search of its own would nearly double the cost. A vertex that arrives after that
evaluation gets its anchor a step later, before which it has nothing to be held by anyway.

An anchor remembers the frame that carries it. When the deepest primitive changes frame (from
thigh to shin) the anchor passes over at its present world position, so friction does not jump.

Blocks of BLOCK vertices are fixed and each vertex is written by its own block only: the same bits
for any number of threads. All scratch is in `Contact`; nothing is allocated in a step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_contact.distance_fields.sample import join_fields
from nuno_contact.margins import round_margin, roundness
from nuno_contact.penalty.distance import (  # fmt: skip
    BOX,
    CAPSULE,
    FIELD,
    PLANE,
    Bodies,
    Deepest,
    Fields,
    Volumes,
    are_apart,
    find_bounds,
    lower_box,
    lower_capsule,
    lower_field,
    lower_plane,
    primitive_distance,
)
from nuno_geometry.poses import Index, Vector, pose_frame, write_interval
from nuno_kernels import block_kernel, forced_inline, kernel
from nuno_kernels.lanes import cross, dot, minus, plus, times
from nuno_kernels.terms import over_blocks, register
from nuno_schemas.bodies import ClosedForm, DistanceField, Geometry, Poses
from nuno_schemas.fabric import Float, Int
from nuno_schemas.layout import Bounds

# Primitives of bodies posed at a moment of a frame, by the frames that carry them.

CORNER = 1.0 / math.sqrt(3.0)
"""cosine of the angle between a cube's diagonal and its faces' normals"""
SHORTEST = 1e-300
"""A capsule with at most this squared length [m^2] is a sphere: the reciprocal would overflow."""


def set_poses(contact: Contact, poses0: Poses, poses1: Poses) -> None:
    """Write the interval into `contact`, in place; see `write_interval`."""
    write_interval(contact, poses0, poses1)
    contact.posed_at[0] = np.nan


@kernel
def pose_primitive(p: int, f: int, contact: Contact) -> None:
    """Fill row p of `posed` (see nuno_contact.penalty.distance) from the primitive in its frame."""
    kind, shapes, frames, posed, square = contact.kind[p], contact.shapes, contact.frames, contact.posed, 0.0
    a, b, radius, margin = shapes.a, shapes.b, shapes.radius, shapes.largest_margin[p]
    for c in range(3):
        m0, m1, m2 = frames[f, 3 * c], frames[f, 3 * c + 1], frames[f, 3 * c + 2]
        start = frames[f, 9 + c] + m0 * a[p, 0] + m1 * a[p, 1] + m2 * a[p, 2]
        if kind == CAPSULE:
            along = m0 * (b[p, 0] - a[p, 0]) + m1 * (b[p, 1] - a[p, 1]) + m2 * (b[p, 2] - a[p, 2])
            square += along * along
            reach = radius[p] + margin
            low, high = min(start, start + along) - reach, max(start, start + along) + reach
        elif kind in (BOX, FIELD):
            along = b[p, c]
            size = abs(m0) * (b[p, 0] + margin) + abs(m1) * (b[p, 1] + margin) + abs(m2) * (b[p, 2] + margin)
            low, high = start - size, start + size
        else:
            along = m0 * b[p, 0] + m1 * b[p, 1] + m2 * b[p, 2]
            low, high = -math.inf, math.inf
        posed[p, c], posed[p, 3 + c], posed[p, 8 + c], posed[p, 11 + c] = start, along, low, high
    posed[p, 6] = shapes.cosine[p] if kind in (BOX, FIELD) else 1.0 / square if square > SHORTEST else 0.0
    posed[p, 7], posed[p, 14], posed[p, 15] = radius[p], shapes.ball[p], shapes.margin[p]


@block_kernel
def pose_bodies(s: float, contact: Contact) -> None:
    """Pose all frames and primitives at fraction s in [0, 1] of the interval.

    A step's end is the next one's start: where s is what it was, they stand there already.
    """
    if contact.posed_at[0] == s:
        return
    contact.posed_at[0] = s
    for f in range(contact.frames.shape[0]):
        pose_frame(s, f, contact.rotation0, contact.origin0, contact.spin, contact.shift, contact.frames)
    for p in range(contact.posed.shape[0]):
        pose_primitive(p, contact.frame[p], contact)


# Contact of a vertex with a body: the deepest primitive, forces, anchors.
#
# Indices that address arrays per vertex are unsigned, as in nuno_contact.penalty.distance: numba then leaves the
# test for negative indices out. Loops over vertices read the arrays of tuples before they begin: reading a field of a
# tuple counts a reference, atomically, each time round, wherever the compiler cannot tell that it need not.


class BodyContact(NamedTuple):
    """Contact data of n vertices and one body: the rows of Contact's arrays of these names for it."""

    stiffness: Float
    damping: Float
    friction: float
    rate: float
    deepest: NDArray[np.int64]
    anchor: Float
    """(3, n)"""
    anchor_frame: Int
    spread: Float
    """(2, n) see Contact"""


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
def body_contact(contact: Contact, body: int, rate: float) -> BodyContact:
    """Return the contact data of one body, dashpots bounded by `rate` [1/s] (see Contact.rate)."""
    return BodyContact(
        contact.stiffness[body], contact.damping[body], contact.friction[body], rate, contact.deepest[body],
        contact.anchor[body], contact.anchor_frame[body], contact.spread,
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
    deepest = Deepest(contact.distance, contact.deepest[body], contact.spread)
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
            lower_field(fields, int(posed[p, 7]), x, (low, high), posed, p, frames, contact.frame[p], deepest)
    if was_near and not near[body, block]:
        for i in range(np.uint64(low), np.uint64(high)):
            deepest.primitive[i] = -1
    return bool(near[body, block])


@forced_inline
def respond(x: Float, v: Float, i: Index, touch: BodyContact, bodies: Bodies, fields: Fields | None) -> Response:
    """Return the contact of vertex i, of positions and velocities x, v (3, n), with its deepest primitive.

    The dashpot sees an approach of depth times `rate` [1/s] at most: see Contact.rate.
    """
    p = np.uint64(touch.deepest[i])
    f, frames = np.uint64(bodies.frame[p]), bodies.frames
    at = x[0, i], x[1, i], x[2, i]
    distance, n, mark = primitive_distance(at, touch.spread[0, i], touch.spread[1, i], p, f, bodies, fields)
    u = minus((v[0, i], v[1, i], v[2, i]), (frames[f, 12], frames[f, 13], frames[f, 14]))
    arm = minus(at, (frames[f, 9], frames[f, 10], frames[f, 11]))
    u = minus(u, cross((frames[f, 15], frames[f, 16], frames[f, 17]), arm))
    un = dot(u, n)
    push = max(0.0, -touch.stiffness[i] * distance - touch.damping[i] * max(un, touch.rate * distance))
    e = 0.0, 0.0, 0.0
    if touch.anchor_frame[i] >= 0:
        g = np.uint64(touch.anchor_frame[i])
        ax, ay, az = touch.anchor[0, i], touch.anchor[1, i], touch.anchor[2, i]
        ex = at[0] - (frames[g, 9] + frames[g, 0] * ax + frames[g, 1] * ay + frames[g, 2] * az)
        ey = at[1] - (frames[g, 10] + frames[g, 3] * ax + frames[g, 4] * ay + frames[g, 5] * az)
        ez = at[2] - (frames[g, 11] + frames[g, 6] * ax + frames[g, 7] * ay + frames[g, 8] * az)
        e = ex, ey, ez
        e = minus(e, times(dot(e, n), n))
    return Response(distance, push, e, n, minus(u, times(un, n)), mark)


@forced_inline
def rub(k: float, c: float, response: Response) -> Vector:
    """Return the force [N] of the friction spring k [N/m] and its dashpot c [N s/m], before Coulomb's limit."""
    return minus(times(-k, response.stretch), times(c, response.slip))


@forced_inline
def limit_friction(response: Response, friction: Vector, push: float, limit: float) -> Vector:
    """Return the force [N] of `push` along the normal and of friction, no longer than `limit`."""
    size = math.sqrt(dot(friction, friction))
    return plus(times(push, response.normal), times(limit / size if size > limit else 1.0, friction))


@forced_inline
def place_anchor(x: Float, i: Index, response: Response, limit: float, touch: BodyContact, bodies: Bodies) -> None:
    """Place the anchor of a touching vertex after a step: unchanged while it sticks, else dragged along until the
    spring's force is `limit` [N].
    """
    anchor, anchor_frame, frames = touch.anchor, touch.anchor_frame, bodies.frames
    f = np.uint64(bodies.frame[np.uint64(touch.deepest[i])])
    ex, ey, ez = response.stretch
    stretch = touch.stiffness[i] * math.sqrt(dot(response.stretch, response.stretch))
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
    x: Float, v: Float, low: int, high: int, touch: BodyContact, bodies: Bodies, fields: Fields | None, force: Float
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
def commit_body(
    x: Float, v: Float, low: int, high: int, touch: BodyContact, bodies: Bodies, fields: Fields | None
) -> int:
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


BLOCK = 256
"""vertices handled together, about a ring or two of a skirt: 64 have tighter bounds, but a block's overhead then takes
a third of the time"""


AT_ONCE = 1e300
"""a rate that nothing reaches, and that times a depth of 0 is 0"""


class Shapes(NamedTuple):
    """p primitives in their frames."""

    a: Float
    """(p, 3), b (p, 3) and radius (p,) [m] in the frame, as in Geometry"""
    b: Float
    radius: Float
    ball: Float
    """(p,) radius [m], and cosine (p,), of boxes and fields for nuno_contact.margins.round_margin"""
    cosine: Float
    margin: Float
    """(p,) distance from the surface at which all vertices are kept [m]"""
    largest_margin: Float
    """(p,) largest margin of a vertex [m]"""


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
    shapes: Shapes
    spread: Float
    """(2, n) S = L^2 / 3 [m^2] of each vertex, L the longest side of its triangles, 0 without any; and 1 for those that
    are kept off by `Shapes.margin`, too, 0 for others"""
    stiffness: Float
    """(b, n) k of each vertex on each body [N/m]"""
    damping: Float
    """(b, n) c = 2 zeta sqrt(k m) [N s/m]"""
    friction: Float
    """(b,) Coulomb coefficient"""
    rate: Float
    """(1,) [1/s] most of the depth that a vertex can have come in over a second: the dashpot's impulse over a step of h
    is c times the way inside of the body, so that a method whose force is the mean over its step sets 1 / h. A dashpot
    that acts at once jumps at the surface, where such a step has no end."""
    rotation0: Float
    """(f, 9) rotation matrix by rows at the start of the interval"""
    origin0: Float
    """(f, 3) [m] at the start"""
    spin: Float
    """(f, 3) rotation vector over the interval [rad], world axes"""
    shift: Float
    """(f, 3) [m] over the interval"""
    anchor: Float
    """(b, 3, n) friction anchors in their frame [m]: part of the state"""
    anchor_frame: Int
    """(b, n) frame that carries the anchor, -1 where there is none: part of the state"""
    frames: Float
    """(f, 18) frames posed, and their velocities; see nuno_contact.penalty.distance"""
    posed: Float
    """(p, 16) primitives posed"""
    posed_at: Float
    """(1,) fraction of the interval at which frames and primitives are posed, NaN where they are not"""
    distance: Float
    """(n,) scratch: least distance to the primitives of one body, 0 where none is negative"""
    deepest: NDArray[np.int64]
    """(b, n) scratch of the last evaluation: the body's deepest primitive, -1 where none touches"""
    near: NDArray[np.bool_]
    """(b, B) scratch of the last evaluation: whether the body was within reach of the block"""
    bounds: Float
    """(B, 6) scratch: bounds of a block's vertices"""
    tally: NDArray[np.int64]
    """(B, 2) vertices touching after the last step; evaluations without a normal so far"""
    fields: Fields | None = None
    """distance fields, read only; None where no body is one: the code that reads them is then not compiled, as is that
    of closed forms where none is"""


def count_contacts(contact: Contact) -> dict[str, int]:
    """Return the counts for a step report: contacts after the last step, evaluations without a normal so far."""
    touching, on_axis = (int(total) for total in contact.tally.sum(axis=0))
    return {"touching": touching, "on_capsule_axis": on_axis}


@block_kernel
def add_block(block: int, x: Float, v: Float, contact: Contact, force: Float) -> None:
    """Add the contact force [N] on the vertices of one block; bodies are posed already."""
    low, high = block * BLOCK, min((block + 1) * BLOCK, x.shape[1])
    find_bounds(x, low, high, contact.bounds, block)
    bodies, fields = bodies_of(contact), contact.fields
    for body in range(contact.friction.shape[0]):
        if find_deepest(x, low, high, block, body, contact, fields):
            on_axis = add_body(x, v, low, high, body_contact(contact, body, contact.rate[0]), bodies, fields, force)
            contact.tally[block, 1] += on_axis


@block_kernel
def commit_block(block: int, x: Float, v: Float, contact: Contact) -> None:
    """Set, drag along or drop the friction anchors of one block; bodies are posed already."""
    low, high = block * BLOCK, min((block + 1) * BLOCK, x.shape[1])
    touching, anchor_frame, bodies, fields = 0, contact.anchor_frame, bodies_of(contact), contact.fields
    for body in range(contact.friction.shape[0]):
        if contact.near[body, block]:
            touching += commit_body(x, v, low, high, body_contact(contact, body, contact.rate[0]), bodies, fields)
        else:
            for i in range(low, high):
                anchor_frame[body, i] = -1
    contact.tally[block, 0] = touching


add_blocks = over_blocks(add_block, "x, v, contact, force")
commit_blocks = over_blocks(commit_block, "x, v, contact")


@kernel
def add_contact(contact: Contact, x: Float, v: Float, s: float, force: Float, threads: int | None) -> None:
    """Add the contact force [N] on vertices x, v (3, n) at fraction s of the interval to force (3, n).

    The same bits with any number of threads; None is for one.
    """
    pose_bodies(s, contact)
    add_blocks(x, v, contact, force, contact.bounds.shape[0], threads)


@kernel
def commit_contact(contact: Contact, x: Float, v: Float, s: float, threads: int | None) -> None:
    """Update the friction anchors after a completed step that ends at fraction s.

    Uses the contacts of the last `add_contact`, which every step calls before.
    """
    pose_bodies(s, contact)
    commit_blocks(x, v, contact, contact.bounds.shape[0], threads)


def limit_approach(contact: Contact, rate: float) -> None:
    """Limit the depth that dashpots see to the way at `rate` [1/s]; see Contact.rate."""
    contact.rate[0] = min(rate, AT_ONCE)


def act_alone(contact: Contact, body: int) -> Contact:
    """Return the contact with one of its bodies: the others have no force."""
    own = (np.arange(len(contact.friction)) == body)[:, None]
    return contact._replace(stiffness=contact.stiffness * own, damping=contact.damping * own)


register(
    Contact, "contact", memory=("anchor", "anchor_frame"),
    bounds=lambda term: {"anchor_frame": Bounds(-1, len(term.origin0) - 1)},
    after=add_contact, settle=commit_contact, interval=set_poses, approach=limit_approach,
    project="projection:project", alone=act_alone, counts=count_contacts,
)  # fmt: skip


def make_contact(
    geometry: Geometry, stiffness: Float, damping: Float, spread: Float | None = None, margin: float = 0.0
) -> Contact:
    """Return a contact with bodies at rest, without anchors, for n vertices.

    `stiffness` (b, n) [N/m] and `damping` (b, n) [N s/m] are those of each vertex on each body;
    the geometry's own are not looked at. `spread` (n,) [m^2] sets the margins of vertices, and `margin` [m] is added
    for those of triangles; it is that of all without a spread. Primitives are put in the order of their bodies,
    otherwise in the order given.
    """
    g = geometry
    order = np.argsort(g.body, kind="stable")
    bodies, frames, n = len(g.bodies), int(g.frame.max(initial=-1)) + 1, stiffness.shape[1]
    blocks = -(-n // BLOCK)

    kind, a, b, radius = g.kind[order], g.a[order], g.b[order], g.radius[order].astype(np.float64)
    of_field = kind == FIELD
    a, b = np.where(of_field[:, None], 0.5 * (a + b), a), np.where(of_field[:, None], 0.5 * (b - a), b)
    fields = [field for field in g.fields if field is not None]
    closed = np.array([not isinstance(field, DistanceField) for field in fields], bool)
    numbers = np.where(closed, -np.cumsum(closed), np.cumsum(~closed) - 1)
    radius[of_field] = numbers[which := (np.cumsum(g.kind == FIELD) - 1)[order][of_field]]
    all_have, spread = spread is None, np.zeros(n) if spread is None else spread
    ball, cosine = np.where(kind == CAPSULE, radius, b.min(axis=1)), np.where(kind == BOX, CORNER, 1.0)
    for p in np.flatnonzero(of_field).tolist():
        ball[p], cosine[p] = roundness(*g.mesh(order[p]))
    most = float(spread.max(initial=0.0))
    widest = np.array([round_margin(most, *pair) for pair in zip(ball.tolist(), cosine.tolist(), strict=True)])
    widest[kind == PLANE] = 0.0
    # A sampled field's surface may lie outside of its mesh by the tolerance.
    b[of_field] += np.array([getattr(field, "tolerance", 0.0) for field in fields])[which, None]

    def floats(array: Float) -> Float:
        return np.array(array, np.float64, order="C")

    return Contact(
        kind=np.ascontiguousarray(kind, np.int8),
        frame=np.ascontiguousarray(g.frame[order], np.int32),
        first=np.searchsorted(g.body[order], np.arange(bodies + 1)).astype(np.int32),
        shapes=Shapes(floats(a), floats(b), floats(radius), ball, cosine, np.full(len(kind), margin), margin + widest),
        spread=floats(np.stack([spread, np.ones(n) if all_have else spread > 0.0])),
        stiffness=floats(stiffness),
        damping=floats(damping),
        friction=floats(g.friction),
        rate=np.full(1, AT_ONCE),
        rotation0=np.tile(np.eye(3).ravel(), (frames, 1)),
        origin0=np.zeros((frames, 3)),
        spin=np.zeros((frames, 3)),
        shift=np.zeros((frames, 3)),
        anchor=np.zeros((bodies, 3, n)),
        anchor_frame=np.full((bodies, n), -1, np.int32),
        frames=np.zeros((frames, 18)),
        posed=np.zeros((order.shape[0], 16)),
        posed_at=np.full(1, np.nan),
        distance=np.zeros(n),
        deepest=np.full((bodies, n), -1, np.int64),
        near=np.zeros((bodies, blocks), np.bool_),
        bounds=np.zeros((blocks, 6)),
        tally=np.zeros((blocks, 2), np.int64),
        fields=pack_fields(fields) if of_field.any() else None,
    )


def pack_fields(fields: Sequence[DistanceField | ClosedForm]) -> Fields:
    """Return distance fields, at least one, whose arrays are read-only: solvers share them."""
    sampled = [field for field in fields if isinstance(field, DistanceField)]
    joined = join_fields(sampled) if sampled else None
    for array in joined or ():
        array.setflags(write=False)
    if joined is not None and len(sampled) == len(fields):
        return joined
    return Volumes(joined, tuple(field for field in fields if not isinstance(field, DistanceField)))
