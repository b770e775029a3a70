"""Frames between checkpoints are had again to the last bit; resumed runs end in the same bits by any solver."""

from __future__ import annotations

from collections import Counter
from importlib.metadata import entry_points
from itertools import pairwise
from pathlib import Path
from typing import Any

import garment_scene
import numpy as np
import pytest
from live_run import Run, wait_until
from scenes import BALL, write_scene

import nuno
from nuno.cli import main
from nuno.collision.bodies import build_bodies
from nuno.dye.run import DyeRun
from nuno.recording.recorded import Checkpoint
from nuno.report.run_report import make_report
from nuno.runtime import runs, supervisor
from nuno.runtime.service import Options
from nuno.runtime.stepper import copy_into
from nuno.scene import scene_file
from nuno.simulation.run import Simulation
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import DYE_STATUS


@pytest.fixture(scope="module")
def garment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten frames of a garment that is dyed, with checkpoints of frames 4, 8 and 10."""
    folder = tmp_path_factory.mktemp("garment")
    return nuno.run(garment_scene.write(folder), record=folder / "run.mcap").path


def test_every_frame_of_cloth_and_dye_is_the_runs_own(garment: Path, tmp_path: Path) -> None:
    with nuno.open(garment) as recording:
        assert [point.frame for point in recording.checkpoints()] == [4, 8, 10]
        moments = {moment.frame: moment for moment in nuno.states(recording)}
        shown = {frame.number: frame for frame in recording.frames()}
        points = {point.frame: point for point in recording.checkpoints()}
        dyed = dict(recording.marks(DYE_STATUS.name).values())
    assert list(moments) == list(shown) == list(dyed) == list(range(11))
    for number, moment in moments.items():
        assert (moment.digest, moment.t) == (shown[number].digest, shown[number].t)
        assert np.abs(moment.x - shown[number].x).max() < 1e-7
        assert moment.forces is None and moment.fabric is not None
    own = [moment.fabric.position for moment in moments.values() if moment.fabric is not None]
    assert not any(np.shares_memory(one, other) for one, other in pairwise(own)), "what is handed out is a copy"
    for number, point in points.items():
        assert moments[number].x.tobytes() == point.x.tobytes() and moments[number].v.tobytes() == point.v.tobytes()
    # A run that ends at a frame between two checkpoints keeps that frame.
    folder = tmp_path / "shorter"
    folder.mkdir()
    ended = nuno.run(garment_scene.write(folder), "duration=0.12")
    six = moments[6]
    assert six.phi is not None and six.fixed is not None and ended.phi is not None and ended.fixed is not None
    for ours, theirs in ((six.x, ended.x), (six.v, ended.v), (six.phi[0], ended.phi), (six.fixed[0], ended.fixed)):
        assert ours.dtype == np.float64 and ours.tobytes() == np.ascontiguousarray(theirs).tobytes()
    assert six.digest == ended.digest


def test_only_what_lies_after_the_nearest_checkpoint_is_simulated(
    garment: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps: Counter[str] = Counter()
    for kind in (Simulation, DyeRun):

        def advance(self: Any, *args: Any, before: Any = kind.advance, name: str = kind.__name__) -> Any:
            steps[name] += 1
            return before(self, *args)

        monkeypatch.setattr(kind, "advance", advance)
    with nuno.open(garment) as recording:
        for frames, expected in (([7], 3), ([8], 0), ([3], 3), ([6, 5, 5], 2), ([1, 9, 10], 3)):
            steps.clear()
            assert [moment.frame for moment in nuno.states(recording, frames)] == sorted(set(frames))
            assert steps == Counter({name: expected for name in ("Simulation", "DyeRun") if expected}), frames


def test_what_was_changed_while_the_run_went_on_is_changed_again(tmp_path: Path) -> None:
    """Before the first frame, between two checkpoints and at one, each asked for by itself and all together."""
    run = Run(write_scene(tmp_path, bodies=BALL), tmp_path / "run.mcap", paused=True)
    wait_until(lambda: run.run in runs.running() and answers(run))
    for item, frames in (("damping=0.5", 7), ("gravity=[0, -5, 0]", 3), ("damping=3", 4)):
        assert run.control("set", item=item)["ok"]
        run.control("step", frames=frames)
        run.wait_until_paused()
    run.control("resume")
    assert run.join().state == "done"
    with nuno.open(run.record) as recording:
        assert 10 in {point.frame for point in recording.checkpoints()}
        whole = {moment.frame: moment for moment in nuno.states(recording, forces=True)}
        assert list(whole) == list(range(26))
        for number in (0, 6, 7, 8, 10, 11, 14, 25):
            (moment,) = nuno.states(recording, [number], forces=True)
            assert moment.x.tobytes() == whole[number].x.tobytes()
            assert moment.forces is not None and whole[number].forces is not None
            for kind, force in whole[number].forces.parts.items():
                assert np.array_equal(moment.forces.parts[kind], force), (number, kind)


def answers(run: Run) -> bool:
    """Whether the simulation is there to be asked."""
    try:
        return bool(run.control("status")["ok"])
    except RunFailed:
        return False


def test_frames_that_are_not_there_and_other_bits_are_refused(garment: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with nuno.open(garment) as recording:
        with pytest.raises(BadInput, match="no such frame") as caught:
            next(nuno.states(recording, [11]))
        assert caught.value.limit == "frames 0 to 10"
        before = Simulation.advance

        def advance(self: Simulation, *args: Any) -> Any:
            self.state.x[0, 0] += 1e-15
            return before(self, *args)

        monkeypatch.setattr(Simulation, "advance", advance)
        with pytest.raises(BadInput, match="frame 5 of the cloth comes out otherwise") as caught:
            list(nuno.states(recording, [4, 5]))
        assert "nuno verify" in str(caught.value.remedy)


def test_the_forces_in_a_frame_are_those_that_moved_the_cloth(tmp_path: Path) -> None:
    """Symplectic Euler, a step a frame: v' - v = a dt with the forces before the step, of springs and hinges, wind,
    damping, and a ball that moves and rubs.
    """
    up = {"plugin": "keyframes", "times": [0, 1], "positions": [[0, 0, 0], [0, 0.2, 0.5]]}
    ball = garment_scene.BALL | {"motion": up, "friction": 0.4}
    path = garment_scene.write(
        tmp_path, dye=None, bodies=[ball], frame_rate=2000, duration=0.05, damping=0.5, forces=[{"plugin": "wind"}],
        solver={"plugin": "symplectic_euler", "dt": "0.5 ms"}, record={"checkpoint_every": 0.02},
    )  # fmt: skip
    result = nuno.run(path, record=tmp_path / "run.mcap")
    with result.recording as recording:
        moments = list(nuno.states(recording, range(41), forces=True))
    kinds: Counter[str] = Counter()
    for before, after in pairwise(moments[1:]):  # before the first frame nothing has moved
        assert before.forces is not None and before.fabric is not None
        free, mass = ~before.fabric.pinned, before.fabric.mass[:, None]
        moved = (after.v - before.v)[free]
        assert np.allclose(moved, 5e-4 * before.forces.acceleration[free], rtol=0.0, atol=1e-11 * np.abs(moved).max())
        assert not before.forces.acceleration[~free].any()
        total = sum(before.forces.parts.values())
        assert np.allclose((total / mass)[free], before.forces.acceleration[free], rtol=1e-12, atol=1e-9)
        for kind, force in before.forces.parts.items():
            kinds[kind] += bool(np.abs(force).max() > 1e-9)
        # What the cloth does to itself moves it as a whole by nothing.
        for kind in ("springs", "hinges"):
            inner = before.forces.parts[kind]
            assert np.abs(inner.sum(axis=0)).max() < 1e-12 * max(1.0, np.abs(inner).sum())
    assert set(kinds) == {"gravity", "damping", "springs", "hinges", "wind", "contact"}
    assert min(kinds.values()) > 20


def test_a_frame_and_its_forces_are_exported(garment: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, forces = tmp_path / "out.npz", tmp_path / "forces.npz"
    assert main(["export", str(garment), "--frame", "7", "--npz", str(out), "--forces", str(forces)]) == 0
    with nuno.open(garment) as recording:
        (moment,) = nuno.states(recording, [7], forces=True)
    fabric, acting = moment.fabric, moment.forces
    assert fabric is not None and fabric.springs is not None and acting is not None and moment.phi is not None
    with np.load(out) as arrays:
        assert set(arrays.files) == {"x", "v", "t", "phi", "fixed"}
        assert float(arrays["t"]) == moment.t and arrays["x"].tobytes() == moment.x.tobytes()
        assert arrays["phi"].tobytes() == moment.phi.tobytes()
    with np.load(forces) as arrays:
        assert int(arrays["frame"]) == 7 and arrays["v"].tobytes() == moment.v.tobytes()
        assert {name for name in arrays.files if name.startswith("force_")} == {
            f"force_{kind}" for kind in acting.parts
        }
        assert np.array_equal(arrays["force_contact"], acting.parts["contact"])
        assert np.array_equal(arrays["acceleration"], acting.acceleration)
        assert np.array_equal(arrays["mass"], fabric.mass) and np.array_equal(arrays["pinned"], fabric.pinned)
        pairs, tension = arrays["spring_pairs"], arrays["spring_tension"]
        length = np.linalg.norm(moment.x[pairs[:, 1]] - moment.x[pairs[:, 0]], axis=1)
        assert np.allclose(tension, arrays["spring_k"] * (length - arrays["spring_rest"]), rtol=0.0, atol=1e-9)
    capsys.readouterr()
    assert main(["export", str(garment), "--frame", "70", "--forces", str(tmp_path / "no.npz")]) == 2
    assert "--frame: no such frame" in capsys.readouterr().err
    assert not (tmp_path / "no.npz").exists()


def test_links_of_a_knit_pull_by_their_tensions() -> None:
    """Along yarns, too: what springs and yarns do to a point is the sum of its links' tensions, but for damping."""
    with nuno.run("knit/stitch-10x10", "duration=0.3").recording as recording:
        last = max(number for number, _ in recording.marks().values())
        (moment,) = nuno.states(recording, [last], forces=True)
    fabric, acting = moment.fabric, moment.forces
    assert fabric is not None and fabric.springs is not None and acting is not None
    pairs = fabric.springs.pairs()
    d = moment.x[pairs[:, 1]] - moment.x[pairs[:, 0]]
    speed = ((moment.v[pairs[:, 1]] - moment.v[pairs[:, 0]]) * d).sum(axis=1) / np.linalg.norm(d, axis=1)
    along = acting.tension + fabric.springs.per_spring(fabric.springs.c) * speed
    pull = (along / np.linalg.norm(d, axis=1))[:, None] * d
    expected = np.zeros_like(moment.x)
    np.add.at(expected, pairs[:, 0], pull)
    np.add.at(expected, pairs[:, 1], -pull)
    found = acting.parts["springs"] + acting.parts["yarns"]
    assert np.abs(acting.parts["yarns"]).max() > 1e-3 * np.abs(found).max() > 0.0
    assert np.allclose(found, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


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
    loaded = scene_file.read(scene)
    resumed = supervisor.supervise(loaded, options)
    assert resumed.state == "done"
    assert np.isfinite(whole.x).all()
    assert resumed.summary["digest"] == whole.digest
    report = make_report(loaded, resumed)
    largest = ("stretch", "start_stretch", "penetration", "last_penetration", "energy", "counts", "warnings")
    assert {name: report[name] for name in largest} == {name: whole.report[name] for name in largest}
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
        kicked = name == "respa"  # its contact is felt with the velocity of the last kick: see the next test
        for kind, force in expected.parts.items():
            assert np.array_equal(found.parts[kind], force) or (kicked and kind == "contact"), kind
        assert np.array_equal(found.acceleration, expected.acceleration) or kicked
        assert np.array_equal(found.parts["gravity"][:, 1], np.full(6, 0.01 * -9.81))
        length = np.linalg.norm(np.diff(moment.x, axis=0), axis=1)
        assert np.allclose(found.tension, 100.0 * (length - 0.1), rtol=0.0, atol=1e-12)
        touching += bool(found.parts["contact"].any())
    assert touching


@pytest.mark.quick(name=["symplectic_euler", "rk4"])
@pytest.mark.parametrize("name", ["symplectic_euler", "rk4", "implicit_euler", "respa"])
def test_forces_beside_a_moving_body_are_those_of_the_frames_state(name: str, tmp_path: Path) -> None:
    """A chain lies on a ball that is lifted, faster and faster: its contact is that of `sim/contact`, and springs are
    those of the exported positions and velocities.
    """
    motion = {"plugin": "keyframes", "times": [0, 0.2, 0.4], "positions": [[0, 0, 0], [0, 0.01, 0], [0, 0.06, 0]]}
    scene = write_scene(
        tmp_path, bodies=[BALL[0] | {"motion": motion}], solver={"plugin": name, "dt": "1 ms"}, allow_unstable=True,
        duration=0.4, record={"contact_forces": True},
    )  # fmt: skip
    touching = 0
    with nuno.run(scene, record=tmp_path / "run.mcap").recording as recording:
        series = recording.series()
        loads = np.stack([series[f"force_ball_{axis}"] for axis in "xyz"], axis=-1)
        for moment in nuno.states(recording, [5, 9, 13, 17, 20], forces=True):
            springs = moment.fabric.springs
            assert springs is not None and moment.forces is not None
            felt = -moment.forces.parts["contact"].sum(axis=0)
            assert felt == pytest.approx(loads[moment.frame], abs=1e-12)
            touching += bool(felt.any())
            first, second = springs.pairs().T
            d, u = moment.x[second] - moment.x[first], moment.v[second] - moment.v[first]
            length = np.linalg.norm(d, axis=1)
            k, rest, c = (springs.per_spring(values) for values in (springs.k, springs.rest, springs.c))
            tension = k * (length - rest) + c * (d * u).sum(axis=1) / length
            pull = (tension / length)[:, None] * d
            expected = np.zeros_like(moment.x)
            np.add.at(expected, first, pull)
            np.add.at(expected, second, -pull)
            assert moment.forces.parts["springs"] == pytest.approx(expected, abs=1e-12)
    assert touching >= 3


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
