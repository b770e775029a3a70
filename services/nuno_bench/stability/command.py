"""`nuno bench stability SCENE…`: maps over stiffness or mesh and step, energy drift, amplification."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from nuno import registry
from nuno.scene import scene_file
from nuno.scene.scene_file import Loaded
from nuno.viewer.require import require as require_viewer
from nuno.words import duration
from nuno_bench import machine, options
from nuno_bench.report import markdown, plots
from nuno_bench.report.result import text_table
from nuno_bench.stability import page as shown
from nuno_bench.stability.case import Posed
from nuno_bench.stability.drift import measure_modes
from nuno_bench.stability.dye import AXIS, DyePosed
from nuno_bench.stability.plots import maps
from nuno_bench.stability.sweep import Mapped, Row, measure_all, settings_of
from nuno_bench.sweep import executor
from nuno_bench.sweep.kept import Kept, hint, require, require_place
from nuno_schemas.errors import BadInput

MODES_SHARE = 0.25
"""Of the budget that goes to the long runs of a small net."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    options.add_shared(parser, "scenes", "--set", "--solvers", "--resume", "--out", "--rrd", "--docs")
    options.add_seconds(parser, "--budget", 180.0, "wall time for each scene")
    executor.add_arguments(parser)


def main(args: argparse.Namespace) -> int:
    """Map each scene, print the counts, write page, CSV and JSON. A run that diverges is a result."""
    plots.require_matplotlib()
    paths: list[Path] = [scene_file.find(name) for name in args.scenes]
    solvers = _choose(args, paths)
    require_viewer(None, args.rrd, "--rrd")
    for path in paths if args.docs is not None else ():
        markdown.check_section(args.docs, f"stability {path.stem}")
    if args.resume:
        require([_rows(args, path) for path in paths])
    for path in paths:
        require_place(_rows(args, path))
    mapped = list[Mapped]()
    with executor.opened(args) as where:
        for path in paths:
            mapped.append(_map(args, path, solvers[path], where))
            if args.docs is not None:
                markdown.replace_section(args.docs, f"stability {path.stem}", _document(args, mapped[-1]))
                print(f"written {args.docs}")
    if args.rrd is not None:
        from nuno_bench.stability import rerun

        print(f"written {rerun.write(args.rrd, mapped)}")
    return 0


def _choose(args: argparse.Namespace, paths: Sequence[Path]) -> dict[Path, list[str]]:
    """Names of the solvers of each scene. Raises BadInput before anything runs."""
    groups = {path: _group(scene_file.read(path, args.overrides)) for path in paths}
    installed = {group: sorted(registry.installed(group)) for group in groups.values()}
    known = [name for names in installed.values() for name in names]
    names = options.names_of(args.solvers)
    options.require_known(names, known, "solver", "--solvers")
    chosen = {path: [n for n in names or installed[group] if n in installed[group]] for path, group in groups.items()}
    for path, own in chosen.items():
        if not own:
            remedy, problem = f"known: {', '.join(installed[groups[path]])}", "none of these solvers can run the scene"
            raise BadInput(problem, str(path), field="--solvers", value=", ".join(names), remedy=remedy)
    if args.budget <= 0.0:
        raise BadInput("a sweep needs time", field="--budget", value=args.budget, limit="> 0 s")
    executor.check(args)
    return chosen


def _group(loaded: Loaded) -> str:
    return DyePosed.group if loaded.solver is None else Posed.group


def _rows(args: argparse.Namespace, path: Path) -> Path:
    folder: Path = args.out
    return folder / f"stability-{path.stem}.rows.jsonl"


def _map(args: argparse.Namespace, path: Path, solvers: list[str], where: executor.Executor) -> Mapped:
    """One scene."""
    others, base = machine.Others(), args.out / f"stability-{path.stem}"

    def told(text: str) -> None:
        print(f"{path.stem}: {text}", file=sys.stderr)

    told(f"at most {duration(args.budget)}, and what compiling takes")
    settings, omissions = settings_of(path, args.overrides)
    identity = {"scene": settings[0].scene.digest, "solvers": solvers, "versions": executor.versions()}
    kept = Kept(_rows(args, path), identity, args.resume)
    with hint(kept.path):
        share = 0.0 if settings[0].axis == AXIS else MODES_SHARE
        modes, lost = measure_modes(solvers, kept, share * args.budget, where, told) if share else ([], [])
        sweep = measure_all(settings, solvers, kept, (1.0 - share) * args.budget, where, told)
    omissions += lost
    sweep.omissions[:0] = omissions
    about = {"command": machine.command(), **machine.describe(), "points": where.where, "load": others.describe()}
    sizes, drifts = [each.amplification for each in modes], [each.drift for each in modes]
    files = shown.write(base, path.stem, sweep, (sizes, drifts), about)
    print(f"{path.stem}: {shown.summary(sweep)}")
    print(text_table(shown.COUNTS, shown.counts(sweep.rows)))
    for text in sweep.omissions:
        print(f"left out: {text}")
    for file in files:
        print(f"written {file}")
    return Mapped(path.stem, sweep, modes)


def _document(args: argparse.Namespace, mapped: Mapped) -> list[str]:
    """Parts for the documentation."""
    sweep = mapped.sweep
    sizes, drifts = [each.amplification for each in mapped.modes], [each.drift for each in mapped.modes]
    return [
        f"{shown.summary(sweep)}.",
        *_pictures(args, mapped.scene, sweep.rows),
        markdown.table(shown.COUNTS, shown.counts(sweep.rows)),
        markdown.table(shown.BEYOND, shown.beyond(sweep.rows)),
        *([markdown.table(shown.MODES, shown.modes(sizes, drifts))] if sizes else []),
        *(f"Left out: {text}." for text in sweep.omissions),
        markdown.facts({"command": machine.command(), **machine.describe()}),
    ]


def _pictures(args: argparse.Namespace, name: str, rows: Sequence[Row]) -> list[str]:
    """The maps beside the page of the documentation, as the page of the run shows them."""
    folder, parts = args.docs.parent / "pictures", []
    folder.mkdir(exist_ok=True)
    for axis, words in shown.AXES.items():
        own = [row for row in rows if row.axis == axis]
        if not own:
            continue
        picture = folder / f"stability-{name}-{axis}.svg"
        picture.write_text(maps(own, axis, words), encoding="utf-8")
        parts.append(f"![Maps of {name} over {words}, and the step](pictures/{picture.name})")
    return parts
