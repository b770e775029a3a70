"""Error over wall time: orders that a sweep must show, what it keeps and leaves out, and what it refuses."""

from __future__ import annotations

import argparse
import csv
import json
from dataclasses import replace
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from line_net import problem_of, reference_of, write_net
from scenes import BALL, write_scene

from nuno import registry
from nuno.cli import main as nuno_main
from nuno.viewer.layout import entity
from nuno_bench import executor, precision, precision_run
from nuno_bench.observe import Problem, simulate
from nuno_bench.packed import pack
from nuno_bench.precision_errors import POSITIONS, Error, find_scales, measure_errors
from nuno_bench.precision_findings import choice_rows, fit_order, judge
from nuno_bench.precision_page import Findings
from nuno_bench.precision_point import Kept, Point
from nuno_bench.precision_untimed import UNTIMED, run_untimed
from nuno_bench.reference import GROUP, Reference
from nuno_bench.sweep import choose_solvers
from nuno_integrators.symplectic_euler import SymplecticEuler
from nuno_schemas.errors import BadInput
from nuno_schemas.plugin import Config, StepReport

FLAGS = ("--repeats", "1", "--budget", "600")


def arguments(path: Path, *flags: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    precision.add_arguments(parser)
    return parser.parse_args([str(path), *FLAGS, "--out", str(path.parent / "out"), *flags])


def swept(path: Path, *flags: str) -> Findings:
    args = arguments(path, *flags)
    with executor.opened(args, 1) as where:
        return precision.sweep_scene(precision._check(args)[0], args, where)


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Findings:
    """The line's whole sweep."""
    return swept(write_net(tmp_path_factory.mktemp("line")))


def points_of(found: Findings, solver: str) -> list[Point]:
    return [point for point in found.points if point.solver == solver]


@pytest.mark.parametrize(
    ("solver", "order"),
    [("symplectic_euler", 1), ("leapfrog", 2), ("rk4", 4), ("implicit_euler", 1), ("tr_bdf2", 2)],
)
def test_errors_fall_at_the_nominal_order(found: Findings, solver: str, order: int) -> None:
    seen = fit_order(points_of(found, solver), POSITIONS, found.floors[POSITIONS].l2)
    assert seen == pytest.approx(order, abs=0.1)


def test_the_floor_is_below_every_error_and_all_are_judged(found: Findings) -> None:
    errors = [error for point in found.points if (error := point.error(POSITIONS)) is not None]
    assert len(errors) > 30
    assert found.floors[POSITIONS].l2 < 1e-12
    assert min(errors) > 3.0 * found.floors[POSITIONS].l2
    assert {judgement.verdict for judgement in judge(found.points, found.floors)} == {"judged"}


def test_every_installed_solver_is_run_or_named(found: Findings) -> None:
    run = {point.solver for point in found.points}
    assert run | {one.solver for one in found.sweep.omitted} == set(registry.installed(GROUP))
    assert len({point.key for point in found.points}) == len(found.points)
    assert "slips" in next(one.reason for one in found.sweep.omitted if one.solver == "rk4_printed")


class Halved(SymplecticEuler):
    """Another package's solver: two steps for one."""

    name = "halved"

    def advance(self, system: Any, state: Any, memory: Any, poses: Any, steps: int, dt: float) -> StepReport:
        return super().advance(system, state, memory, poses, 2 * steps, dt / 2)


class Particular(Halved):
    """One that cannot be run without being told something."""

    name = "particular"

    class Config(Config):  # type: ignore[assignment]
        needed: float


def test_solvers_of_other_packages_take_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    problem, own = problem_of(write_net(tmp_path)), entry_points(group=GROUP)
    foreign = [EntryPoint(each.name, f"{__name__}:{each.__name__}", GROUP) for each in (Halved, Particular)]
    monkeypatch.setattr(registry, "entry_points", lambda group: [*own, *foreign] if group == GROUP else [])
    solvers, omitted = choose_solvers(problem, ["halved", "symplectic_euler", "particular"])
    assert [solver.name for solver in solvers] == ["halved", "symplectic_euler"]
    assert [one.solver for one in omitted] == ["particular"] and "needed" in omitted[0].reason
    reference = reference_of(problem)
    runner = precision_run.Runner(problem, reference, find_scales(problem, reference.run.series), 21, 1)
    half, whole = (runner.measure(solver, solver.settings[0], 1.0, 1.0).errors[POSITIONS].l2 for solver in solvers)
    assert whole / half == pytest.approx(2.0, rel=0.1)


def test_short_runs_are_repeated_more_often(found: Findings) -> None:
    repeats = {len(point.seconds) for point in found.points if point.done and max(point.seconds) < 0.005}
    assert repeats == {precision_run.MORE}


def test_adaptive_errors_follow_the_tolerance(tmp_path: Path) -> None:
    """Over a hundredfold they fall a hundredfold, give or take a few, where a frame holds several steps."""
    found = swept(write_net(tmp_path, frame_rate=5, duration=4), "--solvers", "dopri5,dop853")
    for solver in ("dopri5", "dop853"):
        points = sorted(points_of(found, solver), key=lambda point: -point.finer)
        assert [point.setting for point in points] == [f"tolerance 1e-{i:02}" for i in range(3, 10)]
        slope = fit_order(points, POSITIONS, found.floors[POSITIONS].l2)
        assert slope == pytest.approx(1.0, abs=0.2)


def test_a_step_beyond_the_limit_is_a_marked_failure(tmp_path: Path) -> None:
    """Frames long enough for steps beyond the limit: those diverge, all below the limit do not."""
    found = swept(write_net(tmp_path, frame_rate=5, duration=60), "--solvers", "symplectic_euler,rk4,leapfrog")
    beyond = [point for point in found.points if point.beyond]
    assert {point.solver for point in beyond} == {"symplectic_euler", "rk4", "leapfrog"}
    assert {point.outcome for point in beyond} <= {"diverged", "ran away"}
    assert all(point.message and not point.errors and point.seconds for point in beyond)
    assert all(point.done for point in found.points if not point.beyond)
    page = precision.write(tmp_path / "page", found)[0].read_text()
    assert all(point.setting in page and point.message in page for point in beyond)


def test_runs_of_one_problem_do_not_touch_each_other(tmp_path: Path) -> None:
    """The system is shared; friction anchors and steps are not."""
    problem = problem_of(write_scene(tmp_path, bodies=BALL, gravity=[0.0, -9.81, 0.0]))
    plugin = registry.load(GROUP, "symplectic_euler")
    first = simulate(problem, plugin, plugin.Config(), 40).series
    other = registry.load(GROUP, "dopri5")
    simulate(problem, other, other.Config(), 1)
    again = simulate(problem, plugin, plugin.Config(), 40).series
    assert again.x.tobytes() == first.x.tobytes()


def test_a_scene_with_a_body_is_swept(tmp_path: Path) -> None:
    path = write_scene(tmp_path, bodies=BALL, duration=0.2)
    found = swept(path, "--solvers", "symplectic_euler,implicit_euler,dopri5")
    assert "dop853" in found.how
    best = {name: min(e for p in points_of(found, name) if (e := p.error("centre")) is not None) for name in
            ("symplectic_euler", "implicit_euler", "dopri5")}  # fmt: skip
    assert max(best.values()) < 1e-2 and best["dopri5"] < 1e-4


def test_a_reference_that_disagrees_with_itself_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def unsure(problem: Problem, *rest: Any) -> Reference:
        sure = reference_of(problem)
        coarse = simulate(
            problem, registry.load(GROUP, "implicit_euler"), registry.load(GROUP, "implicit_euler").Config(), 1
        )
        return Reference(sure.run, coarse, "made to disagree", 0.0, sure.twin)  # fmt: skip

    monkeypatch.setattr(precision, "make_reference", unsure)
    path = write_net(tmp_path)
    assert nuno_main(["bench", "precision", str(path), *FLAGS, "--solvers", "rk4,dopri5", "--out", str(tmp_path)]) == 1
    said = capsys.readouterr()
    assert "nothing is known of them" in said.out and "judges no point" in said.err


def test_an_interrupted_sweep_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, whole, taken = write_net(tmp_path), precision_run.Runner.measure, list[str]()

    def measure(self: precision_run.Runner, solver: Any, setting: Any, *times: float) -> Point:
        if len(taken) == 5:
            raise KeyboardInterrupt
        taken.append(setting.label)
        return whole(self, solver, setting, *times)

    monkeypatch.setattr(precision_run.Runner, "measure", measure)
    with pytest.raises(KeyboardInterrupt):
        swept(path, "--solvers", "rk4,leapfrog")
    lines = (tmp_path / "out" / "precision-line.jsonl").read_text().splitlines()
    assert len(lines) == 6
    # The last point was being written when the power went.
    (tmp_path / "out" / "precision-line.jsonl").write_text("\n".join(lines)[:-10])
    first, taken[:] = {tuple(json.loads(line)["seconds"]) for line in lines[1:5]}, []
    monkeypatch.setattr(precision_run.Runner, "measure", whole)
    found = swept(path, "--solvers", "rk4,leapfrog", "--resume")
    assert len(first & {point.seconds for point in found.points}) == 4
    assert len({point.key for point in found.points}) == len(found.points) > 8


def test_what_does_not_belong_together_is_not_resumed(tmp_path: Path) -> None:
    path = write_net(tmp_path)
    with pytest.raises(BadInput, match="no sweep"):
        swept(path, "--solvers", "rk4", "--resume")
    swept(path, "--solvers", "rk4")
    with pytest.raises(BadInput, match="another sweep"):
        swept(path, "--solvers", "rk4", "--resume", "--set", "damping=0.2")


def test_a_budget_leaves_finer_points_out_by_name(tmp_path: Path, found: Findings) -> None:
    small = swept(write_net(tmp_path), "--budget", "0.02", "--solvers", "rk4,leapfrog,tr_bdf2")
    dropped = {(one.solver, one.setting) for one in small.sweep.omitted}
    kept = {point.key for point in small.points}
    assert dropped and all("budget" in one.reason for one in small.sweep.omitted)
    assert dropped.isdisjoint(kept)
    assert dropped | kept == {p.key for p in found.points if p.solver in ("rk4", "leapfrog", "tr_bdf2")}


def test_a_slow_solver_takes_no_fast_ones_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """rk4, first by its place in the list, is given 40 of 60 s a point: leapfrog is through before it begins."""
    order = list[str]()

    def measure(self: precision_run.Runner, solver: Any, setting: Any, *times: float) -> Point:
        order.append(solver.name)
        return self._point(solver, setting, "done", "", (setting.work * costs[solver.name],))

    problem = problem_of(write_net(tmp_path))
    reference = reference_of(problem)
    runner = precision_run.Runner(problem, reference, find_scales(problem, reference.run.series), 21, 1)
    solvers, _ = choose_solvers(problem, ["rk4", "leapfrog"])
    costs = {"rk4": 40.0, "leapfrog": 0.1}
    sweep = precision_run.Sweep(costs=costs)
    monkeypatch.setattr(precision_run.Runner, "measure", measure)
    precision_run.run_sweep(sweep, runner, solvers, Kept(tmp_path / "kept", {}, False), 60.0, lambda text: None)
    fast = len(solvers[1].settings)
    assert order[:fast] == ["leapfrog"] * fast and "rk4" in order[fast:]
    assert {one.solver for one in sweep.omitted} == {"rk4"}
    assert [point.solver for point in sweep.points] == sorted(order, reverse=True)


def test_points_too_slow_for_the_budget_are_computed_beside_each_other_without_times(
    tmp_path: Path, found: Findings
) -> None:
    """With the same bits as alone, and no word on how fast they are."""
    path = write_net(tmp_path)
    args, told = arguments(path, "--jobs", "2"), list[str]()
    problem = problem_of(path)
    reference = reference_of(problem)
    runner = precision_run.Runner(problem, reference, find_scales(problem, reference.run.series), 21, 1)
    solvers, _ = choose_solvers(problem, ["rk4", "leapfrog"])
    sweep = precision_run.start_sweep(problem, solvers, told.append)
    kept = Kept(tmp_path / "kept", {}, False)
    precision_run.run_sweep(sweep, runner, solvers, kept, 1e-9, told.append)
    assert sweep.points == [] and len(sweep.unaffordable) > 8
    with executor.opened(args, 1) as where:
        run_untimed(sweep, runner, pack(path, ["allow_unstable=true"]), kept, 60.0, where, told.append)
    alone = {point.key: point for point in found.points}
    assert {point.key for point in sweep.points} == {key for key in alone if key[0] in ("rk4", "leapfrog")}
    assert all(point == replace(alone[point.key], seconds=()) for point in sweep.points)
    assert all(UNTIMED in one.reason for one in sweep.omitted)
    assert choice_rows(sweep.points, POSITIONS, 0.0) == []
    page = precision.write(tmp_path / "page", replace(found, sweep=sweep))[0].read_text()
    assert all(point.setting in page for point in sweep.points)


def test_without_predictable_time_only_observables_are_compared(tmp_path: Path, found: Findings) -> None:
    horizon = replace(found.horizon, frames=1, t=0.0, whole=False)
    floors = {name: floor for name, floor in found.floors.items() if name != POSITIONS}
    page = precision.write(tmp_path / "line", replace(found, horizon=horizon, floors=floors))[0].read_text()
    assert "Positions cannot be compared" in page and page.count("<svg") == 1
    problem = problem_of(write_net(tmp_path))
    run = reference_of(problem).run.series
    assert set(measure_errors(run, run, find_scales(problem, run), 1)) == {"energy", "centre", "drop", "strain"}


def test_files_hold_every_point(tmp_path: Path, found: Findings) -> None:
    html, table, data = precision.write(tmp_path / "line", found)
    content = json.loads(data.read_text())
    assert [Point.from_json(point) for point in content["points"]] == found.points
    with table.open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == sum(max(1, len(point.errors)) for point in found.points)
    text = html.read_text()
    assert all(point.setting in text for point in found.points)
    assert text.count("<svg") == 2 and "http" not in text.replace("http://www.w3.org", "")


def test_a_rerun_file_holds_every_point_and_its_error_over_the_frames(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="needs nuno[view]")
    import rerun.chunk

    from nuno_bench import precision_rerun

    found = swept(write_net(tmp_path), "--solvers", "rk4,leapfrog")
    path = precision_rerun.write(tmp_path / "line.rrd", [found])
    assert not list(tmp_path.glob("*.part"))
    curves, dots = dict[str, list[float]](), dict[str, list[list[float]]]()
    for chunk in rerun.chunk.RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        if "Scalars:scalars" in batch.schema.names:
            curves[chunk.entity_path] = [value[0] for value in batch["Scalars:scalars"].to_pylist()]
        if "/solvers/" in chunk.entity_path and "Points2D:positions" in batch.schema.names:
            dots[chunk.entity_path] = batch["Points2D:positions"].to_pylist()[0]
    done = [each for each in found.points if each.done]
    assert len(curves) == sum(len(each.history) for each in done) == 5 * len(done)
    for each in done:
        curve = 10.0 ** np.array(curves[entity("line", POSITIONS, "frames", each.solver, each.setting)])
        assert np.sqrt((curve**2).mean()) == pytest.approx(each.errors[POSITIONS].l2, rel=1e-3)
    rk4 = sorted((each for each in done if each.solver == "rk4"), key=lambda each: -each.finer)
    drawn = np.array(dots[entity("line", POSITIONS, "wall time", "solvers", "rk4")])
    expected = [[3.0 * np.log10(each.median), -np.log10(each.errors[POSITIONS].l2)] for each in rk4]
    assert drawn == pytest.approx(np.array(expected), rel=1e-5)


def point(error: float, solver: str = "rk4", seconds: float = 1.0, beyond: bool = False) -> Point:
    setting, errors = f"{error:g}", {"drop": Error(0.0, error, 0.0)}
    return Point(solver, setting, "fixed steps", 4, error, beyond, "done", "", (seconds,), {}, errors)


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
        (("--repeats", "0"), "one repeat"),
        (("--jobs", "0"), "at least one process"),
        (("--rrd", "series.txt"), "ends in .rrd"),
        (("--jobs", "2", "--dask", "tcp://127.0.0.1:1"), "either --jobs or --dask"),
        (("--observable", "dropp"), "drop"),
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
