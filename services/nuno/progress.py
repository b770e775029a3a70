"""A progress line: simulated time, real-time factor, what is left."""

from __future__ import annotations

import math
import sys
import time
from collections import deque
from types import TracebackType
from typing import Any

from nuno.formatting import LONG, factor, roughly, time_of
from nuno_schemas.messages import FrameStatus
from nuno_schemas.scene import Scene

SETTLED = 2.0
"""Wall time of frames that the first estimate is made of [s]; a shorter run needs none."""
LATEST, OTHER = 0.25, 1.5
"""Share of the time so far whose frames tell what is left; and by which factor an estimate differs that is said."""
LEAST = 1.0
"""What is left is told where it is longer than this [s]."""


class ProgressLine:
    """A bar on a terminal; elsewhere a line at the start and at each tenth.

    What is left follows from the latest frames: the first ones of cloth that is put on take longer, those of cloth that
    gets caught take shorter. The first estimate is a line of its own, after SETTLED, and so is one that differs.
    """

    def __init__(self, scene: Scene, bar: bool | None = None) -> None:
        """bar: whether there is one; None: on a terminal."""
        self.scene, self.end = scene, scene.frames / scene.frame_rate
        self.start = 0.0
        self.tenth = -1
        self.estimate = 0.0
        """Wall time of the run that was last said [s]."""
        self.latest: deque[tuple[float, float]] = deque()
        """When the latest frames were done [s], and which time of the scene they ended at [s]."""
        self._terminal = sys.stderr.isatty() if bar is None else bar
        self._bar: Any = None

    def __enter__(self) -> ProgressLine:
        if self._terminal:
            from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.fields[rate]}"),
                TimeRemainingColumn(),
                transient=True,
            )
            self._bar.start()
            self._task = self._bar.add_task("preparing", total=self.end, rate="")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def update(self, status: FrameStatus | str) -> None:
        """Show one frame's status, or a line that a service has to say."""
        if isinstance(status, str):
            print(status, file=sys.stderr)
            return
        self.show(status.t)

    def show(self, t: float) -> None:
        """Show how far a run is [s]."""
        now = time.perf_counter()
        if not self.start:
            self.start = now
        self.latest.append((now, t))
        while len(self.latest) > 2 and now - self.latest[1][0] > max(SETTLED, LATEST * (now - self.start)):
            self.latest.popleft()
        began, first = self.latest[0]
        times = (t - first) / max(now - began, 1e-9)
        rate = f"{factor(times)} real time" if times > 0.0 else ""
        left = (self.end - t) / times if times > 0.0 else 0.0
        self._estimate(now - self.start + left, now - self.start > SETTLED and left > 0.0)
        unit, name = time_of(self.end) if self.end > LONG else (1.0, "s")
        done = f"{t / unit:.2f} of {self.end / unit:g} {name}"
        if self._bar is not None:
            self._bar.update(self._task, completed=t, description=done, rate=rate)
            return
        tenth = int(10 * t / self.end + 1e-9)
        if tenth > self.tenth:
            self.tenth = tenth
            print(f"{done}  {rate}{f', {roughly(left)} left' if left > LEAST else ''}", file=sys.stderr)

    def _estimate(self, whole: float, settled: bool) -> None:
        """Say how long the run takes, `whole` [s], where that is not known yet, or is other than was said."""
        before = self.estimate
        if not settled or 1.0 / OTHER <= whole / (before or math.inf) <= OTHER:
            return
        self.estimate, until = whole, self.scene.until
        ends = "" if until == "duration" else f" at most, less where it comes to {until} before"
        now = f", not {roughly(before)}: frames take {'longer' if whole > before else 'shorter'} now" if before else ""
        print(f"the run takes {roughly(whole)}{ends}{now}", file=sys.stderr)
