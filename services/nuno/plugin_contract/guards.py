"""Plugins of other distributions, guarded: what they raise names them, and what they give back is looked at.

The project's own plugins are held to their contract by its tests, and pay for none of this.
"""

from __future__ import annotations

import contextlib
import logging
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from nuno.plugin_contract import containment
from nuno.plugin_contract.results import check, check_turn, doubts
from nuno.plugin_contract.values import ContractError, check_array
from nuno_schemas.dye import DyeState, Isotherm
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Float, State
from nuno_schemas.layout import Bounds
from nuno_schemas.plugin import BodyShape, Mover
from nuno_schemas.system import Term

LOGGER = logging.getLogger("nuno.plugins")
ARRAYS: dict[type, tuple[str, ...]] = {State: ("x", "v"), DyeState: ("phi", "fixed")}
"""What a solver advances in place."""


FLOATS = "\nAll that nuno's kernels are given is float64: a method's own buffers, too, as `stages` are"


def _hint(error: BaseException) -> str:
    """What a compiler's words do not say by themselves."""
    return FLOATS if type(error).__name__ == "TypingError" and "float32" in str(error) else ""


def _place(error: BaseException) -> str:
    """The last line of the plugin's own folder on the way to an error, "" where there is none."""
    between = (__file__, *containment.OWN_FRAMES)
    frames = [one for one in traceback.extract_tb(error.__traceback__) if one.filename not in between]
    own = [one for one in frames if Path(one.filename).parent == Path(frames[0].filename).parent]
    return f" ({Path(own[-1].filename).name}:{own[-1].lineno})" if own else ""


class Lacking(BadInput, AttributeError):
    """A plugin lacks what its kind has: said so where it is used, and None to whoever asks whether it is there."""


class Foreign:
    """Stands for a plugin; every method of it is guarded.

    A method may raise BadInput and RunFailed; anything else, KeyboardInterrupt too where no signal came, becomes
    RunFailed with the plugin's name; `nuno.plugin_contract.containment` says what else it cannot do. Its results are
    checked against the contract of its kind (`nuno.plugin_contract.results`), and so are the state after `advance`
    and what its functions return.
    """

    def __init__(self, plugin: Any, group: str, name: str, package: str) -> None:
        self._plugin, self._group, self._who = plugin, group, f"the plugin {name!r} of {package} in {group}"
        self.name = name  # a scene and its recording know it by the entry point

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # what Python asks of an object that is being copied
            raise AttributeError(name)
        if not hasattr(self._plugin, name):
            raise Lacking(f"{self._who} has no {name}", remedy=containment.UNWRITTEN)
        value = getattr(self._plugin, name)
        return self._guarded(name, value) if callable(value) and not isinstance(value, type) else value

    def _guarded(self, name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **named: Any) -> Any:
            known = [(state, {n: getattr(state, n).shape for n in ARRAYS[type(state)]})
                     for state in args if type(state) in ARRAYS]  # fmt: skip
            found = self._call(name, method, *args, **named)
            for state, shapes in known:
                for field, shape in shapes.items():
                    finite = getattr(found, "status", "ok") == "ok"
                    self._check(f"{name} leaves a state whose {field}", getattr(state, field), shape, finite)
            return self._checked(name, found, args)

        return call

    def _call(self, name: str, method: Callable[..., Any], *args: Any, **named: Any) -> Any:
        def fail(error: BaseException) -> BaseException:
            if isinstance(error, BadInput | RunFailed):
                return error
            said = f"{type(error).__name__}: {error}{_hint(error)}{_place(error)}"
            return RunFailed(f"{self._who} failed in {name}: {said}")

        return containment.call(fail, method, *args, **named)

    def _checked(self, name: str, found: Any, args: Sequence[Any]) -> Any:
        """What a method gave, looked at, and its own functions guarded in turn."""
        with self._named(f"{name} gives {type(found).__name__}"):
            check(self._group, name, found, args)
        for doubt in doubts(found):
            LOGGER.warning("%s: %s gives %s: %s", self._who, name, type(found).__name__, doubt)
        if isinstance(found, Term) and callable(found.data):
            return replace(found, data=self._force(found.data))
        if isinstance(found, Mover):
            return replace(found, pose=lambda t: self._pose(found.pose, len(found.joints), t))
        if isinstance(found, BodyShape) and (pose := found.pose) is not None:
            return replace(found, pose=lambda t: self._pose(pose, len(found.frames), t))
        if isinstance(found, Isotherm) and found.function is not None:
            return replace(found, function=self._law(found.function))
        return found

    @contextlib.contextmanager
    def _named(self, what: str) -> Iterator[None]:
        try:
            yield
        except ContractError as error:
            raise RunFailed(f"{self._who}: {what}: {error}") from None

    def _force(self, function: Callable[[Float, Float, float, Float], None]) -> Callable[..., None]:
        def add(x: Float, v: Float, t: float, out: Float) -> None:
            self._call("its force", function, x, v, t, out)
            # A state that is not finite already is the solver's to tell; and what was there before is not to blame.
            if not np.isfinite(out).all() and np.isfinite(x).all() and np.isfinite(v).all():
                own = np.zeros_like(out)
                self._call("its force", function, x, v, t, own)
                self._check(f"at {t:g} s its force", own, out.shape)

        return add

    def _law(self, function: Callable[[Float, Float], Float]) -> Callable[[Float, Float], Float]:
        def fixed(phi: Float, room: Float) -> Float:
            found: Float = self._call("its isotherm", function, phi, room)
            self._check("its isotherm", found, phi.shape, bool(np.isfinite(phi).all()))
            return found

        return fixed

    def _pose(self, pose: Callable[..., Any], number: int, t: float) -> tuple[Float, Float]:
        rotation, translation = self._call("its pose", pose, t)
        self._check(f"at {t:g} s its rotation", rotation, (number, 4), strided=True)
        self._check(f"at {t:g} s its translation", translation, (number, 3), strided=True)
        with self._named(f"at {t:g} s"):
            check_turn(rotation)
        return rotation, translation

    def _check(
        self, what: str, values: Any, shape: tuple[int, ...], finite: bool = True, strided: bool = False
    ) -> None:
        """Raises RunFailed for another shape or dtype, and values that are not finite."""
        try:
            check_array(what, values, np.float64, shape, Bounds(finite=finite, strided=strided))
        except ContractError as error:
            raise RunFailed(f"{self._who}: {error}") from None
