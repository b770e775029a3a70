"""A solver of renumbered cloth, which is given and gives what it has of vertices in the user's order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Float, Int, Memory, State
from nuno_schemas.system import Forces, StepLimit, StepReport, System, Touched


class Ordered:
    """Stands for an integrator (nuno_schemas.plugin.Integrator) wherever that is given a state: of systems whose fabric
    is renumbered, by `numbers` (n,), for states that are not.

    Memory is the integrator's own, with its vertices as they are stepped.
    """

    def __init__(self, plugin: Any, numbers: Int) -> None:
        self._plugin, self._numbers = plugin, numbers

    def prepare(self, config: Any, system: System, state: State, without: Sequence[str] = ()) -> Memory:
        """See Integrator."""
        memory: Memory = self._plugin.prepare(config, system, self._ordered(state), without)
        return memory

    def limit(self, config: Any, system: System, state: State) -> StepLimit:
        """See Integrator."""
        limit: StepLimit = self._plugin.limit(config, system, self._ordered(state))
        return limit

    def advance(
        self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None, steps: int, dt: float
    ) -> StepReport:
        """See Integrator."""
        own = self._ordered(state)
        report: StepReport = self._plugin.advance(system, own, memory, poses, steps, dt)
        state.x[self._numbers], state.v[self._numbers], state.t = own.x, own.v, own.t
        return report

    def profile(
        self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None
    ) -> Mapping[str, float]:
        """See Integrator."""
        costs: Mapping[str, float] = self._plugin.profile(system, self._ordered(state), memory, poses)
        return costs

    def unbalance(self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None) -> Float:
        """See Integrator."""
        return self._given(self._plugin.unbalance(system, self._ordered(state), memory, poses))

    def forces(self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None) -> Forces:
        """See Integrator; springs, and so their tensions, have kept their order."""
        found: Forces = self._plugin.forces(system, self._ordered(state), memory, poses)
        parts = {name: self._given(part) for name, part in found.parts.items()}
        return Forces(parts, self._given(found.acceleration), found.tension)

    def touched(self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses]) -> Touched:
        """See Integrator."""
        found: Touched = self._plugin.touched(system, self._ordered(state), memory, poses)
        return Touched({name: self._given(part) for name, part in found.by.items()}, self._given(found.total))

    def _ordered(self, state: State) -> State:
        """A state as it is stepped, an array of its own."""
        return State(state.x[self._numbers], state.v[self._numbers], state.t)

    def _given(self, values: Float) -> Float:
        """Values (n, ...) of vertices in the user's order."""
        out = np.empty_like(values)
        out[self._numbers] = values
        return out
