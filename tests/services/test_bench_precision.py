"""Error over wall time: orders, what a sweep keeps, leaves out and refuses, and the scene's own step."""

from __future__ import annotations

import csv
import json
import re
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import pytest
from dye_wave import write_wave
from line_net import problem_of, reference_of, write_net
from precision_sweeps import FLAGS, points_of, swept
from scenes import BALL, write_scene

from nuno.cli import main as nuno_main
from nuno.plugin_contract import registry
from nuno_bench import machine
from nuno_bench.precision import command as precision
from nuno_bench.precision.command import Findings, orders, report
from nuno_bench.precision.sweep import MORE, Runner, SolverPoint, Sweep, choose_solvers, fit_order, judge, run_sweep
from nuno_bench.problem import AMOUNTS, POSITIONS, Problem, simulate
from nuno_bench.reference import Reference
from nuno_bench.report.page import number
from nuno_bench.sweep.executor import SweepFile
from nuno_integrators.explicit.fixed_step import SymplecticEuler
from nuno_kernels import kernel
from nuno_schemas.errors import BadInput
from nuno_schemas.plugin import GROUPS, Config
from nuno_schemas.system import StepReport

GROUP = Problem.group


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Findings:
    """The line's whole sweep."""
    return swept(write_net(tmp_path_factory.mktemp("line")))


@pytest.mark.full
@pytest.mark.parametrize(
    ("solver", "order"),
    [("symplectic_euler", 1), ("leapfrog", 2), ("rk4", 4), ("implicit_euler", 1), ("tr_bdf2", 2)],
)
def test_errors_fall_at_the_nominal_order(found: Findings, solver: str, order: int) -> None:
    seen = fit_order(points_of(found, solver), POSITIONS, found.floors[POSITIONS].l2)
    assert seen == pytest.approx(order, abs=0.1)


@pytest.mark.full
def test_the_floor_is_below_every_error_and_all_are_judged(found: Findings) -> None:
    errors = [error for point in found.points if (error := point.error(POSITIONS)) is not None]
    assert len(errors) > 30
    assert found.floors[POSITIONS].l2 < 1e-10
    assert min(errors) > 3.0 * found.floors[POSITIONS].l2
    assert {judgement.verdict for judgement in judge(found.points, found.floors)} == {"judged"}


@pytest.mark.full
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
    runner = Runner(problem, reference, problem.scales(reference.run.series), 21, 1)
    half, whole = (runner.measure(solver, solver.settings[0], 1.0, 1.0).errors[POSITIONS].l2 for solver in solvers)
    assert whole / half == pytest.approx(2.0, rel=0.1)


class Raising(Halved):
    """One that raises in the middle of a run."""

    name = "raising"

    def advance(self, system: Any, state: Any, *rest: Any) -> StepReport:
        if state.t > 0.2:
            raise ValueError("in the middle")
        return super().advance(system, state, *rest)


@kernel
def advance_wrongly(x: Any, v: Any, stages: Any, steps: int, dt: float, p: Any) -> None:
    """What no compiler takes."""
    if steps < 0:
        x.no_such_thing()


class Uncompiled(SymplecticEuler):
    """One that cannot be compiled."""

    name = "uncompiled"

    def steps_of(self, work: Any) -> Any:
        return advance_wrongly


