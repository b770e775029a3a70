"""Penalty contact: stiffness from what the cloth can bear, damping, Coulomb friction."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from pydantic import BaseModel, Field

from nuno_contact.margins import Margin, check_margin, triangle_spread
from nuno_contact.penalty.contact import make_contact
from nuno_contact.reaction import auto_stiffness
from nuno_schemas.bodies import MESH, SKIN, Geometry
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.plugin import Config
from nuno_schemas.system import Term
from nuno_schemas.vectors import norm

REST_DEPTH = 5e-4
"""depth to which a vertex at rest sinks under its own weight at most [m]"""
STOP_DEPTH = 1e-3
"""Depth within which a vertex that arrives at `nuno_contact.reaction.STOP_SPEED` is stopped [m]."""
GAP = 2.5e-3
"""Margin of triangles on any body, also a plane [m]: more than a vertex that arrives at 2.5 m/s or rests sinks."""
SHARE = 0.25
"""share of the stiffness of the vertex's springs together that the stiffness to stop it has at most"""


class PenaltyConfig(Config):
    """The margin; stiffness, damping and friction belong to each body of the scene."""

    margin: Margin = Field(
        default="auto",
        description="distance from the surface at which vertices are kept [m]; auto: as much as the triangles of each "
        "vertex, which cut through round bodies, and the body's curvature need",
    )


def slip_speed(damping: float) -> float:
    """Return by how much a vertex that starts to slide is faster than by Coulomb's law, in mu g sqrt(m / k) [m/s].

    A vertex that is pulled off from rest by mu N or a little more has the friction f = x + 2 zeta x' in units of mu N,
    x'' = 1 - f, until f is 1, and gains what is missing of it until then: the largest speed of a damped oscillator's
    answer to a step, exp(-zeta arccos(zeta) / sqrt(1 - zeta^2)). A stronger pull loads the friction spring sooner, and
    gains less.
    """
    if damping < 1.0:
        return math.exp(-damping * math.acos(damping) / math.sqrt(1.0 - damping**2))
    if damping > 1.0:
        return math.exp(-damping * math.acosh(damping) / math.sqrt(damping**2 - 1.0))
    return math.exp(-1.0)


def check(geometry: Geometry) -> None:
    """Raise BadInput for a body that is a mesh, or whose contact constants make no sense."""
    for primitive in np.flatnonzero(np.isin(geometry.kind, (MESH, SKIN))).tolist():
        body = geometry.bodies[geometry.body[primitive]]
        if geometry.kind[primitive] == SKIN:
            raise BadInput(
                "penalty contact goes by the distance from bodies that do not bend, and a skin does", field=body,
                remedy=f"cloth_contact: {{plugin: offset, bodies: [{body}]}} meets its triangles; contact: {{plugin: "
                "sliding} keeps off vertices and the middles of edges",
            )  # fmt: skip
        raise BadInput(
            "penalty contact knows no meshes",
            field=body,
            remedy="give the body contact: {plugin: sliding}, or collider: {plugin: sdf, ...}",
        )
    for index, body in enumerate(geometry.bodies):
        stiffness = geometry.stiffness[index]
        if not (np.isnan(stiffness) or 0.0 < stiffness < np.inf):
            raise BadInput("contact stiffness must be positive", field=body, value=float(stiffness), limit="> 0 N/m")
        for name in ("damping", "friction"):
            value = float(getattr(geometry, name)[index])
            if not 0.0 <= value < np.inf:
                raise BadInput(f"contact {name} must not be negative", field=body, value=value, limit=">= 0")


class Penalty:
    """Penalty contact (the skirt paper) with damping and friction that sticks.

    Every body's stiffness, damping and friction are in the Geometry; NaN stiffness means "auto".
    """

    name: ClassVar[str] = "penalty"
    any_numbering: ClassVar[bool] = True
    Config: ClassVar[type[BaseModel]] = PenaltyConfig

    def prepare(self, config: PenaltyConfig, fabric: Fabric, geometry: Geometry, gravity: Float) -> Term:
        """Return the term. Raises BadInput for constants that make no sense.

        All bodies may touch a vertex at once, so their k/m and c/m add up; within a body one primitive acts, and its
        normal and its friction spring are orthogonal, so k counts once.
        """
        check(geometry)
        if (margin := config.margin) != "auto":
            check_margin(margin, geometry)
        spread = triangle_spread(fabric.position, fabric.faces) if margin == "auto" else None
        fixed = GAP if margin == "auto" else margin
        own = auto_stiffness(fabric, gravity, REST_DEPTH, STOP_DEPTH, SHARE)
        stiffness = np.where(np.isnan(geometry.stiffness)[:, None], own, geometry.stiffness[:, None])
        damping = 2.0 * geometry.damping[:, None] * np.sqrt(stiffness * fabric.mass)
        free = ~fabric.pinned
        weight = fabric.mass * float(norm(gravity))
        omega_squared = (stiffness.sum(axis=0) / fabric.mass)[free]
        rate = (damping.sum(axis=0) / fabric.mass)[free]
        shares = np.array([slip_speed(ratio) for ratio in geometry.damping.tolist()]) * geometry.friction
        faster = shares[:, None] * weight / np.sqrt(stiffness * fabric.mass)
        contact = make_contact(geometry, stiffness, damping, spread, fixed)
        return Term(
            name="contact",
            data=(contact,),
            omega_squared=float(omega_squared.max(initial=0.0)),
            damping_rate=float(rate.max(initial=0.0)),
            facts={
                "rest_depth": float((weight / stiffness.min(axis=0)).max(initial=0.0)),
                "margin": float(contact.shapes.largest_margin.max(initial=0.0)) if contact.spread[1].any() else 0.0,
                "slip_speed": float(faster[:, free].max(initial=0.0)),
            },
        )
