"""`nuno yarns`: the yarns that knits can name, and their sources."""

from __future__ import annotations

import argparse
import textwrap

from nuno import registry
from nuno.cli.fabrics import GROUP, table
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.preset import Preset

LEGEND = (
    "EA is a yarn's tensile stiffness, force per strain; from the strain lock on it is EA_lock. Any value can be given "
    "in a scene, for example yarns: [nylon, {name: mine, ea: 2 N, density: 44 dtex}]."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("names", nargs="*", metavar="YARN", help="only these (default: all)")


def main(args: argparse.Namespace) -> int:
    known = find_yarns()
    for name in args.names:
        if name not in known:
            raise BadInput(f"no yarn {name!r}", remedy=nearest(name, known))
    chosen = [preset for name, preset in known.items() if not args.names or name in args.names]
    for line in show(chosen):
        print(line)
    print()
    print(textwrap.fill(LEGEND, 100))
    return 0


def find_yarns() -> dict[str, Preset]:
    """By name, of every installed model that lists some by `yarns()`."""
    models = (registry.load(GROUP, name) for name in sorted(registry.installed(GROUP)))
    return {yarn.name: yarn for model in models if hasattr(model, "yarns") for yarn in model.yarns()}


def show(yarns: list[Preset]) -> list[str]:
    """Lines: their values as a table, then the source of each."""
    sources = (textwrap.wrap(f"{yarn.name}: {yarn.source}", 100, subsequent_indent="  ") for yarn in yarns)
    return [*table(yarns), "", *(line for lines in sources for line in lines)]
