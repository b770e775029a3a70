"""A record of speed: a line of JSON for each run of `nuno bench speed --save`, and what has changed since the last."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from nuno.scene.provenance import processor
from nuno_bench import machine
from nuno_bench.report.page import Table
from nuno_bench.report.result import Result, apart, number, spread_of
from nuno_schemas.errors import BadInput

ROOT = Path(__file__).parents[3]
"""The repository, where nuno runs from one."""
HEADINGS = ("case", "what", "unit", "then", "now", "now / then", "verdict")


@dataclass(frozen=True)
class Record:
    """A run: when, of which commit ("" outside of a repository), on what machine, and what it gave.

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
        """What two records must share to be compared."""
        return self.processor, self.cores

    def describe(self) -> str:
        """A sentence on the run."""
        versions = ", ".join(f"{package} {given}" for package, given in self.versions.items())
        return f"{self.date}, {self.commit or 'no commit'}, {versions}; {machine.describe_load(self.load)}"

    def line(self) -> str:
        """As JSON; one that others disturbed is marked."""
        data = {"date": self.date, "commit": self.commit, **vars(self), "load": round(self.load, 3)}
        data |= {"results": [_saved(result) for result in self.results]}
        if self.load > machine.DISTURBED:
            data["disturbed"] = True
        return json.dumps({name: value for name, value in data.items() if value != ""})


RECORD = TypeAdapter(Record)


def _saved(one: Result) -> dict[str, object]:
    spread = {"median": one.median, "least": min(one.samples), "greatest": max(one.samples)}
    return {"case": one.case, "what": one.what, "unit": one.unit, **spread, "samples": one.samples}


def own_file(field: str) -> Path:
    """The repository's record. Raises BadInput where nuno runs from none."""
    if not (ROOT / ".git").exists():
        raise BadInput("this nuno is in no repository that has a record", field=field, remedy="name a file")
    return ROOT / "docs" / "measured" / "speed.jsonl"


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
    """Those of this machine. Raises BadInput where there is none, with the machines that there are."""
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
class Change:
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
        """Its line under HEADINGS."""
        then, now = (f"{number(one.median)} ({spread_of(one.samples)})" if one else "" for one in (self.then, self.now))
        ratio = number(self.now.median / self.then.median) if self.then and self.then.median > 0.0 else ""
        return [self.now.case, self.now.what, self.now.unit, then, now, ratio, self.verdict]


def compare(records: Sequence[Record], results: Sequence[Result]) -> list[Change]:
    """Each result that has samples beside its last record: runs of some cases leave those of others to earlier ones."""
    last = {_key(one): (one, record) for record in records for one in record.results if one.samples}
    return [Change(one, *last.get(_key(one), ())) for one in results if one.samples]


def _key(result: Result) -> tuple[str, str, str]:
    return result.case, result.what, result.unit


def describe_changes(changes: Sequence[Change], load: float) -> list[Table | str]:
    """Their table, how many have changed, the records that they were held against, and what disturbed either."""
    verdicts = [change.verdict for change in changes]
    counts = ", ".join(f"{verdicts.count(verdict)} {verdict}" for verdict in dict.fromkeys(verdicts))
    used = dict.fromkeys(change.record.describe() for change in changes if change.record)
    table = Table(HEADINGS, [change.row() for change in changes])
    said = [f"Since the last record: {counts or 'nothing measured'}.", *(f"then: {text}" for text in used)]
    return [table, *said, f"now: {machine.describe_load(load)}"]
