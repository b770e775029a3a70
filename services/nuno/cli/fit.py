"""`nuno fit`: how a garment of a recording fits the body that wears it."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from nuno.cli.active_runs import align
from nuno.cli.common import add_flags
from nuno.python_api.fit import Fit, pressing, read_fits, remarks, tables
from nuno.recording.reader import open_recording
from nuno.runtime import runs
from nuno_schemas.errors import BadInput
from nuno_schemas.units import to_si


def fit_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", type=Path, metavar="FILE", help="a recording, or last")
    parser.add_argument(
        "--at", action="append", default=[], metavar="NAME=HEIGHT",
        help="measure at this height above the body's sole too, or instead of one of its own: --at bust='1.2 m'",
    )  # fmt: skip
    add_flags(parser, {
        "--frame": ("N", "the frame that is measured (default: the last)", int),
        "--body": ("NAME", "the body that wears it (default: the only one)", str),
    })  # fmt: skip
    parser.add_argument("--json", action="store_true", help="the same for a program, in SI units")


def fit_command(args: argparse.Namespace) -> int:
    heights = dict(_height(item) for item in args.at)
    with open_recording(runs.find_recording(args.recording)) as recording:
        fits = read_fits(recording, args.frame, args.body, heights)
    if args.json:
        print(json.dumps([asdict(fit) | {"ease": {one.name: one.ease for one in fit.girths}} for fit in fits]))
    else:
        print("\n".join(describe(fit) for fit in fits))
    # In a chosen frame, a garment may not be on the body yet.
    return 1 if args.frame is None and not all(fit.on for fit in fits) else 0


def _height(item: str) -> tuple[str, float]:
    name, equals, text = item.partition("=")
    if not name or not equals:
        raise BadInput("a height has a name", field="--at", value=item, remedy="for example: --at 'elbow=1.1 m'")
    try:
        return name, to_si(text, "m")
    except ValueError as error:
        raise BadInput(str(error), field="--at", value=item) from None


def describe(fit: Fit) -> str:
    """Return the fit as tables, in centimetres."""
    lines = [fit.name]
    for rows in tables(fit):
        lines += ["", align(rows, left=(0, 1) if rows[0][1] == "panels" else (0,))]
    for name, text in [*pressing(fit), *remarks(fit)]:
        lines += ["", f"{name:10} {text}"]
    return "\n".join([*lines, ""])
