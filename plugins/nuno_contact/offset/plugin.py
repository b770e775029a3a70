"""Offset contact: cloth keeps a distance from itself and other cloth, with friction, and never passes through."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, cast

import numpy as np
from pydantic import BaseModel, Field

from nuno_contact.offset.bodies import (
    STANDS,
    copy_part,
    find_behind,
    is_waiting,
    make_solids,
    place_solids,
    pose_solids,
    set_solid_poses,
)
from nuno_contact.offset.candidate_pairs import choose_near, make_list
from nuno_contact.offset.ccd import all_close, limit_step
from nuno_contact.offset.contact_state import ContactState, make_contact_state, tree_of
from nuno_contact.offset.force import STEEPEST, across, add_pairs, corners_of, faces_of, is_fresh, touch
from nuno_contact.offset.iterate import restrain
from nuno_contact.offset.matrix import add_diagonal, fill_pairs, foresee, make_touching, multiply_pairs
from nuno_contact.offset.places import (
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
)
from nuno_contact.offset.plan import LEAST, LISTS, LONGEST, MOST, WINDOW, allow, set_out
from nuno_contact.offset.projection import project
from nuno_contact.offset.proximity import closest, unit, weigh
from nuno_contact.offset.start import check_gaps, check_outside, check_start, check_thickness
from nuno_contact.offset.touching import find_touching
from nuno_contact.reaction import elastic_stiffness
from nuno_contact.untangle.search import find_crossings
from nuno_kernels import block_kernel, forced_inline, kernel
from nuno_kernels.lanes.simd import dot
from nuno_kernels.step.blocks import all_finite, copy_rows, same_rows
from nuno_kernels.terms import register
from nuno_schemas.bodies import Geometry, Poses
from nuno_schemas.fabric import Bool, Fabric, Float, Int
from nuno_schemas.layout import Bounds
from nuno_schemas.plugin import Config
from nuno_schemas.system import Term
from nuno_schemas.units import quantity
from nuno_schemas.vectors import norm

# The start of an interval: contact continues with its lists, or makes new ones if cloth was moved meanwhile.


@kernel
def begin_interval(m: ContactState, x: Float, span: float, threads: int | None) -> None:
    """Before an interval's first step from x (3, n), keep the lists, or begin anew if x is another state."""
    n, goal = x.shape[1], x
    if m.local.shape[0] > 0:
        goal, m.still[0] = m.goal, min(m.still[0], STANDS)
        pose_solids(m, 0.0)
        copy_part(x, goal, 0, n)
    begin_whole(m, goal, same_rows(x, m.last), span, threads)
    if m.local.shape[0] > 0:
        find_behind(m, n)


@block_kernel
def begin_whole(m: ContactState, x: Float, goes_on: bool, span: float, threads: int | None) -> None:
    """Do so for cloth and bodies together; `goes_on`: the cloth is where it was left."""
    clock, m.span[0] = m.clock, span
    m.share[:] = 1.0  # a resumed run lacks it
    clock[LIST_BEGUN] -= clock[NOW]
    clock[NEAR_BEGUN] -= clock[NOW]
    clock[NOW] = 0.0
    if not (goes_on and all_finite(m.reference)):
        if not all_finite(x):
            return
        copy_rows(x, m.last)
        clock[LIST_BEGUN], clock[LIST_WINDOW], clock[LIST_ROOM], clock[LAST_STEP] = 0.0, LISTS, 1.0, 0.0
        m.unrest[:] = 0.0
        m.anchored[:] = False
        m.number[LISTED] = 0
        allow(m, m.spread[1], m.unrest[1], WINDOW, LEAST[1], MOST[1])
        set_out(m, m.nothing, 1.0, WINDOW, True, threads)
    elif not (
        same_rows(m.listed[:6], m.reference)
        and same_rows(m.listed[6:12], m.motion)
        and same_rows(m.listed[12:], m.spread)
    ):
        make_list(m, threads)
        choose_near(m, threads)
    renew_planes(m)
    all_close(m)
    find_touching(m, threads)


