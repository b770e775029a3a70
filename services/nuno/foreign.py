"""Plugins of other distributions, guarded: what they raise names them, and what they give back is looked at.

The project's own plugins are held to their contract by its tests, and pay for none of this.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno import contain
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.plugin import BodyShape, Mover, Term


class Foreign:
    """Stands for a plugin; every method of it is guarded.

    A method may raise BadInput and RunFailed; anything else, KeyboardInterrupt too where no signal came, becomes
    RunFailed with the plugin's name; see `nuno.contain` for what else it cannot do. Values that are not finite are
    found in what `build` gives, in what a force adds and in the state after `advance`, and the first vertex is named.
    """

    def __init__(self, plugin: Any, group: str, name: str, package: str) -> None:
        self._plugin, self._who = plugin, f"the plugin {name!r} of {package} in {group}"

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # what Python asks of an object that is being copied
            raise AttributeError(name)
        value = getattr(self._plugin, name)
        return self._guarded(name, value) if callable(value) and not isinstance(value, type) else value

    def _guarded(self, name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **named: Any) -> Any:
            known = [(state, state.x.shape, state.v.shape) for state in args if isinstance(state, State)]
            found = self._call(name, method, *args, **named)
            for state, *shapes in known:
                for array, shape in zip((state.x, state.v), shapes, strict=True):
                    self._check(array, f"{name} leaves a state", shape, finite=getattr(found, "status", "ok") == "ok")
            return self._checked(name, found)

        return call

    def _call(self, name: str, method: Callable[..., Any], *args: Any, **named: Any) -> Any:
        def fail(error: BaseException) -> BaseException:
            if isinstance(error, BadInput | RunFailed):
                return error
            return RunFailed(f"{self._who} failed in {name}: {type(error).__name__}: {error}")

        return contain.call(fail, method, *args, **named)

    def _checked(self, name: str, found: Any) -> Any:
        """What a method gave, looked at, and its own functions guarded in turn."""
        if isinstance(found, Fabric):
            for field in ("position", "velocity", "mass"):
                values = getattr(found, field)
                self._check(values, f"{name} gives a fabric whose {field}", (len(found.position), 3)[: values.ndim])
        elif isinstance(found, Term) and found.kind == "python":
            return replace(found, data=self._force(found.data))  # type: ignore[arg-type]
        elif isinstance(found, Mover):
            return replace(found, pose=lambda t: self._pose(found, t))
        elif isinstance(found, BodyShape):
            for field in ("a", "b", "vertices"):
                values = getattr(found, field)
                self._check(values, f"{name} gives a body whose {field}", (len(values), 3))
        return found

    def _force(self, function: Callable[[Float, Float, float, Float], None]) -> Callable[..., None]:
        def add(x: Float, v: Float, t: float, out: Float) -> None:
            self._call("its force", function, x, v, t, out)
            # A state that is not finite already is the solver's to tell; and what was there before is not to blame.
            if not np.isfinite(out).all() and np.isfinite(x).all() and np.isfinite(v).all():
                own = np.zeros_like(out)
                self._call("its force", function, x, v, t, own)
                self._check(own, f"at {t:g} s its force", out.shape)

        return add

    def _pose(self, mover: Mover, t: float) -> tuple[Float, Float]:
        rotation, translation = self._call("its pose", mover.pose, t)
        number = len(mover.joints)
        self._check(rotation, f"at {t:g} s its rotation", (number, 4))
        self._check(translation, f"at {t:g} s its translation", (number, 3))
        return rotation, translation

    def _check(self, values: NDArray[Any], what: str, shape: tuple[int, ...], finite: bool = True) -> None:
        """Raises RunFailed for another shape or dtype, and values that are not finite."""
        if not isinstance(values, np.ndarray) or values.dtype != np.float64 or values.shape != shape:
            given = f"{values.dtype} {values.shape}" if isinstance(values, np.ndarray) else type(values).__name__
            raise RunFailed(f"{self._who}: {what} is {given}, not float64 {shape}")
        if finite and not np.isfinite(values).all():
            place = tuple(int(i) for i in np.argwhere(~np.isfinite(values))[0])
            raise RunFailed(f"{self._who}: {what} is {values[place]} at row {place[0]}")
