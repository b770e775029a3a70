"""What a precision sweep says of the scene's own step, and of one twice as large."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from dye_wave import write_wave
from line_net import write_net
from precision_sweeps import FLAGS, swept

from nuno.cli import main as nuno_main
from nuno_bench import machine
from nuno_bench.precision.page import Findings, orders
from nuno_bench.precision.point import Point, fit_order
from nuno_bench.problem.dye import AMOUNTS
from nuno_bench.problem.observe import POSITIONS
from nuno_bench.report.result import number


def of(found: Findings, label: str) -> Point:
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
    monkeypatch.setattr(machine.Others, "share", lambda self: 0.4)
    path = write_net(tmp_path)
    assert nuno_main(["bench", "precision", str(path), *FLAGS, "--solvers", "rk4", "--out", str(tmp_path)]) == 0
    said = "other processes took 40% of the machine meanwhile: TIMES ARE DISTURBED"
    terminal, page = capsys.readouterr().out, (tmp_path / "precision-line.html").read_text()
    assert terminal.index("fastest") < terminal.index(said) < terminal.index("written")
    table = page[page.index("Which solver for which accuracy") : page.index("inside the predictable time")]
    assert said in table[: table.index("<table")]
