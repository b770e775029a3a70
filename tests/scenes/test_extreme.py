"""Extreme scenes: each does, with every installed solver, what its description says."""

from __future__ import annotations

import itertools
import subprocess
import sys
import zipfile
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pytest

from nuno.collision.bodies import build_bodies
from nuno.runtime.stepper import Stepped
from nuno.scene import scene_file
from nuno.simulation.run import Simulation
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

FOLDER = Path(__file__).resolve().parents[2] / "scenes" / "extreme"
SOLVERS = sorted(point.name for point in entry_points(group="nuno.integrators"))
G = 9.81
WITHOUT_STEP = ("euler", "no step is stable", "too many steps")
"""Explicit Euler has no step for undamped springs, or none within reason for stiff ones, and says so."""


class Played:
    """A scene run to its end: the simulation and what each frame reported; x (frames + 1, n, 3), v likewise."""

    def __init__(self, name: str, solver: str, *overrides: str) -> None:
        loaded = scene_file.read(FOLDER / f"{name}.yaml", [f"solver.plugin={solver}", *overrides])
        bodies = build_bodies(loaded) if loaded.scene.bodies else None
        rate = loaded.scene.frame_rate
        poses = [bodies.poses(i / rate) if bodies else None for i in range(loaded.scene.frames + 1)]
        self.simulation = Simulation(loaded, bodies.geometry if bodies else None, poses[0], 1)
        self.frames: list[Stepped] = []
        self.plugin = loaded.integrator.plugin
        start = self.simulation.measure(poses[0])
        path, speed, self.energy = [self.simulation.state.x.copy()], [self.simulation.state.v.copy()], [start.energy]
        for before, after in itertools.pairwise(poses):
            frame = self.simulation.advance(before, after)
            assert frame.report.status == "ok", frame.report.message
            self.frames.append(frame)
            path.append(self.simulation.state.x.copy())
            speed.append(self.simulation.state.v.copy())
            self.energy.append(frame.report.energy)
        self.x, self.v = np.array(path), np.array(speed)
        self.t: Float = np.arange(len(path)) / rate
        assert np.isfinite(self.x).all()
        assert np.isfinite(self.v).all()

    @property
    def total(self) -> Float:
        """(frames + 1,) energy [J]."""
        return np.array([sum(kinds.values()) for kinds in self.energy])

    @property
    def exact(self) -> bool:
        """Whether the solver resolves the motion at the step it chooses: implicit ones damp it."""
        return bool(self.plugin.explicit)

    @property
    def give(self) -> float:
        """How much softer than its fabric a run may be: where a solver leaves a share of each force missing."""
        partly = np.isfinite(self.simulation.limit.resolved)
        return 1.0 / (1.0 - float(self.simulation.loaded.integrator.config.residual)) if partly else 1.0

    @property
    def pull(self) -> float:
        """Gravity as the solver takes it: one is kept to show what counting it twice does."""
        return 2.0 * G if self.plugin.name == "rk4_printed" else G


def bounces(name: str, solver: str) -> None:
    run = Played(name, solver)
    y = run.x[:, -1, 1] + 1.0
    sag, omega = run.pull / 1250.0, np.sqrt(1250.0)
    assert y.max() < 0.01 * sag
    assert y.min() > -2.02 * sag * run.give
    assert y.min() < -0.5 * sag
    if run.exact:
        np.testing.assert_allclose(y, -sag * (1.0 - np.cos(omega * run.t)), atol=0.01 * sag)


def swings_stiffly(name: str, solver: str) -> None:
    run = Played(name, solver)
    rods = np.linalg.norm(np.diff(run.x, axis=1), axis=2)
    assert np.abs(rods / 0.2 - 1.0).max() < 1e-5
    lift = 5 * 0.05 * run.pull * 0.5
    # The reported energy has gravity once.
    gained = run.total - run.total[0] if run.pull == G else np.zeros(1)
    assert gained.max() < 1e-3 * lift
    assert run.x[-1, :, 1].mean() < -0.05
    if run.exact:
        assert gained.min() > -2e-3 * lift


def falls_together(name: str, solver: str) -> None:
    run = Played(name, solver)
    assert run.x[:, 0].tobytes() == run.x[:, 1].tobytes() == run.x[:, 2].tobytes()
    assert run.x[:, 0, 1].tobytes() == run.x[:, 3, 1].tobytes(), "as a vertex without springs does"
    assert run.x[-1, 0, 1] < -0.1
    assert all(frame.report.counts["zero_length_springs"] == 2 for frame in run.frames)


def swings_in_its_plane(name: str, solver: str) -> None:
    run = Played(name, solver)
    assert not run.x[:, :, 2].any()
    # Symplectic Euler's energy wavers by omega dt, 1 % at this step; viscous damping takes e^(-c t) of the moving half.
    assert run.total.max() < 1.02 * run.total[0]
    assert 0.75 * run.total[0] < run.total[-1] < 0.9 * run.total[0]


def names_the_triangle(name: str, solver: str) -> None:
    with pytest.raises(BadInput, match="1 triangles without area") as refused:
        Played(name, solver)
    assert "degenerate-triangles.obj" in str(refused.value)


def stays_a_strip(name: str, solver: str) -> None:
    run = Played(name, solver)
    fallen = run.x[-1] - run.x[0]
    assert fallen[:, 1].max() < 0.0
    assert np.ptp(fallen, axis=0).max() < 2e-4


