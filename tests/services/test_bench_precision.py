"""Error over wall time: orders that a sweep must show, what it keeps and leaves out, and what it refuses."""

from __future__ import annotations

import csv
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import pytest
from line_net import problem_of, reference_of, write_net
from precision_sweeps import FLAGS, points_of, swept
from scenes import BALL, write_scene

from nuno.cli import main as nuno_main
from nuno.plugin_contract import registry
from nuno_bench.precision.command import Findings, report
from nuno_bench.precision.settings import choose_solvers
from nuno_bench.precision.sweep import MORE, Runner, fit_order, judge
from nuno_bench.problem import POSITIONS, Problem, simulate
from nuno_bench.reference import Reference
from nuno_integrators.explicit.fixed_step import SymplecticEuler
from nuno_kernels import kernel
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
def advance_wrongly(x: Any, v: Any, stages: Any, steps: int, dt: float, p: Any, extra: Any) -> None:
    """What no compiler takes."""
    for _ in range(steps):
        x.no_such_thing()


class Uncompiled(SymplecticEuler):
    """One that cannot be compiled."""

    name = "uncompiled"
    loop = advance_wrongly

    def loop_for(self, packed: Any) -> Any:
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
