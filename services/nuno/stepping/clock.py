"""Frames paced to the clock: a simulated second a second of wall time."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nuno.stepping.driver import Driver

PATIENCE = 0.5
"""Longest that control is not looked at while a frame waits [s]."""


class Clock:
    """Waits after each frame until it is due, counted from the first, without what the run was paused for.

    A frame is late that is done after the next one would be due. Those after it do not wait until they have caught up.
    """

    def __init__(self, driver: Driver) -> None:
        self._driver = driver
        self._origin: float | None = None
        self.late, self.frames, self.most = 0, 0, 0.0

    def hold(self, began: float) -> None:
        """Wait until the frame that was begun at a wall time [s] is due; say it where the run falls behind."""
        driver, interval = self._driver, 1.0 / self._driver.scene.frame_rate
        if self._origin is None:  # the first is due an interval after it was begun
            self._origin = began - (driver.stepper.t - interval)
        self.frames += 1
        behind = -self._left()
        self.most = max(self.most, behind)
        if behind > interval:
            self.late += 1
            if self.late == 1:
                text = f"cannot keep up with the clock: frame {driver.stepper.frame} is {behind:.2g} s late"
                driver.context.event("warning", text, driver.stepper.frame, driver.stepper.t)
        while (left := self._left()) > 0.0 and driver.finish is None and driver.state == "running":
            driver.listen(min(left, PATIENCE))

    def _left(self) -> float:
        """Until the present frame is due [s]."""
        assert self._origin is not None
        return self._origin + self._driver.stepper.t + self._driver.paused_seconds - time.perf_counter()

    def told(self) -> dict[str, Any]:
        """For the report: frames in all and those that were late, and by how much the latest [s]."""
        return {"frames": self.frames, "late": self.late, "most": max(0.0, self.most)}
