"""`nuno bench precision SCENE...`: the error of every applicable solver over the wall time it takes."""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Collection
from functools import partial

from nuno import registry
from nuno.formatting import duration
from nuno.scene import scene_file, shipped
from nuno.scene.scene_file import Loaded
from nuno.solver_selection.cloth import decide
from nuno.viewer.require import require as require_viewer
from nuno_bench import machine, options
from nuno_bench.precision import page as shown
from nuno_bench.precision.page import Findings
from nuno_bench.precision.point import judge, measure_errors
from nuno_bench.precision.settings import add_own, choose_solvers
from nuno_bench.precision.sweep import Runner, run_sweep, start_sweep
from nuno_bench.problem.dye import DyeProblem, pose
from nuno_bench.problem.observe import Problem
from nuno_bench.problem.reference import DISTURBANCE, refer
from nuno_bench.report import page, plots
from nuno_bench.sweep.executor import versions
from nuno_bench.sweep.storage import Kept, require_kept
from nuno_schemas.errors import BadInput


def add_arguments(parser: argparse.ArgumentParser) -> None:
    options.add_shared(parser, "scenes", "--set", "--solvers", "--resume", "--out", "--rrd", "--docs")
    options.add_count(parser, "--repeats", "timed runs of each point (default: %(default)s)", 3)
    budget = "for a scene's sweep; finer points that would exceed it are left out"
    options.add_seconds(parser, "--budget", 120.0, budget)
    parser.add_argument("--duration", metavar="TIME", help="simulated time, instead of the scene's")
    known = f"{', '.join(Problem.observables)}; of dye {', '.join(DyeProblem.observables)}"
    parser.add_argument("--observable", metavar="A,B", help=f"what is plotted beside positions (default: all): {known}")


def main(args: argparse.Namespace) -> int:
    """Sweep each scene; 1 where a reference could judge nothing. A solver that diverges is a result."""
    failed, tabs = False, dict[str, list[plots.Panel]]()
    for one in _check(args):
        found, name = sweep_scene(one, args), one.scene.name
        print(f"\n{found.own_sentence}")
        print(f"\n{name}: {found.how}\npredictable: {found.horizon.describe()}")
        print(shown.choices(found).text())
        print(f"of the times: {found.about['load']}")
        print(shown.verdicts(found).text())
        print(f"{len(found.points)} points, {sum(not p.done for p in found.points)} of them failed; "
              f"{len(found.sweep.omitted)} left out")  # fmt: skip
        shown.report(found).write_beside(args.out / f"precision-{name}", args.docs, f"precision {name}")
        tabs |= shown.tabs(found)
        if all(judgement.verdict in ("failed", "no point") for judgement in judge(found.points, found.floors)):
            print(f"{name}: the reference judges no point", file=sys.stderr)
            failed = True
    if args.rrd is not None:
        from nuno_bench.report import rerun

        rerun.write(args.rrd, "nuno bench precision", tabs)
    return int(failed)


def _check(args: argparse.Namespace) -> list[Loaded]:
    """The scenes. Raises BadInput before anything runs."""
    plots.require_matplotlib()
    require_viewer(None, args.rrd, "--rrd")
    overrides = [*args.overrides, *([f"duration={args.duration}"] if args.duration else []), "allow_unstable=true"]
    loaded = [decide(scene_file.read(shipped.find(name), overrides)) for name in args.scenes]
    kinds = {DyeProblem if one.solver is None else Problem for one in loaded}
    solvers = [list(registry.installed(kind.group)) for kind in kinds]
    observables = [list(kind.observables) for kind in kinds]
    for field, given, each in (("--solvers", args.solvers, solvers), ("--observable", args.observable, observables)):
        wanted, known = options.names_of(given), [name for names in each for name in names]
        options.require_known(wanted, known, field.removeprefix("--").removesuffix("s"), field)
        if given is not None and not wanted:
            raise BadInput("none is named: the sweep would be empty", field=field, value=given)
        if wanted and not all(set(wanted) & set(names) for names in each):
            remedy = "name some of both, or give scenes of cloth and scenes of dye by turns"
            raise BadInput("one of the scenes has none of these", field=field, value=given, remedy=remedy)
    names = [one.scene.name for one in loaded]
    if len(set(names)) < len(names):
        raise BadInput("two scenes have one name, and would write the same files", field="SCENE", value=names)
    for name in names:
        page.check_section(args.docs, f"precision {name}")
    if args.resume:
        require_kept([args.out / f"precision-{name}.jsonl" for name in names])
    return loaded


def _own(text: str | None, known: Collection[str]) -> list[str]:
    """What is named and known: of scenes of cloth and of dye each has its own."""
    return [name for name in options.names_of(text) if name in known]


def sweep_scene(loaded: Loaded, args: argparse.Namespace) -> Findings:
    """Reference, horizon and sweep of one scene. Raises BadInput."""
    say = partial(print, f"{loaded.scene.name}:", file=sys.stderr)
    others, path = machine.Others(), args.out / f"precision-{loaded.scene.name}.jsonl"
    digest = hashlib.blake2b(json.dumps(loaded.data, sort_keys=True, default=str).encode(), digest_size=16).hexdigest()
    kept = Kept(path, {"scene": digest, "repeats": args.repeats, "versions": versions()}, args.resume, say)
    say(f"at most {duration(args.budget)} for the points, and as much for each run of the reference; --resume goes on "
         f"from {path}")  # fmt: skip
    problem = pose(loaded)
    solvers, omitted = choose_solvers(problem, _own(args.solvers, registry.installed(problem.group)))
    solvers, own = add_own(problem, solvers)
    sweep = start_sweep(problem, solvers, say)
    sweep.omitted[:0] = omitted
    reference, horizon = refer(problem, args.budget, say)
    scales = problem.scales(reference.run.series)
    floors = measure_errors(reference.check.series, reference.run.series, scales, horizon.frames)
    runner = Runner(problem, reference, scales, horizon.frames, args.repeats)
    with kept:
        run_sweep(sweep, runner, solvers, kept, args.budget, say)
    disturbed = "" if horizon.fades else f"; disturbance {DISTURBANCE:g} of the size"
    about = machine.about(
        others,
        scene=f"{problem.describe()}, {problem.frames} frames, {problem.frames * problem.frame:.3g} s",
        reference=f"{reference.how}; {reference.seconds:.2g} s for both{disturbed}",
    )
    shown = _own(args.observable, problem.observables)
    return Findings(problem, sweep, floors, horizon, reference.how, about, own, shown)