@pytest.mark.full
def test_a_solver_that_fails_ends_itself_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whether in the middle of a run or at its first call: table, page and data say why, and have the others."""
    foreign = [EntryPoint(each.name, f"{__name__}:{each.__name__}", GROUP) for each in (Raising, Uncompiled)]
    known = {group: [*entry_points(group=group), *(foreign if group == GROUP else ())] for group in GROUPS}
    monkeypatch.setattr(registry, "entry_points", lambda group: known[group])
    names = "raising,uncompiled,symplectic_euler"
    path = write_net(tmp_path)
    assert nuno_main(["bench", "precision", str(path), *FLAGS, "--solvers", names, "--out", str(tmp_path)]) == 0
    with (tmp_path / "precision-line.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert {row["outcome"] for row in rows if row["solver"] == "symplectic_euler"} == {"done"}
    raised = [row for row in rows if row["solver"] == "raising"]
    assert raised and {row["outcome"] for row in raised} == {"failed"} and all(float(row["seconds"]) for row in raised)
    page = (tmp_path / "precision-line.html").read_text()
    assert "ValueError: in the middle" in page and "no_such_thing" in page
    assert "uncompiled is left out" in capsys.readouterr().err


@pytest.mark.full
def test_short_runs_are_repeated_more_often(found: Findings) -> None:
    repeats = {len(point.seconds) for point in found.points if point.done and max(point.seconds) < 0.005}
    assert repeats == {MORE}


@pytest.mark.full
def test_adaptive_errors_follow_the_tolerance(tmp_path: Path) -> None:
    """Over a hundredfold they fall a hundredfold, give or take a few, where a frame holds several steps."""
    found = swept(write_net(tmp_path, frame_rate=5, duration=2), "--solvers", "dopri5,dop853")
    for solver in ("dopri5", "dop853"):
        points = sorted(points_of(found, solver), key=lambda point: -point.finer)
        assert [point.setting for point in points] == [f"tolerance 1e-{i:02}" for i in range(3, 10)]
        slope = fit_order(points, POSITIONS, found.floors[POSITIONS].l2)
        assert slope == pytest.approx(1.0, abs=0.2)


@pytest.mark.full
def test_a_step_beyond_the_limit_is_a_marked_failure(tmp_path: Path) -> None:
    """Frames long enough for steps beyond the limit: those diverge, all below the limit do not."""
    found = swept(write_net(tmp_path, frame_rate=5, duration=60), "--solvers", "symplectic_euler,rk4,leapfrog")
    beyond = [point for point in found.points if point.beyond]
    assert {point.solver for point in beyond} == {"symplectic_euler", "rk4", "leapfrog"}
    assert {point.outcome for point in beyond} <= {"diverged", "ran away"}
    assert all(point.message and not point.errors and point.seconds for point in beyond)
    assert all(point.done for point in found.points if not point.beyond)
    page = report(found).page()
    assert all(point.setting in page and point.message in page for point in beyond)


@pytest.mark.parametrize("solver", ["symplectic_euler", "implicit_euler"])
def test_a_frame_that_would_take_hours_is_abandoned_when_its_time_is_over(solver: str, tmp_path: Path) -> None:
    problem, plugin = problem_of(write_scene(tmp_path)), registry.load(GROUP, solver)
    run = simulate(problem, plugin, plugin.Config(), 10**9, most_seconds=0.2)
    assert run.status == "cut" and len(run.series.x) == 1


def test_runs_of_one_problem_do_not_touch_each_other(tmp_path: Path) -> None:
    """The system is shared; friction anchors and steps are not."""
    problem = problem_of(write_scene(tmp_path, bodies=BALL, gravity=[0.0, -9.81, 0.0]))
    plugin = registry.load(GROUP, "symplectic_euler")
    first = simulate(problem, plugin, plugin.Config(), 40).series
    other = registry.load(GROUP, "dopri5")
    simulate(problem, other, other.Config(), 1)
    again = simulate(problem, plugin, plugin.Config(), 40).series
    assert again.x.tobytes() == first.x.tobytes()


@pytest.mark.full
def test_a_scene_with_a_body_is_swept(tmp_path: Path) -> None:
    path = write_scene(tmp_path, bodies=BALL, duration=0.2)
    found = swept(path, "--solvers", "symplectic_euler,implicit_euler,dopri5")
    assert "dop853" in found.how
    best = {name: min(e for p in points_of(found, name) if (e := p.error("centre")) is not None) for name in
            ("symplectic_euler", "implicit_euler", "dopri5")}  # fmt: skip
    assert max(best.values()) < 1e-2 and best["dopri5"] < 1e-4


@pytest.mark.full
def test_a_reference_that_disagrees_with_itself_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def unsure(problem: Problem, *rest: Any) -> Reference:
        sure = reference_of(problem)
        coarse = simulate(
            problem, registry.load(GROUP, "implicit_euler"), registry.load(GROUP, "implicit_euler").Config(), 1
        )
        return Reference(sure.run, coarse, "made to disagree", 0.0, sure.twin)  # fmt: skip

    monkeypatch.setattr("nuno_bench.reference.make_reference", unsure)
    path = write_net(tmp_path)
    assert nuno_main(["bench", "precision", str(path), *FLAGS, "--solvers", "rk4,dopri5", "--out", str(tmp_path)]) == 1
    said = capsys.readouterr()
    assert "failed" in said.out and "judges no point" in said.err


SOLVERS = "rk4,leapfrog,tr_bdf2"


@pytest.fixture(scope="module")
def points_kept(tmp_path_factory: pytest.TempPathFactory) -> Findings:
    """The line's sweep by three solvers; all of them are swept where orders are tested."""
    return swept(write_net(tmp_path_factory.mktemp("line")), "--solvers", SOLVERS)


