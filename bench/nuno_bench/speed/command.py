"""`nuno bench speed`: every measured bar as a named case, medians and spread, compile time apart."""

from __future__ import annotations

import argparse
import importlib
import json
import subprocess
import sys
import time
import traceback
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter, ValidationError

from nuno.scene.provenance import processor
from nuno_bench import machine, options
from nuno_bench.report import page
from nuno_bench.report.page import Result, Table, apart, number, spread_of, table
from nuno_schemas.errors import BadInput

# A record of speed: a line of JSON for each run of `nuno bench speed --save`, and what has changed since the last.

ROOT = Path(__file__).parents[3]
"""The repository, where nuno runs from one."""
HEADINGS = ("case", "what", "unit", "then", "now", "now / then", "verdict")


@dataclass(frozen=True)
class Record:
    """Results of one run of the benchmark, with its date, commit ("" outside of a repository) and machine.

    load  share of the machine that other processes took meanwhile, 0 to 1
    """

    date: str
    processor: str
    cores: int
    versions: dict[str, str]
    load: float
    results: tuple[Result, ...]
    commit: str = ""

    @classmethod
    def of(cls, results: Sequence[Result], load: float) -> Record:
        """That of this run, with all results that have samples."""
        versions = {package: version(package) for package in ("numpy", "numba")}
        kept = tuple(result for result in results if result.samples)
        return cls(time.strftime("%Y-%m-%d"), processor(), machine.cores(), versions, load, kept, commit())

    @property
    def place(self) -> tuple[str, int]:
        """Processor and cores, which two records must share to be compared."""
        return self.processor, self.cores

    def describe(self) -> str:
        """A sentence on the run."""
        versions = ", ".join(f"{package} {given}" for package, given in self.versions.items())
        return f"{self.date}, {self.commit or 'no commit'}, {versions}; {machine.describe_load(self.load)}"

    def line(self) -> str:
        """As JSON; one that others disturbed is marked."""
        data = {"date": self.date, "commit": self.commit, **vars(self), "load": round(self.load, 3)}
        data["results"] = [
            {"case": one.case, "what": one.what, "unit": one.unit, "median": one.median, "least": min(one.samples),
             "greatest": max(one.samples), "samples": one.samples}
            for one in self.results
        ]  # fmt: skip
        if self.load > machine.DISTURBED:
            data["disturbed"] = True
        return json.dumps({name: value for name, value in data.items() if value != ""})


RECORD = TypeAdapter(Record)


def commit() -> str:
    """The commit that is measured, "+changes" where files differ from it, or "".

    What measuring writes into the documentation changes no speed.
    """

    def git(*arguments: str) -> str:
        return subprocess.check_output(["git", "-C", ROOT, *arguments], stderr=subprocess.DEVNULL, text=True).strip()

    if not (ROOT / ".git").exists():
        return ""
    try:
        changes = git("status", "--porcelain", "--untracked-files=no", "--", ".", ":!docs")
        return git("describe", "--always") + ("+changes" if changes else "")
    except (OSError, subprocess.CalledProcessError):
        return ""


def read(path: Path) -> list[Record]:
    """All records of a file, the oldest first. Raises BadInput, with the line, for what is none."""
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}", str(path), remedy="name one that --save wrote") from None
    records = []
    for i, line in enumerate(lines, 1):
        try:
            records.append(RECORD.validate_json(line))
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(map(str, first["loc"])) or None
            raise BadInput(f"no record of speed: {first['msg']}", str(path), i, place) from None
    return records


def read_of_machine(path: Path) -> list[Record]:
    """Return the records of this machine. Raises BadInput, which lists the other machines, if there is none."""
    records, here = read(path), (processor(), machine.cores())
    if not (found := [record for record in records if record.place == here]):
        named = [f"{name}, {cores} cores" for name, cores in (here, *dict.fromkeys(record.place for record in records))]
        remedy = f"--save adds one; there are those of: {'; '.join(named[1:]) or 'none'}"
        raise BadInput("no record of this machine", str(path), value=named[0], remedy=remedy)
    return found


