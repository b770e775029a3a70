"""Compilation without garbage collection.

Python looks for cycles of objects whenever many have been made, and the compiler makes millions that are wanted until
it is done: of a first run's compilation that took a seventh. Without, the process has a sixth more memory at its end.
"""

from __future__ import annotations

import gc
from typing import Any

from numba.core import event


class _Quiet(event.Listener):  # type: ignore[misc]
    """Stops collection from a compilation's start, through nested ones, to its end. One thread compiles at a time."""

    def __init__(self) -> None:
        self.compilations, self.looked = 0, False

    def on_start(self, event: Any) -> None:
        """See numba."""
        if self.compilations == 0:
            self.looked = gc.isenabled()
            gc.disable()
        self.compilations += 1

    def on_end(self, event: Any) -> None:
        """See numba."""
        self.compilations -= 1
        if self.compilations == 0 and self.looked:
            gc.enable()


def compile_quietly() -> None:
    """Suspend garbage collection in all of numba's compilations in this process."""
    event.register("numba:compile", _Quiet())
