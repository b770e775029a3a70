"""What a precision sweep writes: files, judgements, comparisons of two sweeps."""

from __future__ import annotations

import base64
import csv
import json
import re
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from dye_scene import write_scene as write_dyed
from line_net import problem_of, reference_of, write_net
from precision_sweeps import swept
from rrd import columns

from nuno.cli import main
from nuno.cli import main as nuno_main
from nuno.viewer.layout import entity
from nuno_bench.precision.command import Findings, _own, over_frames, over_wall_time, report, tabs
from nuno_bench.precision.compare import SweepResult, compare, read, summary
from nuno_bench.precision.sweep import POINT, Error, SolverPoint, choice_rows, judge, measure_errors
from nuno_bench.problem import POSITIONS, DyeProblem, Problem

SOLVERS = "rk4,leapfrog,tr_bdf2"


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Findings:
    """The line's sweep by three solvers; all of them are swept where orders are tested."""
    return swept(write_net(tmp_path_factory.mktemp("line")), "--solvers", SOLVERS)


@pytest.mark.full
def test_without_predictable_time_only_observables_are_compared(tmp_path: Path, found: Findings) -> None:
    horizon = replace(found.horizon, frames=1, t=0.0, whole=False)
    floors = {name: floor for name, floor in found.floors.items() if name != POSITIONS}
    page = report(replace(found, horizon=horizon, floors=floors)).page()
    assert "Positions cannot be compared" in page and page.count("<svg") == 1
    problem = problem_of(write_net(tmp_path))
    run = reference_of(problem).run.series
    assert set(measure_errors(run, run, problem.scales(run), 1)) == {"energy", "centre", "drop", "strain"}


@pytest.mark.full
def test_files_hold_every_point(tmp_path: Path, found: Findings) -> None:
    report(found).write_beside(tmp_path / "line")
    content = json.loads((tmp_path / "line.json").read_text())
    assert [POINT.validate_python(point) for point in content["points"]] == found.points
    assert content["premises"].items() >= {"duration": found.problem.loaded.scene.duration, "gravity[1]": -9.81}.items()
    with (tmp_path / "line.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == sum(max(1, len(point.errors)) for point in found.points)
    limits = [float(row["dt"]) / float(row["share_of_limit"]) for row in rows if row["solver"] == "rk4"]
    assert limits == pytest.approx([limits[0]] * len(limits)) and not any(row["tolerance"] for row in rows)
    text = (tmp_path / "line.html").read_text()
    assert all(point.setting in text for point in found.points)
    assert text.count("<svg") == 2 and "http" not in text.replace("http://www.w3.org", "")


@pytest.mark.full
def test_a_figure_can_be_saved_as_a_file_of_its_own(found: Findings) -> None:
    links = re.findall(r'href="data:image/svg\+xml;base64,([^"]+)" download="([^"]+)"', report(found).page())
    assert [name for _, name in links] == ["precision-line-positions.svg", "precision-line-observed.svg"]
    for data, _ in links:
        assert ElementTree.fromstring(base64.b64decode(data)).tag == "{http://www.w3.org/2000/svg}svg"


@pytest.mark.full
def test_a_rerun_file_holds_every_point_and_its_error_over_the_frames(tmp_path: Path) -> None:
    from nuno_bench.report import rerun

    found = swept(write_net(tmp_path), "--solvers", "rk4,leapfrog")
    path = tmp_path / "line.rrd"
    rerun.write(path, "test", tabs(found))
    assert not list(tmp_path.glob("*.part"))
    dots = {place: np.array(rows[0]) for place, rows in columns(path, "Points2D:positions").items()}
    done = [each for each in found.points if each.done]
    tab, frames, wall = f"line, {POSITIONS}", over_frames(found, POSITIONS), over_wall_time(found, POSITIONS)
    for each in done:
        place = entity(tab, frames.title, "curves", f"{each.solver}, {each.setting}")
        axis = rerun.axes_of(frames)[1]
        curve = 10.0 ** (axis.low - dots[place][:, 1] / axis.length * (axis.high - axis.low))
        assert np.sqrt((curve**2).mean()) == pytest.approx(each.errors[POSITIONS].l2, rel=1e-3)
    rk4 = sorted((each for each in done if each.solver == "rk4"), key=lambda each: -each.finer)
    expected = [np.log10([each.median, each.errors[POSITIONS].l2]) for each in rk4]
    drawn = dots[entity(tab, wall.title, "curves", "rk4")]
    for k, (axis, sign) in enumerate(zip(rerun.axes_of(wall), (1.0, -1.0), strict=True)):
        values = axis.low + sign * drawn[:, k] / axis.length * (axis.high - axis.low)
        assert values == pytest.approx(np.array(expected)[:, k], abs=1e-5)


def point(error: float, solver: str = "rk4", seconds: float = 1.0, beyond: bool = False) -> SolverPoint:
    setting, errors = f"{error:g}", {"drop": Error(0.0, error, 0.0)}
    return SolverPoint(solver, setting, "fixed steps", 4, error, beyond, "done", "", (seconds,), {}, errors)


def test_a_judgement_counts_what_the_floor_hides() -> None:
    points = [point(error) for error in (1e-2, 1e-4, 1e-6)]
    verdicts = [judge(points, {"drop": Error(0.0, floor, 0.0)})[0].verdict for floor in (1e-8, 1e-5, 1e-2)]
    assert verdicts == ["judged", "in part", "failed"]
    assert judge([], {"drop": Error(0.0, 1e-8, 0.0)})[0].verdict == "no point"


def test_the_fastest_stable_solver_within_each_accuracy_is_named_once() -> None:
    points = [point(2e-3, "coarse", 0.1), point(5e-5, "fine", 0.5), point(2e-3, "fine", 0.3)]
    points += [point(1e-5, "lucky", 0.01, beyond=True)]
    rows = choice_rows(points, "drop", 1e-6)
    assert [row[:4] for row in rows] == [["0.01", "coarse", "0.002", "0.1"], ["0.0001", "fine", "5e-05", "0.5"]]
    assert rows[0][4] == "fine 0.3"
    # Of what the floor hides nothing is said.
    assert [row[0] for row in choice_rows(points, "drop", 1e-4)] == ["0.01", "0.001"]


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (("--solvers", "leapfrgo"), "leapfrog"),
        (("--solvers", ","), "empty"),
        (("--budget", "0"), "more than 0"),
        (("--budget", "nan"), "more than 0"),
        (("--repeats", "0"), "--repeats"),
        (("--rrd", "series.txt"), "must end in .rrd"),
        (("--observable", "dropp"), "drop"),
        (("--observable", ","), "empty"),
        (("--docs", "nowhere.md"), "no section"),
    ],
)
def test_bad_input_is_refused_before_anything_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], flags: tuple[str, ...], said: str
) -> None:
    path = write_net(tmp_path)
    assert nuno_main(["bench", "precision", str(path), "--out", str(tmp_path / "out"), *flags]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("flags", [("--observable", "mobile"), ("--solvers", "rk4")])
def test_what_only_one_of_the_scenes_has_is_refused_before_anything_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], flags: tuple[str, ...]
) -> None:
    """Scenes of cloth and of dye have their own; of names of both each takes its own."""
    (tmp_path / "dyed").mkdir()
    scenes = [str(write_net(tmp_path)), str(write_dyed(tmp_path / "dyed"))]
    assert nuno_main(["bench", "precision", *scenes, "--out", str(tmp_path / "out"), *flags]) == 2
    assert "one of the scenes has none of these" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert _own("drop,mobile", Problem.observables) == ["drop"]
    assert _own("drop,mobile", DyeProblem.observables) == ["mobile"]


