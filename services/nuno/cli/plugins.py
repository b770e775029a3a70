"""`nuno plugins`: which plugins are installed, without importing any."""

from __future__ import annotations

import argparse

from nuno import registry
from nuno_schemas.plugin import GROUPS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("group", nargs="?", help="only this kind, e.g. nuno.integrators")


def main(args: argparse.Namespace) -> int:
    for group, meaning in GROUPS.items():
        if args.group in (None, group, group.removeprefix("nuno.")):
            print(f"{group}  ({meaning})")
            for name, points in sorted(registry.claims(group).items()):
                twice = "" if len(points) == 1 else "   claimed twice: a scene that names it is refused"
                print(f"  {name:20} {', '.join(map(registry.package, points))}{twice}")
    return 0
