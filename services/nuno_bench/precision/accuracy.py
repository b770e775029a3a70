"""`nuno bench accuracy`: whether `accuracy: preview | normal | reference` delivers the error that it promises.

Each scene of cloth is run by the solver and the step that are chosen for it, and compared with a converged run as long
as a disturbance has grown no more than a thousandfold, which is how far the promise goes. Dye is compared with closed
forms (nuno_bench.precision.accuracy_dye).
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from nuno.scene import scene_file
from nuno.scene.choose import PROMISE, decide
from nuno.scene.trials import GROWTH
from nuno_bench import machine, options
from nuno_bench.precision.accuracy_dye import CASES, FRAMES, LENGTHS, measure_case, measure_dye
from nuno_bench.precision.delivered import HEADINGS, WITHIN, Delivered
from nuno_bench.problem.horizon import DISTURBANCE, disturb
from nuno_bench.problem.observe import Problem, Run, make_problem, simulate
from nuno_bench.problem.random_scenes import random_scene
from nuno_bench.problem.reference import Reference, make_reference
from nuno_bench.report import markdown, page
from nuno_bench.report.page import Facts, Table
from nuno_schemas.errors import BadInput
from nuno_schemas.solver import Accuracy

SCENES = (
    "hanging-sheet", "net", "drape-over-sphere", "skirt-hula", "skirt-paper", "skirt-walk", "stiff-sheet",
    "extreme/mass-ratio", "extreme/far-away", "extreme/millimetres",
)  # fmt: skip
"""Shipped scenes in which something moves, by name or path below scenes/."""
CAPTION = (
    "Of cloth, root mean square distance to a converged run as a share of its size, up to the time given; of dye, "
    "largest distance of any cell's amount to the exact one, as a share of the largest amount."
)
SCENES_HELP = f"a scene, or dye of closed form: {', '.join(CASES)}; default: ten shipped scenes, random ones, and these"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=SCENES_HELP)
    parser.add_argument("--random", type=int, default=3, metavar="N", help="scenes made at random (default: 3)")
    parser.add_argument("--first", type=int, default=1, metavar="SEED", help="seed of the first of them (default: 1)")
    parser.add_argument("--duration", default="0.3 s", help="of each scene (default: %(default)s)")
    parser.add_argument("--levels", default=",".join(PROMISE), metavar="A,B", help="default: %(default)s")
    options.add_seconds(parser, "--budget", 60.0, "for a run of the reference")
    options.add_shared(parser, "--out", "--docs")


def main(args: argparse.Namespace) -> int:
    """The table of all scenes and levels; 1 where an error is more than may be delivered."""
    levels = options.names_of(args.levels)
    options.require_known(levels, PROMISE, "level", "--levels")
    if not levels or (not args.scenes and args.random < 0) or not args.budget > 0.0:
        raise BadInput("nothing to measure", remedy="name a level and a scene, and a budget of more than 0 s")
    markdown.check_section(args.docs, "accuracy")
    others, found = machine.Others(), list[Delivered]()
    with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
        for path in _paths(args, Path(folder)):
            found += _scene(path, args.duration, levels, args.budget)
        for name in CASES if not args.scenes else [name for name in args.scenes if name in CASES]:
            for length in LENGTHS:
                found += measure_case(name, length, FRAMES, levels, Path(folder))
    kept = sum(one.verdict == "agrees" for one in found)
    summary = f"{kept} of {len(found)} within what was promised, of cloth within {WITHIN:g} times of it"
    table, about = Table(HEADINGS, [one.row() for one in found], CAPTION), machine.about(others)
    print(table.text())
    print(summary)
    reasons = Table(("scene", "accuracy", "reason"), [[one.scene, one.accuracy, one.why] for one in found],
                    "What was tried.", prose=True)  # fmt: skip
    sections: page.Sections = [
        ("", [summary + ".", table]),
        ("Why", [reasons]),
        ("Made by", [Facts(about)]),
    ]
    data = {"about": about, "results": [asdict(one) | {"verdict": one.verdict} for one in found]}
    lead = "What the solver and the step that are chosen for a scene deliver, against what the level promises."
    for file in page.write(args.out / "accuracy", "Accuracy promised and delivered", lead, sections, data, table):
        print(f"written {file}")
    if args.docs is not None:
        markdown.replace_section(args.docs, "accuracy", [f"{summary}.", table, Facts(about)])
    return int(kept < len(found))


def _paths(args: argparse.Namespace, folder: Path) -> list[Path]:
    shipped = scene_file.find("hanging-sheet").parent
    paths = [scene_file.find(name) for name in args.scenes if name not in CASES]
    if not args.scenes:
        paths = [shipped / f"{name}.yaml" for name in SCENES]
        for seed in range(args.first, args.first + args.random):
            paths.append(folder / f"random-{seed}.yaml")
            paths[-1].write_text(json.dumps(random_scene(seed)))
    return paths


def _scene(path: Path, duration: str, levels: Sequence[str], budget: float) -> list[Delivered]:
    """All levels of a scene against one reference. Raises BadInput where there is none."""
    if scene_file.read(path).solver is None:
        return measure_dye(path, duration, levels, budget)
    chosen = ["solver=auto", f"duration={duration}"]
    problem = make_problem(scene_file.read(path, chosen))
    name = problem.loaded.scene.name
    reference = make_reference(problem, budget, lambda text: print(f"{name}: {text}", file=sys.stderr))
    frames = promised_frames(problem, reference)
    return [_level(problem, reference, frames, path, [*chosen, f"accuracy={level}"]) for level in levels]


def promised_frames(problem: Problem, reference: Reference) -> int:
    """Frames, the start among them, until a disturbance has grown more than the promise allows for; two at least."""
    twin, exact = reference.twin(disturb(problem)).series.x, reference.run.series.x
    apart = np.sqrt(((twin - exact[: len(twin)]) ** 2).sum(axis=2).mean(axis=1)) / problem.size
    lost = np.flatnonzero(~(apart <= GROWTH * DISTURBANCE))
    return max(2, int(lost[0])) if lost.size else len(apart)


def _level(problem: Problem, reference: Reference, frames: int, path: Path, overrides: Sequence[str]) -> Delivered:
    decided = decide(scene_file.read(path, overrides))
    accuracy: Accuracy = next(level for level in PROMISE if f"accuracy={level}" in overrides)
    solver, integrator = decided.scene.solver, decided.integrator
    assert solver.dt != "auto"
    steps = round(problem.frame / float(solver.dt))
    simulate(problem, integrator.plugin, integrator.config, steps)  # compiles
    run = simulate(problem, integrator.plugin, integrator.config, steps)
    error, floor = (_apart(problem, one, reference.run, frames) for one in (run, reference.check))
    promise, until = PROMISE[accuracy], (frames - 1) * problem.frame
    name = problem.loaded.scene.name
    return Delivered(name, accuracy, integrator.name, steps, promise, error, floor, until, run.seconds, decided.why)


def _apart(problem: Problem, run: Run, exact: Run, frames: int) -> float:
    """Root mean square over vertices and frames after the start [sizes]."""
    if run.status != "ok":
        return math.nan
    difference = run.series.x[1:frames] - exact.series.x[1:frames]
    return float(np.sqrt((difference**2).sum(axis=2).mean())) / problem.size
