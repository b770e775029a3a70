"""Time budget of the trials for a solver, and their progress messages."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nuno.formatting import roughly

BUDGET = 60.0
"""Default wall time of the trials [s]."""
SILENT = 2.0
"""Total time of trials from which messages are shown [s]."""


class Spent(Exception):
    """The budget is used up."""


@dataclass
class Budget:
    """Wall time for the trials of one scene [s]. The choice depends on it only if it is used up.

    leave  (1,) nonzero once it is used up, or the choice is no longer needed: solvers then abandon their frame
    tell   is called with messages about the trials
    """

    seconds: float = BUDGET
    tell: Callable[[str], None] = lambda text: None
    leave: NDArray[np.int64] = field(default_factory=lambda: np.zeros(1, np.int64))
    used: float = 0.0
    """Wall time of trials so far [s], without compilation."""

    @property
    def over(self) -> str:
        """Message for a budget that is used up."""
        return f"trials were ended after {self.seconds:g} s: --budget gives them longer"

    def stop(self) -> None:
        """Abandon the present trial."""
        self.leave[0] = 1

    @contextmanager
    def trial(self, what: str, expected: float = 0.0) -> Iterator[None]:
        """Time one trial, which is expected to take `expected` [s]. Raises Spent without the time for it, or if the
        budget is used up before its end.
        """
        left, began = self.seconds - self.used, time.monotonic()
        if self.leave[0] or expected > left:
            raise Spent
        if self.used > SILENT or expected > SILENT:
            takes = f", {roughly(expected)}" if expected else ""
            self.tell(f"trying {what}{takes}: {self.used:.0f} of {self.seconds:g} s are used (--budget)")
        timer = threading.Timer(left, self.stop)
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
            self.used += time.monotonic() - began
        if self.leave[0]:
            raise Spent
