"""`nuno bench contact`: random scenes of cloth that meets cloth, every frame looked at by ipctk and by us."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from nuno_bench import extras, machine, options
from nuno_bench.contact import page as shown
from nuno_bench.contact.run import Passed, run_pile
from nuno_bench.problem.random_piles import random_pile
from nuno_bench.report import page
from nuno_bench.sweep import places
from nuno_bench.sweep.executor import Executor, Lost, versions
from nuno_bench.sweep.kept import Kept, require
from nuno_schemas.errors import BadInput

FOLDER, KEPT = "contact", "contact.jsonl"
"""Of --out: into the first go scenes that went wrong, into the second what is finished, line by line."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("seeds", nargs="*", type=int, metavar="SEED", help="of the scenes (default: 1 to --count)")
    options.add_count(parser, "--count", "scenes, where no seed is given (default: %(default)s)", 200)
    options.add_seconds(parser, "--duration", 0.5, "of each scene, of which a shorter one is the beginning")
    places.add_arguments(parser)
    options.add_shared(parser, "--resume", "--out", "--docs")


def main(args: argparse.Namespace) -> int:
    """Run the scenes, print tables; 1 where cloth passed through cloth, or a scene could not be run."""
    if any(seed < 0 for seed in args.seeds):
        raise BadInput("a seed is not negative", field="SEED", value=min(args.seeds), limit="0 and more")
    extras.require("cloth is looked at by", "ipctk")
    page.check_section(args.docs, "contact")
    if args.resume:
        require([args.out / KEPT])
    others, seeds = machine.Others(), args.seeds or list(range(1, args.count + 1))
    kept = Kept(args.out / KEPT, {"duration": args.duration, "versions": versions()}, args.resume)
    with places.opened(args) as where:
        found = run_all(seeds, args.duration, kept, where, lambda text: print(text, file=sys.stderr))
    for table in shown.tables(found):
        print(table.text(), end="\n\n")
    print("\n".join([*map(shown.line, found), shown.summary(found)]).lstrip())
    folder = keep(found, args.duration, args.out / FOLDER)
    about = machine.about(others) | ({"scenes that went wrong": str(folder)} if folder else {})
    shown.report(found, args.duration, about).write_beside(args.out / "contact", args.docs, "contact")
    return int(any(shown.is_bad(one) for one in found))


def run_all(
    seeds: Sequence[int], duration: float, kept: Kept, where: Executor, told: Callable[[str], None]
) -> list[Passed]:
    """What came of the scenes of all seeds, in their order; those that are kept are not run again."""
    found = {one.seed: one for one in (Passed(**line) for line in kept.lines)}
    left = [(seed, duration) for seed in dict.fromkeys(seeds) if seed not in found]
    for (seed, _), one in where.run(run_pile, left):
        if isinstance(one, BadInput | Lost):
            one = Passed(seed, status="crashed", message=str(one))
        found[seed] = one
        kept.add(vars(one))
        told(f"{len(found)} of {len(seeds)}: {shown.line(one) or f'seed {seed}, {one.solver}: clean'}")
    return [found[seed] for seed in dict.fromkeys(seeds)]


def keep(found: Sequence[Passed], duration: float, folder: Path) -> Path | None:
    """Write the scenes that went wrong or failed, each with its files; the folder, None where there is none."""
    wrong = [one for one in found if one.verdict != "clean"]
    for one in wrong:
        (own := folder / str(one.seed)).mkdir(parents=True, exist_ok=True)
        random_pile(one.seed, duration, own)
    return folder if wrong else None
