"""What a precision sweep keeps when it is interrupted, and what its budget leaves out."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from line_net import problem_of, reference_of, write_net
from precision_sweeps import FLAGS, swept

from nuno.cli import main as nuno_main
from nuno_bench.precision import command as precision
from nuno_bench.precision.command import Findings
from nuno_bench.precision.settings import choose_solvers
from nuno_bench.precision.sweep import Runner, SolverPoint, Sweep, run_sweep
from nuno_bench.sweep.storage import SweepFile
from nuno_schemas.errors import BadInput

SOLVERS = "rk4,leapfrog,tr_bdf2"


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Findings:
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
    found = swept(path, "--solvers", "rk4,leapfrog", "--resume")
    assert len(first & {point.seconds for point in found.points}) == 4
    assert len({point.key for point in found.points}) == len(found.points) > 8


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
def test_a_budget_leaves_finer_points_out_by_name(tmp_path: Path, found: Findings) -> None:
    small = swept(write_net(tmp_path), "--budget", "0.02", "--solvers", SOLVERS)
    dropped = {(one.solver, one.setting) for one in small.sweep.omitted}
    kept = {point.key for point in small.points}
    assert dropped and all("budget" in one.reason for one in small.sweep.omitted)
    assert dropped.isdisjoint(kept)
    assert dropped | kept == {p.key for p in found.points}


def test_a_place_that_cannot_be_written_is_refused_before_a_reference_is_computed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(precision, "pose", None)
    path = write_net(tmp_path)
    (tmp_path / "out").write_text("a file in the folder's place")
    with pytest.raises(BadInput, match="cannot write there") as refused:
        swept(path)
    assert (refused.value.field, refused.value.value) == ("--out", str(tmp_path / "out"))
