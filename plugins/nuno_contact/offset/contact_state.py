"""The state of cloth contact: the mesh, the pairs of primitives that may come near, and their history."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from nuno_contact.offset.tree import MovingTree, adjacent_faces, make_tree, rings
from nuno_kernels import block_kernel
from nuno_kernels.compilation.reference import by_reference
from nuno_kernels.step.blocks import Long, block_count
from nuno_schemas.bodies import Skin
from nuno_schemas.fabric import Bool, Fabric, Float, Int
from nuno_schemas.vectors import vertex_areas

# Indices of the arrays of ContactState that hold single numbers.

LISTED, NEAR, LACKING, LISTS_MADE, CHOICES, SHARED, CLOSE, TOUCHING, WITH_FACES = range(9)
"""Indices of ContactState.counts: listed pairs; near ones; pairs without room in the list; the number of lists made,
and of choices of near pairs; the choice that is assigned to blocks; close pairs; touching pairs; listed pairs of a
vertex and a triangle, which stand first."""
CUT, HELD_CUT, STEPS, LEFT_OUT, STILL = range(5)
"""Indices of ContactState.so_far: shortened steps of vertices, and of held ones; steps; pairs that had no room in a
list; steps in which nothing moved for that reason."""
NOW, LIST_BEGUN, LIST_WINDOW, NEAR_BEGUN, NEAR_WINDOW, LIST_ROOM, LAST_STEP = range(7)
"""Indices of ContactState.clock, in fractions of the interval: the end of the last step; the time of the list, and its
window; the same of near pairs; the share of the list plan's spread that is allowed at most; the duration of the last
step of an explicit method [s]."""


PER_VERTEX, OF_BODIES, FEWEST = 64, 16, 32768
"""most pairs that are listed for each vertex of cloth, of bodies, and in addition"""
EDGES = 0.25
"""share of the stiffness that two edges have: see nuno_contact.offset.force"""
ROWS = 4
PARTS = ROWS * ROWS
"""parts in which threads share pairs: a fixed number, so that results keep their order"""
WORTH = 256
"""number of pairs from which on threads pay"""
IN_TURN = f"block % {ROWS} * {ROWS} + block // {ROWS}"
"""The order in which threads take parts, each from everywhere: pairs of vertices and triangles, which stand first, take
longer than those of edges."""


@by_reference
class ContactSurface(NamedTuple):
    """The n vertices of cloth, and of bodies behind it, and how its f triangles adjoin each other."""

    adjacent: Int
    """(f, 3) number of the triangle across the edges a-b, b-c, c-a; -1 if there is none"""
    ring_start: Int
    """(n + 1,) bounds of each vertex' neighbours in ring"""
    ring: Int
    first_face: Int
    """(n,) lowest number of the triangles at each vertex, -1 where there are none"""
    start: Float
    """(3, n) vertices at the start [m]: what is nearer than the thickness there keeps the distance that it has"""
    size: Float
    """(n,) see size_of [m]"""
    piece: Int
    """(n,) the object of each vertex"""
    meets: Bool
    """(o, o) which objects and bodies meet each other"""
    stiffness: Float
    """(n,) what a vertex can bear [N/m]"""
    mass: Float
    """(n,) [kg], 0 for those that are held or carried, and for bodies"""
    law: Float
    """(4,) thickness [m], Coulomb coefficient, damping as a ratio of critical; 1 where bodies push cloth by more than
    forces, in this contact or by one that acts before it, else 0"""


@by_reference
class BodyVertices(NamedTuple):
    """The bodies' b vertices, which are the last of the n, and the motion of the frames that carry them."""

    local: Float
    """(b, 3) where they are in their frames [m]"""
    frame: Int
    """(b,) the frame of each"""
    law: Float
    """(bodies, 2) Coulomb coefficient, and damping as a ratio of critical"""
    rotation0: Float
    """(f, 9), and the next four fields, as in nuno_geometry.poses.Frames"""
    origin0: Float
    spin: Float
    shift: Float
    frames: Float
    behind: Bool
    """(b,) which of the vertices are behind their bodies at `last`"""
    still: Long
    """(1,) motion of bodies in the interval: see nuno_contact.offset.bodies.MOVES"""
    skin_joint: Int
    """(s, k) of the s vertices that are of skins, on e carriers: the carriers of each"""
    skin_weight: Float
    """(s, k) the shares of those"""
    skin_place: Float
    """(e, 3) where the carriers lie as the skins are bound [m]"""
    skin_frame: Int
    """(e,) which frames they are"""
    skin_begin: Float
    """(b, 3) of all bodies' vertices, where there are skins: where those of skins begin in the interval [m]"""
    skin_end: Float
    """(b, 3) where they end"""
    skin_rate: Float
    """(1,) 1 over the interval's duration [1/s]"""
    active: Int
    """(b,) in its first `number` places the vertices that are posed in every step: see nuno_contact.offset.bodies"""
    number: Long
    """(1,)"""
    is_active: Bool
    """(b,) which these are"""
    always: Bool
    """(1,) whether all are, for methods that examine all vertices"""
    posed: Float
    """(1,) the fraction at which active vertices are in m.goal and m.whole_velocity as posed, NaN for none"""
    until: Float
    """(1,) the fraction of the interval until which the others are as the list's plan has them"""