def is_refused_or_taken(name: str, solver: str) -> None:
    if solver == "euler":
        return
    plugin = scene_file.read(FOLDER / f"{name}.yaml", [f"solver.plugin={solver}"]).integrator.plugin
    if plugin.explicit and not plugin.adaptive:
        with pytest.raises(BadInput, match="above the stability limit") as refused:
            Played(name, solver)
        limit = float(str(refused.value.limit).split()[0])
        assert 50.0 < 1.0 / limit < 200.0
    else:
        run = Played(name, solver)
        assert run.x[-1, :, 1].mean() < run.x[0, :, 1].mean()
        own = run.simulation
        # A step that its solver does not claim to resolve stretches the chain, but no further than it would fall.
        fall = 0.5 * run.pull * run.t[-1] * (run.t[-1] + own.dt)
        assert np.abs(run.x).max() < (10.0 if own.dt <= own.limit.resolved else fall)


def stays_to_the_bit(name: str, solver: str) -> None:
    run = Played(name, solver)
    assert {x.tobytes() for x in run.x} == {run.x[0].tobytes()}
    assert not run.v.any()
    # A simulation may leave out frames in which nothing would change: the solver itself must stand still too.
    own = run.simulation
    for _ in range(20):
        run.plugin.advance(own.system, own.state, own.memory, None, own.steps, own.dt)
    assert own.state.x.tobytes() == run.x[0].tobytes()
    assert not own.state.v.any()


def flies(name: str, solver: str) -> None:
    run = Played(name, solver)
    exact = np.stack([run.t, 2.0 * run.t - 0.5 * run.pull * run.t**2, 0.0 * run.t], axis=1)
    step = 1e-3 if run.plugin.order == 1 else 1e-9
    np.testing.assert_allclose(run.x[:, 0], exact, atol=0.5 * run.pull * 0.4 * step * 1.01)


def falls_alike(name: str, solver: str) -> None:
    run = Played(name, solver)
    assert run.x[:, 0, 1].tobytes() == run.x[:, 1, 1].tobytes() == run.x[:, 2, 1].tobytes()
    assert run.x[-1, 0, 1] == pytest.approx(-0.5 * run.pull * 0.4**2, rel=5e-3)


def runs_to_its_end(name: str, solver: str) -> None:
    run = Played(name, solver)
    assert run.x.shape == (6, 0, 3)
    assert run.total.tolist() == [0.0] * 6


def is_thrown_ahead(name: str, solver: str) -> None:
    run = Played(name, solver)
    floor = 100.0 * run.t
    depth = 100.0 * 1e-3  # sqrt(m / k) is 1 ms: the contact is as stiff as stops 1 m/s within 1 mm
    assert (run.x[:, :, 1] > floor[:, None] - depth).all()
    assert (run.v[-1, :, 1] > 99.0).all()
    assert (run.v[-1, :, 1] < 200.0).all()


def moves_as_at_the_origin(name: str, solver: str) -> None:
    far, near = Played(name, solver), Played(name, solver, "objects.0.model.centre=[0, 0, 0]")
    np.testing.assert_allclose(far.x - 1e6, near.x, atol=1e-6)
    assert near.x[-1, :, 1].mean() < near.x[0, :, 1].mean() - 0.01


def holds_itself_up(name: str, solver: str) -> None:
    run = Played(name, solver)
    assert run.x[-1, -8:, 1].mean() < 0.0
    assert np.abs(run.x[:, :, 1]).max() < 2e-6
    assert max(frame.report.stretch for frame in run.frames) < 1e-3


LAWS: dict[str, Callable[[str, str], None]] = {
    "mass-ratio": bounces,
    "stiffness": swings_stiffly,
    "zero-length": falls_together,
    "coincident": swings_in_its_plane,
    "degenerate-triangles": names_the_triangle,
    "slivers": stays_a_strip,
    "step-too-long": is_refused_or_taken,
    "weightless": stays_to_the_bit,
    "one-particle": flies,
    "no-springs": falls_alike,
    "nothing": runs_to_its_end,
    "fast-floor": is_thrown_ahead,
    "far-away": moves_as_at_the_origin,
    "millimetres": holds_itself_up,
}


@pytest.mark.quick(solver=["symplectic_euler"])
@pytest.mark.parametrize(("name", "solver"), [(name, solver) for name in LAWS for solver in SOLVERS])
def test_scene_does_what_it_says(name: str, solver: str) -> None:
    if solver == "rk4_printed" and name in ("one-particle", "no-springs"):
        with pytest.raises(AssertionError, match="the energy has grown"):  # as it counts gravity twice
            Played(name, solver)
        return
    try:
        LAWS[name](name, solver)
    except BadInput as refused:
        if solver not in WITHOUT_STEP or not any(words in str(refused) for words in WITHOUT_STEP):
            raise


def test_every_scene_has_its_law() -> None:
    assert {path.stem for path in FOLDER.glob("*.yaml")} == set(LAWS)


def test_files_are_what_their_script_makes(tmp_path: Path) -> None:
    copy = tmp_path / "make_extreme.py"
    copy.write_text((FOLDER / "make_extreme.py").read_text())
    subprocess.run([sys.executable, str(copy)], check=True)
    made = {path.name for path in tmp_path.iterdir()} - {copy.name}
    assert made == {path.name for path in FOLDER.iterdir() if path.suffix in (".npz", ".obj")}
    for name in made:
        if name.endswith(".obj"):
            assert (tmp_path / name).read_text() == (FOLDER / name).read_text()
            continue
        with zipfile.ZipFile(tmp_path / name) as new, zipfile.ZipFile(FOLDER / name) as old:
            for member in old.namelist():
                assert new.read(member) == old.read(member), name
