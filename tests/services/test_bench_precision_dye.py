"""Error over wall time of scenes of dye: orders, the reference against a closed form, what is kept and shown."""

from __future__ import annotations

import json
import math
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dye_scene import CELL, D0, TAU3
from dye_wave import MODE, N, write_wave
from precision_sweeps import points_of, swept

from nuno.cli import main as nuno_main
from nuno.plugin_contract import registry
from nuno.scene import scene_file
from nuno_bench.precision.command import orders
from nuno_bench.precision.sweep import fit_order
from nuno_bench.problem import AMOUNTS, DyeProblem, Series, make_dye_problem
from nuno_bench.reference import make_dye_reference
from nuno_dye.solvers.explicit import Explicit
from nuno_schemas.dye import DyeReport, DyeState, DyeSystem
from nuno_schemas.fabric import Float


class Extrapolated(Explicit):
    """Another package's solver, of second order: two half steps of the explicit scheme against a whole one."""

    name = "extrapolated"
    order = 2

    def advance(self, system: DyeSystem, state: DyeState, memory: Any, steps: int, dt: float) -> DyeReport:
        for _ in range(steps):
            whole = DyeState(state.phi.copy(), state.fixed.copy())
            super().advance(system, whole, memory, 1, dt)
            super().advance(system, state, memory, 2, 0.5 * dt)
            state.phi[...] = 2.0 * state.phi - whole.phi
        return super().advance(system, state, memory, 0, dt)


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """No other solver of dye is installed than the explicit one."""
    own = [point for point in entry_points(group=DyeProblem.group) if point.name == "explicit"]
    known = registry.entry_points
    monkeypatch.setattr(
        registry, "entry_points", lambda group: own if group == DyeProblem.group else known(group=group)
    )


