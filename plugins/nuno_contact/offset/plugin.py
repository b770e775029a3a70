"""Offset contact: cloth keeps a distance from itself and other cloth, with friction, and never passes through."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar

import numpy as np
from pydantic import BaseModel, Field

from nuno_contact.crossings import NearPairs, find_turns
from nuno_contact.offset.bodies import (
    STANDS,
    activate,
    copy_part,
    find_behind,
    is_waiting,
    make_solids,
    place_solids,
    pose_solids,
    set_solid_poses,
)
from nuno_contact.offset.candidate_pairs import (
    LEAST,
    LISTS,
    LONGEST,
    MOST,
    WINDOW,
    allow,
    begun_apart,
    choose_near,
    make_list,
    set_out,
)
from nuno_contact.offset.ccd import all_close, limit_step
from nuno_contact.offset.contact_state import (
    CUT,
    HELD_CUT,
    LAST_STEP,
    LEFT_OUT,
    LIST_BEGUN,
    LIST_ROOM,
    LIST_WINDOW,
    LISTED,
    NEAR,
    NEAR_BEGUN,
    NOW,
    STILL,
    TOUCHING,
    ContactState,
    Solids,
    make_contact_state,
)
from nuno_contact.offset.force import STEEPEST, across, add_pairs, corners_of, faces_of, find_touching, is_fresh, touch
from nuno_contact.offset.impulse import credit_change
from nuno_contact.offset.matrix import add_diagonal, fill_pairs, foresee, make_contact_matrix, multiply_pairs
from nuno_contact.offset.projection import project
from nuno_contact.offset.proximity import closest, unit, weigh
from nuno_contact.offset.separating_plane import restrain
from nuno_contact.reaction import auto_stiffness
from nuno_contact.untangle.search import find_crossings
from nuno_geometry.check import closed_parts, place_of
from nuno_geometry.closest_point import closest_points
from nuno_geometry.skinning import bend_skin
from nuno_geometry.tree import build_tree
from nuno_kernels import block_kernel, forced_inline, kernel
from nuno_kernels.lanes import dot
from nuno_kernels.step.blocks import all_finite, copy_rows, same_rows
from nuno_kernels.terms import register
from nuno_schemas.bodies import MESH, SKIN, Geometry, Poses
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Fabric, Float, Int
from nuno_schemas.layout import Bounds
from nuno_schemas.plugin import Config
from nuno_schemas.system import Term
from nuno_schemas.units import quantity
from nuno_schemas.vectors import norm

# Checks of cloth contact's start: cloth that meets cloth or bodies, and cloth that is too thick for its mesh.

NEAREST = 1e-8
"""Cloth that starts nearer to cloth or a body than this [m] touches it: within rounding no plane can be shown to keep
it apart, and layers in one plane seem apart in the search for edges that go through triangles."""


def check_thickness(fabric: Fabric, thickness: float) -> None:
    """Raise BadInput for cloth that is thicker than its edges are long: as they are cut, if that is known."""
    x, faces, cut = fabric.position, fabric.faces, fabric.membrane
    lengths = norm(x[faces] - x[np.roll(faces, -1, axis=1)])
    if cut is not None and len(cut.faces) == len(faces):
        lengths = cut.sides()
    shortest = float(lengths.min())
    if thickness > shortest:
        raise BadInput(
            "cloth is thicker than its shortest edge is long", field="thickness", value=f"{thickness:g} m",
            limit=f"{shortest:.3g} m", remedy="make it thinner, or the mesh coarser",
        )  # fmt: skip


def check_start(m: ContactState, fabric: Fabric, pieces: Sequence[str], objects: int) -> None:
    """Raise BadInput for cloth that passes through cloth or a body as it starts; bodies are the pieces after so many
    objects; pieces that do not meet may.
    """
    surface = m.surface
    x = np.ascontiguousarray(surface.start.T)
    edge, face = find_crossings(m.tree, x, surface.piece, surface.meets, objects < len(pieces))
    if not len(edge):
        return
    both = surface.piece[m.tree.edges[edge, 0]], surface.piece[m.tree.faces[face, 0]]
    of_cloth = np.flatnonzero((both[0] < objects) & (both[1] < objects))
    first = int(of_cloth[0]) if len(of_cloth) else 0
    i, j = m.tree.edges[edge[first]]
    place = place_of(x[[i, j]].mean(axis=0))
    if len(of_cloth):
        one, other = (pieces[int(piece[first])] for piece in both)
        raise BadInput(
            f"{one} passes through {'itself' if one == other else other} where it starts "
            f"({len(of_cloth):,} edges through triangles)",
            value=f"edge {fabric.told(i)}-{fabric.told(j)} through triangle {face[first]}, {place}",
            limit="a start in which nothing meets",
            remedy="add operations: [{plugin: untangle}], move the objects apart, or leave cloth_contact out",
        )  # fmt: skip
    cloth, body = (pieces[i] for i in sorted((int(both[0][first]), int(both[1][first]))))
    remedy = f"add operations: [{{plugin: untangle}}], place or size {cloth}, or move the body, otherwise, or "
    # An edge that goes in and out again has both ends outside: it is a chord across a round body.
    of_edge = np.unique(edge[both[0] < objects], return_counts=True)[1]
    if len(of_edge) and not (of_edge % 2).any():
        remedy = "give the cloth shorter edges, which go round what these go through; or "
    raise BadInput(
        f"{cloth} passes through {body} where it starts ({len(edge):,} edges through triangles)",
        field="bodies", value=place, limit="a start in which nothing meets", remedy=remedy + _without(body),
    )  # fmt: skip


def _without(body: str) -> str:
    """Suggest contact for a body that no start avoids, such as a scan that passes through itself: neither by its
    triangles, nor by vertices that slide on them.
    """
    field = "collider: {plugin: sdf, ...} and contact: {plugin: penalty}"
    return f"leave {body} out here and give it, if it is no skin, {field}"


def check_outside(fabric: Fabric, geometry: Geometry, solids: Solids) -> None:
    """Raise BadInput for cloth that starts inside of a closed mesh, or a closed part of a skin."""
    count = 0
    for primitive, kind in enumerate(geometry.kind.tolist()):
        starts, faces = geometry.mesh(primitive)
        x = solids.x[count : count + len(starts)]
        count += len(starts)
        if kind not in (MESH, SKIN):
            continue
        faces = faces[closed_parts(faces)]
        if len(inside := np.flatnonzero(find_turns(fabric.position, x, faces))):
            distance = np.zeros(fabric.number)
            distance[inside] = -np.abs(closest_points(build_tree(x, faces), fabric.position[inside]).distance)
            name, deepest = geometry.bodies[int(geometry.body[primitive])], int(distance.argmin())
            raise BadInput(
                f"cloth starts inside of {name} ({len(inside):,} of {fabric.number:,} vertices)", field="bodies",
                value=f"vertex {fabric.told(deepest)}, {-1e3 * distance[deepest]:.3g} mm deep, "
                + place_of(fabric.position[deepest]),
                remedy=f"place or size the cloth, or move the body, otherwise, or {_without(name)}",
            )  # fmt: skip


@block_kernel
def gaps_at_start(m: ContactState, gap: Float) -> None:
    """Write how far apart each of the listed pairs starts, gap (p,) [m]."""
    for p in range(gap.shape[0]):
        gap[p] = begun_apart(m, p)


def check_gaps(m: ContactState, pieces: Sequence[str]) -> None:
    """Raise BadInput for cloth that touches itself, other cloth or a body as it starts."""
    surface = m.surface
    m.plan.reference[:3] = surface.start
    make_list(m, None)
    gap = np.empty(int(m.counts[LISTED]))
    gaps_at_start(m, gap)
    if len(close := np.flatnonzero(gap < NEAREST)):
        i, j = m.pairs.vertices[close[gap[close].argmin()], [0, 3]]
        one, other = (pieces[k] for k in sorted((int(surface.piece[i]), int(surface.piece[j]))))
        raise BadInput(
            f"{one} touches {'itself' if one == other else other} where it starts "
            f"({len(close):,} pairs of vertices, edges and triangles)",
            value=place_of(surface.start[:, i]), limit=f"{NEAREST:g} m apart at least",
            remedy="lay it out without layers in one plane" if one == other else "move them apart",
        )  # fmt: skip
    m.plan.reference[:] = np.nan
    m.counts[:] = 0


# The start of an interval: contact continues with its lists, or makes new ones if cloth was moved meanwhile.


@kernel
def begin_interval(m: ContactState, x: Float, span: float, threads: int | None) -> None:
    """Before an interval's first step from x (3, n), keep the lists, or begin anew if x is another state."""
    n, goal = x.shape[1], x
    if span > 0.0:
        m.push[:] = 0.0
    if m.bodies.local.shape[0] > 0:
        goal, m.bodies.still[0] = m.goal, min(m.bodies.still[0], STANDS)
        pose_solids(m, 0.0)
        copy_part(x, goal, 0, n)
    begin_whole(m, goal, same_rows(x, m.last), span, threads)
    if m.bodies.local.shape[0] > 0:
        activate(m, True)
        find_behind(m, n)
        activate(m, bool(m.bodies.always[0]))


