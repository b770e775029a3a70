"""`nuno bench stability SCENE…`: maps over stiffness or mesh, and step."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from nuno import registry
from nuno.scene import scene_file
from nuno.viewer.require import require as require_viewer
from nuno.words import duration
from nuno_bench import machine, options
from nuno_bench.problem.observe import Problem
from nuno_bench.report import markdown, page, plots
from nuno_bench.stability import page as shown
from nuno_bench.stability.sweep import Mapped, measure_all, settings_of
from nuno_bench.sweep import executor, kept, places
from nuno_schemas.errors import BadInput


def add_arguments(parser: argparse.ArgumentParser) -> None:
    options.add_shared(parser, "scenes", "--set", "--solvers", "--resume", "--out", "--rrd", "--docs")
    options.add_seconds(parser, "--budget", 180.0, "wall time for each scene")
    places.add_arguments(parser)


def main(args: argparse.Namespace) -> int:
    """Map each scene, print the counts, write page, CSV and JSON. A run that diverges is a result."""
    plots.require_matplotlib()
    paths: list[Path] = [scene_file.find(name) for name in args.scenes]
    solvers = _choose(args, paths)
    require_viewer(None, args.rrd, "--rrd")
    for path in paths:
        markdown.check_section(args.docs, f"stability {path.stem}")
    kept.check([_rows(args, path) for path in paths], args.resume)
    with places.opened(args) as where:
        mapped = [_map(args, path, solvers, where) for path in paths]
    if args.rrd is not None:
        from nuno_bench.report import rerun

        print(f"written {rerun.write(args.rrd, 'nuno bench stability', shown.tabs(mapped))}")
    return 0


def _choose(args: argparse.Namespace, paths: Sequence[Path]) -> list[str]:
    """Names of the solvers. Raises BadInput before anything runs."""
    options.require_budget(args.budget)
    places.check(args)
    for path in paths:
        if scene_file.read(path, args.overrides).solver is None:
            remedy = "nuno bench precision holds solvers of dye against each other"
            raise BadInput("the maps are of cloth that moves, and here none does", str(path), remedy=remedy)
    names, installed = options.names_of(args.solvers), sorted(registry.installed(Problem.group))
    options.require_known(names, installed, "solver", "--solvers")
    return names or installed


def _rows(args: argparse.Namespace, path: Path) -> Path:
    folder: Path = args.out
    return folder / f"stability-{path.stem}.rows.jsonl"


def _map(args: argparse.Namespace, path: Path, solvers: list[str], where: executor.Executor) -> Mapped:
    """One scene."""

    def told(text: str) -> None:
        print(f"{path.stem}: {text}", file=sys.stderr)

    others = machine.Others()
    told(f"at most {duration(args.budget)}, and what compiling takes")
    settings, omissions = settings_of(path, args.overrides)
    identity = {"scene": settings[0].scene.digest, "solvers": solvers, "versions": executor.versions()}
    finished = kept.Kept(_rows(args, path), identity, args.resume)
    with kept.hint(finished.path):
        points, lost = measure_all(settings, solvers, finished, args.budget, where, told)
    about, found = machine.about(others, points=where.where), Mapped(path.stem, points, [*omissions, *lost])
    print(f"{path.stem}: {shown.summary(found)}")
    print(shown.counts(points).text())
    for text in found.omissions:
        print(f"left out: {text}")
    base, parts = args.out / f"stability-{path.stem}", list(shown.sections(found, about))
    data, lines = shown.data(found, about), shown.lines(found)
    for file in page.write(base, f"Stability of {path.stem}", shown.LEAD, parts, data, lines):
        print(f"written {file}")
    if args.docs is not None:
        markdown.replace_section(args.docs, f"stability {path.stem}", shown.document(found, about))
        print(f"written {args.docs}")
    return found
