"""A progress line: simulated time, real-time factor, remaining time."""

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
"""Wall time of the frames for the first estimate [s]; a shorter run needs none."""
LATEST, OTHER = 0.25, 1.5
"""Share of the time so far whose frames give the estimate; and the factor by which a new shown estimate differs."""
LEAST = 1.0
"""Least remaining time that is shown [s]."""


class ProgressLine:
    """A bar on a terminal; elsewhere a line at the start and at each tenth.

    The remaining time follows from the latest frames: the first ones of worn cloth take longer, those of caught cloth
    are shorter. The first estimate is a separate line, after SETTLED, and so is one that differs.
    """

    def __init__(self, scene: Scene, bar: bool | None = None) -> None:
        """bar: whether to show a bar; None shows it on a terminal."""
        self.scene, self.end = scene, scene.frames / scene.frame_rate
        self.start = 0.0
        self.tenth = -1
        self.estimate = 0.0
        """Last shown estimate of the run's wall time [s]."""
        self.latest: deque[tuple[float, float]] = deque()
        """Wall time [s] and time of the scene [s] at the end of the latest frames."""
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
        """Show one frame's status, or a message of a service."""
        if isinstance(status, str):
            print(status, file=sys.stderr)
            return
        self.show(status.t, status.paused_seconds)

    def show(self, t: float, paused: float = 0.0) -> None:
        """Show the progress at time t of the scene [s], after pauses that counted for nothing [s]."""
        now = time.perf_counter() - paused
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

    def _estimate(self, total: float, settled: bool) -> None:
        """Print the run's wall time `total` [s], if it is new, or differs from the last estimate."""
        former = self.estimate
        if not settled or 1.0 / OTHER <= total / (former or math.inf) <= OTHER:
            return
        self.estimate, until = total, self.scene.until
        ends = "" if until == "duration" else f" at most, less where it comes to {until} before"
        now = f", not {roughly(former)}: frames take {'longer' if total > former else 'shorter'} now" if former else ""
        print(f"the run takes {roughly(total)}{ends}{now}", file=sys.stderr)