@block_kernel
def begin_whole(m: ContactState, x: Float, goes_on: bool, span: float, threads: int | None) -> None:
    """Do so for cloth and bodies together; `goes_on`: the cloth is where it was left."""
    plan = m.plan
    clock, m.span[0] = m.clock, span
    m.share[:] = 1.0  # a resumed run lacks it
    clock[LIST_BEGUN] -= clock[NOW]
    clock[NEAR_BEGUN] -= clock[NOW]
    clock[NOW] = 0.0
    if not (goes_on and all_finite(plan.reference)):
        if not all_finite(x):
            return
        copy_rows(x, m.last)
        clock[LIST_BEGUN], clock[LIST_WINDOW], clock[LIST_ROOM], clock[LAST_STEP] = 0.0, LISTS, 1.0, 0.0
        plan.unrest[:] = 0.0
        m.anchored[:] = False
        m.counts[LISTED] = 0
        allow(m, plan.spread[1], plan.unrest[1], WINDOW, LEAST[1], MOST[1])
        set_out(m, plan.zeros, 1.0, WINDOW, True, threads)
    elif not (
        same_rows(plan.listed[:6], plan.reference)
        and same_rows(plan.listed[6:12], plan.motion)
        and same_rows(plan.listed[12:], plan.spread)
    ):
        make_list(m, threads)
        choose_near(m, threads)
    renew_planes(m)
    all_close(m)
    find_touching(m, threads)


