"""A resumed run ends in the bits of the uninterrupted one, whichever integrator is installed."""

from __future__ import annotations

from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
import pytest
from scenes import BALL, write_scene

import nuno
from nuno.collision.bodies import build_bodies
from nuno.recording.recorded import Checkpoint
from nuno.runtime import supervisor
from nuno.runtime.service import Options
from nuno.runtime.stepper import copy_into
from nuno.scene import scene_file
from nuno.simulation.run import Simulation

INTEGRATORS = sorted(point.name for point in entry_points(group="nuno.integrators"))


@pytest.mark.quick(name=["symplectic_euler", "implicit_euler"])
@pytest.mark.parametrize("name", INTEGRATORS)
def test_resumed_run_ends_in_the_same_bits(name: str, tmp_path: Path) -> None:
    """The chain is cut off while it lies on the ball, so that friction's memory matters too."""
    solver = {"plugin": name, "dt": "1 ms"}
    scene = write_scene(tmp_path, bodies=BALL, solver=solver, allow_unstable=True, duration=0.4)
    whole = nuno.run(scene, record=tmp_path / "whole.mcap")
    part = nuno.run(scene, "duration=0.2", record=tmp_path / "part.mcap")
    assert part.report["frames"]["sent"] == 11
    options = Options(record=tmp_path / "resumed.mcap", resume=part.path)
    resumed = supervisor.supervise(scene_file.read(scene), options)
    assert resumed.state == "done"
    assert np.isfinite(whole.x).all()
    assert resumed.summary["digest"] == whole.digest
    with nuno.open(tmp_path / "resumed.mcap") as ours, nuno.open(whole.path) as reference:
        assert [f.digest for f in ours.frames()] == [f.digest for f in reference.frames()]


@pytest.mark.quick(name=["symplectic_euler", "implicit_euler"])
@pytest.mark.parametrize("name", INTEGRATORS)
def test_a_frame_is_had_again_and_its_forces_are_the_scenes_whatever_the_solver(name: str, tmp_path: Path) -> None:
    """Also those of contact and friction, whose dashpots solvers bound in their own steps."""
    fields = {"bodies": BALL, "allow_unstable": True, "duration": 0.4}
    scene = write_scene(tmp_path, solver={"plugin": name, "dt": "1 ms"}, **fields)
    path = nuno.run(scene, record=tmp_path / "run.mcap").path
    with nuno.open(path) as recording:
        points = list(recording.checkpoints())
        between = next(nuno.states(recording, [13]))
        kept = list(nuno.states(recording, [point.frame for point in points], forces=True))
    assert between.x.dtype == np.float64 and len(points) == 4
    loaded = scene_file.read(write_scene(tmp_path, solver={"plugin": "symplectic_euler", "dt": "1 ms"}, **fields))
    bodies = build_bodies(loaded)
    poses = bodies.poses(0.0)
    other = Simulation(loaded, bodies.geometry, poses, 1)
    touching = 0
    for point, moment in zip(points, kept, strict=True):
        anchors = {key: values for key, values in point.memory.items() if key.startswith("anchor")}
        memory = {f"memory/{key}": values for key, values in anchors.items()}
        other.resume(Checkpoint(point.state | memory, point.text))
        expected, found = other.forces((poses, poses)), moment.forces
        assert found is not None and set(found.parts) == set(expected.parts) == {"gravity", "springs", "contact"}
        for kind, force in expected.parts.items():
            assert np.array_equal(found.parts[kind], force), kind
        assert np.array_equal(found.acceleration, expected.acceleration)
        assert np.array_equal(found.parts["gravity"][:, 1], np.full(6, 0.01 * -9.81))
        length = np.linalg.norm(np.diff(moment.x, axis=0), axis=1)
        assert np.allclose(found.tension, 100.0 * (length - 0.1), rtol=0.0, atol=1e-12)
        touching += bool(found.parts["contact"].any())
    assert touching


def test_memory_matters_where_the_run_is_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without it the tests above would end in the same bits whatever a checkpoint holds."""
    scene = write_scene(tmp_path, bodies=BALL, duration=0.4)
    whole = nuno.run(scene, record=tmp_path / "whole.mcap")
    part = nuno.run(scene, "duration=0.2", record=tmp_path / "part.mcap")

    def forget(simulation: Simulation, point: Checkpoint) -> None:
        copy_into(simulation.arrays(), point.state)
        simulation.frame = point.frame

    monkeypatch.setattr(Simulation, "take_over", forget)
    options = Options(record=tmp_path / "resumed.mcap", resume=part.path)
    assert supervisor.supervise(scene_file.read(scene), options).summary["digest"] != whole.digest


def test_forces_at_the_start_of_a_step_follow_from_the_checkpoint(tmp_path: Path) -> None:
    """The trapezoidal stage evaluates contact before it solves: how far its dashpots see is the step's, not the last
    one's. In frame 9 a vertex comes in faster than that.
    """
    solver = {"plugin": "tr_bdf2", "dt": "4 ms"}
    scene = write_scene(tmp_path, bodies=BALL, solver=solver, allow_unstable=True, duration=0.3)
    loaded = scene_file.read(scene)
    bodies = build_bodies(loaded)
    poses = bodies.poses(0.0)
    whole = Simulation(loaded, bodies.geometry, poses, 1)
    whole.measure(poses)
    points, digests = [], []
    while not whole.finished:
        points.append(whole.keep())
        digests.append(whole.advance(poses, poses).digest)
    for point in points[1:]:
        resumed = Simulation(loaded, bodies.geometry, poses, 1)
        resumed.resume(point)
        resumed.measure(poses)
        after = digests[point.frame :]
        assert [resumed.advance(poses, poses).digest for _ in after] == after, point.frame


def test_a_checkpoint_is_a_copy_of_the_state_and_of_the_solvers_memory(tmp_path: Path) -> None:
    """What the run does afterwards does not reach it, nor what is done with it the run that was resumed from it."""
    scene = write_scene(tmp_path, bodies=BALL, solver={"plugin": "symplectic_euler", "dt": "1 ms"}, duration=0.4)
    whole = Simulation.with_bodies(scene_file.read(scene), 1)
    while whole.frame < 12:
        whole.step()
    point, digest = whole.keep(), whole.digest()
    assert {"x", "v", "memory/anchor", "memory/anchor_frame", "energy"} <= set(point.arrays)
    kept = {name: values.tobytes() for name, values in point.arrays.items()}
    after = [whole.step().digest for _ in range(4)]
    assert {name: values.tobytes() for name, values in point.arrays.items()} == kept and point.digest == digest
    resumed = Simulation.with_bodies(scene_file.read(scene), 1)
    resumed.resume(point)
    for values in point.arrays.values():
        values[...] = 0
    assert [resumed.step().digest for _ in range(4)] == after
