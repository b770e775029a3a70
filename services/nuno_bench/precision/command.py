"""`nuno bench precision SCENE...`: the error of every applicable solver over the wall time it takes."""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from nuno import registry
from nuno.choose.cloth import decide
from nuno.scene import scene_file
from nuno.scene.scene_file import Loaded
from nuno.viewer.require import require
from nuno.words import duration
from nuno_bench import machine, options
from nuno_bench.precision import page as shown
from nuno_bench.precision.errors import measure_errors
from nuno_bench.precision.findings import judge
from nuno_bench.precision.own import add_own
from nuno_bench.precision.page import CLOTH, DYE, Findings
from nuno_bench.precision.settings import choose_solvers
from nuno_bench.precision.sweep import Runner, run_sweep, start_sweep
from nuno_bench.problem.dye import DYE_OBSERVABLES, DyeProblem
from nuno_bench.problem.dye_reference import make_dye_reference
from nuno_bench.problem.horizon import DISTURBANCE, Horizon, find_horizon, whole_run
from nuno_bench.problem.observe import OBSERVABLES, Problem
from nuno_bench.problem.posing import AnyProblem, pose
from nuno_bench.problem.reference import Compared, make_reference
from nuno_bench.report import markdown, page, plots
from nuno_bench.sweep import kept
from nuno_schemas.errors import BadInput


def add_arguments(parser: argparse.ArgumentParser) -> None:
    options.add_shared(parser, "scenes", "--set", "--solvers", "--resume", "--out", "--rrd", "--docs")
    options.add_repeats(parser, 3, "timed runs of each point")
    budget = "for a scene's sweep; finer points that would exceed it are left out"
    options.add_seconds(parser, "--budget", 120.0, budget)
    parser.add_argument("--duration", metavar="TIME", help="simulated time, instead of the scene's")
    known = f"{', '.join(OBSERVABLES)}; of dye {', '.join(DYE_OBSERVABLES)}"
    parser.add_argument("--observable", metavar="A,B", help=f"what is plotted beside positions (default: all): {known}")


def main(args: argparse.Namespace) -> int:
    """Sweep each scene; 1 where a reference could judge nothing. A solver that diverges is a result."""
    failed, swept = False, list[Findings]()
    for one in _check(args):
        found = sweep_scene(one, args)
        swept.append(found)
        print(f"\n{shown.own_sentence(found)}")
        print(f"\n{one.scene.name}: {found.how}\npredictable: {found.horizon.describe()}")
        print(shown.choices(found).text())
        print(f"of the times: {found.about['load']}")
        print(shown.verdicts(found).text())
        print(f"{len(found.points)} points, {sum(not p.done for p in found.points)} of them failed; "
              f"{len(found.sweep.omitted)} left out")  # fmt: skip
        for file in write(_base(args, one), found):
            print(f"written {file}")
        if args.docs is not None:
            markdown.replace_section(args.docs, _section(one), shown.document(found))
            print(f"written {args.docs}")
        if all(judgement.verdict in ("failed", "no point") for judgement in judge(found.points, found.floors)):
            print(f"{one.scene.name}: the reference judges no point", file=sys.stderr)
            failed = True
    if args.rrd is not None:
        from nuno_bench.report import rerun

        print(f"written {rerun.write(args.rrd, 'nuno bench precision', shown.tabs(swept))}")
    return int(failed)


def write(base: Path, found: Findings) -> list[Path]:
    """Write the page, one CSV line per point and quantity, and everything as JSON, beside each other."""
    title, lead = f"Error over wall time: {found.scene}", shown.LEAD + found.kind.scales
    return page.write(base, title, lead, list(shown.sections(found)), shown.data(found), shown.lines(found))


def _section(loaded: Loaded) -> str:
    return f"precision {loaded.scene.name}"


def _base(args: argparse.Namespace, loaded: Loaded) -> Path:
    folder: Path = args.out
    return folder / f"precision-{loaded.scene.name}"


def _points(args: argparse.Namespace, loaded: Loaded) -> Path:
    return _base(args, loaded).with_suffix(".jsonl")


