"""The number of threads that steps fastest at present, which depends on the machine's load, not on the mesh alone.

Threads meet after every pass over the vertices. Where another process has one of the cores, each meeting waits
for it, and two threads are several times slower than one; where it has not, they are up to twice as fast. The
result is the same to the last bit, so the number may change from frame to frame by what the frames took.
"""

from __future__ import annotations

import math

TRY_AGAIN = 24
"""frames after which the other number is tried for one"""
SLOWER = 1.2
"""factor by which one frame may raise the known time of a number of threads"""
BETTER = 0.95
"""share of the present time that a change must promise: times vary by a few percent"""


class ThreadTuning:
    """Chooses between one thread and `most` by the time that an evaluation took with each."""

    def __init__(self, most: int) -> None:
        self.most, self.threads, self.used, self.frames = most, most, most, 0
        self.taken: dict[int, float] = {}

    def choose(self) -> int:
        """Return the threads for the next frame. The first one is not counted: its data are not yet in the caches."""
        self.frames += 1
        other = 1 if self.threads == self.most else self.most
        again = self.frames == 3 or self.frames % TRY_AGAIN == 0
        self.used = other if again else self.threads
        return self.used

    def took(self, seconds: float, work: int) -> None:
        """Note the time of the frame just chosen for, and its work (steps, or evaluations)."""
        if work < 1 or self.frames == 1:
            return
        # A single slow frame is a disturbance; a second one is a change.
        self.taken[self.used] = min(seconds / work, SLOWER * self.taken.get(self.used, math.inf))
        best = min(self.taken, key=self.taken.__getitem__)
        if self.taken[best] < BETTER * self.taken.get(self.threads, 0.0):
            self.threads = best