@by_reference
class Pairs(NamedTuple):
    """The listed pairs, with places for P, and which of them are near, close, and touching."""

    vertices: Int
    """(P, 4) vertices of each pair: see nuno_contact.offset.proximity"""
    face: Int
    """(P,) number of the triangle of a vertex and a triangle, -1 for two edges"""
    key: Long
    """(P,) a number of the pair, the same in every list"""
    reach: Float
    """(P,) distance within which a pair pushes [m]; negative if it was not near so far, and the rest is unset"""
    stiffness: Float
    """(P,) k of a pair [N/m]: half of what the weakest of its vertices can bear, or EDGES of that"""
    damping: Float
    """(P,) c = 2 zeta sqrt(k m / 2) [N s/m], m the mass of the lightest"""
    friction: Float
    """(P,) Coulomb coefficient of a pair"""
    normal: Float
    """(P, 3) of a plane that keeps the pair apart at `last`"""
    gaps: Float
    """(2, P) how far apart another keeps it at the start and at the end of the list's plan, without strays [m]"""
    near: Int
    """(P,) the near ones among them"""
    close: Int
    """(P,) near pairs that may touch after the last step, or come too near in the next"""
    block_start: Int
    """(B + 1,) bounds of the near pairs of each block of cloth in"""
    block_pair: Int
    """(4 P,)"""
    touching: Int
    """(P,) those that touch at `last`"""
    touch_start: Int
    """(B + 1,) bounds of the touching pairs of each block of cloth in"""
    touch_pair: Int
    """(4 P,)"""
    weights: Float
    """(P, 4) at the closest points of those that touch"""
    distance: Float
    """(P,) of those that touch [m]"""
    eased: Float
    """(P,) share of its damping that a pair which touches has: see nuno_contact.offset.force.ease_part"""


@by_reference
class CandidatePlan(NamedTuple):
    """The ways for which the list was made, and near pairs were chosen: see nuno_contact.offset.candidate_pairs."""

    reference: Float
    """(6, n) vertices when the list was made, and when near pairs were chosen [m]; NaN before: part of the state"""
    motion: Float
    """(6, n) their expected way from there over the windows [m]: part of the state"""
    spread: Float
    """(2, n) how far they may be from there, in the list's plan and in that of near pairs [m]: part of the state"""
    unrest: Float
    """(2, n) how much they strayed in the last plans, over the square of the plans' time [m]: part of the state"""
    listed: Float
    """(14, n) references, motions and spreads of the present lists"""
    zeros: Float
    """(3, n)"""
    ways: Float
    """(n, 8) scratch: see nuno_contact.offset.tree.lay_out"""


@by_reference
class SolverScratch(NamedTuple):
    """What an implicit method or xpbd notes within a step."""

    step: Float
    """(1,) g [s] of a method that feels the forces at its step's end, x = x^ + g v; 0 for others"""
    velocity: Float
    """(3, n) of an implicit method: where forces were found last [m/s]"""
    expected: Bool
    """(P,) of an implicit method: which pairs are expected to touch after its next Newton step"""
    calm: Long
    """(1,) of an implicit method: Newton steps since one was shortened"""
    frozen: Bool
    """(1,) of an implicit method: whether the contacts of kept_weights are frozen"""
    kept: Bool
    """(P,) pairs whose contacts are kept from one iterate to the next"""
    kept_weights: Float
    """(P, 4) of those, at the closest points"""
    kept_normal: Float
    """(P, 3) of those"""
    force: Float
    """(P, 4) of xpbd: the force [N] of pairs that are kept, and the share of its friction that each gets, 1 where it
    sticks"""
    sweeps: Long
    """(1,) of xpbd: sweeps over pairs in this step so far"""