def _check(args: argparse.Namespace) -> list[Loaded]:
    """The scenes. Raises BadInput before anything runs."""
    plots.require_matplotlib()
    require(None, args.rrd, "--rrd")
    options.require_repeats(args.repeats)
    options.require_budget(args.budget)
    overrides = [*args.overrides, *([f"duration={args.duration}"] if args.duration else []), "allow_unstable=true"]
    loaded = [decide(scene_file.read(scene_file.find(name), overrides)) for name in args.scenes]
    dyed = {one.solver is None for one in loaded}
    solvers = [name for dye in dyed for name in registry.installed(DyeProblem.group if dye else Problem.group)]
    observables = [name for dye in dyed for name in (DYE_OBSERVABLES if dye else OBSERVABLES)]
    for field, given, known in (("--solvers", args.solvers, solvers), ("--observable", args.observable, observables)):
        options.require_known(options.names_of(given), known, field.removeprefix("--").removesuffix("s"), field)
        if given is not None and not options.names_of(given):
            raise BadInput("none is named: the sweep would be empty", field=field, value=given)
    names = [one.scene.name for one in loaded]
    if len(set(names)) < len(names):
        raise BadInput("two scenes have one name, and would write the same files", field="SCENE", value=names)
    for one in loaded:
        markdown.check_section(args.docs, _section(one))
    kept.check([_points(args, one) for one in loaded], args.resume)
    return loaded


def sweep_scene(loaded: Loaded, args: argparse.Namespace) -> Findings:
    """Reference, horizon and sweep of one scene. Raises BadInput."""

    def told(text: str) -> None:
        print(f"{loaded.scene.name}: {text}", file=sys.stderr)

    others = machine.Others()
    told(f"at most {duration(args.budget)} for the points, and as much for each run of the reference")
    problem = pose(loaded)
    solvers, omitted = choose_solvers(problem, options.names_of(args.solvers))
    solvers, own = add_own(problem, solvers)
    sweep = start_sweep(problem, solvers, told)
    sweep.omitted[:0] = omitted
    reference, horizon = _refer(problem, args.budget, told)
    scales = problem.scales(reference.run.series)
    floors = measure_errors(reference.check.series, reference.run.series, scales, horizon.frames)
    finished = kept.Kept(_points(args, loaded), identity(problem, reference, args.repeats), args.resume)
    runner = Runner(problem, reference, scales, horizon.frames, args.repeats)
    with kept.hint(finished.path):
        run_sweep(sweep, runner, solvers, finished, args.budget, told)
    kind = DYE if isinstance(problem, DyeProblem) else CLOTH
    wanted = [name for name in options.names_of(args.observable) or kind.titles if name != kind.leading]
    disturbed = "" if horizon.fades else f"; disturbance {DISTURBANCE:g} of the size"
    about = machine.about(
        others,
        scene=f"{problem.describe()}, {problem.frames} frames, {problem.frames * problem.frame:.3g} s",
        reference=f"{reference.how}; {reference.seconds:.2g} s for both{disturbed}",
    )
    return Findings(loaded.scene.name, sweep, floors, horizon, reference.how, wanted, about, problem.frame, own, kind)


def _refer(problem: AnyProblem, budget: float, told: Callable[[str], None]) -> tuple[Compared, Horizon]:
    """The reference, each run of which may take `budget` [s], and how long it can be predicted. Raises BadInput."""
    if isinstance(problem, DyeProblem):
        of_dye = make_dye_reference(problem, budget, told)
        return of_dye, whole_run(of_dye)
    reference = make_reference(problem, budget, told)
    told("predictable time: the disturbed twin")
    return reference, find_horizon(problem, reference)


def identity(problem: AnyProblem, reference: Compared, repeats: int) -> dict[str, Any]:
    """What a sweep's points belong to: the scene's own text, what its reference ends in, and the installed code."""
    text = json.dumps(problem.loaded.data, sort_keys=True, default=str)
    end = np.ascontiguousarray(reference.run.series.x[-1])
    packages = {registry.package_version(problem.group, name) for name in registry.installed(problem.group)}
    return {
        "scene": hashlib.blake2b(text.encode(), digest_size=16).hexdigest(),
        "reference": hashlib.blake2b(end.data, digest_size=16).hexdigest(),
        "repeats": repeats,
        "solvers": ", ".join(sorted(packages)),
    }
