"""A solver of renumbered cloth, which takes and returns vertex arrays in the user's order."""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno_schemas.fabric import Int, State
from nuno_schemas.system import Forces, Touched


class RenumberedSolver:
    """Wraps an integrator (nuno_schemas.plugin.Integrator): it takes systems whose fabric is renumbered by `numbers`
    (n,), and states that are not.

    Memory is the integrator's own, in the renumbered order. Springs, and so their tensions, keep their order.
    """

    def __init__(self, plugin: Any, numbers: Int) -> None:
        self._plugin, self._numbers = plugin, numbers

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # a copy is asked for these before it has a plugin
            raise AttributeError(name)
        method = getattr(self._plugin, name)

        def call(*args: Any) -> Any:
            numbers = self._numbers
            renumbered_args = [State(a.x[numbers], a.v[numbers], a.t) if isinstance(a, State) else a for a in args]
            result = method(*renumbered_args)
            for state, stepped in zip(args, renumbered_args, strict=True):
                if isinstance(state, State):
                    state.x[numbers], state.v[numbers], state.t = stepped.x, stepped.v, stepped.t
            return self._restore(result)

        return call if callable(method) else method

    def _restore(self, result: Any) -> Any:
        """Return the integrator's result with arrays (n, ...) of vertices in the user's order."""
        if isinstance(result, Forces):
            parts = {name: self._restore(part) for name, part in result.parts.items()}
            return Forces(parts, self._restore(result.acceleration), result.tension)
        if isinstance(result, Touched):
            return Touched({name: self._restore(part) for name, part in result.by.items()}, self._restore(result.total))
        if isinstance(result, np.ndarray):
            out = np.empty_like(result)
            out[self._numbers] = result
            return out
        return result
