"""A solver of renumbered cloth, which is given and gives what it has of vertices in the user's order."""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno_schemas.fabric import Int, State
from nuno_schemas.system import Forces, Touched


class RenumberedSolver:
    """Stands for an integrator (nuno_schemas.plugin.Integrator) wherever that is given a state: of systems whose fabric
    is renumbered, by `numbers` (n,), for states that are not.

    Memory is the integrator's own, with its vertices as they are stepped. Springs, and so their tensions, have kept
    their order.
    """

    def __init__(self, plugin: Any, numbers: Int) -> None:
        self._plugin, self._numbers = plugin, numbers

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # asked of a copy before it has a plugin
            raise AttributeError(name)
        method = getattr(self._plugin, name)

        def call(*args: Any) -> Any:
            numbers = self._numbers
            own = [State(a.x[numbers], a.v[numbers], a.t) if isinstance(a, State) else a for a in args]
            found = method(*own)
            for state, stepped in zip(args, own, strict=True):
                if isinstance(state, State):
                    state.x[numbers], state.v[numbers], state.t = stepped.x, stepped.v, stepped.t
            return self._given(found)

        return call if callable(method) else method

    def _given(self, found: Any) -> Any:
        """What the integrator has found, with values (n, ...) of vertices in the user's order."""
        if isinstance(found, Forces):
            parts = {name: self._given(part) for name, part in found.parts.items()}
            return Forces(parts, self._given(found.acceleration), found.tension)
        if isinstance(found, Touched):
            return Touched({name: self._given(part) for name, part in found.by.items()}, self._given(found.total))
        if isinstance(found, np.ndarray):
            out = np.empty_like(found)
            out[self._numbers] = found
            return out
        return found
