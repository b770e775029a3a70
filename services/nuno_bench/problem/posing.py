"""A scene as a problem for solvers: moving cloth, or dye."""

from __future__ import annotations

from nuno.scene.scene_file import Loaded
from nuno_bench.problem.dye import DyeProblem, make_dye_problem
from nuno_bench.problem.observe import Problem, make_problem

AnyProblem = Problem | DyeProblem


def pose(loaded: Loaded, threads: int = 0) -> AnyProblem:
    """Dye where nothing moves, else cloth; `threads` (0: all cores) step it, to the same bits. Raises BadInput."""
    return make_dye_problem(loaded, threads) if loaded.solver is None else make_problem(loaded, threads)