@block_kernel
def renew_planes(m: ContactState) -> None:
    """Give each near pair the plane across its closest points at `last`."""
    pairs, pair = m.pairs, m.pairs.vertices
    for q in range(m.counts[NEAR]):
        p = pairs.near[q]
        corners = corners_of(m.last, pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3])
        n, _ = unit(weigh(closest(pairs.face[p] < 0, corners).weights, corners))
        pairs.normal[p, 0], pairs.normal[p, 1], pairs.normal[p, 2] = n


# The energy of contacts whose forces are in nuno_contact.offset.force.


@forced_inline
def stored(k: float, h: float, distance: float) -> float:
    """Return the energy [J] of nuno_contact.offset.force.push."""
    if distance >= 0.5 * h:
        return 0.5 * k * (h - distance) * (h - distance)
    d = max(distance, STEEPEST * h)
    deeper = (d - distance) / d
    return k * h * h * (0.125 + 0.25 * (math.log(0.5 * h / d) + deeper + 0.5 * deeper * deeper))


@kernel
def measure_pairs(m: ContactState, x: Float) -> float:
    """Return the energy [J] of all contacts at x (3, n), with that of friction's springs, and bodies as they are."""
    pairs, anchor, anchored = m.pairs, m.anchor, m.anchored
    if m.bodies.local.shape[0] > 0:
        copy_part(x, m.whole, 0, x.shape[1])
        x = m.whole
    pair, of, reach, stiffness, mesh, total = pairs.vertices, pairs.face, pairs.reach, pairs.stiffness, faces_of(m), 0.0
    for q in range(m.counts[NEAR]):
        p = pairs.near[q]
        i, j, k, l = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]  # noqa: E741
        corners = corners_of(x, i, j, k, l)
        at = touch(x, i, of[p], corners, reach[p], mesh)
        if at.distance < reach[p]:
            total += stored(stiffness[p], reach[p], at.distance)
            if anchored[p]:
                a = (anchor[p, 0], anchor[p, 1], anchor[p, 2], anchor[p, 3])
                e = across(weigh(a, corners), at.normal)
                total += 0.5 * stiffness[p] * dot(e, e)
    return total


