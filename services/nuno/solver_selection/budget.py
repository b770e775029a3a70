"""How long it may take to choose a solver by trying some, and what is said meanwhile."""

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
"""Wall time that trials may take unless another is given [s]."""
SILENT = 2.0
"""Trials that take so long altogether [s] are told of."""


class Spent(Exception):
    """The budget is used up."""


@dataclass
class Budget:
    """Wall time for the trials of one scene [s]. A choice does not depend on it unless it is used up.

    leave  (1,) not 0 once it is, or nobody waits for the choice any more: what steps then returns, and gives nothing
    tell   is called with what is tried
    """

    seconds: float = BUDGET
    tell: Callable[[str], None] = lambda text: None
    leave: NDArray[np.int64] = field(default_factory=lambda: np.zeros(1, np.int64))
    used: float = 0.0
    """Wall time of trials so far [s], without what was compiled for them."""

    @property
    def over(self) -> str:
        """What is said where it is used up."""
        return f"trials were ended after {self.seconds:g} s: --budget gives them longer"

    def stop(self) -> None:
        """Have what is being tried return at once."""
        self.leave[0] = 1

    @contextmanager
    def trial(self, what: str, expected: float = 0.0) -> Iterator[None]:
        """While something is tried that is expected to take so long [s]. Raises Spent where there is no time for it, or
        it is over before that has ended.
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
