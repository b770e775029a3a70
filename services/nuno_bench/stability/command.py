"""`nuno bench stability SCENE…`: maps over stiffness or mesh, and step."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from nuno import registry
from nuno.scene import scene_file, shipped
from nuno.viewer.require import require as require_viewer
from nuno.words import duration
from nuno_bench import machine, options
from nuno_bench.problem.observe import Problem
from nuno_bench.report import page, plots
from nuno_bench.stability import page as shown
from nuno_bench.stability.sweep import Mapped, measure_all, settings_of
from nuno_bench.sweep import places
from nuno_bench.sweep.executor import Executor, versions
from nuno_bench.sweep.kept import Kept, require
from nuno_schemas.errors import BadInput


def add_arguments(parser: argparse.ArgumentParser) -> None:
    options.add_shared(parser, "scenes", "--set", "--solvers", "--resume", "--out", "--rrd", "--docs")
    options.add_seconds(parser, "--budget", 180.0, "wall time for each scene")
    places.add_arguments(parser)


def main(args: argparse.Namespace) -> int:
    """Map each scene, print the counts, write page, CSV and JSON. A run that diverges is a result."""
    plots.require_matplotlib()
    require_viewer(None, args.rrd, "--rrd")
    tabs = dict[str, list[plots.Panel]]()
    paths: list[Path] = [shipped.find(name) for name in args.scenes]
    for path in paths:
        if scene_file.read(path, args.overrides).solver is None:
            remedy = "nuno bench precision holds solvers of dye against each other"
            raise BadInput("the maps are of cloth that moves, and here none does", str(path), remedy=remedy)
        page.check_section(args.docs, f"stability {path.stem}")
    names, installed = options.names_of(args.solvers), sorted(registry.installed(Problem.group))
    options.require_known(names, installed, "solver", "--solvers")
    if args.resume:
        require([_rows(args, path) for path in paths])
    with places.opened(args) as where:
        for path in paths:
            tabs |= shown.tabs(_map(args, path, names or installed, where))
    if args.rrd is not None:
        from nuno_bench.report import rerun

        rerun.write(args.rrd, "nuno bench stability", tabs)
    return 0


def _rows(args: argparse.Namespace, path: Path) -> Path:
    folder: Path = args.out
    return folder / f"stability-{path.stem}.rows.jsonl"


def _map(args: argparse.Namespace, path: Path, solvers: Sequence[str], where: Executor) -> Mapped:
    """One scene."""
    told = partial(print, f"{path.stem}:", file=sys.stderr)
    others, base = machine.Others(), args.out / f"stability-{path.stem}"
    settings, omissions = settings_of(path, args.overrides)
    identity = {"scene": settings[0].scene.digest, "solvers": list(solvers), "versions": versions()}
    kept = Kept(_rows(args, path), identity, args.resume)
    told(f"at most {duration(args.budget)}, and what compiling takes; --resume goes on from {kept.path}")
    points, lost = measure_all(settings, solvers, kept, args.budget, where, told)
    found = Mapped(path.stem, points, [*omissions, *lost])
    print(f"{path.stem}: {shown.summary(found)}")
    print(shown.counts(points).text())
    for text in found.omissions:
        print(f"left out: {text}")
    about = machine.about(others, points=where.where)
    shown.report(found, about).write_beside(base, args.docs, f"stability {path.stem}")
    return found