class ContactState(NamedTuple):
    """The state of cloth contact: cloth, and bodies behind it, of n vertices, e edges and f triangles.

    Few parts: numba looks at each anew whenever Python calls a kernel, as an implicit method often does.
    """

    tree: MovingTree
    surface: ContactSurface
    bodies: BodyVertices
    pairs: Pairs
    plan: CandidatePlan
    solver: SolverScratch
    anchor: Float
    """(P, 4) weights of the points of a pair that friction holds together: part of the state"""
    anchored: Bool
    """(P,) which pairs have an anchor: part of the state"""
    last: Float
    """(3, n) vertices after the last step [m]: part of the state"""
    push: Float
    """(bodies + 1, n, 3) mean force on cloth by impulses in the last interval [N], of cloth, then of each body: part of
    the state
    """
    share: Float
    """(n,) scratch: the share of a step that each vertex makes"""
    rate: Float
    """(n,) scratch: of damping, see nuno_contact.offset.force.ease_part [1/s]"""
    fresh: Bool
    """(1,) whether forces are asked for at `last`"""
    whole: Float
    """(3, n) for contact with bodies, as the next three: where forces are found [m]"""
    whole_velocity: Float
    """(3, n) velocities there [m/s]"""
    goal: Float
    """(3, n) scratch: the end of a step, bodies' vertices where their bodies are"""
    way: Float
    """(3, n) scratch of an implicit method: the way to its next iterate"""
    clock: Float
    """(7,) times and shares: see NOW; part of the state"""
    span: Float
    """(1,) of the interval [s]"""
    counts: Long
    """(9,) counts: see LISTED"""
    so_far: Long
    """(5,) counts of the whole run: see CUT; part of the state"""
    leave: Long
    """(1,) see nuno_kernels.step.acceleration.Packed"""


@block_kernel
def close_up(found: Int, count: int, number: Long) -> int:
    """Join the results of `count` parts, number (PARTS,) from each part's first place on; return their sum."""
    at = 0
    for part in range(PARTS):
        first = part * count // PARTS
        for q in range(first, first + number[part]):
            found[at] = found[q]
            at += 1
    return at


def make_pairs(places: int, blocks: int) -> Pairs:
    """Allocate so many places for pairs, for so many blocks of cloth."""
    return Pairs(
        vertices=np.zeros((places, 4), np.int32),
        face=np.zeros(places, np.int32),
        key=np.zeros(places, np.int64),
        reach=np.zeros(places),
        stiffness=np.zeros(places),
        damping=np.zeros(places),
        friction=np.zeros(places),
        normal=np.zeros((places, 3)),
        gaps=np.zeros((2, places)),
        near=np.zeros(places, np.int32),
        close=np.zeros(places, np.int32),
        block_start=np.zeros(blocks + 1, np.int32),
        block_pair=np.zeros(4 * places, np.int32),
        touching=np.zeros(places, np.int32),
        touch_start=np.zeros(blocks + 1, np.int32),
        touch_pair=np.zeros(4 * places, np.int32),
        weights=np.zeros((places, 4)),
        distance=np.zeros(places),
        eased=np.zeros(places),
    )


class Solids(NamedTuple):
    """Bodies by name: x (b, 3) where their vertices start [m], local (b, 3) in their frames (b,) of f, the number of
    the body (b,) that each is of, faces (t, 3), law (bodies, 2) friction and damping of each.

    Of skins, whose frame is OF_SKIN and local their vertices as bound: skin, all of them as one, on frames carrier
    (e,).
    """

    names: Sequence[str]
    x: Float
    local: Float
    frame: Int
    body: Int
    faces: Int
    law: Float
    frames: int
    skin: Skin
    carrier: Int


def size_of(x: Float, faces: Int) -> Float:
    """Return the width (n,) [m] of a square of the area of each vertex x (n, 3), a third of its faces (f, 3)."""
    return np.asarray(np.sqrt(vertex_areas(x, faces)))


