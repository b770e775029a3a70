"""`nuno sweep`: a scene run for each combination of values of its fields."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from nuno.cli.common import add_scene, load_scene
from nuno.exports.camera import SIDES
from nuno.scene import yaml_lines
from nuno_bench import options
from nuno_bench.sweep import grid, places
from nuno_bench.sweep.storage import require_kept
from nuno_schemas.errors import BadInput


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    parser.add_argument(
        "--over", action="append", default=[], metavar="KEY=A,B,...",
        help="a field and its values: objects.0.model.fabric=denim,jacket; again for another, with all combinations",
    )  # fmt: skip
    parser.add_argument("--side", choices=["scene", *SIDES, "none"], default="scene",
                        help="from where each end is drawn (default: by the scene's own camera)")  # fmt: skip
    places.add_arguments(parser)
    options.add_shared(parser, "--resume")
    parser.add_argument("--out", type=Path, metavar="DIR", help="where page, table and what is finished meanwhile go "
                        "(default: recordings/sweep/SCENE)")  # fmt: skip


def main(args: argparse.Namespace) -> int:
    """Run all combinations and print the table; return 1 if any of them was not finished."""
    over = dict[str, list[Any]]()
    for key, values in map(values_of, args.over):
        if key in over:
            raise BadInput("a field is swept over once", field="--over", value=key, remedy="give all its values in one")
        over[key] = values
    print("\n".join(f"{key}: {', '.join(map(str, values))}" for key, values in over.items()), file=sys.stderr)
    loaded = load_scene(args)
    folder = args.out or Path("recordings/sweep") / loaded.scene.name
    if args.resume:
        require_kept([folder / grid.KEPT])
    with places.opened(args) as where:
        place = grid.Place(where, folder, args.resume, lambda text: print(text, file=sys.stderr, flush=True))
        try:
            made = grid.run_all(loaded, over, place, args.side.replace("none", ""))
        except KeyboardInterrupt:
            print("to go on with it, give the same command with --resume", file=sys.stderr)
            raise
    made.keep()
    print(made.table().text())
    return int(any(row[grid.STATE] not in ("done", "stopped") for row in made.rows))


def values_of(item: str) -> tuple[str, list[Any]]:
    """Return a field's key and its values, parsed as YAML. Raises BadInput."""
    key, equals, text = item.partition("=")
    if not key or not equals:
        remedy = "for example --over solver.dt='1/6000 s, 1/3000 s'"
        raise BadInput("a sweep goes over KEY=A,B,...", field="--over", value=item, remedy=remedy)
    try:
        values = yaml_lines.parse_value(f"[{text}]")
    except BadInput as error:
        raise BadInput(error.problem, field="--over", value=item, remedy=error.remedy) from None
    return key, list(values)
