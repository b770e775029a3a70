"""`nuno plan`: services, features left out and why, stable step, estimated cost."""

from __future__ import annotations

import argparse

from nuno.api.plan import describe, line_of
from nuno.cli.common import add_budget, add_scene, budget_of, load_scene
from nuno.process import attended
from nuno.simulation.solver_selection.budget import Budget


def plan_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    add_budget(parser)


def plan_command(args: argparse.Namespace) -> int:
    budget = budget_of(args)
    attended(lambda: _print(args, budget), budget.stop)
    return 0


def _print(args: argparse.Namespace, budget: Budget) -> None:
    for row in describe(load_scene(args), budget):
        print(line_of(row), flush=True)