@block_kernel
def renew_planes(m: ContactState) -> None:
    """Give each near pair the plane across its closest points at `last`."""
    for q in range(m.number[NEAR]):
        p = m.near[q]
        corners = corners_of(m.last, m.pair[p, 0], m.pair[p, 1], m.pair[p, 2], m.pair[p, 3])
        n, _ = unit(weigh(closest(m.of[p] < 0, corners).weights, corners))
        m.normal[p, 0], m.normal[p, 1], m.normal[p, 2] = n


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
    if m.local.shape[0] > 0:
        copy_part(x, m.whole, 0, x.shape[1])
        x = m.whole
    pair, of, reach, stiffness, mesh, total = m.pair, m.of, m.reach, m.pair_stiffness, faces_of(m), 0.0
    for q in range(m.number[NEAR]):
        p = m.near[q]
        i, j, k, l = pair[p, 0], pair[p, 1], pair[p, 2], pair[p, 3]  # noqa: E741
        corners = corners_of(x, i, j, k, l)
        at = touch(x, i, of[p], corners, reach[p], mesh)
        if at.distance < reach[p]:
            total += stored(stiffness[p], reach[p], at.distance)
            if m.anchored[p]:
                a = (m.anchor[p, 0], m.anchor[p, 1], m.anchor[p, 2], m.anchor[p, 3])
                e = across(weigh(a, corners), at.normal)
                total += 0.5 * stiffness[p] * dot(e, e)
    return total


THINNEST = 1e-6
"""least thickness [m]: below a micrometre, distances come near to the last digits of positions"""
Thickness = Annotated[float, quantity("m", ge=THINNEST)]
REST_SHARE = 0.1
"""share of the thickness that a vertex sinks in under its own weight"""
STOP_SPEED = 1.0
"""A vertex that arrives at this speed [m/s] is stopped within the thickness, if its stiffness is no more than SHARE
allows."""
SHARE, AT_ONCE = 0.4, 4
"""The stiffness of all contacts of a vertex, of which stacked layers have about AT_ONCE, is at most this share of that
of the vertex' springs together: see nuno_contact.penalty.plugin.auto_stiffness."""


class OffsetConfig(Config):
    """The contact of cloth with cloth."""

    thickness: Thickness = Field(default=1e-3, description="distance from which on cloth pushes cloth away [m]")
    friction: float = Field(default=0.3, ge=0, le=100, description="Coulomb coefficient of cloth on cloth")
    damping: float = Field(default=0.5, ge=0, le=10, description="normal damping in contact, as a ratio of critical")


def auto_stiffness(fabric: Fabric, gravity: Float, thickness: float) -> Float:
    """Return the stiffness (n,) [N/m] k = m max(g / (REST_SHARE h), min(w0^2, SHARE / AT_ONCE sum_j k_j / m))."""
    weight = fabric.mass * float(norm(gravity)) / (REST_SHARE * thickness)
    stop = fabric.mass * (STOP_SPEED / thickness) ** 2
    return np.maximum(weight, np.minimum(stop, SHARE / AT_ONCE * elastic_stiffness(fabric)))


def take_step(m: ContactState, rate: float) -> None:
    """Let forces act as at the end of steps of 1 / rate [s]; see ContactState.step."""
    m.step[0], m.calm[0], m.frozen[0] = 1.0 / rate, 0, False


def make_no_batches(m: ContactState, vertices: int) -> tuple[()]:
    """Return no batches: contacts cannot be laid out beforehand; see nuno_contact.offset.projection."""
    return ()


def count_contacts(m: ContactState) -> dict[str, int]:
    """Return the counts for a step's report."""
    behind = {"body_vertices_behind": int(m.behind.sum())} if len(m.local) else {}
    return behind | {
        "cloth_contacts": int(m.number[TOUCHING]),
        "cut_short": int(m.so_far[CUT]),
        "held_cut_short": int(m.so_far[HELD_CUT]),
        "pairs_left_out": int(m.so_far[LEFT_OUT]),
        "steps_without_motion": int(m.so_far[STILL]),
    }


def find_pinched(m: ContactState) -> tuple[Int, Float]:
    """Return pieces (k,) and places (k, 3) [m] of vertices that the last step has shortened, or left behind their
    bodies; and if nothing moves, while bodies pass through each other, of those there.
    """
    if not m.share.any():
        meets, cloth, x = np.zeros_like(m.meets), len(m.meets) - len(m.body_law), np.ascontiguousarray(m.last.T)
        meets[cloth:, cloth:] = ~np.eye(len(m.body_law), dtype=bool)
        # In separate boxes: callers may ask while the tree is in use.
        own = {name: getattr(m, name).copy() for name in ("boxes", "face_boxes", "edge_boxes", "vertex_boxes")}
        edge, face = find_crossings(tree_of(m)._replace(**own), x, m.piece, meets)
        if len(edge):
            ends = np.unique(np.concatenate([m.edges[edge].ravel(), m.faces[face].ravel()]))
            return m.piece[ends], x[ends]
    caught = m.share < 1.0
    caught[len(caught) - len(m.behind) :] |= m.behind
    return m.piece[caught], m.last[:, caught].T