def make_bodies(solids: Solids) -> BodyVertices:
    """Return the part of bodies."""
    skinned = len(solids.x) if len(solids.skin.joint) else 0
    return BodyVertices(
        local=np.array(solids.local, np.float64, order="C"),
        frame=np.array(solids.frame, np.int32),
        law=np.array(solids.law, np.float64, order="C"),
        rotation0=np.tile(np.eye(3).ravel(), (solids.frames, 1)),
        origin0=np.zeros((solids.frames, 3)),
        spin=np.zeros((solids.frames, 3)),
        shift=np.zeros((solids.frames, 3)),
        frames=np.zeros((solids.frames, 18)),
        behind=np.zeros(len(solids.x), np.bool_),
        still=np.zeros(1, np.int64),
        skin_joint=np.array(solids.skin.joint, np.int32),
        skin_weight=np.array(solids.skin.weight, np.float64, order="C"),
        skin_place=np.array(solids.skin.place, np.float64, order="C"),
        skin_frame=np.array(solids.carrier, np.int32),
        skin_begin=np.zeros((skinned, 3)),
        skin_end=np.zeros((skinned, 3)),
        skin_rate=np.zeros(1),
        active=np.arange(len(solids.x), dtype=np.int32),
        number=np.full(1, len(solids.x), np.int64),
        is_active=np.ones(len(solids.x), np.bool_),
        always=np.zeros(1, np.bool_),
        posed=np.full(1, np.nan),
        until=np.full(1, np.inf),
    )


def make_contact_state(
    fabric: Fabric, piece: Int, meets: Bool, stiffness: Float, law: Float, solids: Solids
) -> ContactState:
    """Return the contact state of a fabric with triangles and bodies, without a list; the pieces (n,) are of both."""
    b = len(solids.x)
    n, places = fabric.number + b, PER_VERTEX * fabric.number + OF_BODIES * b + FEWEST
    x = np.concatenate([fabric.position, solids.x])
    faces = np.concatenate([fabric.faces, solids.faces + np.int32(fabric.number)])
    tree = make_tree(x, faces, len(fabric.faces))
    ring_start, ring = rings(tree.edges, n)
    first_face = np.full(n, -1, np.int32)
    corners = faces.ravel()
    first_face[corners[::-1]] = np.arange(len(corners))[::-1] // 3
    surface = ContactSurface(
        adjacent=adjacent_faces(faces),
        ring_start=ring_start,
        ring=ring,
        first_face=first_face,
        start=np.ascontiguousarray(x.T),
        size=size_of(x, faces),
        piece=piece.astype(np.int32),
        meets=meets,
        stiffness=np.concatenate([stiffness, np.zeros(b)]),
        mass=np.concatenate([np.where(fabric.pinned, 0.0, fabric.mass), np.zeros(b)]),
        law=law,
    )
    plan = CandidatePlan(
        reference=np.full((6, n), np.nan),
        motion=np.zeros((6, n)),
        spread=np.zeros((2, n)),
        unrest=np.zeros((2, n)),
        listed=np.zeros((14, n)),
        zeros=np.zeros((3, n)),
        ways=np.zeros((n, 8)),
    )
    solver = SolverScratch(
        step=np.zeros(1),
        velocity=np.zeros((3, n)),
        expected=np.zeros(places, np.bool_),
        calm=np.zeros(1, np.int64),
        frozen=np.zeros(1, np.bool_),
        kept=np.zeros(places, np.bool_),
        kept_weights=np.zeros((places, 4)),
        kept_normal=np.zeros((places, 3)),
        force=np.zeros((places, 4)),
        sweeps=np.zeros(1, np.int64),
    )
    wide = n if b else 0
    return ContactState(
        tree=tree,
        surface=surface,
        bodies=make_bodies(solids),
        pairs=make_pairs(places, block_count(fabric.number)),
        plan=plan,
        solver=solver,
        anchor=np.zeros((places, 4)),
        anchored=np.zeros(places, np.bool_),
        last=np.zeros((3, n)),
        push=np.zeros((len(solids.law) + 1, fabric.number, 3)),
        share=np.ones(n),
        rate=np.zeros(n),
        fresh=np.zeros(1, np.bool_),
        whole=np.zeros((3, wide)),
        whole_velocity=np.zeros((3, wide)),
        goal=np.zeros((3, wide)),
        way=np.zeros((3, n if law[3] > 0.0 else 0)),
        clock=np.zeros(7),
        span=np.zeros(1),
        counts=np.zeros(9, np.int64),
        so_far=np.zeros(5, np.int64),
        leave=np.zeros(1, np.int64),
    )