def test_an_interrupted_sweep_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, whole, taken = write_net(tmp_path), Runner.measure, list[str]()

    def measure(self: Runner, solver: Any, setting: Any, *times: float) -> SolverPoint:
        if len(taken) == 5:
            raise KeyboardInterrupt
        taken.append(setting.label)
        return whole(self, solver, setting, *times)

    monkeypatch.setattr(Runner, "measure", measure)
    with pytest.raises(KeyboardInterrupt):
        swept(path, "--solvers", "rk4,leapfrog")
    lines = (tmp_path / "out" / "precision-line.jsonl").read_text().splitlines()
    assert len(lines) == 6
    # The last point was being written when the power went.
    (tmp_path / "out" / "precision-line.jsonl").write_text("\n".join(lines)[:-10])
    first, taken[:] = {tuple(json.loads(line)["seconds"]) for line in lines[1:5]}, []
    monkeypatch.setattr(Runner, "measure", whole)
    points_kept = swept(path, "--solvers", "rk4,leapfrog", "--resume")
    assert len(first & {point.seconds for point in points_kept.points}) == 4
    assert len({point.key for point in points_kept.points}) == len(points_kept.points) > 8


@pytest.mark.full
def test_scenes_that_never_began_are_begun_by_a_resumed_sweep(tmp_path: Path) -> None:
    first, second = write_net(tmp_path), tmp_path / "other.yaml"
    second.write_text(first.read_text().replace("name: line", "name: other", 1))
    flags = [*FLAGS, "--solvers", "leapfrog", "--out", str(tmp_path / "out")]
    assert nuno_main(["bench", "precision", str(first), *flags]) == 0
    before = (tmp_path / "out" / "precision-line.jsonl").read_text()
    assert nuno_main(["bench", "precision", str(first), str(second), *flags, "--resume"]) == 0
    assert (tmp_path / "out" / "precision-line.jsonl").read_text() == before
    content = json.loads((tmp_path / "out" / "precision-other.json").read_text())
    assert len(content["points"]) == len(before.splitlines()) - 2


def test_what_does_not_belong_together_is_not_resumed(tmp_path: Path) -> None:
    path = write_net(tmp_path)
    with pytest.raises(BadInput, match="no sweep"):
        swept(path, "--solvers", "rk4", "--resume")
    swept(path, "--solvers", "rk4")
    with pytest.raises(BadInput, match="another sweep"):
        swept(path, "--solvers", "rk4", "--resume", "--set", "damping=0.2")


def test_a_slow_solver_takes_no_fast_ones_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """rk4, first by its place in the list, is given 40 of 60 s a point: leapfrog is through before it begins."""
    order = list[str]()

    def measure(self: Runner, solver: Any, setting: Any, *times: float) -> SolverPoint:
        order.append(solver.name)
        seconds = (setting.work * {"rk4": 40.0, "leapfrog": 0.1}[solver.name],)
        return SolverPoint(
            solver.name, setting.label, "", 0, setting.finer, setting.beyond, "done", "", seconds, {}, {}
        )

    problem = problem_of(write_net(tmp_path))
    reference = reference_of(problem)
    runner = Runner(problem, reference, problem.scales(reference.run.series), 21, 1)
    solvers, _ = choose_solvers(problem, ["rk4", "leapfrog"])
    costs = {"rk4": 40.0, "leapfrog": 0.1}
    sweep = Sweep(costs=costs)
    monkeypatch.setattr(Runner, "measure", measure)
    run_sweep(sweep, runner, solvers, SweepFile(tmp_path / "kept", {}, False, print), 60.0, lambda text: None)
    fast = len(solvers[1].settings)
    assert order[:fast] == ["leapfrog"] * fast and "rk4" in order[fast:]
    assert {one.solver for one in sweep.omitted} == {"rk4"}
    assert [point.solver for point in sweep.points] == sorted(order, reverse=True)


