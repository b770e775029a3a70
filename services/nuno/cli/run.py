"""`nuno run`, and what comes before it: `nuno new` and `nuno plan`."""

from __future__ import annotations

import argparse
import contextlib
import shlex
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from nuno.cli.common import add_budget, add_config, add_flags, add_scene, budget_of, compilation_notice, load_scene
from nuno.process import attended, ending_at_once
from nuno.python_api.plan import describe, keep_up, line_of
from nuno.python_api.progress import ProgressLine
from nuno.recording.writer import check_target, part_of
from nuno.report.run_report import make_report, row, show_report
from nuno.runtime import log, runs, supervisor
from nuno.runtime.outcome import Outcome
from nuno.runtime.service import Options
from nuno.runtime.supervisor import Deployment
from nuno.scene import shipped
from nuno.scene.recorded_scene import resumed_scene
from nuno.scene.scene_file import Loaded
from nuno.simulation.solver_selection.cloth import decide
from nuno.simulation.solver_selection.trials import Budget
from nuno.viewer.live import add_view, choose_view, keep_page
from nuno_schemas.errors import BadInput, nearest

# `nuno new`: a commented scene to start from.

KINDS = {
    "skirt": "skirt-hula",
    "fitted-skirt": "skirt-on-mannequin",
    "circle-skirt": "circle-skirt",
    "sheet": "drape-over-sphere",
    "round-cloth": "round-table",
    "ribbon": "contact/ribbon",
    "shirt": "shirt-on-mannequin",
    "poncho": "poncho",
    "trousers": "sewn/trousers",
    "dress": "sewn/dress",
    "garment": "sewn/shirt",
    "stocking": "knit/stocking-leg",
    "dye": "dye/drops",
}
"""Shipped scene that each kind copies."""


def new_arguments(parser: argparse.ArgumentParser) -> None:
    kinds = ", ".join(KINDS)
    parser.add_argument("kind", help=f"{kinds}; or any scene that comes with nuno (nuno scenes)")
    parser.add_argument("file", nargs="?", type=Path, help="what is written (default: KIND.yaml, here)")


def new_command(args: argparse.Namespace) -> int:
    """Write the scene, and the files that it needs into its folder."""
    from nuno.scene.templates import write_after  # no run waits for what writes scenes

    known = shipped.scenes()
    name = KINDS.get(args.kind, args.kind)
    if name not in known:
        raise BadInput(
            "nothing of this kind to start from", value=args.kind, remedy=nearest(args.kind, [*KINDS, *known])
        )
    file: Path = args.file or Path(f"{args.kind.rsplit('/', 1)[-1]}.yaml")
    if file.suffix not in (".yaml", ".yml"):
        raise BadInput("a scene is YAML", field="FILE", value=str(file), remedy=f"{file.stem}.yaml")
    *beside, _ = write_after(name, file)
    for path in beside:
        print(f"written {path}")
    print(f"written {file}  (change it, and: nuno run {shlex.quote(str(file))})")
    return 0


# `nuno plan`: services, features left out and why, stable step, estimated cost.


def plan_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    add_budget(parser)


def plan_command(args: argparse.Namespace) -> int:
    budget = budget_of(args)
    attended(lambda: _print(args, budget), budget.stop)
    return 0


def _print(args: argparse.Namespace, budget: Budget) -> None:
    for heading in describe(load_scene(args), budget):
        print(line_of(heading), flush=True)


def run_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser, optional=True)
    add_budget(parser)
    recording = parser.add_argument_group("recording")
    either = recording.add_mutually_exclusive_group()
    either.add_argument("--no-record", action="store_true", help="do not record")
    add_flags(either, {"--record": ("FILE", "where the recording goes (default: recordings/<run>.mcap)", Path)})
    add_flags(recording, {
        "--resume": ("FILE", "go on from the last checkpoint of a recording, or of the last, with its own scene", Path),
        "--log": ("FILE", "what happened, as lines of JSON: a file, which is appended to, or - for standard output "
                  "(default: beside the recording)", Path),
    })  # fmt: skip
    add_view(parser, "show nothing and draw no picture")
    add_flags(parser, {"--mp4": ("FILE", "draw an animation at the end: .mp4 (needs nuno[video]) or .gif", Path)})
    paced = "no frame is sooner than the clock says; the run warns of a late one"
    parser.add_argument("--real-time", action="store_true", help=paced)
    parser.add_argument("--report", action="store_true", help="print all of the report, and why something is left out")
    paused = "wait before the first frame until: nuno control RUN resume"
    parser.add_argument("--paused", action="store_true", help=paused)
    where = parser.add_argument_group("where services run")
    where.add_argument("--processes", action="store_true", help="one process per service instead of threads")
    add_config(where)
    add_flags(where, {
        "--listen": ("ENDPOINT", "listen here, e.g. tcp/127.0.0.1:7447 (default: a free port on loopback)"),
        "--connect": ("ENDPOINT", "start no service: those started by hand are at this hub"),
        "--run": ("ID", "name of the run (default: scene, time and four random digits)"),
        "--threads": ("N", "most threads for kernels (default: all cores); the result is the same", int),
    })  # fmt: skip
    parser.set_defaults(threads=0)


def run_command(args: argparse.Namespace) -> int:
    args.words = sys.stderr if str(args.log) == "-" else sys.stdout  # then standard output has the log alone
    with _scene(args) as loaded:
        return _run(loaded, args)