THINNEST = 1e-6
"""least thickness [m]: below a micrometre, distances come near to the last digits of positions"""
Thickness = Annotated[float, quantity("m", ge=THINNEST)]
REST_SHARE = 0.1
"""share of the thickness that a vertex sinks in under its own weight"""
SHARE, AT_ONCE = 0.4, 4
"""The stiffness of all contacts of a vertex (about AT_ONCE in stacked layers) is at most this share of that
of the vertex' springs together: see nuno_contact.reaction.auto_stiffness."""


class OffsetConfig(Config):
    """The contact of cloth with cloth."""

    thickness: Thickness = Field(default=1e-3, description="distance from which on cloth pushes cloth away [m]")
    friction: float = Field(default=0.3, ge=0, le=100, description="Coulomb coefficient of cloth on cloth")
    damping: float = Field(default=0.5, ge=0, le=10, description="normal damping in contact, as a ratio of critical")


def take_step(m: ContactState, rate: float) -> None:
    """Let forces act as at the end of steps of 1 / rate [s]; see SolverScratch.step."""
    m.solver.step[0], m.solver.calm[0], m.solver.frozen[0] = 1.0 / rate, 0, False


def make_no_batches(m: ContactState, vertices: int) -> tuple[()]:
    """Return no batches: contacts cannot be laid out beforehand; see nuno_contact.offset.projection."""
    return ()


def count_contacts(m: ContactState) -> dict[str, int]:
    """Return the counts for a step's report."""
    behind = {"body_vertices_behind": int(m.bodies.behind.sum())} if len(m.bodies.local) else {}
    return behind | {
        "cloth_contacts": int(m.counts[TOUCHING]),
        "cut_short": int(m.so_far[CUT]),
        "held_cut_short": int(m.so_far[HELD_CUT]),
        "pairs_left_out": int(m.so_far[LEFT_OUT]),
        "steps_without_motion": int(m.so_far[STILL]),
    }


def find_pinched(m: ContactState) -> tuple[Int, Float]:
    """Return pieces (k,) and places (k, 3) [m] of vertices that the last step has shortened, or left behind their
    bodies; and if nothing moves, while bodies pass through each other, of those there.
    """
    surface = m.surface
    if not m.share.any():
        meets, cloth = np.zeros_like(surface.meets), len(surface.meets) - len(m.bodies.law)
        x = np.ascontiguousarray(m.last.T)
        meets[cloth:, cloth:] = ~np.eye(len(m.bodies.law), dtype=bool)
        # In separate boxes: callers may ask while the tree is in use.
        own = {name: getattr(m.tree, name).copy() for name in ("nodes", "node_boxes", "way", "row", "box")}
        edge, face = find_crossings(m.tree._replace(**own), x, surface.piece, meets)
        if len(edge):
            ends = np.unique(np.concatenate([m.tree.edges[edge].ravel(), m.tree.faces[face].ravel()]))
            return surface.piece[ends], x[ends]
    caught = m.share < 1.0
    caught[len(caught) - len(m.bodies.behind) :] |= m.bodies.behind
    return surface.piece[caught], m.last[:, caught].T


def count_cut(m: ContactState, held: Bool) -> None:
    """Count vertices (n,) that a step leaves behind."""
    free = m.surface.mass[: len(held)] > 0.0
    m.so_far[CUT] += int((held & free).sum())
    m.so_far[HELD_CUT] += int((held & ~free).sum())


def read_push(m: ContactState) -> Float:
    """Return the mean force (n, 3) [N] of impulses on cloth in the last interval."""
    return np.asarray(m.push.sum(axis=0))


