"""`nuno bench accuracy`: whether `accuracy: preview | normal | reference` delivers the error that it promises.

Each scene is run by the solver and the step that are chosen for it, and compared with a converged run: cloth as long as
a disturbance has grown no more than a thousandfold, which is how far the promise goes, and dye to the end. That is the
choice of `solver: auto`, whatever solver a scene names, or the step alone of a solver that is named here.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from nuno.dye.run import DyeRun
from nuno.scene import scene_file, shipped
from nuno.simulation.solver_selection.cloth import decide
from nuno.simulation.solver_selection.trials import GROWTH, PROMISE
from nuno_bench import machine, options
from nuno_bench.piles import random_scene
from nuno_bench.precision.sweep import measure_errors
from nuno_bench.problem import AnyProblem, DyeProblem, Run, pose
from nuno_bench.reference import DISTURBANCE, Horizon, ReferenceRuns, refer
from nuno_bench.report import page
from nuno_bench.report.page import Report, Table
from nuno_schemas.errors import BadInput
from nuno_schemas.parts import Accuracy

SCENES = (
    "hanging-sheet", "net", "drape-over-sphere", "skirt-hula", "skirt-paper", "skirt-walk", "stiff-sheet",
    "extreme/mass-ratio", "extreme/far-away", "extreme/millimetres",
)  # fmt: skip
"""Shipped scenes in which something moves, by name or path below scenes/."""
WITHIN = 3.0
"""How many times the promised error may be delivered of cloth, where the error of a whole scene is judged by its
beginning."""
HEADINGS = ("scene", "accuracy", "solver", "steps a frame", "promised", "delivered", "until [s]", "time [s]", "verdict")
CAPTION = (
    "Of cloth, root mean square distance to a converged run as a share of its size, up to the time given; of dye, "
    "largest distance of any cell's amount to the exact one, as a share of the largest amount."
)


@dataclass(frozen=True)
class DeliveredAccuracy:
    """One scene at one level: promise and error, up to the time that the promise goes, and what it took.

    Both are shares of the cloth's size, or of the largest amount of dye. floor is what the reference itself is known
    to; error is nan where the run failed; `within` is how many times the promise it may be.
    """

    scene: str
    accuracy: Accuracy
    solver: str
    steps: int
    promised: float
    error: float
    floor: float
    until: float
    seconds: float
    why: str
    within: float

    @property
    def verdict(self) -> str:
        if self.error <= self.within * self.promised:
            return "agrees"
        return "failed" if not self.error <= 3.0 * self.floor else "failed: not known, the reference is no better"

    def row(self) -> list[str]:
        """Return the texts under HEADINGS."""
        return [self.scene, self.accuracy, self.solver, str(self.steps), f"{self.promised:g}", f"{self.error:.2g}",
                f"{self.until:.3g}", f"{self.seconds:.3g}", self.verdict]  # fmt: skip


def accuracy_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help="default: ten shipped scenes, and random ones")
    named = "of this solver the step alone is chosen (default: auto, whatever a scene names: the solver, too)"
    parser.add_argument("--solver", default="auto", metavar="NAME", help=named)
    parser.add_argument("--random", type=int, default=3, metavar="N", help="scenes made at random (default: 3)")
    parser.add_argument("--duration", default="0.3 s", help="of each scene (default: %(default)s)")
    parser.add_argument("--levels", default=",".join(PROMISE), metavar="A,B", help="default: %(default)s")
    options.add_seconds(parser, "--budget", 60.0, "for a run of the reference")
    options.add_shared(parser, "--out", "--docs")


def accuracy_command(args: argparse.Namespace) -> int:
    """The table of all scenes and levels; 1 where an error is more than may be delivered."""
    levels = options.names_of(args.levels)
    options.require_known(levels, PROMISE, "level", "--levels")
    if not levels or (not args.scenes and args.random < 0):
        raise BadInput("nothing to measure", remedy="name a level and a scene")
    page.check_section(args.docs, "accuracy")
    others, found = machine.OtherLoad(), list[DeliveredAccuracy]()
    with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
        for path in _paths(args, Path(folder)):
            found += measure_scene(path, args.duration, levels, args.budget, args.solver)
    kept = sum(one.verdict == "agrees" for one in found)
    summary = f"{kept} of {len(found)} within what was promised, of cloth within {WITHIN:g} times of it"
    table = Table(HEADINGS, [one.row() for one in found], CAPTION)
    print(table.text())
    print(summary)
    reasons = Table(("scene", "accuracy", "reason"), [[one.scene, one.accuracy, one.why] for one in found],
                    "What was tried.", prose=True)  # fmt: skip
    data = {"results": [vars(one) | {"verdict": one.verdict} for one in found]}
    lead = "What the solver and the step that are chosen for a scene deliver, against what the level promises."
    sections: page.Sections = [("", [summary + ".", table]), ("Why", [reasons])]
    about, rows = machine.about(others), [dict(zip(HEADINGS, row, strict=True)) for row in table.rows]
    report = Report("Accuracy promised and delivered", lead, sections, about, data, sections[0][1], rows)
    report.write_beside(args.out / "accuracy", args.docs, "accuracy")
    return int(kept < len(found))


def _paths(args: argparse.Namespace, folder: Path) -> list[Path]:
    paths = [shipped.find(name) for name in args.scenes]
    if not args.scenes:
        paths = [shipped.folder() / f"{name}.yaml" for name in SCENES]
        for seed in range(1, args.random + 1):
            paths.append(folder / f"random-{seed}.yaml")
            paths[-1].write_text(json.dumps(random_scene(seed)))
    return paths


def measure_scene(
    path: Path, duration: str, levels: Sequence[str], budget: float, solver: str = "auto"
) -> list[DeliveredAccuracy]:
    """All levels of a scene against one reference. Raises BadInput where there is none."""
    dyed = scene_file.read(path).solver is None
    chosen = [f"dye.solver={solver}" if dyed else f"solver={solver}", f"duration={duration}"]
    problem = pose(scene_file.read(path, chosen))
    say = partial(print, f"{problem.loaded.scene.name}:", file=sys.stderr)
    compared, horizon = refer(problem, budget, say)
    frames = promised_frames(horizon)
    return [_level(problem, compared, frames, path, [*chosen, f"accuracy={level}"]) for level in levels]


def promised_frames(horizon: Horizon) -> int:
    """Frames, the start among them, until a disturbance has grown more than the promise allows for; two at least."""
    lost = np.flatnonzero(~(horizon.distance <= GROWTH * DISTURBANCE))
    return max(2, int(lost[0])) if lost.size else len(horizon.distance)


def _level(
    problem: AnyProblem, reference: ReferenceRuns, frames: int, path: Path, overrides: Sequence[str]
) -> DeliveredAccuracy:
    decided = decide(scene_file.read(path, overrides))
    accuracy: Accuracy = next(level for level in PROMISE if f"accuracy={level}" in overrides)
    if decided.dye is not None and isinstance(problem, DyeProblem):
        promise, within, solver, steps = PROMISE[accuracy], 1.0, decided.dye.solver, DyeRun(decided, 1).steps
        name, plugin, config = solver.name, solver.plugin, solver.config
    else:
        promise, within, chosen, dt = PROMISE[accuracy], WITHIN, decided.integrator, decided.scene.solver.dt
        assert dt != "auto"
        name, plugin, config, steps = chosen.name, chosen.plugin, chosen.config, round(problem.frame / float(dt))
    problem.run(plugin, config, steps)  # compiles
    run = problem.run(plugin, config, steps)
    error, floor = (_apart(problem, one, reference.run, frames) for one in (run, reference.check))
    until = (frames - 1) * problem.frame
    scene, why = problem.loaded.scene.name, decided.why
    return DeliveredAccuracy(
        scene, accuracy, name, steps, promise, error, floor, until, run.seconds, why, within
    )  # fmt: skip


def _apart(problem: AnyProblem, run: Run, exact: Run, frames: int) -> float:
    """The error after the start, as CAPTION says; nan of a run that failed."""
    if run.status != "ok":
        return math.nan
    if isinstance(problem, DyeProblem):
        difference = run.series.x[1:frames] - exact.series.x[1:frames]
        return float(np.abs(difference).max() / np.abs(exact.series.x[1:]).max())
    return measure_errors(run.series, exact.series, problem.scales(exact.series), frames)[problem.leading].l2
