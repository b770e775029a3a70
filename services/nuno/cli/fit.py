"""`nuno fit`: how a garment of a recording fits the body that wears it."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from nuno.cli.active_runs import align
from nuno.cli.common import add_flags
from nuno.python_api.fit import Fit, Girth, Seam, Spread, read_fits
from nuno.recording.reader import open_recording
from nuno.runtime import runs
from nuno_schemas.errors import BadInput
from nuno_schemas.units import to_si

SEAMS = 8
"""Most seams in the text, those with the largest pull."""
UNBALANCED = 0.1
"""Sum of all forces, as a share of those of contact, above which the text says that they do not balance."""


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
    rows = [["at", "height cm", "body cm", "cut cm", "worn cm", "ease cm"], *map(_row, fit.girths)]
    lines = [f"{fit.name}", "", align(rows)] if fit.girths else [f"{fit.name}"]
    rows = [["opening", "from cm", "to cm", "cut cm", "round cm"]]
    rows += [[f"{i}", *(f"{1e2 * value:.1f}" for value in (one.low, one.high, one.cut)),
              " + ".join(f"{1e2 * girth:.1f}" for girth in one.through) or "-"]
             for i, one in enumerate(fit.openings, 1)]  # fmt: skip
    lines += ["", align(rows)] if fit.openings else []
    rows = [["strain", "median %", "95 % below", "most %"]]
    rows += [[name, *_percents(spread)] for name, spread in fit.strains.items()]
    lines += ["", align(rows)]
    lines += ["", align(_seam_rows(fit.seams), left=(0, 1))] if fit.seams else []
    if (p := fit.pressed) is not None:
        text = f"{p.mean:.0f} Pa on {1e4 * p.area:.0f} cm² of cloth, 95 % of it below {p.high:.0f} Pa"
        lines += ["", f"presses    {text}; {p.force:.2f} N in all"]
        if p.unbalanced > UNBALANCED:
            text = "it is not at rest, or its contact bears more than this solver reports"
            lines += ["", f"unbalanced by {p.unbalanced:.0%} of these forces: {text}"]
    if fit.off:
        lines += ["", "worn       not at all: it touches the body nowhere, and is not on yet, or has slid off"]
    for i, one in enumerate(fit.openings, 1):
        if one.passed:
            inner = " and ".join(f"{k + 1}" for k in one.passed)
            edges = ", ".join(one.edges) or "of no panel"
            several = "s" if len(one.passed) > 1 else ""
            text = f"what goes out through opening{several} {inner} goes out through opening {i} ({edges}), too"
            lines += ["", f"slipped    {text}: narrow it, or hold it by an elastic"]
    numbered = enumerate(fit.openings, 1)
    empty = [f"{i} ({', '.join(one.edges) or 'of no panel'})" for i, one in numbered if not one.through]
    if empty and not fit.off:
        lines += ["", f"empty      nothing of the body goes through opening {', '.join(empty)}: is it worn there?"]
    if tight := [one for one in fit.girths if one.ease is not None and one.ease < 0.0]:
        girths = ", ".join(f"by {-1e2 * (one.ease or 0.0):.1f} cm at the {one.name}" for one in tight)
        lines += ["", f"smaller    than the body {girths}"]
    return "\n".join([*lines, ""])


def _seam_rows(seams: list[Seam]) -> list[list[str]]:
    """Return rows of the seams with the largest pull."""
    most = sorted(seams, key=lambda one: -one.mean)[:SEAMS]
    which = "seam" if len(most) == len(seams) else f"{len(most)} of {len(seams)} seams"
    rows = [[which, "panels", "cut cm", "pulled N/m", "most N/m"]]
    return rows + [
        [one.letters, ", ".join(one.panels), f"{1e2 * one.length:.1f}", f"{one.mean:.1f}", f"{one.most:.1f}"]
        for one in most
    ]


def _row(one: Girth) -> list[str]:
    open_ = one.share is not None and one.ease is None and one.body is not None
    ease = (
        f"open, {100 * (one.share or 0):.0f} % round"
        if open_
        else "-"
        if one.ease is None
        else f"{1e2 * one.ease:+.1f}"
    )
    cells = ["-" if value is None else f"{1e2 * value:.1f}" for value in (one.body, one.cut, one.worn)]
    return [one.name, f"{1e2 * one.height:.1f}", *cells, ease]


def _percents(spread: Spread) -> list[str]:
    return [f"{100 * value:+.1f}" for value in (spread.median, spread.high, spread.most)]
