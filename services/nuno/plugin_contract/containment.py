"""Calls of other distributions' code, which may do what no plugin may: contained, so that it is said who it was."""

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
from nuno.process import refusing_exit, working_folder

T = TypeVar("T")
OWN_FRAMES = (__file__, process.__file__)
"""Files that stand between a call and the code that is called."""
UNWRITTEN = (
    "write it, if the package is yours: docs/reference/protocols.md has what a plugin of each kind is asked for; if "
    "not, update it"
)
"""What to do where a plugin lacks a method."""


def call(fail: Callable[[BaseException], BaseException], function: Callable[..., T], *args: Any, **named: Any) -> T:
    """What `function` gives. Raises `fail(error)` for whatever it raises, but the user's own Ctrl-C or SIGTERM.

    `os._exit` in it raises SystemExit, instead of ending the process with any exit code it likes; the working folder
    and how NumPy treats errors are as they were afterwards.
    """
    with np.errstate(), _same_folder(), refusing_exit(), _signals() as came:
        try:
            return function(*args, **named)
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt) and came:
                raise
            failure = fail(error)
            if failure is error:
                raise
            raise failure from error


@contextlib.contextmanager
def _signals() -> Iterator[list[int]]:
    """The signals that have come meanwhile: a KeyboardInterrupt without any is not the user's.

    Python handles signals in the main thread alone.
    """
    came: list[int] = []
    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        before = {n: known for n in (signal.SIGINT, signal.SIGTERM) if callable(known := signal.getsignal(n))}

    def note(number: int, frame: FrameType | None) -> None:
        came.append(number)
        before[number](number, frame)

    for number in before:
        signal.signal(number, note)
    try:
        yield came
    finally:
        for number, known in before.items():
            if signal.getsignal(number) is note:
                signal.signal(number, known)


@contextlib.contextmanager
def _same_folder() -> Iterator[None]:
    """Put back the working folder, which all threads share."""
    before = working_folder()
    try:
        yield
    finally:
        if before and working_folder() != before:
            os.chdir(before)
