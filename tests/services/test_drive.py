"""Who moves a body of a run waits until the run is there, and is told at once what cannot be."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest
from live_hand import LONG, SHEET, hand, poses
from live_run import Run
from scenes import write_scene

import nuno
from nuno.bus.sessions import free_port
from nuno.scene import scene_file
from nuno.service import Options
from nuno.simulation.run import Simulation
from nuno.supervision import runs, supervisor
from nuno.supervision.supervisor import Deployment
from nuno_schemas.bodies import Poses
from nuno_schemas.errors import BadInput
from nuno_schemas.system import StepReport


def test_a_run_is_waited_for_until_it_takes_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiling and all: what is sent and added then is not lost."""
    rehearse, compiled = Simulation.rehearse, threading.Event()

    def slowly(simulation: Simulation) -> None:
        compiled.wait(1.0)
        compiled.set()
        rehearse(simulation)

    monkeypatch.setattr(Simulation, "rehearse", slowly)
    run = Run(hand(tmp_path), tmp_path / "run.mcap")
    with nuno.drive(run.run, "hand", wait=LONG) as ball:
        assert compiled.is_set()
        said = ball.add("attach: {body: hand, vertices: [40]}")
        assert said == {"vertices": 1, "held": 1} and all(type(number) is int for number in said.values())
        for position, rotation in poses():
            ball.send(position, rotation)
    assert run.join().state == "done" and run.report["followed"]["hand"]["used"] == 20


def test_the_first_hold_is_rehearsed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So that what its steps need is compiled before the first frame; nothing is left of it."""
    plain, rehearsed = (Simulation.with_bodies(scene_file.read(hand(tmp_path)), 1) for _ in range(2))
    measure, held = Simulation.measure, list[int]()

    def note(simulation: Simulation, poses: Poses | None) -> StepReport:
        held.append(len(simulation.fabric.bindings))
        return measure(simulation, poses)

    monkeypatch.setattr(Simulation, "measure", note)
    rehearsed.rehearse()
    assert held == [1] and rehearsed.changes == [] and not rehearsed.fabric.bindings
    for simulation in (plain, rehearsed):
        simulation.step()
        simulation.add("attach: {body: hand, vertices: [40]}")
    assert plain.step().digest == rehearsed.step().digest


def test_a_run_of_another_folder_is_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing of a stranger's run is moved, though `last` leads to it elsewhere."""
    for name in ("notes", "here", "there"):
        (tmp_path / name).mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "notes"))
    monkeypatch.chdir(tmp_path / "there")
    with runs.announced("other", "tcp/127.0.0.1:1"):
        monkeypatch.chdir(tmp_path / "here")
        assert runs.find("last")[0] == "other"
        for wait in (0.0, 0.2):
            with pytest.raises(BadInput, match="no such run is going on"):
                nuno.drive("last", "hand", wait=wait)


def test_another_hosts_hub_is_waited_for(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    deployment = Deployment(listen=endpoint, run="late")
    loaded = scene_file.read(hand(tmp_path))
    late = threading.Timer(0.7, supervisor.supervise, (loaded, Options(record=tmp_path / "run.mcap"), deployment))
    late.start()
    with nuno.drive("late", "hand", connect=endpoint, wait=LONG) as ball:
        for position, rotation in poses():
            ball.send(position, rotation)
    late.join()
    with nuno.open(tmp_path / "run.mcap") as recording:
        assert recording.last_checkpoint().frame == 20


def test_a_body_that_moves_by_itself_is_refused(tmp_path: Path) -> None:
    moved = {"plugin": "topic", "frames": "poses", "silence": LONG, "key": "robot/hand"}
    ball = {"collider": {"plugin": "sphere", "radius": 0.03}}
    bodies = [{"name": "table"} | ball, {"name": "hand", "motion": moved} | ball]
    scene = write_scene(
        tmp_path, objects=[{"name": "cloth", "model": SHEET}], bodies=bodies, solver="symplectic_euler", duration=0.4
    )
    run = Run(scene, tmp_path / "run.mcap", paused=True)
    run.wait_until_paused()
    with pytest.raises(BadInput, match=r"table has no motion: {plugin: topic}(.|\n)*or take hand"):
        nuno.drive(run.run, "table", wait=LONG)
    with nuno.drive(run.run, "hand") as driving:  # by the key that the scene names
        for _ in range(20):
            driving.send([0.0, 0.0, 0.2])
        run.control("resume")
        assert run.join().state == "done"
    assert run.report["followed"]["hand"]["used"] == 20
    bare = Run(write_scene(tmp_path), tmp_path / "bare.mcap", paused=True)
    bare.wait_until_paused()
    with pytest.raises(BadInput, match="the run has no bodies"):
        nuno.drive(bare.run, "hand")
    bare.stop()


def test_what_cannot_be_followed_is_not_sent(tmp_path: Path) -> None:
    """It is refused where it is said: by the rules of the run, and with the body's joints."""
    run = Run(hand(tmp_path), tmp_path / "run.mcap", paused=True)
    run.wait_until_paused()
    with nuno.drive(run.run, "hand") as ball:
        for position, rotation, said in (
            ([0.0, 0.0, 0.2], [0.0, 0.0, 0.0, 0.0], "a rotation of no length"),
            ([1e7, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], "out of this world"),
            ([np.nan, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], "position: not finite"),
            ("hello", [1.0, 0.0, 0.0, 0.0], "position: no numbers"),
            ([[0.0] * 3] * 2, [[1.0, 0.0, 0.0, 0.0]] * 2, "another skeleton"),
            ([[0.0] * 3] * 2, [1.0, 0.0, 0.0, 0.0], "of another shape"),
        ):
            with pytest.raises(BadInput, match=said):
                ball.send(position, rotation)
    for late in (lambda: ball.send([0.0, 0.0, 0.2]), lambda: ball.add("release: {body: hand}")):
        with pytest.raises(BadInput, match="closed"):
            late()
    assert run.stop().state == "stopped" and run.report["followed"]["hand"]["heard"] == 0
