"""Guards of plugins of other distributions: their errors name them, and their results are checked.

Tests check the contract of the project's own plugins, which have no guards at run time.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

import numpy as np

from nuno import process
from nuno.plugin_contract.results import ContractError, check, check_array, check_turn, doubts
from nuno.process import ENDING, refusing_exit, working_folder
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
    skipped = (__file__, *OWN_FRAMES)
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename not in skipped]
    plugin_frames = [frame for frame in frames if Path(frame.filename).parent == Path(frames[0].filename).parent]
    return f" ({Path(plugin_frames[-1].filename).name}:{plugin_frames[-1].lineno})" if plugin_frames else ""


class Lacking(BadInput, AttributeError):
    """A plugin lacks an attribute of its kind; as an AttributeError, it makes `hasattr` false."""


class Foreign:
    """Wraps a plugin, and guards each of its methods.

    A method may raise BadInput and RunFailed; any other error, also KeyboardInterrupt without a signal, becomes
    RunFailed with the plugin's name; `nuno.plugin_contract.guards` has the other limits. Its results are checked
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
            raise Lacking(f"{self._label} has no {name}", remedy=UNWRITTEN)
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

        return call(fail, method, *args, **kwargs)

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

    def _law(self, function: Callable[[Float, Float], Float]) -> Callable[[Float, Float], Float]:
        def fixed(phi: Float, room: Float) -> Float:
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


# Containment of calls into other distributions' code, so that errors name the plugin.

T = TypeVar("T")
OWN_FRAMES = (__file__, process.__file__)
"""Files whose frames lie between a call and the called code."""
UNWRITTEN = (
    "write it, if the package is yours: docs/reference/protocols.md has what a plugin of each kind is asked for; if "
    "not, update it"
)
"""Remedy for a plugin that lacks a method."""


def call(fail: Callable[[BaseException], BaseException], function: Callable[..., T], *args: Any, **kwargs: Any) -> T:
    """Return the result of `function`. Raises `fail(error)` for any error, except the user's own signals.

    `os._exit` in it raises SystemExit, instead of ending the process; the working folder and NumPy's error handling
    are restored afterwards.
    """
    with np.errstate(), _same_folder(), refusing_exit(), _signals() as signals:
        try:
            return function(*args, **kwargs)
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt) and signals:
                raise
            failure = fail(error)
            if failure is error:
                raise
            raise failure from error


@contextlib.contextmanager
def _signals() -> Iterator[list[int]]:
    """Collect the signals that arrive: a KeyboardInterrupt without one is not the user's.

    Python handles signals only in the main thread.
    """
    received: list[int] = []
    handlers: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        handlers = {n: handler for n in ENDING if callable(handler := signal.getsignal(n))}

    def note(number: int, frame: FrameType | None) -> None:
        received.append(number)
        handlers[number](number, frame)

    for number in handlers:
        signal.signal(number, note)
    try:
        yield received
    finally:
        for number, handler in handlers.items():
            if signal.getsignal(number) is note:
                signal.signal(number, handler)


@contextlib.contextmanager
def _same_folder() -> Iterator[None]:
    """Restore the working folder, which all threads share."""
    before = working_folder()
    try:
        yield
    finally:
        if before and working_folder() != before:
            os.chdir(before)