FLOOR = 1e-8


def written_point(setting: str, error: float = 1e-3, times: tuple[float, ...] = (1.0, 1.05, 0.95)) -> SolverPoint:
    errors = {"drop": Error(error, error, error), "energy": Error(1e-5, 1e-5, 1e-5)}
    return SolverPoint("rk4", setting, "fixed steps", 4, 1.0, False, "done", "", times, {"steps": 10}, errors)


def result(*points: SolverPoint) -> SweepResult:
    return SweepResult("net", {}, {one.key: one for one in points}, {"drop": FLOOR, "energy": FLOOR}, {})


def changed(a: SolverPoint, b: SolverPoint) -> tuple[str, ...]:
    return compare(result(a), result(b))[0].changed


def test_the_same_result_has_no_change() -> None:
    one = result(written_point("a"), written_point("b"))
    assert all(not change.changed for change in compare(one, one))
    assert all((change.row()[6], change.row()[9]) == ("1", "1") for change in compare(one, one))


def test_an_error_that_doubles_is_found_in_its_quantity() -> None:
    change = compare(result(written_point("a")), result(written_point("a", error=2e-3)))[0]
    assert change.changed == ("error",) and change.quantity == "drop"
    assert change.errors == (1e-3, 2e-3) and change.row()[6] == "2"
    assert changed(written_point("a", error=2e-3), written_point("a")) == ("error",)


def test_errors_at_the_floor_are_not_compared() -> None:
    assert changed(written_point("a", error=0.4 * FLOOR), written_point("a", error=2.0 * FLOOR)) == ()
    assert changed(written_point("a", error=0.4 * FLOOR), written_point("a", error=20.0 * FLOOR)) == ("error",)


