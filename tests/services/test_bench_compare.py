"""What `nuno bench compare` calls a change: outside the repeats' ranges, above the floor, and nothing else."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from nuno.cli import main
from nuno_bench.precision.compare import SweepResult, compare, read, summary
from nuno_bench.precision.sweep import Error, SolverPoint

FLOOR = 1e-8


def point(setting: str, error: float = 1e-3, times: tuple[float, ...] = (1.0, 1.05, 0.95)) -> SolverPoint:
    errors = {"drop": Error(error, error, error), "energy": Error(1e-5, 1e-5, 1e-5)}
    return SolverPoint("rk4", setting, "fixed steps", 4, 1.0, False, "done", "", times, {"steps": 10}, errors)


def result(*points: SolverPoint) -> SweepResult:
    return SweepResult("net", {one.key: one for one in points}, {"drop": FLOOR, "energy": FLOOR}, {})


def changed(a: SolverPoint, b: SolverPoint) -> tuple[str, ...]:
    return compare(result(a), result(b))[0].changed


def test_the_same_result_has_no_change() -> None:
    one = result(point("a"), point("b"))
    assert all(not change.changed for change in compare(one, one))
    assert all((change.row()[6], change.row()[9]) == ("1", "1") for change in compare(one, one))


def test_an_error_that_doubles_is_found_in_its_quantity() -> None:
    change = compare(result(point("a")), result(point("a", error=2e-3)))[0]
    assert change.changed == ("error",) and change.quantity == "drop"
    assert change.errors == (1e-3, 2e-3) and change.row()[6] == "2"
    assert changed(point("a", error=2e-3), point("a")) == ("error",)


def test_errors_at_the_floor_are_not_compared() -> None:
    assert changed(point("a", error=0.4 * FLOOR), point("a", error=2.0 * FLOOR)) == ()
    assert changed(point("a", error=0.4 * FLOOR), point("a", error=20.0 * FLOOR)) == ("error",)


def test_a_time_has_changed_only_beyond_the_repeats() -> None:
    assert changed(point("a"), point("a", times=(2.0, 2.1, 1.9))) == ("time",)
    assert changed(point("a"), point("a", times=(0.5, 0.6, 0.5))) == ("time",)
    # Twice as slow by the median, but one repeat was as fast.
    assert changed(point("a"), point("a", times=(2.0, 2.1, 1.0))) == ()
    # Taken once: who knows its spread.
    assert changed(point("a"), point("a", times=(5.0,))) == ()
    # Apart, but by less than a tenth.
    assert changed(point("a", times=(1.0, 1.01)), point("a", times=(1.05, 1.06))) == ()


def test_an_outcome_that_changed_is_found_without_errors() -> None:
    lost = replace(point("a"), outcome="diverged", errors={}, seconds=(0.1,))
    change = compare(result(point("a")), result(lost))[0]
    assert change.changed == ("outcome",)
    assert change.errors is None and change.times == (1.0, 0.1) and change.row()[9] == "0.1"


def test_points_of_one_result_only_are_named() -> None:
    first, second = result(point("a"), point("b")), result(point("b"), point("c"))
    said = " ".join(summary(first, second, compare(first, second)))
    assert "1 points in both" in said
    assert "Only in A: rk4 a." in said and "Only in B: rk4 c." in said


def write(path: Path, *points: SolverPoint, scene: str = "net") -> Path:
    floors = {name: asdict(Error(FLOOR, FLOOR, FLOOR)) for name in ("drop", "energy")}
    data = {"about": {"date": "today"}, "scene": scene, "reference": {"how": "", "floors": floors}}
    path.write_text(json.dumps(data | {"points": [asdict(one) for one in points]}))
    return path


def test_files_are_compared_and_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a = write(tmp_path / "a.json", point("a"), point("b"))
    b = write(tmp_path / "b.json", point("a"), point("b", error=3e-3, times=(3.0, 3.3)))
    assert read(a).points == result(point("a"), point("b")).points
    assert main(["bench", "compare", str(a), str(b), "--html", str(tmp_path / "page.html")]) == 0
    said = capsys.readouterr().out
    assert "0 in outcome, 1 in error, 1 in time" in said
    assert "error, time" in said and "3.15" in said
    assert "error, time" in (tmp_path / "page.html").read_text()


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"points": [{}], "reference": {"floors": {}}}', '{"points": 3}'])
def test_another_file_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str) -> None:
    good, other = write(tmp_path / "a.json", point("a")), tmp_path / "other.json"
    other.write_text(content)
    assert main(["bench", "compare", str(good), str(other)]) == 2
    assert "no result of a precision sweep" in capsys.readouterr().err


def test_results_without_anything_in_common_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a = write(tmp_path / "a.json", point("a"))
    for b, said in (
        (write(tmp_path / "b.json", point("b")), "no point in common"),
        (write(tmp_path / "c.json", point("a"), scene="skirt"), "two scenes"),
        (tmp_path / "nowhere.json", "cannot be read"),
    ):
        assert main(["bench", "compare", str(a), str(b)]) == 2
        assert said in capsys.readouterr().err
