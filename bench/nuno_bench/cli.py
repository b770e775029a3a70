"""`nuno bench`: one module per kind of measurement, imported only when it is used."""

from __future__ import annotations

import argparse
from functools import partial

from nuno import cli

COMMANDS = {
    "speed": ("nuno_bench.speed.command", "measured bars: kernels, pipeline, start, memory, recording"),
    "precision": ("nuno_bench.precision.command", "every solver's error over the wall time it takes, on any scene"),
    "accuracy": ("nuno_bench.precision.accuracy", "whether `accuracy: LEVEL` keeps its promise, on many scenes"),
    "compare": ("nuno_bench.precision.compare", "two results of precision: which errors and times have changed"),
    "stability": ("nuno_bench.stability", "maps of what solvers make of a scene over stiffness, mesh and step"),
    "contact": ("nuno_bench.contact", "random scenes of cloth that meets cloth: none may pass through"),
    "peers": ("nuno_bench.peers.command", "the same cloth in other engines and in ours: a sheet, a pile, a skirt"),
    "integrators": (
        "nuno_bench.integrators",
        "the skirt paper's experiment: four methods, split and unsplit bones",
    ),
}
"""Module and summary of each measurement; a module has `KIND_arguments(parser)` and `KIND_command(args)`."""
parser_of = partial(cli.parser_of, commands=COMMANDS, program="nuno bench")


def bench_arguments(parser: argparse.ArgumentParser) -> None:
    rows = "\n".join(f"  {name:12} {summary}" for name, (_, summary) in COMMANDS.items())
    parser.description = f"What to measure:\n{rows}\n\n`nuno bench KIND --help` says more."
    parser.add_argument("kind", choices=list(COMMANDS), help="what to measure")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, help="its own arguments")


def bench_command(args: argparse.Namespace) -> int:
    """Run one measurement; the exit code is 1 if it could not be taken."""
    module, parser = parser_of(args.kind)
    return int(getattr(module, f"{args.kind}_command")(parser.parse_args(args.arguments)))
