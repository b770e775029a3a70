"""`make soak`, or `python -m soak` with tests/ on the path: each part in figures, of which every bar is a law."""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path

from nuno_bench import machine, options
from nuno_bench.report import page
from nuno_bench.report.page import Result, number
from nuno_schemas.errors import BadInput

PARTS = {
    "same-bits": "soak.same_bits", "access": "soak.access", "faults": "soak.faults", "lost": "soak.lost",
    "fuzz": "soak.fuzz.search", "damage": "soak.damage",
}  # fmt: skip
"""Module of each part, whose `run(quick, seed)` gives results."""
HEADINGS = ("case", "what", "found", "must be", "verdict")
VERDICTS = {"bar met": "holds", "missed": "BROKEN", "failed": "FAILED", "": ""}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the parts one after the other; 1 if anything that must hold does not, 2 for bad input."""
    parser = argparse.ArgumentParser(prog="python -m soak", description="Reliability at length.")
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"which to run (default: all): {', '.join(PARTS)}")
    parser.add_argument("--quick", action="store_true", help="a small share of each, for a look")
    parser.add_argument("--seed", type=int, default=0, help="what random moments and inputs are drawn from (0)")
    options.add_shared(parser, "--docs")
    args = parser.parse_args(argv)
    try:
        options.require_known(args.parts, PARTS, "part", "PART")
        parts = _chosen(args.parts, args.docs)
        broken = [part for part in parts if not _run(part, args.quick, args.seed, args.docs)]
        return int(len(broken) > 0)
    except BadInput as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


def _chosen(named: Sequence[str], docs: Path | None) -> list[str]:
    """Parts that can be run. Raises BadInput where one that was asked for cannot, or the page has no section for it."""
    parts = list(named or PARTS)
    if "fuzz" in parts and importlib.util.find_spec("atheris") is None:
        remedy = "pip install -e '.[soak]'"
        if named:
            raise BadInput("the part fuzz needs atheris, which is not installed", field="PART", remedy=remedy)
        print(f"fuzz is left out: atheris is not installed ({remedy})", file=sys.stderr)
        parts.remove("fuzz")
    if docs is not None:
        for part in parts:
            page.check_section(docs, f"soak {part}")
    return parts


def _run(part: str, quick: bool, seed: int, docs: Path | None) -> bool:
    """Run a part, print its table and put it into the page; whether all holds. One that fails as a whole says why."""
    print(f"{part} ...", file=sys.stderr)
    others = machine.OtherLoad()
    try:
        run: Callable[[bool, int], list[Result]] = importlib.import_module(PARTS[part]).run
        results = run(quick, seed)
    except Exception as error:  # what the part is about did not hold, and the other parts still count
        traceback.print_exc()
        results = [Result(part, "could not be run", "", failure=f"{type(error).__name__}: {error}")]
    table = page.Table(HEADINGS, [_row(result) for result in results])
    judged = [verdict for *_, verdict in table.rows if verdict]
    summary = f"{judged.count('holds')} of {len(judged)} hold."
    notes = [f"{r.case}, {r.what}: {r.failure or r.note}" for r in results if r.failure or r.note]
    print(table.text(), *notes, f"{part}: {summary}", sep="\n")
    if docs is not None:
        command = f"make soak ARGS='{part} --seed {seed}{' --quick' if quick else ''}'"
        about = machine.about(others) | {"command": command}
        page.replace_section(docs, f"soak {part}", [summary, table, *notes, page.Facts(about)])
    return judged.count("holds") == len(judged)


def _row(result: Result) -> list[str]:
    """Under HEADINGS."""
    found = f"{number(result.samples[0])} {result.unit}".rstrip() if result.samples else "-"
    wanted = f"at {'most' if result.at_most else 'least'} {number(result.bar)}" if result.bar is not None else ""
    return [result.case, result.what, found, wanted, VERDICTS[result.verdict]]


if __name__ == "__main__":
    sys.exit(main())
