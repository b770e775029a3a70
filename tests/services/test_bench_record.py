"""What a record of speed keeps, what it calls slower, and what it refuses."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from nuno.cli import main
from nuno_bench.machine import DISTURBED
from nuno_bench.report.page import Result
from nuno_bench.speed import command as speed
from nuno_bench.speed.command import Record

BEFORE = (1.0, 1.1, 1.2)
PAGE = Path(__file__).parents[2] / "docs" / "measured" / "benchmarks.md"


def timed(samples: tuple[float, ...] = BEFORE, unit: str = "s", what: str = "a step") -> Result:
    return Result("case", what, unit, samples)


def verdicts(records: list[Record], *results: Result) -> list[str]:
    return [change.verdict for change in speed.compare(records, results)]


@pytest.mark.parametrize(
    ("samples", "of_time", "of_rate"),
    [
        ((1.4, 1.5, 1.3), "slower", "faster"),
        ((0.7, 0.9, 0.8), "faster", "slower"),
        ((1.2, 1.5, 1.6), "within the spread", "within the spread"),
        ((0.5, 0.6, 1.0), "within the spread", "within the spread"),
        ((1.201, 1.205, 1.209), "within the spread", "within the spread"),
        ((9.0,), "taken once", "taken once"),
    ],
)
def test_slower_and_faster_are_beyond_both_spreads(samples: tuple[float, ...], of_time: str, of_rate: str) -> None:
    """And by more than a tenth, as everywhere in the benches."""
    for unit, expected in (("ms a frame", of_time), ("M vertex-steps/s", of_rate)):
        assert verdicts([Record.of([timed(unit=unit)], 0.0)], timed(samples, unit)) == [expected]


def test_rates_are_what_must_reach_at_least_their_bar() -> None:
    """In the documentation's tables, whose bars say which way is better; times faster than a peer are in no case."""
    rows = [line.split(" | ") for line in PAGE.read_text().splitlines() if line.count(" | ") == 9]
    found = {(row[4], row[5][:2]) for row in rows if row[0][2:] in speed.CASES and row[5]}
    assert {"M vertex-steps/s", "s", "times"} <= {unit for unit, _ in found}
    for unit, sign in found:
        assert Result("case", "what", unit).more_is_better == (sign == ">="), unit


def test_each_result_is_held_against_the_last_record_that_has_it() -> None:
    first = Record.of([timed((5.0, 5.1)), timed(what="another")], 0.0)
    second = Record.of([timed()], 0.0)
    results = timed((2.0, 2.1)), timed(what="another"), timed(what="a third"), timed(unit="ms")
    assert verdicts([first, second], *results) == ["slower", "within the spread", "no record", "no record"]
    assert verdicts([first, second], replace(results[0], samples=(), failure="it broke")) == []


def test_a_record_is_read_as_it_was_written_and_what_was_there_is_kept(tmp_path: Path) -> None:
    path, quiet = tmp_path / "docs" / "speed.jsonl", Record.of([timed(), timed((), what="failed")], 0.01)
    speed.append(path, quiet)
    before = path.read_text()
    path.write_text(before.rstrip("\n"))  # as an editor may leave it
    disturbed = Record.of([timed((3.0,))], 2 * DISTURBED)
    speed.append(path, disturbed)
    assert path.read_text().startswith(before)
    assert speed.read(path) == [quiet, disturbed] and len(quiet.results) == 1
    first, second = map(json.loads, path.read_text().splitlines())
    assert "disturbed" not in first and second["disturbed"] is True
    saved = {"case": "case", "what": "a step", "unit": "s", "median": 1.1, "least": 1.0, "greatest": 1.2}
    assert first["results"] == [saved | {"samples": list(BEFORE)}]
    for then, load in ((disturbed, 0.0), (quiet, disturbed.load)):
        said = speed.describe_changes(speed.compare([then], [timed()]), load)[-2:]
        assert ["DISTURBED" in str(text) for text in said] == [then is disturbed, then is quiet]


def test_a_commit_is_told_only_in_a_repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed, "ROOT", tmp_path)
    outside = Record.of([timed()], 0.0)
    assert outside.commit == "" and "commit" not in json.loads(outside.line())
    git = "git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b"
    (tmp_path / "kept").write_text("1")
    for arguments in (["init", "-q"], ["add", "."], ["commit", "-qm", "one"]):
        speed.subprocess.run([*git, *arguments], check=True)
    clean = speed.commit()
    assert re.fullmatch("[0-9a-f]{7,}", clean)
    (tmp_path / "kept").write_text("2")
    assert speed.commit() == f"{clean}+changes"


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> list[Result]:
    """What every case gives, with nothing timed."""
    results = [timed()]
    monkeypatch.setattr(speed, "run_case", lambda name, repeats: list(results))
    return results


def test_runs_are_saved_and_held_against_the_last(
    tmp_path: Path, measured: list[Result], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / ".git").mkdir()
    monkeypatch.setattr(speed, "ROOT", tmp_path)
    kept = tmp_path / "docs" / "measured" / "speed.jsonl"
    bench = ["bench", "speed", "sheet-32", "--save"]
    assert main(bench) == 0 and main([*bench, "--against"]) == 0
    assert "1 within the spread" in capsys.readouterr().out
    measured[0] = timed((2.0, 2.1, 2.2))
    assert main([*bench, "--against"]) == 1
    said = capsys.readouterr().out
    assert re.search(r"1\.1 \(1 - 1\.2\) +2\.1 \(2 - 2\.2\) +1\.91  slower", said)
    assert f"then: {speed.read(kept)[1].date}, no commit, numpy" in said
    # The slow one was saved, too, and is the last now.
    assert main(["bench", "speed", "sheet-32", "--against"]) == 0
    assert len(speed.read(kept)) == 3


def test_other_machines_are_left_alone(
    tmp_path: Path, measured: list[Result], capsys: pytest.CaptureFixture[str]
) -> None:
    path, own = tmp_path / "speed.jsonl", Record.of(measured, 0.0)
    for other in (replace(own, processor="Abacus"), replace(own, cores=own.cores + 1)):
        speed.append(path, replace(other, results=(timed((0.1, 0.1)),)))
    assert main(["bench", "speed", "--against", str(path)]) == 2
    said = capsys.readouterr().err
    assert "no record of this machine" in said and f"Abacus, {own.cores} cores; {own.processor}" in said
    speed.append(path, own)
    assert main(["bench", "speed", "sheet-32", "--against", str(path)]) == 0


@pytest.mark.parametrize("option", ["--save", "--against"])
def test_bad_records_are_refused(
    option: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With exit code 2, before anything is measured."""
    monkeypatch.setattr(speed, "run_case", lambda name, repeats: pytest.fail("measured"))
    monkeypatch.setattr(speed, "ROOT", tmp_path)
    path, good = tmp_path / "speed.jsonl", Record.of([timed()], 0.0).line()
    for file, said in (((), "in no repository"), (("sheet-32",), "this is a case"), ((str(tmp_path),), "be read")):
        assert main(["bench", "speed", option, *file]) == 2
        assert said in capsys.readouterr().err
    for line in ("", "no JSON", "{}", good.replace("1.1", '"fast"')):
        path.write_text(f"{good}\n{line}\n{good}\n")
        assert main(["bench", "speed", option, str(path)]) == 2
        assert f"{path}:2: " in capsys.readouterr().err
