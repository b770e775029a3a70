"""Offset contact: cloth keeps off itself and other cloth by a thickness, rubs, and never passes through."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, cast

import numpy as np
from pydantic import BaseModel, Field

from nuno_contact.offset.energy import measure_pairs
from nuno_contact.offset.force import add_pairs, is_fresh
from nuno_contact.offset.hold import begin_apart, hold_apart
from nuno_contact.offset.iterate import restrain
from nuno_contact.offset.lists import make_list, measure
from nuno_contact.offset.matrix import add_diagonal, fill_pairs, foresee, make_touching, multiply_pairs
from nuno_contact.offset.meeting import Meeting, make_meeting
from nuno_contact.offset.projection import project
from nuno_contact.offset.tree import make_tree
from nuno_contact.reaction import spring_stiffness
from nuno_contact.untangle.search import find_crossings
from nuno_kernels.meshes.check import place_of
from nuno_kernels.terms import register
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Fabric, Float, Int
from nuno_schemas.plugin import Config
from nuno_schemas.system import Term
from nuno_schemas.units import quantity
from nuno_schemas.vectors import norm

Thickness = Annotated[float, quantity("m", gt=0)]
REST_SHARE = 0.1
"""A vertex under its own weight stays off by all but this share of the thickness."""
STOP_SPEED = 1.0
"""A vertex that arrives at this speed [m/s] is stopped within the thickness, if its stiffness is no more than SHARE
allows."""
SHARE, AT_ONCE = 0.4, 4
"""The stiffness of all contacts of a vertex, of which layers that lie on each other have about AT_ONCE, is at most this
share of that of the vertex' springs together: see nuno_contact.penalty.plugin.auto_stiffness."""


class OffsetConfig(Config):
    """How cloth meets cloth."""

    thickness: Thickness = Field(default=1e-3, description="distance from which on cloth pushes cloth away [m]")
    friction: float = Field(default=0.3, ge=0, le=100, description="Coulomb coefficient of cloth on cloth")
    damping: float = Field(default=0.5, ge=0, le=10, description="normal damping in contact, as a ratio of critical")


def auto_stiffness(fabric: Fabric, gravity: Float, thickness: float) -> Float:
    """(n,) what each vertex can bear [N/m]: k = m max(g / (REST_SHARE h), min(w0^2, SHARE / AT_ONCE sum_j k_j / m))."""
    weight = fabric.mass * float(norm(gravity)) / (REST_SHARE * thickness)
    stop = fabric.mass * (STOP_SPEED / thickness) ** 2
    return np.maximum(weight, np.minimum(stop, SHARE / AT_ONCE * spring_stiffness(fabric)))


def check_thickness(fabric: Fabric, thickness: float) -> None:
    """Raises BadInput for cloth that is thicker than its edges are long."""
    x, faces = fabric.position, fabric.faces
    shortest = float(norm(x[faces] - x[np.roll(faces, -1, axis=1)]).min())
    if thickness > shortest:
        raise BadInput(
            "cloth is thicker than its shortest edge is long", field="thickness", value=f"{thickness:g} m",
            limit=f"{shortest:.3g} m", remedy="make it thinner, or the mesh coarser",
        )  # fmt: skip


def check_start(fabric: Fabric, piece: Int, meet: Bool) -> None:
    """Raises BadInput for cloth that passes through cloth as it starts; pieces that do not meet may."""
    x, tree = fabric.position, make_tree(fabric.position, fabric.faces)
    edge, face = find_crossings(tree, x, piece, meet)
    if len(edge):
        i, j = tree.edges[edge[0]]
        raise BadInput(
            f"cloth passes through cloth where it starts ({len(edge):,} edges through triangles)",
            value=f"edge {i}-{j} through triangle {face[0]}, {place_of(x[[i, j]].mean(axis=0))}",
            limit="a start in which nothing meets",
            remedy="add operations: [{plugin: untangle}], move the objects apart, or leave cloth_contact out",
        )


def check_gaps(m: Meeting, pieces: list[str]) -> None:
    """Raises BadInput for objects that start nearer to each other than the thickness."""
    m.reference[:3] = m.start
    make_list(m, None)
    number = int(m.number[0])
    for p in range(number):
        measure(m, p)
    near = m.reach[:number] < m.law[0]
    both = m.piece[m.pair[:number]][:, [0, 3]]
    if len(close := np.flatnonzero(near & (both[:, 0] != both[:, 1]))):
        least = close[m.reach[close].argmin()]
        names = " and ".join(pieces[i] for i in both[least])
        raise BadInput(
            f"{names} start nearer to each other than the thickness", field="thickness", value=f"{m.law[0]:g} m",
            limit=f"{m.reach[least]:.3g} m, {place_of(m.start[:, m.pair[least, 0]])}",
            remedy="move them apart, or make it thinner",
        )  # fmt: skip
    m.reference[:] = np.nan
    m.number[:] = 0


def take_step(m: Meeting, rate: float) -> None:
    """Have forces act as at the end of steps of 1 / rate [s]; see Meeting.step."""
    m.step[0], m.calm[0], m.frozen[0] = 1.0 / rate, 0, False


def no_batches(m: Meeting, vertices: int) -> tuple[()]:
    """Its constraints are none that could be laid out beforehand; see nuno_contact.offset.projection."""
    return ()


def count_meetings(m: Meeting) -> dict[str, int]:
    """Counts for a step's report."""
    return {
        "cloth_contacts": int(m.tally[0]), "cut_short": int(m.tally[1]), "held_cut_short": int(m.tally[2]),
        "pairs_left_out": int(m.tally[4]),
    }  # fmt: skip


register(
    Meeting,
    name="cloth_contact",
    memory=("anchor", "anchored", "reference", "motion", "spread", "unrest", "last", "clock"),
    lists=True,
    reads_velocity=lambda term: True,
    look=is_fresh,
    block=add_pairs,
    hold=hold_apart,
    begin=begin_apart,
    approach=take_step,
    bound=restrain,
    foresee=foresee,
    rows=make_touching,
    fill=fill_pairs,
    diagonal=add_diagonal,
    multiply=multiply_pairs,
    constraints=no_batches,
    project=project,
    energy=measure_pairs,
    counts=count_meetings,
)


class Offset:
    """Repulsion and friction within a thickness, and steps that go only as far as nothing meets."""

    name: ClassVar[str] = "offset"
    Config: ClassVar[type[BaseModel]] = OffsetConfig

    def prepare(self, config: Any, fabric: Fabric, objects: Mapping[str, Int], meet: Bool, gravity: Float) -> Term:
        """The term. Raises BadInput for a start in which cloth meets, and for cloth thicker than its edges."""
        settings = cast(OffsetConfig, config)
        h, piece = float(settings.thickness), np.zeros(fabric.number, np.int32)
        for number, vertices in enumerate(objects.values()):
            piece[vertices] = number
        check_thickness(fabric, h)
        check_start(fabric, piece, meet)
        stiffness = auto_stiffness(fabric, gravity, h)
        law = np.array([h, settings.friction, settings.damping])
        free = ~fabric.pinned
        most = AT_ONCE * (stiffness / fabric.mass)[free].max(initial=0.0)
        term = make_meeting(fabric, piece, meet, stiffness, law)
        if len(objects) > 1:
            check_gaps(term, list(objects))
        return Term("cloth_contact", (term,), float(most), 2.0 * settings.damping * float(np.sqrt(most)))
