"""Sheets that meet: pieces of cloth by hand, under cloth contact, stepped by any solver; and ipctk as the judge."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import ipctk
import numpy as np

from nuno import registry
from nuno.cloth.join import join_fabrics
from nuno_contact.offset.meeting import Meeting
from nuno_contact.offset.plugin import Offset, OffsetConfig
from nuno_kernels.meshes.normals import edge_numbers
from nuno_schemas.fabric import Fabric, Float, Memory, State
from nuno_schemas.system import StepReport, System

DOWN = np.array([0.0, -9.81, 0.0])


def sheet(
    side: int = 8,
    size: float = 0.1,
    at: Float | None = None,
    v: Float | None = None,
    pinned: bool = False,
    name: str = "sheet",
) -> Fabric:
    """A level square of cloth, its middle at a place, moving at v."""
    plugin = registry.load("nuno.models", "sheet")
    config = plugin.Config.model_validate({"size": [size, size], "resolution": [side, side], "plane": "xz",
                                           "fabric": "jacket"})  # fmt: skip
    fabric: Fabric = plugin.build(config, None, 0)
    x = fabric.position - fabric.position.mean(axis=0) + (np.zeros(3) if at is None else at)
    moving = np.zeros_like(x) + (np.zeros(3) if v is None else v)
    return replace(fabric, name=name, position=x, velocity=moving, pinned=np.full(len(x), pinned))


class Pile:
    """Pieces under cloth contact and a solver."""

    def __init__(
        self, *pieces: Fabric, solver: str = "symplectic_euler", gravity: Float = DOWN, dt: float = 2e-4,
        threads: int = 1, contact: bool = True, **settings: Any,
    ) -> None:  # fmt: skip
        self.fabric, self.dt = join_fabrics(list(pieces), "pile"), dt
        stops = np.cumsum([0, *(piece.number for piece in pieces)])
        objects = {str(i): np.arange(a, b, dtype=np.int32) for i, (a, b) in enumerate(pairwise(stops))}
        meet = np.ones((len(pieces), len(pieces)), bool)
        terms = (Offset().prepare(OffsetConfig(**settings), self.fabric, objects, meet, gravity),) if contact else ()
        self.system = System(self.fabric, gravity, 0.0, terms, threads)
        self.solver = registry.load("nuno.integrators", solver)
        self.state = State(self.fabric.position.copy(), self.fabric.velocity.copy())
        self.memory: Memory = self.solver.prepare(self.solver.Config(), self.system, self.state)
        self.mesh = ipctk.CollisionMesh(self.fabric.position, edge_numbers(self.fabric.faces)[1], self.fabric.faces)

    def go(self, steps: int) -> StepReport:
        """An interval of so many steps."""
        report: StepReport = self.solver.advance(self.system, self.state, self.memory, None, steps, self.dt)
        assert report.status == "ok", report.message
        return report

    @property
    def momentum(self) -> Float:
        """Of all cloth [kg m/s]."""
        return np.asarray((self.fabric.mass[:, None] * self.state.v).sum(axis=0))

    @property
    def crossed(self) -> bool:
        """Whether cloth passes through cloth, as ipc-toolkit sees it."""
        return bool(ipctk.has_intersections(self.mesh, self.state.x))

    @property
    def meeting(self) -> Meeting:
        """The term itself."""
        return next(term for term in self.memory.work.packed.bodies if isinstance(term, Meeting))  # type: ignore[attr-defined]
