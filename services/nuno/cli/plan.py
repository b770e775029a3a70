"""`nuno plan`: what will run, what is left out and why, the stable step, the estimated cost."""

from __future__ import annotations

import argparse

from nuno.api.plan import describe, line_of
from nuno.cli.common import add_scene, load_scene


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)


def main(args: argparse.Namespace) -> int:
    for row in describe(load_scene(args)):
        print(line_of(row), flush=True)
    return 0
