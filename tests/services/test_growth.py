"""Scenes at the edge of what can run, and energy that grows by more than all work done."""

from __future__ import annotations

import json
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from random_fabrics import write_random
from refusals import of_file, write_net
from scenes import BALL, write_scene

import nuno
from nuno.cli import main
from nuno.scene import scene_file
from nuno.simulation.run import Simulation, internal

SEEDS, SHARE, QUICK = 200, 0.9, (3, 134)
EXPLICIT = sorted(point.name for point in entry_points(group="nuno.integrators") if point.load().explicit)
BLOWN = "forces=[{{plugin: wind, velocity: [0, 0, {}]}}]"
HINGES, SWING = "34-hinges-blow-up", "37-undamped-swing-diverges"


def run(scene: Path, *overrides: str, share: float = 0.0) -> tuple[Simulation, Any, float]:
    """A whole run, at a share of its stated limit, its last report, and the most energy over all that was there."""
    simulation = Simulation.with_bodies(scene_file.read(scene, list(overrides)), 1)
    if share:
        frame = 1.0 / simulation.loaded.scene.frame_rate
        simulation.steps = int(np.ceil(frame / (share * simulation.limit.dt)))
        simulation.dt = frame / simulation.steps
    report = simulation.present().report
    whole, there, most = sum(report.energy.values()), internal(report.energy), 0.0
    with np.errstate(all="ignore"):
        while not simulation.finished and report.status == "ok":
            report = simulation.step().report
            there = max(there, whole - report.energy["gravitational"])
            most = max(most, internal(report.energy) / there)
    return simulation, report, most


@pytest.fixture
def case(shared_data: Path) -> Path:
    return shared_data / "cases"


def test_hinges_that_blow_up_are_said_to_and_the_remedies_help(case: Path) -> None:
    """Stiff hinges on soft springs, whose energy grew two thousandfold; at the step that `dt: auto` takes."""
    scene = case / HINGES / "scene.yaml"
    simulation, report, _ = run(scene)
    assert report.status == "diverged" and simulation.t < 0.5
    assert "energy" in report.message and "damping_ratio of 0.05" in report.message
    shorter = report.message.rpartition("--set ")[2]
    assert float(shorter.partition("=")[2]) == pytest.approx(0.5 * simulation.dt)
    for remedy in (shorter, "objects.0.model.fabric.damping_ratio=0.05"):
        _, report, most = run(scene, remedy)
        assert report.status == "ok" and most < 1.1, remedy


@pytest.mark.parametrize("solver", [name for name in EXPLICIT if name not in ("euler", "symplectic_euler")])
@pytest.mark.full
def test_hinges_that_blow_up_do_so_by_no_solver_unnoticed(case: Path, solver: str) -> None:
    _, report, most = run(case / HINGES / "scene.yaml", f"solver.plugin={solver}", "duration=5")
    assert report.status != "ok" or most < 10.0


@pytest.mark.full
def test_an_undamped_swing_that_is_lost_says_why_and_the_remedies_help(case: Path) -> None:
    scene = case / SWING / "scene.yaml"
    _, report, _ = run(scene)
    assert report.status == "diverged" and "of the limit of the cloth at its start" in report.message
    shorter = report.message.rpartition("--set ")[2]
    for remedy in (shorter, "objects.0.model.fabric.damping_ratio=0.05"):
        _, report, most = run(scene, remedy)
        assert report.status == "ok" and most < 1.1, remedy


@pytest.mark.parametrize("seed", [pytest.param(i, marks=[] if i in QUICK else pytest.mark.full) for i in range(SEEDS)])
def test_no_random_scene_diverges_unnoticed_below_the_stated_limit(tmp_path: Path, seed: int) -> None:
    """20 s at nine tenths of it, where what symplectic Euler keeps wavers by up to 19 times."""
    _, report, most = run(write_random(seed, tmp_path, "symplectic_euler"), share=SHARE)
    assert report.status == "diverged" or most < 24.0
    if seed == 134:
        assert "the energy has grown" in report.message