@pytest.mark.full
def test_a_budget_leaves_finer_points_out_by_name(tmp_path: Path, points_kept: Findings) -> None:
    small = swept(write_net(tmp_path), "--budget", "0.02", "--solvers", SOLVERS)
    dropped = {(one.solver, one.setting) for one in small.sweep.omitted}
    kept = {point.key for point in small.points}
    assert dropped and all("budget" in one.reason for one in small.sweep.omitted)
    assert dropped.isdisjoint(kept)
    assert dropped | kept == {p.key for p in points_kept.points}


def test_a_place_that_cannot_be_written_is_refused_before_a_reference_is_computed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(precision, "pose", None)
    path = write_net(tmp_path)
    (tmp_path / "out").write_text("a file in the folder's place")
    with pytest.raises(BadInput, match="cannot write there") as refused:
        swept(path)
    assert (refused.value.field, refused.value.value) == ("--out", str(tmp_path / "out"))


def of(found: Findings, label: str) -> SolverPoint:
    return next(point for point in found.points if point.key == (found.own.solver, label))


def test_the_own_step_and_twice_it_are_swept_and_the_sentence_is_that_of_their_rows(tmp_path: Path) -> None:
    """rk4 at 10 and at 5 steps a frame, neither of which is a share of the limit: 16 times the error."""
    found = swept(write_net(tmp_path, solver={"plugin": "rk4", "dt": 0.002}), "--solvers", "rk4,leapfrog")
    own, coarser = (of(found, label) for label in (found.own.setting, found.own.coarser))
    assert (own.finer, coarser.finer) == pytest.approx((0.002, 0.004))
    assert len({point.key for point in found.points}) == len(found.points)
    errors = [point.errors[POSITIONS].l2 for point in (own, coarser)]
    assert errors[1] / errors[0] == pytest.approx(16.0, rel=0.1)
    said = found.own_sentence
    assert said.startswith(f"This scene as it is (rk4, {own.setting}): error in positions {errors[0]:.2e}, run time ")
    ratios = re.findall(r"\(([\d.]+) times\)", said)
    assert ratios == [number(errors[1] / errors[0]), number(coarser.median / own.median)]
    assert f"with a step twice as large ({coarser.setting}): error in positions {errors[1]:.2e}" in said


@pytest.mark.full
def test_the_command_and_its_files_begin_with_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_net(tmp_path, solver={"plugin": "rk4", "dt": 0.002})
    assert nuno_main(["bench", "precision", str(path), *FLAGS, "--solvers", "rk4", "--out", str(tmp_path)]) == 0
    content = json.loads((tmp_path / "precision-line.json").read_text())
    said = content["own"]["said"]
    assert capsys.readouterr().out.strip().startswith(said)
    page = (tmp_path / "precision-line.html").read_text()
    assert said in page[: page.index("<h2>")]
    first = [json.loads(line)["setting"] for line in (tmp_path / "precision-line.jsonl").read_text().splitlines()[1:3]]
    assert set(first) == {content["own"]["setting"], content["own"]["coarser"]}, "run before all others"


@pytest.mark.full
@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"frame_rate": 5, "solver": {"plugin": "rk4", "dt": 0.05}}, "a step twice as large is above the stability"),
        ({"solver": {"plugin": "rk4", "dt": 0.02}}, "a step twice as large is longer than a frame"),
        ({"solver": {"plugin": "rk4", "dt": 0.004}}, "with a step 1.67 times as large (whole steps make a frame)"),
        ({"solver": "leapfrog"}, "(leapfrog) has no point: it is not among the solvers that are swept"),
        (
            {"frame_rate": 5, "duration": 60, "solver": {"plugin": "rk4", "dt": 0.2}},
            ": diverged (|: ran away (",
        ),
    ],
)
def test_what_cannot_be_compared_is_said_instead(tmp_path: Path, fields: dict[str, Any], said: str) -> None:
    found = swept(write_net(tmp_path, **fields), "--solvers", "rk4")
    sentence = found.own_sentence
    assert any(each in sentence for each in said.split("|")), sentence
    if "above the stability" in said:
        assert found.own.coarser == "" and of(found, found.own.setting).done


