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
            for name in sorted(registry.installed(group)):
                print(f"  {name:20} {registry.package_version(group, name)}")
    return 0