@pytest.fixture
def foreign(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is installed."""
    group = DyeProblem.group
    own = [*entry_points(group=group), EntryPoint("extrapolated", f"{__name__}:Extrapolated", group)]
    known = registry.entry_points
    monkeypatch.setattr(
        registry, "entry_points", lambda group: own if group == DyeProblem.group else known(group=group)
    )


def decay(t: Float) -> Float:
    """exp(-t D0 P (tau along + tau across) 4 sin^2 / d^2): one way along the yarn, one across, in either layer."""
    speed = 0.5 * D0 / CELL**2 * (TAU3["V"] + TAU3["II"]) * 4.0 * math.sin(0.5 * math.pi * MODE / N) ** 2
    found: Float = np.exp(-speed * t)
    return found


def problem_of(path: Path) -> DyeProblem:
    return make_dye_problem(scene_file.read(path, ["allow_unstable=true"]), 1)


def exact(start: Float, t: Float) -> Float:
    """(f, cells) mobile dye of the wave."""
    found: Float = 0.25 + decay(t)[:, None] * (start - 0.25)
    return found


@pytest.mark.usefixtures("alone")
def test_the_reference_is_the_closed_form_to_its_floor(tmp_path: Path) -> None:
    reference = make_dye_reference(problem_of(write_wave(tmp_path)), 20.0, lambda text: None)
    series: Series = reference.run.series
    off = np.abs(series.x[:, :, 0] - exact(series.x[0, :, 0], series.t)).max()
    floor = np.abs(series.x - reference.check.series.x).max()
    assert 0.1 * floor < off < floor < 1e-5, "twice the step is four times as far off"
    assert "extrapolated, checked by the same at twice the step" in reference.how


@pytest.mark.full
@pytest.mark.usefixtures("foreign")
def test_errors_fall_at_the_order_of_each_solver(tmp_path: Path) -> None:
    found = swept(write_wave(tmp_path))
    assert {point.solver for point in found.points} >= {"explicit", "extrapolated"}
    assert "checked by" in found.how and "twice the step" not in found.how
    for solver, order in (("explicit", 1), ("extrapolated", 2)):
        seen = fit_order(points_of(found, solver), AMOUNTS, found.floors[AMOUNTS].l2)
        assert seen == pytest.approx(order, abs=0.1), solver
    assert {point.order for point in points_of(found, "extrapolated")} == {2}
    nominal = {row[0]: row[2] for row in orders(found).rows}
    assert nominal["extrapolated"] == "2" and nominal["explicit"] in ("1", "not stated")


@pytest.mark.full
def test_errors_are_those_against_the_closed_form(tmp_path: Path) -> None:
    path = write_wave(tmp_path)
    found, problem = swept(path, "--solvers", "explicit"), problem_of(path)
    point = min(points_of(found, "explicit"), key=lambda one: -one.finer)
    steps = round(problem.frame / point.finer)
    run = problem.run(Explicit(), Explicit.Config(), steps).series
    x = exact(run.x[0, :, 0], run.t)
    scale = np.sqrt((x**2).mean(axis=1)).max()
    apart = np.sqrt(((run.x[1:, :, 0] - x[1:]) ** 2).mean(axis=1)) / scale
    assert point.errors[AMOUNTS].l2 == pytest.approx(np.sqrt((apart**2).mean()), rel=1e-3)
    assert set(point.errors) == {AMOUNTS, "mobile", "fixed", "spread"}
    assert point.errors["mobile"].l2 < 1e-13 and point.errors["fixed"].l2 == 0.0


def test_spread_grows_as_a_drop_s_second_moment(tmp_path: Path) -> None:
    """By 2 D t along the yarns and across them, of a drop in one layer without exchange."""
    path = write_wave(tmp_path, cloth={"plugin": "cells", "file": "cells.npz", "cell_size": CELL, "tau2": 1.0,
                                       "tau3": TAU3 | {"I": 0.0}})  # fmt: skip
    data = dict(np.load(tmp_path / "cells.npz"))
    data["phi"] = np.zeros_like(data["phi"])
    data["phi"][0, N // 2, N // 2] = 0.1
    np.savez(tmp_path / "cells.npz", **data)  # type: ignore[arg-type]
    series = problem_of(path).run(Explicit(), Explicit.Config(), 40).series
    grown = series.values["spread"][:2, 0] ** 2
    expected = 2.0 * 0.5 * D0 * (TAU3["V"] + TAU3["II"]) * series.t[:2]
    assert grown == pytest.approx(expected, rel=1e-2, abs=1e-16)


@pytest.mark.full
def test_a_step_beyond_the_limit_is_tried_and_marked(tmp_path: Path) -> None:
    found = swept(write_wave(tmp_path), "--solvers", "explicit")
    (beyond,) = [point for point in found.points if point.beyond]
    stable = [error for point in found.points if not point.beyond and (error := point.error(AMOUNTS)) is not None]
    limit = problem_of(tmp_path / "scene.yaml").limit(Explicit(), Explicit.Config()).dt
    assert beyond.finer > 1.4 * limit and len(stable) >= 6
    error = beyond.error(AMOUNTS)
    assert beyond.outcome == "done" and error is not None and error > 2.0 * max(stable)


@pytest.mark.full
def test_the_command_writes_all_and_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = write_wave(tmp_path), tmp_path / "out"
    flags = ["--repeats", "1", "--budget", "60", "--solvers", "explicit", "--out", str(out)]
    flags += ["--observable", "mobile", "--rrd", str(tmp_path / "wave.rrd")]
    assert nuno_main(["bench", "precision", str(path), *flags]) == 0
    assert (tmp_path / "wave.rrd").stat().st_size > 0
    assert "what disturbs diffusion fades" in capsys.readouterr().out
    page = (out / "precision-wave.html").read_text()
    assert "Amounts, inside the predictable time" in page and page.count("<svg") == 2 and "positions" not in page
    lines = (out / "precision-wave.jsonl").read_text().splitlines()
    (out / "precision-wave.jsonl").write_text("\n".join(lines[:4]) + "\n")
    assert nuno_main(["bench", "precision", str(path), *flags, "--resume"]) == 0
    again = (out / "precision-wave.jsonl").read_text().splitlines()
    assert again[:4] == lines[:4] and len(again) == len(lines)
    points = json.loads((out / "precision-wave.json").read_text())["points"]
    assert len(points) == len(lines) - 2  # beside the head, and the line that says that it is finished


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (("--solvers", "rk4"), "known: "),
        (("--solvers", "explict"), "'explicit'"),
    ],
)
def test_names_of_cloth_are_none_of_dye(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], flags: tuple[str, ...], said: str
) -> None:
    assert nuno_main(["bench", "precision", str(write_wave(tmp_path)), "--out", str(tmp_path / "out"), *flags]) == 2
    assert said in capsys.readouterr().err