def count_cut(m: ContactState, held: Bool) -> None:
    """Count vertices (n,) that a step leaves behind."""
    free = m.mass[: len(held)] > 0.0
    m.so_far[CUT] += int((held & free).sum())
    m.so_far[HELD_CUT] += int((held & ~free).sum())


def act_alone(m: ContactState, body: int) -> ContactState:
    """Return the contact state in which cloth meets one of the bodies alone: all other pairs have no force."""
    near = m.near[: m.number[NEAR]]
    own = (m.piece[m.pair[near]] == len(m.meets) - len(m.body_law) + body).any(axis=1)
    stiffness, damping = np.zeros_like(m.pair_stiffness), np.zeros_like(m.pair_damping)
    stiffness[near], damping[near] = m.pair_stiffness[near] * own, m.pair_damping[near] * own
    return m._replace(pair_stiffness=stiffness, pair_damping=damping)


register(
    ContactState,
    name="cloth_contact",
    memory=("anchor", "anchored", "reference", "motion", "spread", "unrest", "last", "clock", "so_far"),
    bounds=lambda term: {
        "reference": Bounds(finite=False),
        "spread": Bounds(0.0),
        "unrest": Bounds(0.0),
        "clock": Bounds(-2.0 * LONGEST, 2.0 * LONGEST),
        "so_far": Bounds(0),
    },
    lists=True,
    reads_velocity=lambda term: True,
    vertices=lambda term: int(term.mass.shape[0]),
    place=place_solids,
    interval=set_solid_poses,
    look=is_fresh,
    block=add_pairs,
    hold=limit_step,
    begin=begin_interval,
    approach=take_step,
    bound=restrain,
    waits=is_waiting,
    cut=count_cut,
    foresee=foresee,
    rows=make_touching,
    fill=fill_pairs,
    diagonal=add_diagonal,
    multiply=multiply_pairs,
    constraints=make_no_batches,
    project=project,
    energy=measure_pairs,
    counts=count_contacts,
    pinched=find_pinched,
    alone=act_alone,
)


class Offset:
    """Repulsion and friction within a thickness, and steps that end where cloth meets."""

    name: ClassVar[str] = "offset"
    any_numbering: ClassVar[bool] = True
    Config: ClassVar[type[BaseModel]] = OffsetConfig

    def prepare(
        self, config: Any, fabric: Fabric, objects: Mapping[str, Int], meet: Bool, gravity: Float,
        bodies: Geometry | None = None, poses: Poses | None = None,
    ) -> Term:  # fmt: skip
        """Return the term. Raises BadInput for a start in which cloth meets cloth or a body, for cloth thicker than its
        edges, and for bodies that are not of triangles.
        """
        settings, solids = cast(OffsetConfig, config), make_solids(bodies, poses)
        h, piece = float(settings.thickness), np.zeros(fabric.number, np.int32)
        for number, vertices in enumerate(objects.values()):
            piece[vertices] = number
        check_thickness(fabric, h)
        stiffness = auto_stiffness(fabric, gravity, h)
        law = np.array([h, settings.friction, settings.damping])
        free = ~fabric.pinned
        most = AT_ONCE * (stiffness / fabric.mass)[free].max(initial=0.0)
        pieces, cloth = [*objects, *solids.names], len(objects)
        meets = np.ones((len(pieces), len(pieces)), bool)
        meets[:cloth, :cloth], meets[cloth:, cloth:] = meet, False
        piece = np.concatenate([piece, cloth + solids.body])
        term = make_contact_state(fabric, piece, meets, stiffness, law, solids)
        check_start(term, fabric, pieces, cloth)
        if bodies is not None and poses is not None:
            check_outside(fabric, bodies, solids)
            set_solid_poses(term, poses, poses)
        check_gaps(term, pieces)
        damping = max(settings.damping, float(solids.law[:, 1].max(initial=0.0)))
        return Term("cloth_contact", (term,), float(most), 2.0 * damping * float(np.sqrt(most)))