def append(path: Path, record: Record) -> None:
    """Add a line to a file, which is made where there is none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    ended = not path.exists() or path.read_bytes()[-1:] in (b"\n", b"")
    with path.open("a", encoding="utf-8") as stream:
        stream.write(("" if ended else "\n") + record.line() + "\n")


@dataclass(frozen=True)
class SpeedChange:
    """A result, and that of the last record that has it, if any."""

    now: Result
    then: Result | None = None
    record: Record | None = None

    @property
    def verdict(self) -> str:
        """slower or faster, beyond what repeats allow, or why neither is said."""
        if self.then is None:
            return "no record"
        if min(len(self.then.samples), len(self.now.samples)) < 2:
            return "taken once"
        if not apart(self.then.samples, self.now.samples):
            return "within the spread"
        return "faster" if (self.now.median > self.then.median) == self.now.more_is_better else "slower"

    def row(self) -> list[str]:
        """Return the texts under HEADINGS."""
        then, now = (f"{number(one.median)} ({spread_of(one.samples)})" if one else "" for one in (self.then, self.now))
        ratio = number(self.now.median / self.then.median) if self.then and self.then.median > 0.0 else ""
        return [self.now.case, self.now.what, self.now.unit, then, now, ratio, self.verdict]


def compare(records: Sequence[Record], results: Sequence[Result]) -> list[SpeedChange]:
    """Each result that has samples beside its last record: runs of some cases leave those of others to earlier ones."""
    last = {_key(one): (one, record) for record in records for one in record.results if one.samples}
    return [SpeedChange(one, *last.get(_key(one), ())) for one in results if one.samples]


def _key(result: Result) -> tuple[str, str, str]:
    return result.case, result.what, result.unit


def describe_changes(changes: Sequence[SpeedChange], load: float) -> list[Table | str]:
    """Their table, how many have changed, the records that they were held against, and what disturbed either."""
    verdicts = [change.verdict for change in changes]
    counts = ", ".join(f"{verdicts.count(verdict)} {verdict}" for verdict in dict.fromkeys(verdicts))
    used = dict.fromkeys(change.record.describe() for change in changes if change.record)
    table = Table(HEADINGS, [change.row() for change in changes])
    said = [f"Since the last record: {counts or 'nothing measured'}.", *(f"then: {text}" for text in used)]
    return [table, *said, f"now: {machine.describe_load(load)}"]


CASES = {
    "grid-256": "steps:grid_256",
    "net-256": "steps:net_256",
    "sheet-32": "steps:sheet_32",
    "membrane": "steps:membrane",
    "numbering": "steps:numbering",
    "stiff": "steps:stiff_sheet",
    "stiffness": "steps:stiffness",
    "closest": "leg:closest",
    "fit": "leg:fits",
    "sdf": "leg:sdf",
    "contact": "contact:contact",
    "wrinkle": "steps:wrinkle",
    "render": "leg:render",
    "dye": "steps:dye",
    "pipeline": "processes:pipeline",
    "live": "processes:live",
    "studio": "studio:studio",
    "start": "processes:start",
    "memory": "processes:memory",
}
"""Module beside this one and function of each case; a function takes the number of repeats and gives results."""
PEERS = {"closest": ("rtree", "igl", "open3d")}
"""Packages beside which a case is measured where they are installed."""
LEAD = (
    "Medians over repeats with the smallest and the largest sample. "
    "The first call, which compiles or loads, is in none of them."
)
OF_LIMIT = (
    "Of limit: the share of what this machine's reciprocal square roots allow; of dye, its memory at a step a pass."
)


def speed_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"which to run (default: all): {', '.join(CASES)}")
    options.add_count(parser, "--repeats", "samples of each figure (default: %(default)s)", 7)
    options.add_shared(parser, "--json", "--html", "--docs")
    for name, what in (("--save", "append this run to"), ("--against", "tell what is slower or faster than in")):
        what += " a record of speed (default: the repository's)"
        parser.add_argument(name, nargs="?", type=Path, const=True, metavar="FILE", help=what)


def speed_command(args: argparse.Namespace) -> int:
    """Run the cases; 1 if any could not be measured or has become slower. A missed bar is a finding, not a failure."""
    options.require_known(args.cases, CASES, "case", "CASE")
    section = " ".join(["speed", *args.cases])
    page.check_section(args.docs, section)
    save, against = _record(args.save, "--save"), _record(args.against, "--against")
    before = read_of_machine(against) if against else []
    if save and save.exists():
        read(save)  # so that a line is added to no other file
    lacking = _tell_lacking(args.cases or CASES)
    others = machine.OtherLoad()
    results: list[Result] = []
    for name in args.cases or CASES:
        print(f"{name} ...", file=sys.stderr)
        results += run_case(name, args.repeats)
    load = others.share()
    about = machine.about(others) | lacking | _limits(results)
    figures, said = table(results, OF_LIMIT), f"{summary(results)}."
    print(figures.text(), end="\n\n")
    for text in (*map(": ".join, notes(results)), *map(": ".join, about.items()), said):
        print(text)
    noted = Table(("what", "note"), notes(results), "Sizes, and what failed.", prose=True)
    changes = compare(before, results) if against else []
    since = describe_changes(changes, load) if against else []
    for part in since:
        print(part if isinstance(part, str) else f"\n{part.text()}\n")
    sections: page.Sections = [("", [said]), ("All figures", [figures]), ("Since", since), ("Notes", [noted])]
    data = {"results": [vars(one) | {"verdict": one.verdict} for one in results]}
    report = page.Report("Speed", LEAD, sections, about, data, [said, figures])
    report.write(args.html, args.json, args.docs, section)
    if save:
        append(save, Record.of(results, load))
        print(f"written {save}")
    return int(any(result.failure for result in results) or any(change.verdict == "slower" for change in changes))


def _record(given: Path | Literal[True] | None, field: str) -> Path | None:
    """Return the file of an option: the repository's where none is named. Raises BadInput where there is none."""
    if given is True:
        if not (ROOT / ".git").exists():
            raise BadInput("this nuno is in no repository that has a record", field=field, remedy="name a file")
        return ROOT / "docs" / "measured" / "speed.jsonl"
    if given and str(given) in CASES:
        raise BadInput("this is a case, and no file", field=field, value=str(given), remedy=f"name it before {field}")
    return given


