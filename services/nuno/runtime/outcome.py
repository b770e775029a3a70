"""The outcome of a run: its state at the end, and its problem in words."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from nuno.process import SIGNALS
from nuno.runtime import intersections
from nuno.runtime.plan import Plan


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
