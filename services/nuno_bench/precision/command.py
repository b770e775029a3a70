"""`nuno bench precision SCENE...`: the error of every applicable solver over the wall time it takes."""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from nuno import registry
from nuno.scene import scene_file
from nuno.scene.choose import decide
from nuno.scene.scene_file import Loaded
from nuno.viewer.require import require
from nuno.words import duration
from nuno_bench import machine, options
from nuno_bench.precision.errors import find_scales, measure_errors
from nuno_bench.precision.findings import judge
from nuno_bench.precision.own import add_own
from nuno_bench.precision.page import CLOTH, DYE, Findings, choices, docs_parts, docs_picture, own_sentence, render
from nuno_bench.precision.point import Kept, Point
from nuno_bench.precision.settings import choose_solvers
from nuno_bench.precision.sweep import Runner, run_sweep, start_sweep
from nuno_bench.precision.untimed import run_untimed
from nuno_bench.problem.dye import DYE_OBSERVABLES, DyeProblem
from nuno_bench.problem.dye_reference import make_dye_reference
from nuno_bench.problem.horizon import DISTURBANCE, Horizon, find_horizon, whole_run
from nuno_bench.problem.observe import OBSERVABLES, Problem
from nuno_bench.problem.posing import AnyProblem, pose
from nuno_bench.problem.reference import Compared, make_reference
from nuno_bench.report import markdown, plots
from nuno_bench.report.result import text_table
from nuno_bench.sweep import executor
from nuno_bench.sweep.executor import Executor, Here
from nuno_bench.sweep.kept import hint, require_place
from nuno_bench.sweep.kept import require as require_any
from nuno_bench.sweep.packed import pack
from nuno_schemas.errors import BadInput


def add_arguments(parser: argparse.ArgumentParser) -> None:
    options.add_shared(parser, "scenes", "--set", "--solvers", "--resume", "--out", "--rrd", "--docs")
    options.add_repeats(parser, 3, "timed runs of each point")
    budget = "for a scene's sweep; finer points that would exceed it are left out"
    options.add_seconds(parser, "--budget", 120.0, budget)
    parser.add_argument("--duration", metavar="TIME", help="simulated time, instead of the scene's")
    known = f"{', '.join(OBSERVABLES)}; of dye {', '.join(DYE_OBSERVABLES)}"
    parser.add_argument("--observable", metavar="A,B", help=f"what is plotted beside positions (default: all): {known}")
    executor.add_arguments(parser)


def main(args: argparse.Namespace) -> int:
    """Sweep each scene; 1 where a reference could judge nothing. A solver that diverges is a result."""
    loaded = _check(args)
    with executor.opened(args) as where:
        return _sweep_all(loaded, args, where)


def _sweep_all(loaded: Sequence[Loaded], args: argparse.Namespace, where: Executor) -> int:
    failed, swept = False, list[Findings]()
    for one in loaded:
        found = sweep_scene(one, args, where)
        swept.append(found)
        headings, rows = choices(found)
        print(f"\n{own_sentence(found)}")
        print(f"\n{one.scene.name}: {found.how}\npredictable: {found.horizon.describe()}")
        print(text_table(headings, rows))
        print(f"of the times: {found.about['load']}")
        judged = judge(found.points, found.floors)
        for judgement in judged:
            print(judgement.describe())
        print(f"{len(found.points)} points, {sum(not p.done for p in found.points)} of them failed; "
              f"{len(found.sweep.omitted)} left out")  # fmt: skip
        for file in write(_base(args, one), found):
            print(f"written {file}")
        if args.docs is not None:
            picture = args.docs.parent / "pictures" / f"precision-{found.scene}.svg"
            picture.parent.mkdir(exist_ok=True)
            picture.write_text(docs_picture(found), encoding="utf-8")
            markdown.replace_section(args.docs, _section(one), docs_parts(found, f"pictures/{picture.name}"))
            print(f"written {args.docs}")
        if all(judgement.verdict in ("failed", "no point") for judgement in judged):
            print(f"{one.scene.name}: the reference judges no point", file=sys.stderr)
            failed = True
    if args.rrd is not None:
        from nuno_bench.precision import rerun

        print(f"written {rerun.write(args.rrd, swept)}")
    return int(failed)


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
    executor.check(args)
    require(None, args.rrd, "--rrd")
    options.require_repeats(args.repeats)
    if not (args.budget > 0.0 and math.isfinite(args.budget)):
        raise BadInput("a sweep needs time", field="--budget", value=args.budget, limit="more than 0 s")
    overrides = [*args.overrides, *([f"duration={args.duration}"] if args.duration else [])]
    loaded = [
        decide(scene_file.read(scene_file.find(name), [*overrides, "allow_unstable=true"])) for name in args.scenes
    ]
    dyed = {one.solver is None for one in loaded}
    solvers = [name for dye in dyed for name in registry.installed(DyeProblem.group if dye else Problem.group)]
    observables = [name for dye in dyed for name in (DYE_OBSERVABLES if dye else OBSERVABLES)]
    for option, given, known in (
        ("solver", args.solvers, solvers),
        ("observable", args.observable, observables),
    ):
        field = f"--{option}" if option == "observable" else "--solvers"
        options.require_known(options.names_of(given), known, option, field)
        if given is not None and not options.names_of(given):
            raise BadInput("none is named: the sweep would be empty", field=field, value=given)
    names = [one.scene.name for one in loaded]
    if len(set(names)) < len(names):
        raise BadInput("two scenes have one name, and would write the same files", field="SCENE", value=names)
    for one in loaded:
        if args.docs is not None:
            markdown.check_section(args.docs, _section(one))
    if args.resume:
        require_any([_points(args, one) for one in loaded])
    for one in loaded:
        require_place(_points(args, one))
    return loaded