@contextlib.contextmanager
def _scene(args: argparse.Namespace) -> Iterator[Loaded]:
    """Load the given scene, or that of the recording to resume."""
    if args.scene is None and args.resume is None:
        raise BadInput("give a scene, or a recording to resume", remedy="for example: nuno run skirt-hula")
    if args.scene is not None and args.resume is not None:
        remedy = "leave the scene out, and change it with --set"
        raise BadInput("a recording is resumed with its own scene", value=args.scene, remedy=remedy)
    if args.resume is None:
        yield load_scene(args)
        return
    args.resume = runs.find_recording(args.resume)
    with resumed_scene(args.resume, args.overrides) as (loaded, words):
        print(words, file=args.words, flush=True)
        yield loaded


def _run(loaded: Loaded, args: argparse.Namespace) -> int:
    for option, value in (("--processes", args.processes), ("--listen", args.listen)):
        if args.connect is not None and value:
            problem = "--connect starts no service, and listens nowhere"
            raise BadInput(problem, field=option, value=args.connect, remedy=f"leave {option} or --connect out")
    budget = budget_of(args)
    run = runs.new_id(loaded.scene.name) if args.run is None else runs.check_id(args.run)
    options = _options(args, run)
    if args.mp4 is not None:
        from nuno.exports.animations import check_animation
        from nuno.output_files import RATE

        if options.record is None:
            raise BadInput("an animation is drawn of the recording", field="--mp4", remedy="leave --no-record out")
        check_animation(args.mp4, RATE)
    deployment = Deployment(args.processes, args.listen, args.connect, run, args.config, args.paused)
    default_log = options.record.with_suffix(log.SUFFIX) if options.record is not None else None
    picture = not args.no_view and options.view is None and options.record is not None
    files = [path for path in (options.record, options.save, args.mp4, loaded.own_path) if path is not None]
    used = [*files, *map(part_of, files), *loaded.files.used.values()]
    with log.written(run, args.log or default_log, used), contextlib.redirect_stdout(args.words):
        if args.connect is None and options.record is not None and options.record.is_file():
            print(f"replaces {options.record} once the new one is whole", flush=True)
        if loaded.scene.undecided:
            print("choosing a solver by trying it on the first frames", flush=True)
        loaded = keep_up(loaded, budget) if args.real_time or loaded.paced else decide(loaded, budget)
        return execute(loaded, options, deployment, picture, args.mp4, args.report)


def _options(args: argparse.Namespace, run: str) -> Options:
    record = None
    if not args.no_record:
        target: Path | None = args.record
        record = runs.record_path(target.parent if target else runs.RECORDINGS, run)
        record = target or record
        if args.connect is None:  # else a recorder that was started by hand may be writing it already
            check_target(record)
    view = choose_view(args)
    return Options(record=record, save=args.save, view=view, resume=args.resume, threads=args.threads,
                   real_time=args.real_time)  # fmt: skip


def _name_files(options: Options, outcome: Outcome) -> None:
    """Print which files the run has written, and not older ones of the same name."""
    files = {name: answer["file"] for name, answer in outcome.services.items() if "file" in answer}
    if "recorder" in files:
        old = files["recorder"].removesuffix(".part")
        stays = "" if old == files["recorder"] else f"  ({old} stays as it was: only a whole one replaces it)"
        print(row("recording", files["recorder"] + stays))
    elif options.record is not None and (path := outcome.recording(options.record)) is not None:
        print(row("recording", f"{path}, which was not finished"))
    if "viewer" in files:
        print(row("rerun file", f"{files['viewer']}  (look: rerun {files['viewer']})"))


def execute(
    loaded: Loaded, options: Options, deployment: Deployment, picture: bool, mp4: Path | None, whole: bool
) -> int:
    """Run, show progress, print the whole or the brief report, draw; return the exit code."""
    started = time.perf_counter()
    with ending_at_once(), ProgressLine(loaded.scene) as progress:
        outcome = supervisor.supervise(
            loaded, options, deployment, progress.update, lambda outcome: make_report(loaded, outcome)
        )
    report = make_report(loaded, outcome)
    show_report(report, sys.stdout, whole)
    _name_files(options, outcome)
    # A recorder that was started by hand has its own --record, and may be on another host.
    recording = None if options.record is None else outcome.recording(options.record)
    if recording is not None:
        runs.note_recording(recording)
    if picture and outcome.state in ("done", "stopped") and recording is not None:
        from nuno.exports.pictures import export_picture

        target = recording.with_suffix(".png")
        print("drawing the last frame", flush=True)
        with compilation_notice():
            export_picture(recording, target)
        look = f"no screen here; on one with a screen: nuno replay {recording} --view"
        print(row("picture", f"{target}  ({look})"))
    print(row("total", f"{time.perf_counter() - started:.1f} s"), flush=True)  # before the error, in a pipe, too
    keep_page(options.view, outcome.services.get("viewer", {}), outcome.state != "terminated")
    if outcome.problem:
        _print_problem(outcome.problem)
        return 1
    if mp4 is not None and recording is None:
        _print_problem(f"no animation: the recording is not here; where it is: nuno export FILE --mp4 {mp4.name}")
        return 1
    if mp4 is not None and recording is not None:
        from nuno.exports.animations import export_animation
        from nuno.python_api.export import progress_lines

        print("drawing the animation", flush=True)
        with compilation_notice():
            export_animation(recording, mp4, progress=progress_lines())
        print(row("animation", mp4))
    return 0


def _print_problem(problem: str) -> None:
    """Print the problem, in red on a terminal."""
    from rich.console import Console

    console = Console(stderr=True, highlight=False, markup=False, soft_wrap=True)
    console.print(f"\n{problem}", style="bold red")
