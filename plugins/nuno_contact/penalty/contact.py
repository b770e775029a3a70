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

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nuno_contact.fields.sample import join_fields
from nuno_contact.penalty.distance import FIELD, find_bounds
from nuno_contact.penalty.poses import pose_bodies, set_poses
from nuno_contact.penalty.response import add_body, bodies_of, commit_body, fields_of, find_deepest, touch_of
from nuno_kernels import block_kernel, kernel
from nuno_kernels.terms import over_blocks, register
from nuno_schemas.bodies import Geometry
from nuno_schemas.fabric import Float, Int
from nuno_schemas.field import DistanceField
from nuno_schemas.layout import Bounds

__all__ = ["Contact", "add_contact", "commit_contact", "count_contacts", "make_contact", "set_poses"]

BLOCK = 256
"""vertices handled together, about a ring or two of a skirt: 64 have tighter bounds, but a block's overhead then takes
a third of the time"""


AT_ONCE = 1e300
"""a rate that nothing reaches, and that times a depth of 0 is 0"""


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
    """(p, 14) primitives posed"""
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
    field_head: Float | None = None
    """Distance fields as nuno_contact.fields.sample.Fields has them, read only; None where no body is one"""
    field_child: Int | None = None
    field_corners: NDArray[np.float32] | None = None


def count_contacts(contact: Contact) -> dict[str, int]:
    """Return the counts for a step report: contacts after the last step, evaluations without a normal so far."""
    touching, on_axis = (int(total) for total in contact.tally.sum(axis=0))
    return {"touching": touching, "on_capsule_axis": on_axis}


@block_kernel
def add_block(block: int, x: Float, v: Float, contact: Contact, force: Float) -> None:
    """Add the contact force [N] on the vertices of one block; bodies are posed already."""
    low, high = block * BLOCK, min((block + 1) * BLOCK, x.shape[1])
    find_bounds(x, low, high, contact.bounds, block)
    bodies, fields = bodies_of(contact), fields_of(contact)
    for body in range(contact.friction.shape[0]):
        if find_deepest(x, low, high, block, body, contact, fields):
            on_axis = add_body(x, v, low, high, touch_of(contact, body, contact.rate[0]), bodies, fields, force)
            contact.tally[block, 1] += on_axis


@block_kernel
def commit_block(block: int, x: Float, v: Float, contact: Contact) -> None:
    """Set, drag along or drop the friction anchors of one block; bodies are posed already."""
    low, high = block * BLOCK, min((block + 1) * BLOCK, x.shape[1])
    touching, anchor_frame, bodies, fields = 0, contact.anchor_frame, bodies_of(contact), fields_of(contact)
    for body in range(contact.friction.shape[0]):
        if contact.near[body, block]:
            touching += commit_body(x, v, low, high, touch_of(contact, body, contact.rate[0]), bodies, fields)
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
    Contact,
    name="contact",
    after=add_contact,
    settle=commit_contact,
    interval=set_poses,
    approach=limit_approach,
    alone=act_alone,
    project="nuno_contact.penalty.projection:project",
    counts=count_contacts,
    memory=("anchor", "anchor_frame"),
    bounds=lambda term: {"anchor_frame": Bounds(-1, len(term.origin0) - 1)},
)


def make_contact(geometry: Geometry, stiffness: Float, damping: Float) -> Contact:
    """Return a contact with bodies at rest, without anchors, for n vertices.

    `stiffness` (b, n) [N/m] and `damping` (b, n) [N s/m] are those of each vertex on each body;
    the geometry's own are not looked at. Primitives are put in the order of their bodies,
    otherwise in the order given.
    """
    g = geometry
    order = np.argsort(g.body, kind="stable")
    bodies, frames, n = len(g.bodies), len(g.frames), stiffness.shape[1]
    blocks = -(-n // BLOCK)

    kind, a, b, radius = g.kind[order], g.a[order], g.b[order], g.radius[order].astype(np.float64)
    of_field = kind == FIELD
    a, b = np.where(of_field[:, None], 0.5 * (a + b), a), np.where(of_field[:, None], 0.5 * (b - a), b)
    # A field's surface may lie outside of its mesh by the tolerance.
    radius[of_field] = (np.cumsum(g.kind == FIELD) - 1)[order][of_field]
    fields = [field for field in g.fields if field is not None]
    for p in np.flatnonzero(of_field).tolist():
        b[p] += fields[int(radius[p])].tolerance

    def floats(array: Float) -> Float:
        return np.array(array, np.float64, order="C")

    return Contact(
        kind=np.ascontiguousarray(kind, np.int8),
        frame=np.ascontiguousarray(g.frame[order], np.int32),
        first=np.searchsorted(g.body[order], np.arange(bodies + 1)).astype(np.int32),
        a=floats(a),
        b=floats(b),
        radius=floats(radius),
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
        posed=np.zeros((order.shape[0], 14)),
        posed_at=np.full(1, np.nan),
        distance=np.zeros(n),
        deepest=np.full((bodies, n), -1, np.int64),
        near=np.zeros((bodies, blocks), np.bool_),
        bounds=np.zeros((blocks, 6)),
        tally=np.zeros((blocks, 2), np.int64),
        **(pack_fields(fields) if of_field.any() else {}),
    )


def pack_fields(fields: Sequence[DistanceField]) -> dict[str, NDArray[Any]]:
    """Return the arrays of distance fields, read-only: solvers share them."""
    joined = join_fields(fields)
    for array in joined:
        array.setflags(write=False)
    return {f"field_{name}": array for name, array in joined._asdict().items()}