def _tell_lacking(cases: Iterable[str]) -> dict[str, str]:
    """Cases whose peers are not installed, and how they are; said before anything runs."""
    lacking = {name: ", ".join(filter(None, map(options.missing_package, PEERS.get(name, ())))) for name in cases}
    said = {f"{name} has fewer peers": text for name, text in lacking.items() if text}
    for what, text in said.items():
        print(f"{what}: {text}", file=sys.stderr)
    return said


def run_case(name: str, repeats: int) -> list[Result]:
    """A case's results; one that fails gives a result that says why."""
    module, _, function = CASES[name].partition(":")
    try:
        case = getattr(importlib.import_module(f"nuno_bench.speed.{module}"), function)
        results: list[Result] = case(repeats)
    except Exception as error:  # any failure is a finding about this case, and others still count
        traceback.print_exc()
        return [Result(name, "could not be measured", "", failure=f"{type(error).__name__}: {error}")]
    return results


def _limits(results: list[Result]) -> dict[str, str]:
    if not any(result.limit for result in results):
        return {}
    from nuno_bench.speed.timing import bandwidth, inverse_roots

    roots, memory = inverse_roots(), bandwidth()
    text = f"{roots * 1e-9:.2f} billion 1/sqrt a second (float64, all cores), {memory * 1e-9:.0f} GB/s from memory"
    return {"limits": f"{text}; 6 springs computed a vertex allow {roots / 6e6:.0f} million vertex-steps/s"}


def notes(results: Sequence[Result]) -> list[tuple[str, str]]:
    """Each figure's name, and why it failed or what is to say of it."""
    return [(f"{r.case}, {r.what}", r.failure or r.note) for r in results if r.failure or r.note]


def summary(results: Sequence[Result]) -> str:
    """Return a sentence on the bars that were met, and those that were not."""
    judged = [r for r in results if r.bar is not None or r.failure]
    missed = [f"{r.case} ({r.what}: {number(r.median)} {r.unit})" for r in judged if r.verdict == "missed"]
    failed = [r.case for r in judged if r.verdict == "failed"]
    text = f"{len(judged) - len(missed) - len(failed)} of {len(judged)} bars met"
    text += f"; missed: {', '.join(missed)}" if missed else ""
    return text + (f"; could not be measured: {', '.join(failed)}" if failed else "")
