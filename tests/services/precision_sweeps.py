"""Precision sweeps for tests, as the command makes them."""

from __future__ import annotations

import argparse
from pathlib import Path

from nuno_bench.precision import command as precision
from nuno_bench.precision.command import Findings
from nuno_bench.precision.sweep import SolverPoint

FLAGS = ("--repeats", "1", "--budget", "600")


def arguments(path: Path, *flags: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    precision.precision_arguments(parser)
    return parser.parse_args([str(path), *FLAGS, "--out", str(path.parent / "out"), *flags])


def swept(path: Path, *flags: str) -> Findings:
    args = arguments(path, *flags)
    return precision.sweep_scene(precision._check(args)[0], args)


def points_of(found: Findings, solver: str) -> list[SolverPoint]:
    return [point for point in found.points if point.solver == solver]
