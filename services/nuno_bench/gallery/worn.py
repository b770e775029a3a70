"""Patterns of one's own on a body of one's own: scenes as `nuno sew` writes them, for the gallery of sewn garments."""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

from nuno.begin.worn import Garment, describe_worn, name_garments
from nuno.cli.common import add_flags
from nuno_schemas.errors import BadInput

NEEDED = "--patterns, --body"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Those of which patterns on which body."""
    own = parser.add_argument_group("sewn: patterns of one's own, instead of those that come with nuno")
    own.add_argument("--patterns", nargs="+", type=Path, default=[], metavar="PATTERN", help="as for nuno sew")
    add_flags(own, {
        "--body": ("FILE", "the body that wears each of them, by itself", Path),
        "--edge": ("LENGTH", "of the triangles' sides (default: 2 cm)", str),
        "--fabric": ("NAME", "a preset (default: interlock)", str),
    })  # fmt: skip
    parser.set_defaults(edge="2 cm", fabric="interlock")


def check(args: argparse.Namespace) -> None:
    """Raises BadInput for patterns without a body, a body without patterns, files that are not there or of one name."""
    if bool(args.patterns) != (args.body is not None):
        raise BadInput("patterns and a body belong together", field=NEEDED, remedy="give both, or none of them")
    if args.patterns and args.kind != "sewn":
        remedy = "nuno gallery sewn --patterns PATTERN... --body BODY"
        raise BadInput("patterns are sewn", field="--patterns", value=args.kind, remedy=remedy)
    for file in (*args.patterns, *([args.body] if args.body else [])):
        if not file.is_file():
            raise BadInput("no such file", field=NEEDED, value=str(file))
    names = [pattern.stem for pattern in args.patterns]
    if twice := [name for name in names if names.count(name) > 1]:
        raise BadInput("two patterns have one name", field="--patterns", value=twice[0], remedy="rename one")


def write_scenes(args: argparse.Namespace, folder: Path) -> dict[str, Path]:
    """A scene for each pattern, in a folder with copies of what they need, by name."""
    found = {}
    body = shutil.copy(args.body, folder / f"body{args.body.suffix}")
    for pattern in args.patterns:
        shutil.copy(pattern, folder)
        garments = [Garment(name_garments([pattern.stem])[0], pattern.name, args.fabric)]
        found[pattern.stem] = folder / f"{pattern.stem}.yaml"
        text = describe_worn(pattern.stem, garments, args.edge, Path(body).name)
        found[pattern.stem].write_text(text, encoding="utf-8")
    return found
