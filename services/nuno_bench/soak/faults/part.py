"""Faults: what a run makes of services that are killed, and of a machine that fails it."""

from __future__ import annotations

from nuno_bench.report.result import Result
from nuno_bench.soak.faults import kills


def run(quick: bool, seed: int) -> list[Result]:
    """All faults."""
    return kills.run(quick, seed)