def sweep_scene(loaded: Loaded, args: argparse.Namespace, where: Executor) -> Findings:
    """Reference, horizon and sweep of one scene. Raises BadInput."""
    others, told = machine.Others(), _teller(loaded.scene.name)
    told(f"at most {duration(args.budget)} for the points, and as much for each run of the reference")
    problem = pose(loaded)
    solvers, omitted = choose_solvers(problem, options.names_of(args.solvers))
    solvers, own = add_own(problem, solvers)
    sweep = start_sweep(problem, solvers, told)
    sweep.omitted[:0] = omitted
    reference, horizon = _refer(problem, args.budget, told)
    scales = find_scales(problem, reference.run.series)
    floors = measure_errors(reference.check.series, reference.run.series, scales, horizon.frames)
    kept = Kept(_points(args, loaded), identity(problem, reference, args.repeats), args.resume)
    runner = Runner(problem, reference, scales, horizon.frames, args.repeats)
    with hint(kept.path):
        run_sweep(sweep, runner, solvers, kept, args.budget, told)
        if not isinstance(where, Here):
            run_untimed(sweep, runner, pack(loaded.path, loaded.overrides), kept, args.budget, where, told)
    kind = DYE if isinstance(problem, DyeProblem) else CLOTH
    shown = [
        name for name in options.names_of(args.observable) or kind.titles if name in floors and name != kind.leading
    ]
    disturbed = "" if horizon.fades else f"; disturbance {DISTURBANCE:g} of the size"
    about = {
        "command": machine.command(),
        "scene": f"{problem.describe()}, {problem.frames} frames, {problem.frames * problem.frame:.3g} s",
        "reference": f"{reference.how}; {reference.seconds:.2g} s for both{disturbed}",
        **machine.describe(),
        "load": others.describe(),
    }
    return Findings(loaded.scene.name, sweep, floors, horizon, reference.how, shown, about, problem.frame, own, kind)


def _refer(problem: AnyProblem, budget: float, told: Callable[[str], None]) -> tuple[Compared, Horizon]:
    """The reference, each run of which may take `budget` [s], and how long it can be predicted. Raises BadInput."""
    if isinstance(problem, DyeProblem):
        of_dye = make_dye_reference(problem, budget, told)
        return of_dye, whole_run(of_dye)
    reference = make_reference(problem, budget, told)
    told("predictable time: the disturbed twin")
    return reference, find_horizon(problem, reference)


def _teller(scene: str) -> Callable[[str], None]:
    return lambda text: print(f"{scene}: {text}", file=sys.stderr)


def identity(problem: AnyProblem, reference: Compared, repeats: int) -> dict[str, Any]:
    """What a sweep's points belong to: the scene's own text, what its reference ends in, and the installed code."""
    text = json.dumps(problem.loaded.data, sort_keys=True, default=str)
    end = hashlib.blake2b(np.ascontiguousarray(reference.run.series.x[-1]).data, digest_size=16)
    packages = {registry.package_version(problem.group, name) for name in registry.installed(problem.group)}
    return {
        "scene": hashlib.blake2b(text.encode(), digest_size=16).hexdigest(),
        "reference": end.hexdigest(),
        "repeats": repeats,
        "solvers": ", ".join(sorted(packages)),
    }


def write(base: Path, found: Findings) -> list[Path]:
    """Write the page, one CSV line per point and quantity, and everything as JSON, beside each other."""
    base.parent.mkdir(parents=True, exist_ok=True)
    html, table, data = (base.with_name(base.name + ending) for ending in (".html", ".csv", ".json"))
    html.write_text(render(found), encoding="utf-8")
    with table.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["solver", "setting", "outcome", "seconds", "quantity", "final", "l2", "linf"])
        writer.writerows(line for point in found.points for line in _csv_lines(point))
    data.write_text(json.dumps(_json(found), indent=1) + "\n", encoding="utf-8")
    return [html, table, data]


def _csv_lines(point: Point) -> list[list[object]]:
    start = [point.solver, point.setting, point.outcome, f"{point.median:.6g}" if point.seconds else ""]
    errors = [[name, *(f"{v:.9g}" for v in (e.final, e.l2, e.linf))] for name, e in point.errors.items()]
    return [[*start, *rest] for rest in errors or [[""] * 4]]


def _json(found: Findings) -> dict[str, Any]:
    horizon = {"t": found.horizon.t, "whole": found.horizon.whole, "growth": found.horizon.growth}
    return {
        "about": dict(found.about),
        "scene": found.scene,
        "reference": {"how": found.how, "floors": {name: asdict(floor) for name, floor in found.floors.items()}},
        "horizon": horizon | {"frames": found.horizon.frames, "distance": found.horizon.distance.tolist()},
        "points": [asdict(point) for point in found.points],
        "own": asdict(found.own) | {"said": own_sentence(found)},
        "omitted": [asdict(one) for one in found.sweep.omitted],
        "first_calls": found.sweep.first_calls,
    }
