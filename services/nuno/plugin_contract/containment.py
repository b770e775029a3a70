"""Containment of calls into other distributions' code, so that errors name the plugin."""

from __future__ import annotations

import contextlib
import ctypes
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any, TypeVar

import numpy as np

from nuno import process
from nuno.process import ENDING, refusing_exit, working_folder

T = TypeVar("T")
OWN_FRAMES = (__file__, process.__file__)
"""Files whose frames lie between a call and the called code."""
UNWRITTEN = (
    "write it, if the package is yours: docs/reference/protocols.md has what a plugin of each kind is asked for; if "
    "not, update it"
)
"""Remedy for a plugin that lacks a method."""


class Overdue(BaseException):
    """A call that goes on in Python where its run is to end."""

    def __str__(self) -> str:
        return "it went on where the run was to end"


LOGGER = logging.getLogger("nuno.plugins")
Fail = Callable[[BaseException], BaseException]
CALLS: dict[int, tuple[float, Fail]] = {}
"""Start of the call that each thread is in [s], the outermost one of several, and what makes its error."""
RUNS: dict[int, str] = {}
"""The run of each thread that is a service's."""
RAISED: set[int] = set()
"""Threads in whose call an error was raised from outside."""
_LOCK = threading.Lock()


@contextlib.contextmanager
def serving(run: str) -> Iterator[None]:
    """Count this thread among those of a run."""
    RUNS[threading.get_ident()] = run
    try:
        yield
    finally:
        del RUNS[threading.get_ident()]


def end_calls(run: str, patience: float) -> bool:
    """Raise Overdue in all calls by a run's threads that have gone on in Python for longer than `patience` [s], except
    in the compiler. Return whether there is a call. Compiled code, which `System.leave` tells, hears nothing of it.
    """
    with _LOCK:
        calls = {thread: call for thread, call in CALLS.items() if RUNS.get(thread) == run}
        for thread, (began, fail) in calls.items():
            if time.monotonic() - began > patience and not _compiles(thread):
                LOGGER.warning("%s", fail(Overdue()))
                RAISED.add(thread)
                _raise(thread, Overdue)
        return bool(calls)


def _compiles(thread: int) -> bool:
    """Return whether a thread is in numba's compiler."""
    frame = sys._current_frames().get(thread)
    while frame is not None:
        if str(frame.f_globals.get("__name__")).startswith("numba."):
            return True
        frame = frame.f_back
    return False


def _raise(thread: int, error: type[BaseException] | None) -> None:
    """Raise an error in a thread at its next line; None takes back one that it has not heard."""
    raised = None if error is None else ctypes.py_object(error)
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), raised)


@contextlib.contextmanager
def _listed(fail: Fail) -> Iterator[None]:
    """List a call among CALLS, unless it is within one."""
    thread = threading.get_ident()
    outermost = thread not in CALLS
    CALLS.setdefault(thread, (time.monotonic(), fail))
    try:
        yield
    finally:
        if outermost:
            with _LOCK:
                del CALLS[thread]
                # Only then: taking an error back that is not there leaves Python looking for one at each line, which
                # slows all threads, and never ends where calls are traced.
                if thread in RAISED:
                    RAISED.remove(thread)
                    _raise(thread, None)


def call(fail: Fail, function: Callable[..., T], *args: Any, **kwargs: Any) -> T:
    """Return the result of `function`. Raises `fail(error)` for any error, except the user's own signals.

    `os._exit` in it raises SystemExit, instead of ending the process; the working folder and NumPy's error handling
    are restored afterwards.
    """
    with np.errstate(), _same_folder(), refusing_exit(), _signals() as signals:
        try:
            with _listed(fail):
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
