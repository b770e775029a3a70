"""Frames between checkpoints are had again to the last bit, and the forces in them are those that moved the cloth."""

from __future__ import annotations

from collections import Counter
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
from nuno.dye.run import DyeRun
from nuno.runtime import runs
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
    for before, after in pairwise(moments):
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
