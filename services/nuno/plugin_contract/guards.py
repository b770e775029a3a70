"""Guards of plugins of other distributions: their errors name them, and their results are checked.

Tests check the contract of the project's own plugins, which have no guards at run time.
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
"""Arrays of a state, which a solver advances in place."""


FLOATS = "\nAll that nuno's kernels are given is float64: a method's own buffers, too, as `stages` are"


def _hint(error: BaseException) -> str:
    """Return an explanation for a compiler's error, "" for others."""
    return FLOATS if type(error).__name__ == "TypingError" and "float32" in str(error) else ""


def _place(error: BaseException) -> str:
    """Return the innermost line of an error in the plugin's own folder, "" if there is none."""
    skipped = (__file__, *containment.OWN_FRAMES)
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename not in skipped]
    plugin_frames = [frame for frame in frames if Path(frame.filename).parent == Path(frames[0].filename).parent]
    return f" ({Path(plugin_frames[-1].filename).name}:{plugin_frames[-1].lineno})" if plugin_frames else ""


class Lacking(BadInput, AttributeError):
    """A plugin lacks an attribute of its kind; as an AttributeError, it makes `hasattr` false."""


class Foreign:
    """Wraps a plugin, and guards each of its methods.

    A method may raise BadInput and RunFailed; any other error, also KeyboardInterrupt without a signal, becomes
    RunFailed with the plugin's name; `nuno.plugin_contract.containment` has the other limits. Its results are checked
    against the contract of its kind (`nuno.plugin_contract.results`), and so are the state after `advance` and the
    results of its functions.
    """

    def __init__(self, plugin: Any, group: str, name: str, package: str) -> None:
        self._plugin, self._group, self._label = plugin, group, f"the plugin {name!r} of {package} in {group}"
        self.name = name  # scenes and recordings name a plugin by its entry point

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # Python looks these up in an object that is being copied
            raise AttributeError(name)
        if not hasattr(self._plugin, name):
            raise Lacking(f"{self._label} has no {name}", remedy=containment.UNWRITTEN)
        value = getattr(self._plugin, name)
        return self._guarded(name, value) if callable(value) and not isinstance(value, type) else value

    def _guarded(self, name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            states = [(state, {n: getattr(state, n).shape for n in ARRAYS[type(state)]})
                     for state in args if type(state) in ARRAYS]  # fmt: skip
            result = self._call(name, method, *args, **kwargs)
            for state, shapes in states:
                for field, shape in shapes.items():
                    finite = getattr(result, "status", "ok") == "ok"
                    self._check(f"{name} leaves a state whose {field}", getattr(state, field), shape, finite)
            return self._checked(name, result, args)

        return call

    def _call(self, name: str, method: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        def fail(error: BaseException) -> BaseException:
            if isinstance(error, BadInput | RunFailed):
                return error
            text = f"{type(error).__name__}: {error}{_hint(error)}{_place(error)}"
            return RunFailed(f"{self._label} failed in {name}: {text}")

        return containment.call(fail, method, *args, **kwargs)

    def _checked(self, name: str, result: Any, args: Sequence[Any]) -> Any:
        """Check the result of a method, and guard the functions in it."""
        with self._naming(f"{name} gives {type(result).__name__}"):
            check(self._group, name, result, args)
        for doubt in doubts(result):
            LOGGER.warning("%s: %s gives %s: %s", self._label, name, type(result).__name__, doubt)
        if isinstance(result, Term) and callable(result.data):
            return replace(result, data=self._force(result.data))
        if isinstance(result, Mover):
            return replace(result, pose=lambda t: self._pose(result.pose, len(result.joints), t))
        if isinstance(result, BodyShape) and (pose := result.pose) is not None:
            return replace(result, pose=lambda t: self._pose(pose, len(result.frames), t))
        if isinstance(result, Isotherm) and result.function is not None:
            return replace(result, function=self._law(result.function))
        return result

    @contextlib.contextmanager
    def _naming(self, what: str) -> Iterator[None]:
        try:
            yield
        except ContractError as error:
            raise RunFailed(f"{self._label}: {what}: {error}") from None

    def _force(self, function: Callable[[Float, Float, float, Float], None]) -> Callable[..., None]:
        def add(x: Float, v: Float, t: float, out: Float) -> None:
            with self._unchanged(f"at {t:g} s its force", x=x, v=v):
                returned = self._call("its force", function, x, v, t, out)
            if returned is not None and returned is not out:
                problem = f"its force returns {type(returned).__name__}, which nothing uses"
                raise RunFailed(f"{self._label}: {problem}: add the force to `out` (n, 3) [N], in place")
            # The solver reports a state that is not finite already; earlier values of `out` are not this force's fault.
            if not np.isfinite(out).all() and np.isfinite(x).all() and np.isfinite(v).all():
                alone = np.zeros_like(out)
                self._call("its force", function, x, v, t, alone)
                self._check(f"at {t:g} s its force", alone, out.shape)

        return add

    @contextlib.contextmanager
    def _unchanged(self, what: str, **read: Float) -> Iterator[None]:
        """Raise RunFailed for a function that writes into what it may only read."""
        before = {name: values.copy() for name, values in read.items()}
        yield
        for name, values in before.items():
            if not np.array_equal(read[name].view(np.int64), values.view(np.int64)):  # of bits NaN is equal to itself
                raise RunFailed(f"{self._label}: {what} writes into {name}, which it may only read")

    def _law(self, function: Callable[[Float, Float], Float]) -> Callable[[Float, Float], Float]:
        def fixed(phi: Float, room: Float) -> Float:
            with self._unchanged("its isotherm", phi=phi, room=room):
                result: Float = self._call("its isotherm", function, phi, room)
            self._check("its isotherm", result, phi.shape, bool(np.isfinite(phi).all()))
            return result

        return fixed

    def _pose(self, pose: Callable[..., Any], number: int, t: float) -> tuple[Float, Float]:
        rotation, translation = self._call("its pose", pose, t)
        self._check(f"at {t:g} s its rotation", rotation, (number, 4), strided=True)
        self._check(f"at {t:g} s its translation", translation, (number, 3), strided=True)
        with self._naming(f"at {t:g} s"):
            check_turn(rotation)
        return rotation, translation

    def _check(
        self, what: str, values: Any, shape: tuple[int, ...], finite: bool = True, strided: bool = False
    ) -> None:
        """Raise RunFailed for another shape or dtype, and for values that are not finite."""
        try:
            check_array(what, values, np.float64, shape, Bounds(finite=finite, strided=strided))
        except ContractError as error:
            raise RunFailed(f"{self._label}: {error}") from None
