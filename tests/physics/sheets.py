"""Pieces of cloth under cloth contact, stepped by any solver; and ipctk as the judge."""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno.plugin_contract import registry
from nuno_bench import piles
from nuno_bench.piles import DOWN, Oracle, pile, sheet
from nuno_contact.offset.contact_state import ContactState
from nuno_schemas.fabric import Fabric, Float, Memory, State
from nuno_schemas.system import StepReport

__all__ = ["DOWN", "Pile", "sheet"]


class Pile:
    """Pieces under cloth contact and a solver."""

    def __init__(
        self, *pieces: Fabric, solver: str = "symplectic_euler", gravity: Float = DOWN, dt: float = 2e-4,
        threads: int = 1, contact: bool = True, **settings: Any,
    ) -> None:  # fmt: skip
        self.system = pile(*pieces, gravity=gravity, threads=threads, contact=contact, **settings)
        self.fabric, self.dt = self.system.fabric, dt
        self.solver = registry.load("nuno.integrators", solver)
        self.state = State(self.fabric.position.copy(), self.fabric.velocity.copy())
        self.memory: Memory = self.solver.prepare(self.solver.Config(), self.system, self.state)
        self.oracle = Oracle(self.fabric.position, self.fabric.faces)

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
        return self.oracle.crossed(self.state.x)

    @property
    def meeting(self) -> ContactState:
        """The term itself."""
        return next(term for term in self.memory.work.packed.bodies if isinstance(term, ContactState))  # type: ignore[attr-defined]


def heap(solver: str, seed: int, contact: bool = True, dt: float = 2e-4) -> Pile:
    """Three uneven sheets that fly at each other, one of them held, faster than a step can see."""
    rng = np.random.default_rng(seed)
    damping, friction = rng.uniform(0.0, 1.0, 2)
    pieces = piles.heap(seed)
    return Pile(*pieces, solver=solver, dt=dt, contact=contact, damping=damping, friction=friction)


def sliding(friction: float, slope: float, **settings: Any) -> Pile:
    """A sheet that lies on a held one, gravity tilted by its slope [rad] towards +x."""
    return Pile(*piles.incline(), gravity=piles.tilted(slope), friction=friction, **settings)


def pace(pile: Pile) -> Float:
    """Mean velocity of the free vertices [m/s]."""
    return np.asarray(pile.state.v[~pile.fabric.pinned].mean(axis=0))