def act_alone(m: ContactState, body: int) -> ContactState:
    """Return the contact state in which cloth meets one of the bodies alone: all other pairs have no force."""
    pairs = m.pairs
    near = pairs.near[: m.counts[NEAR]]
    own = (m.surface.piece[pairs.vertices[near]] == len(m.surface.meets) - len(m.bodies.law) + body).any(axis=1)
    stiffness, damping = np.zeros_like(pairs.stiffness), np.zeros_like(pairs.damping)
    stiffness[near], damping[near] = pairs.stiffness[near] * own, pairs.damping[near] * own
    push = np.zeros_like(m.push)
    push[body + 1] = m.push[body + 1]
    return m._replace(pairs=pairs._replace(stiffness=stiffness, damping=damping), push=push)


register(
    ContactState, "cloth_contact", lists=True,
    memory=(
        "anchor", "anchored", "plan.reference", "plan.motion", "plan.spread", "plan.unrest", "last", "push", "clock",
        "so_far",
    ),
    bounds=lambda term: {
        "plan.reference": Bounds(finite=False), "plan.spread": Bounds(0.0), "plan.unrest": Bounds(0.0),
        "clock": Bounds(-2.0 * LONGEST, 2.0 * LONGEST), "so_far": Bounds(0),
    },
    reads_velocity=lambda term: True, vertices=lambda term: int(term.surface.mass.shape[0]),
    place=place_solids, look=is_fresh, block=add_pairs, hold=limit_step, credit=credit_change,
    interval=set_solid_poses, begin=begin_interval, approach=take_step,
    rows=make_contact_matrix, fill=fill_pairs, diagonal=add_diagonal, multiply=multiply_pairs,
    bound=restrain, waits=is_waiting, cut=count_cut, foresee=foresee, constraints=make_no_batches, project=project,
    energy=measure_pairs, counts=count_contacts, pinched=find_pinched, alone=act_alone, pushed=read_push,
)  # fmt: skip


class Offset:
    """Repulsion and friction within a thickness, and steps that end where cloth meets."""

    name: ClassVar[str] = "offset"
    any_numbering: ClassVar[bool] = True
    Config: ClassVar[type[BaseModel]] = OffsetConfig
    near_pairs: ClassVar[type[NearPairs]] = NearPairs
    find_turns = staticmethod(find_turns)
    bend_skin = staticmethod(bend_skin)
    closed_parts = staticmethod(closed_parts)
    """What the collision service checks all cloth by, whatever its contact."""

    def prepare(
        self, config: OffsetConfig, fabric: Fabric, objects: Mapping[str, Int], meet: Bool, gravity: Float,
        bodies: Geometry | None = None, poses: Poses | None = None,
    ) -> Term:  # fmt: skip
        """Return the term. Raises BadInput for a start in which cloth meets cloth or a body, for cloth thicker than its
        edges, and for bodies that are not of triangles.
        """
        solids, h, piece = make_solids(bodies, poses), float(config.thickness), np.zeros(fabric.number, np.int32)
        for number, vertices in enumerate(objects.values()):
            piece[vertices] = number
        check_thickness(fabric, h)
        stiffness = auto_stiffness(fabric, gravity, REST_SHARE * h, h, SHARE / AT_ONCE)
        law = np.array([h, config.friction, config.damping, float(bodies is not None)])
        free = ~fabric.pinned
        most = AT_ONCE * (stiffness / fabric.mass)[free].max(initial=0.0)
        pieces, cloth = [*objects, *solids.names], len(objects)
        meets = np.ones((len(pieces), len(pieces)), bool)
        meets[:cloth, :cloth], meets[cloth:, cloth:] = meet, False
        piece = np.concatenate([piece, cloth + solids.body])
        term = make_contact_state(fabric, piece, meets, stiffness, law, solids)
        check_start(term, fabric, pieces, cloth)
        if len(solids.x) and bodies is not None and poses is not None:
            check_outside(fabric, bodies, solids)
            set_solid_poses(term, poses, poses)
        check_gaps(term, pieces)
        damping = max(config.damping, float(solids.law[:, 1].max(initial=0.0)))
        return Term("cloth_contact", (term,), float(most), 2.0 * damping * float(np.sqrt(most)))
