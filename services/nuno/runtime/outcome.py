"""The outcome of a run: its state at the end, and its problem in words."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from nuno.process import SIGNALS
from nuno.recording.reader import Recording
from nuno.recording.writer import part_of
from nuno.runtime import intersections
from nuno.runtime.plan import Plan
from nuno_schemas.errors import BadInput


@dataclass
class Outcome:
    """State of a run at its end, and the reports of its services."""

    run: str
    state: str
    """done, stopped, interrupted, terminated, diverged, unconverged or failed"""
    error: str
    plan: Plan
    summary: dict[str, Any]
    services: dict[str, dict[str, Any]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def problem(self) -> str:
        """The problem of the run in words; empty if there is none."""
        if self.state in ("done", "stopped"):
            return intersections.problem(self.services.get("collision", {}).get("cloth_contact"))
        if self.state in SIGNALS:
            return f"{self.state} by {SIGNALS[self.state]} before its end"
        return f"{self.state}: {self.error or self.summary.get('message') or 'positions are no longer finite'}"

    def recording(self, target: Path) -> Path | None:
        """Return the run's recording, finished or not; None without one. The recorder names it, unless it has died."""
        file = self.services.get("recorder", {}).get("file")
        for path in (Path(file),) if file else (part_of(target), target):
            with suppress(BadInput), Recording(path, scan=False) as recording:
                if recording.metadata["run"].get("id") == self.run:
                    return path
        return None