def test_a_time_has_changed_only_beyond_the_repeats() -> None:
    assert changed(written_point("a"), written_point("a", times=(2.0, 2.1, 1.9))) == ("time",)
    assert changed(written_point("a"), written_point("a", times=(0.5, 0.6, 0.5))) == ("time",)
    # Twice as slow by the median, but one repeat was as fast.
    assert changed(written_point("a"), written_point("a", times=(2.0, 2.1, 1.0))) == ()
    # Taken once: who knows its spread.
    assert changed(written_point("a"), written_point("a", times=(5.0,))) == ()
    # Apart, but by less than a tenth.
    assert changed(written_point("a", times=(1.0, 1.01)), written_point("a", times=(1.05, 1.06))) == ()


def test_an_outcome_that_changed_is_found_without_errors() -> None:
    lost = replace(written_point("a"), outcome="diverged", errors={}, seconds=(0.1,))
    change = compare(result(written_point("a")), result(lost))[0]
    assert change.changed == ("outcome",)
    assert change.errors is None and change.times == (1.0, 0.1) and change.row()[9] == "0.1"


def test_points_of_one_result_only_are_named() -> None:
    first, second = result(written_point("a"), written_point("b")), result(written_point("b"), written_point("c"))
    said = " ".join(summary(first, second, compare(first, second)))
    assert "1 points in both" in said
    assert "Only in A: rk4 a." in said and "Only in B: rk4 c." in said


def write(path: Path, *points: SolverPoint, scene: str = "net", size: str = "0.3 s", **premises: object) -> Path:
    floors = {name: asdict(Error(FLOOR, FLOOR, FLOOR)) for name in ("drop", "energy")}
    data = {"about": {"scene": size}, "scene": scene, "reference": {"how": "", "floors": floors}, "premises": premises}
    path.write_text(json.dumps(data | {"points": [asdict(one) for one in points]}))
    return path


def test_files_are_compared_and_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a = write(tmp_path / "a.json", written_point("a"), written_point("b"))
    b = write(tmp_path / "b.json", written_point("a"), written_point("b", error=3e-3, times=(3.0, 3.3)))
    assert read(a).points == result(written_point("a"), written_point("b")).points
    assert main(["bench", "compare", str(a), str(b), "--html", str(tmp_path / "page.html")]) == 0
    said = capsys.readouterr().out
    assert "0 in outcome, 1 in error, 1 in time" in said
    assert "error, time" in said and "3.15" in said
    assert "error, time" in (tmp_path / "page.html").read_text()


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"points": [{}], "reference": {"floors": {}}}', '{"points": 3}'])
def test_another_file_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str) -> None:
    good, other = write(tmp_path / "a.json", written_point("a")), tmp_path / "other.json"
    other.write_text(content)
    assert main(["bench", "compare", str(good), str(other)]) == 2
    assert "no result of a precision sweep" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("a", "b", "field", "values"),
    [
        ({"duration": 0.3}, {"duration": 0.2, "size": "0.2 s"}, "duration", ("0.3", "0.2")),
        ({"gravity[1]": -9.81}, {"gravity[1]": -1.62}, "gravity[1]", ("-9.81", "-1.62")),
        ({"file a.obj": "ab"}, {"file a.obj": "cd"}, "file a.obj", ("ab", "cd")),
        ({}, {"size": "0.2 s"}, "size and duration", ("0.3 s", "0.2 s")),
    ],
)
def test_sweeps_of_other_scenes_of_one_name_are_refused(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    a: dict[str, Any],
    b: dict[str, Any],
    field: str,
    values: tuple[str, str],
) -> None:
    first = write(tmp_path / "a.json", written_point("a"), **a)
    second = write(tmp_path / "b.json", written_point("a"), **b)
    assert main(["bench", "compare", str(first), str(second)]) == 2
    said = capsys.readouterr().err
    assert field in said and all(value in said for value in values) and "b.json" in said


def test_versions_solvers_and_what_one_result_lacks_are_no_other_scene(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = write(tmp_path / "a.json", written_point("a"), **{"version nuno": "1", "solver.dt": 1e-3, "view.fps": 1})
    second = write(tmp_path / "b.json", written_point("a"), **{"version nuno": "2", "solver.dt": 2e-3, "seed": 0})
    older = write(tmp_path / "c.json", written_point("a"))
    assert main(["bench", "compare", str(first), str(second)]) == 0
    said = capsys.readouterr().out
    assert "solver.dt (0.001 in A, 0.002 in B)" in said and "seed" in said
    assert "version" not in said and "view" not in said
    assert main(["bench", "compare", str(older), str(second)]) == 0
    assert "only size and duration were compared" in capsys.readouterr().out


def test_results_without_anything_in_common_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a = write(tmp_path / "a.json", written_point("a"))
    for b, said in (
        (write(tmp_path / "b.json", written_point("b")), "no point in common"),
        (write(tmp_path / "c.json", written_point("a"), scene="skirt"), "two scenes"),
        (tmp_path / "nowhere.json", "cannot be read"),
    ):
        assert main(["bench", "compare", str(a), str(b)]) == 2
        assert said in capsys.readouterr().err
