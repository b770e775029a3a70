"""Containment of calls into other distributions' code, so that errors name the plugin."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
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
