"""What a precision sweep says: files, judgements and choices that follow from the points."""

from __future__ import annotations

import base64
import csv
import json
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from dye_scene import write_scene as write_dyed
from line_net import problem_of, reference_of, write_net
from precision_sweeps import swept
from rrd import columns
from scenes import BALL, write_scene

from nuno.cli import main as nuno_main
from nuno.viewer.layout import entity
from nuno_bench.precision.command import Findings, _own, orders, over_frames, over_wall_time, report, tabs
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
def test_where_there_is_contact_orders_are_not_left_to_speak_for_themselves(tmp_path: Path, found: Findings) -> None:
    over_ball = problem_of(write_scene(tmp_path, bodies=BALL))
    assert "over a jump no method has its order" not in orders(found).caption
    assert "over a jump no method has its order" in orders(replace(found, problem=over_ball)).caption


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
