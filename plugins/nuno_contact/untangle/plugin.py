"""The operation `untangle`: cloth that passes through cloth at the start is moved until it does so no more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Literal

import numpy as np
from pydantic import BaseModel, Field

from nuno_contact.quantities import Size
from nuno_contact.untangle.cloth import JITTER, Cloth, Long, make_cloth
from nuno_contact.untangle.loosen import loosen
from nuno_contact.untangle.search import find_crossings
from nuno_geometry.check import place_of
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Fabric, Float, Int, State
from nuno_schemas.operation import Arranged, Changed, Outcome, Surface
from nuno_schemas.plugin import Config
from nuno_schemas.vectors import norm

GAP = 1e-3
"""gap of cloth that has no thickness [m]"""


class UntangleConfig(Config):
    """The gap, and the number of attempts."""

    gap: Size | Literal["auto"] = Field(
        default="auto",
        description="distance that objects, and what was tangled, come to have where there is room [m]; auto: the "
        f"thickness of cloth_contact, {GAP:g} without",
    )
    iterations: int = Field(default=1000, ge=1, le=1_000_000, description="how often the cloth is moved at most")


class Untangle:
    """Moves crossing cloth and its neighbourhood; nothing if nothing crosses."""

    name: ClassVar[str] = "untangle"
    Config: ClassVar[type[BaseModel]] = UntangleConfig

    def apply(self, config: UntangleConfig, fabric: Fabric, state: State, skin: Surface | None) -> Outcome:
        """Untangle one fabric by itself, at `state`; velocities stay. Raises BadInput if it stays tangled."""
        whole = {fabric.name: np.arange(fabric.number, dtype=np.int32)}
        made = self.arrange(config, replace(fabric, position=state.x), whole, np.ones((1, 1), np.bool_), None)
        after = State(made.position, state.v.copy(), state.t)
        return Outcome(made.facts, changed=Changed(fabric, after, np.arange(fabric.number, dtype=np.int32)))

    def arrange(
        self, config: UntangleConfig, fabric: Fabric, objects: Mapping[str, Int], meet: Bool,
        thickness: float | None, bodies: Surface | None = None,
    ) -> Arranged:  # fmt: skip
        """Untangle all; see nuno_schemas.operation. Raises BadInput if cloth stays tangled, with how much and where."""
        x = fabric.position.copy()
        if not len(fabric.faces):
            return Arranged(x, facts_of(0, 0, np.zeros_like(x)))
        cloth = make_cloth(fabric, objects, meet, bodies)
        whole = x if bodies is None else np.concatenate([x, bodies.vertices])
        before = len(find_crossings(cloth.tree, whole, cloth.piece, cloth.meets, cloth.bodies >= 0)[0])
        if not before:
            return Arranged(x, facts_of(0, 0, np.zeros_like(x)))
        gap = (thickness or GAP) if config.gap == "auto" else config.gap
        found = loosen(cloth, gap + 4.0 * JITTER * cloth.edge, config.iterations)
        # Vertices that have hardly moved stay. The check is of the real places: the search shifted them a little.
        gone = norm(found.moved) > JITTER * cloth.edge
        whole = np.where(gone[:, None], whole + found.moved, whole)
        edge, face = find_crossings(cloth.tree, whole, cloth.piece, cloth.meets, cloth.bodies >= 0)
        check_loose(cloth, whole, edge, face, found.iterations, before, list(objects), fabric)
        x = whole[: fabric.number]
        return Arranged(x, facts_of(before, found.iterations, x - fabric.position))


def facts_of(crossings: int, iterations: int, moved: Float) -> dict[str, float]:
    """Return edges through triangles before, iterations, moved vertices, and their way [m]."""
    far = norm(moved)
    return {
        "crossings": float(crossings),
        "iterations": float(iterations),
        "vertices": float((far > 0.0).sum()),
        "largest": float(far.max(initial=0.0)),
        "mean": float(np.cumsum(far)[-1] / len(far)) if len(far) else 0.0,
    }


def check_loose(
    cloth: Cloth, x: Float, edge: Long, face: Long, iterations: int, before: int, names: list[str], fabric: Fabric
) -> None:
    """Raise BadInput for edges (k,) that still go through triangles (k,)."""
    if not len(edge):
        return
    ends, corners = cloth.tree.edges[edge], cloth.tree.faces[face]
    held = (cloth.free[np.concatenate([ends, corners], axis=1), 0] == 0.0).any(axis=1)
    i, j = ends[0]
    one, two, place = cloth.piece[i], cloth.piece[corners[0, 0]], place_of(x[[i, j]].mean(axis=0))
    of_body, remedy = cloth.bodies in (one, two), "place the objects so that less of them crosses, hold less of them"
    where = place
    if not of_body:
        adjacent = int(np.flatnonzero(np.isin(fabric.faces, [i, j]).sum(axis=1) == 2)[0])
        panels = [_panel_of(fabric, int(k)) for k in (adjacent, face[0])]
        where = f"edge {i}-{j} of {names[one]} through triangle {face[0]} of {names[two]}, {place}"
        if all(panels):
            where = f"{panels[0]} of {names[one]} through {panels[1]} of {names[two]}, {place}"
            remedy = "cut panels that are too small for the body wider, place panels so that less of them crosses"
    raise BadInput(
        f"cloth still passes through {'a body' if of_body else 'cloth'} after {iterations:,} iterations "
        f"({len(edge):,} edges through triangles of {before:,}, {int(held.sum()):,} with vertices that are held)",
        value=where,
        limit="none",
        remedy=f"{remedy}, or allow more iterations",
    )


def _panel_of(fabric: Fabric, face: int) -> str:
    """Return the panel of a triangle of a sewn garment, "" for none."""
    panels = None if fabric.corners is None else fabric.corners.panels
    return "" if panels is None or panels.of[face] < 0 else panels.names[panels.of[face]]