@pytest.mark.full
def test_an_adaptive_solver_is_swept_at_its_own_tolerance(tmp_path: Path) -> None:
    fields = {"frame_rate": 5, "duration": 2, "solver": {"plugin": "dopri5", "tolerance": 3e-7}}
    found = swept(write_net(tmp_path, **fields), "--solvers", "dopri5")
    assert (found.own.setting, found.own.coarser) == ("tolerance 3e-07", "tolerance 3e-06")
    own, coarser = (of(found, label) for label in (found.own.setting, found.own.coarser))
    assert (own.finer, coarser.finer) == pytest.approx((3e-7, 3e-6))
    assert coarser.errors[POSITIONS].l2 > own.errors[POSITIONS].l2
    assert "with 10 times the tolerance (tolerance 3e-06)" in found.own_sentence


@pytest.mark.full
def test_an_implicit_solver_keeps_its_own_residual(tmp_path: Path) -> None:
    """A loose one, which the sweep's own settings would tighten."""
    fields = {"solver": {"plugin": "implicit_euler", "dt": 0.0025, "residual": 5e-3}}
    found = swept(write_net(tmp_path, **fields), "--solvers", "implicit_euler")
    labels = found.own.setting, found.own.coarser
    assert labels == ("dt 2.5 ms, residual 5.0e-03", "dt 5 ms, residual 5.0e-03")
    assert all(of(found, label).done for label in labels)
    without = [point for point in found.points if point.setting not in labels]
    slope = fit_order(without, POSITIONS, found.floors[POSITIONS].l2)
    assert slope == pytest.approx(1.0, abs=0.1)
    assert orders(found).rows[0][3] == f"{slope:.2f}", "what the own residual leaves is no error of the step"


@pytest.mark.full
def test_a_solver_that_the_scene_leaves_open_is_the_one_that_is_chosen(tmp_path: Path) -> None:
    path = write_net(tmp_path, solver="auto", accuracy="normal")
    found = swept(path, "--solvers", "symplectic_euler,leapfrog,rk4")
    assert found.own.solver in {"symplectic_euler", "leapfrog", "rk4"}
    error = of(found, found.own.setting).error(POSITIONS)
    assert error is not None and error < 3e-3


@pytest.mark.full
def test_dye_has_its_own_step_too(tmp_path: Path) -> None:
    """The explicit scheme's error is of first order."""
    found = swept(write_wave(tmp_path, solver={"plugin": "explicit", "dt": 0.5}), "--solvers", "explicit")
    own, coarser = (of(found, label) for label in (found.own.setting, found.own.coarser))
    assert (own.finer, coarser.finer) == pytest.approx((0.5, 1.0))
    ratio = coarser.errors[AMOUNTS].l2 / own.errors[AMOUNTS].l2
    assert ratio == pytest.approx(2.0, rel=0.1)
    assert f"error in amounts {coarser.errors[AMOUNTS].l2:.2e} ({number(ratio)} times)" in found.own_sentence


@pytest.mark.full
def test_disturbed_times_are_called_so_beside_what_is_fastest(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(machine.OtherLoad, "share", lambda self: 0.4)
    path = write_net(tmp_path)
    assert nuno_main(["bench", "precision", str(path), *FLAGS, "--solvers", "rk4", "--out", str(tmp_path)]) == 0
    said = "other processes took 40% of the machine meanwhile: TIMES ARE DISTURBED"
    terminal, page = capsys.readouterr().out, (tmp_path / "precision-line.html").read_text()
    assert terminal.index("fastest") < terminal.index(said) < terminal.index("written")
    table = page[page.index("Which solver for which accuracy") : page.index("inside the predictable time")]
    assert said in table[: table.index("<table")]