@pytest.mark.parametrize("velocity", [0.0, -0.3])
@pytest.mark.parametrize("share", [0.5, 0.95])
def test_what_a_stable_step_makes_of_the_energy_is_no_growth(tmp_path: Path, share: float, velocity: float) -> None:
    """One mass on a spring, all energy in the fastest mode: at a share r of the limit it wavers by up to
    (1 + r) / (1 - r).
    """
    x, v = np.array([[0.0, 0, 0], [1.01, 0, 0]]), np.array([[0.0, 0, 0], [velocity, 0, 0]])
    spring = {"springs": np.array([[0, 1]]), "k": np.array([900.0]), "rest": np.ones(1), "c": np.zeros(1)}
    np.savez(tmp_path / "net.npz", x=x, v=v, m=np.ones(2), pinned=np.array([True, False]), **spring)
    data = {"nuno": 1, "name": "mass", "duration": 20, "frame_rate": 3, "gravity": [0, 0, 0],
            "solver": {"plugin": "symplectic_euler"},
            "objects": [{"name": "mass", "model": {"plugin": "net", "file": "net.npz"}}]}  # fmt: skip
    (tmp_path / "scene.yaml").write_text(json.dumps(data))
    _, report, most = run(tmp_path / "scene.yaml", share=share)
    assert report.status == "ok" and most > (1.0 + 0.5 * share)


def moved(speed: float) -> list[dict[str, Any]]:
    """The ball, which comes up through the chain and stops."""
    positions = [[0, -0.4, 0], [0, -0.4 + 0.4 * speed, 0]]
    return [{**BALL[0], "motion": {"plugin": "keyframes", "times": [0, 0.4], "positions": positions}}]


def test_work_of_bodies_and_of_changes_is_no_growth(tmp_path: Path) -> None:
    """A ball that throws a chain up, and weight that grows a hundredfold while the run goes on."""
    scene = write_scene(tmp_path, bodies=moved(10.0), duration=1, gravity=[0, -0.1, 0])
    simulation = Simulation.with_bodies(scene_file.read(scene), 1)
    fastest = 0.0
    while not simulation.finished:
        if simulation.frame == 20:
            simulation.set("gravity=[0, -10, 0]")
        assert simulation.step().report.status == "ok"
        fastest = max(fastest, float(np.abs(simulation.state.v).max()))
    assert fastest > 5.0


@pytest.mark.full
def test_a_step_that_brings_energy_in_is_told_from_wind(case: Path) -> None:
    """Where more than gravity does work, a frame in shorter steps shows what the step did: of hinges that blow up in a
    breeze, and of a swing that wind gives six times the energy that its weight could.
    """
    hinges, swing = (case / name / "scene.yaml" for name in (HINGES, SWING))
    damped = "objects.0.model.fabric.damping_ratio=0.05"
    assert run(hinges, BLOWN.format(0.1))[1].status == "diverged"
    assert run(hinges, BLOWN.format(0.1), damped)[1].status == "ok"
    _, report, most = run(swing, BLOWN.format(8.0), damped, "duration=1.5")
    assert report.status == "ok" and most > 5.0


NO_SPRINGS = {"springs": np.zeros((0, 2), int), "k": np.zeros(0), "rest": np.zeros(0), "c": np.zeros(0)}


def finished(folder: Path, **fields: Any) -> nuno.Result:
    return nuno.run(write_scene(folder, **fields), record=folder / "run.mcap")


def test_nothing_at_all_runs_and_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for bodies in ([], BALL):
        scene = write_scene(tmp_path, objects=[], bodies=bodies, solver={"plugin": "rk4"}, duration=0.1)
        flags = ["--report", "--record", str(tmp_path / "run.mcap"), *(["--no-view"] if bodies else [])]
        for command in (["run", str(scene), *flags], ["plan", str(scene)]):
            assert main(command) == 0
            assert "the scene has no objects" in capsys.readouterr().out
        with nuno.open(tmp_path / "run.mcap") as recording:
            assert recording.complete
            assert len(list(recording.frames())) == 6
            assert recording.last_checkpoint().x.shape == (0, 3)
        assert (tmp_path / "run.png").stat().st_size > 0


@pytest.mark.parametrize("number", [1, 3])
def test_particles_without_springs_fall_by_the_steps_closed_form(number: int, tmp_path: Path) -> None:
    write_net(tmp_path / "bare.npz", number, pinned=np.zeros(number, bool), **NO_SPRINGS)
    dt, steps = 0.02 / 4, 40
    result = finished(
        tmp_path, objects=of_file("bare.npz"), solver={"plugin": "symplectic_euler", "dt": dt}, duration=0.2
    )
    # Symplectic Euler: v grows by g dt each step, so y = g dt^2 (1 + 2 + ... + n).
    assert result.x[:, 1] == pytest.approx(-9.81 * dt**2 * steps * (steps + 1) / 2, rel=1e-12)
    assert result.x[:, 0] == pytest.approx(np.arange(number), abs=1e-15)


def test_a_duration_shorter_than_a_frame_is_one_frame(tmp_path: Path) -> None:
    result = finished(tmp_path, duration=0.0001)
    assert result.t == pytest.approx(0.02)
    assert result.report["frames"]["recorded"] == 2
