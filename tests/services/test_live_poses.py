"""Bodies that another program moves while a run goes on: poses, lockstep, and who moves them."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from doc_pages import ROOT, blocks
from live_hand import LONG, SHEET, START, hand, places, poses, send
from live_run import Live as LiveRun
from live_run import Run, wait_until
from scenes import write_scene

import nuno
from nuno.bus.sessions import free_port, spoke
from nuno.cli import main
from nuno.collision.messages import POSES_QUERY, read_poses
from nuno.recording.reader import open_recording
from nuno.recording.writer import part_of
from nuno.report.run_report import lines
from nuno.runtime import runs, supervisor
from nuno.runtime.service import Options
from nuno.runtime.supervisor import Deployment
from nuno.scene import scene_file, shipped
from nuno.scene.recorded_scene import resumed_scene
from nuno.simulation.run import Simulation
from nuno_schemas.bodies import Poses
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.live import Live
from nuno_schemas.messages import Event
from nuno_schemas.system import StepReport


def drive(folder: Path, scene: Path, sent: Sequence[tuple[list[float], list[float]]], name: str = "run") -> Run:
    """A run, over, whose ball was sent these poses by who has waited for it."""
    run = Run(scene, folder / f"{name}.mcap", paused=True)
    with nuno.drive(run.run, "hand", wait=LONG) as ball:
        run.wait_until_paused()
        for position, rotation in sent:
            ball.send(position, rotation)
        run.control("resume")
        assert run.join().state == "done"
    return run


def test_each_frame_has_the_poses_that_were_sent_for_it(tmp_path: Path) -> None:
    """All of them, in their order, to the last bit; the cloth is pushed by it, and the recording alone is enough to
    have the run again, and its frames in between.
    """
    sent = poses()
    run = drive(tmp_path, hand(tmp_path), sent)
    path = run.record
    assert places(path).tolist() == [START, *(position for position, _ in sent)]
    found = nuno.verify(path)
    assert found.frame is None and found.compared == 21
    still = nuno.run(hand(tmp_path, silence=0.01), progress=False)
    with nuno.open(path) as recording:
        assert np.abs(recording.last_checkpoint().x - still.x).max() > 0.01
        (moment,) = nuno.states(path, [13])
        assert moment.frame == 13
    assert run.report["followed"]["hand"] | {"silence": 0.0} == {
        "heard": 20, "used": 20, "refused": 0, "left_out": 0, "without": 0, "behind": 0, "silence": 0.0,
        "mixed": 0,
    }  # fmt: skip


def test_a_run_that_goes_on_from_a_checkpoint_is_told_the_rest(tmp_path: Path) -> None:
    """The same poses from there on end in the same bits."""
    sent, scene = poses(), hand(tmp_path)
    whole = drive(tmp_path, scene, sent, "whole").record
    run = Run(scene, tmp_path / "half.mcap", paused=True)
    run.wait_until_paused()
    with nuno.drive(run.run, "hand") as ball:
        for position, rotation in sent[:7]:
            ball.send(position, rotation)
        run.step_to(7)
        run.stop()
    with resumed_scene(tmp_path / "half.mcap", ()) as (loaded, _):
        options = Options(record=tmp_path / "on.mcap", resume=tmp_path / "half.mcap")
        on = LiveRun(loaded, options, Deployment(paused=True))
        on.wait_until_paused()
        with nuno.drive(on.run, "hand") as ball:
            for position, rotation in sent[7:]:
                ball.send(position, rotation)
            on.control("resume")
            assert on.join().state == "done"
    assert places(tmp_path / "on.mcap").tolist() == places(whole).tolist()
    with nuno.open(whole) as one, nuno.open(tmp_path / "on.mcap") as other:
        assert one.last_checkpoint().digest == other.last_checkpoint().digest
    assert nuno.verify(tmp_path / "on.mcap").frame is None


def test_what_cannot_be_followed_is_refused_and_named(tmp_path: Path) -> None:
    """The next good poses are taken in its place, so that nothing is lost; each kind is told once."""
    run = Run(hand(tmp_path, key="robot/hand"), tmp_path / "run.mcap", paused=True)
    run.wait_until_paused()
    nan = b'{"position": [NaN, 0, 0], "rotation": [1, 0, 0, 0]}'
    two = {"positions": [[0, 0, 0], [0, 0, 0]], "rotations": [[1, 0, 0, 0], [1, 0, 0, 0]]}
    bad = [b"hello", nan, two, {"rotation": [1, 0, 0, 0]}, {"position": [0, 0, 0], "rotation": [0, 0, 0, 0]}, nan]
    good = [{"position": position, "rotation": rotation} for position, rotation in poses()]
    send(run, "robot/hand", *bad, *good)
    assert places(tmp_path / "run.mcap")[1:].tolist() == [one["position"] for one in good]
    told = run.report["followed"]["hand"]
    assert (told["heard"], told["used"], told["refused"]) == (26, 20, 6)
    with open_recording(tmp_path / "run.mcap") as recording:
        warnings = [event.text for event in recording.events() if event.kind == "warning"]
    for words in (
        "no poses, which are JSON",
        "no poses: positions: Field required",
        "not finite",
        "another skeleton",
        "a rotation of no length",
    ):
        assert sum(words in text and "body hand" in text for text in warnings) == 1, words


def test_a_jump_is_gone_to_at_the_greatest_speed(tmp_path: Path) -> None:
    """One metre at 5 m/s takes ten frames of 20 ms, in a straight line; where it ends is where it was told to be."""
    sent = [([1.0, 0.0, 0.2], [1.0, 0.0, 0.0, 0.0])] * 20
    run = drive(tmp_path, hand(tmp_path, fastest=5.0), sent)
    x = places(run.record)[:, 0]
    assert np.allclose(np.diff(x)[:10], 0.1, rtol=1e-9) and x[11:].tolist() == [1.0] * 10
    assert run.report["followed"]["hand"]["behind"] == 9
    with open_recording(run.record) as recording:
        warnings = [event.text for event in recording.events() if event.kind == "warning"]
    assert sum("farther on than it gets in a frame, by 90%" in text for text in warnings) == 1


def test_silence_is_said_and_ends_a_run_that_cannot_do_without(tmp_path: Path) -> None:
    """Which keeps its recording; others go on with the body where it is."""
    held = nuno.run(hand(tmp_path, silence=0.01), record=tmp_path / "held.mcap")
    assert held.state == "done" and held.report["followed"]["hand"]["without"] == 20
    assert places(tmp_path / "held.mcap").tolist() == [START] * 21
    with open_recording(tmp_path / "held.mcap") as recording:
        assert sum("has heard nothing for" in event.text for event in recording.events()) == 1
    with pytest.raises(RunFailed, match=r"the body hand has heard nothing for .*silent: stop"):
        nuno.run(hand(tmp_path, silence=0.01, silent="stop"), record=tmp_path / "stopped.mcap")
    assert (tmp_path / "stopped.mcap").is_file()


def test_a_frame_that_waits_does_so_from_its_own_beginning(tmp_path: Path) -> None:
    """Whatever came before it took: poses that come a little after a long pause are waited for, and none is skipped."""
    run = Run(hand(tmp_path, silence=0.5, silent="stop"), tmp_path / "run.mcap", paused=True)
    run.wait_until_paused()
    sent = poses()
    with nuno.drive(run.run, "hand") as ball:
        for position, rotation in sent[:5]:
            ball.send(position, rotation)
        run.step_to(5)
        time.sleep(0.8)  # longer than the silence
        threading.Timer(0.1, lambda: [ball.send(*one) for one in sent[5:]]).start()
        run.control("resume")
        assert run.join().state == "done"
    assert places(run.record)[1:].tolist() == [position for position, _ in sent]


def test_what_is_too_large_or_from_another_world_is_refused(tmp_path: Path) -> None:
    """Without being read, where its size says that it is none; a rotation may be of any length but none."""
    run = Run(hand(tmp_path, key="robot/hand"), tmp_path / "run.mcap", paused=True)
    run.wait_until_paused()
    large = {"positions": [[0, 0, 0]] * 100_000, "rotations": [[1, 0, 0, 0]] * 100_000}
    far = {"position": [1e200, 0, 0], "rotation": [1, 0, 0, 0]}
    good = [{"position": position, "rotation": [1e-90, 0, 0, 0]} for position, _ in poses()]
    send(run, "robot/hand", large, far, *good)
    assert places(tmp_path / "run.mcap")[1:].tolist() == [one["position"] for one in good]
    told = run.report["followed"]["hand"]
    assert (told["heard"], told["used"], told["refused"]) == (22, 20, 2)


def test_bodies_are_not_asked_ahead_of_what_they_are_told(tmp_path: Path) -> None:
    """A question about a later frame is refused, and moves nothing."""
    run = Run(hand(tmp_path), tmp_path / "run.mcap", paused=True)
    run.wait_until_paused()
    with spoke(run.endpoint) as session, nuno.drive(run.run, "hand") as ball:
        (reply,) = session.get(f"nuno/{run.run}/{POSES_QUERY}", payload=b'{"frame": 15}', timeout=20.0)
        assert reply.err is not None and "told where to be in frame 1 next" in reply.err.payload.to_string()
        for position, rotation in poses():
            ball.send(position, rotation)
        run.control("resume")
        run.join()
    assert places(run.record)[1:].tolist() == [position for position, _ in poses()]


def test_a_run_or_a_body_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no such run is going on"):
        nuno.drive("nobody", "hand", wait=0.2)
    run = Run(hand(tmp_path, silence=0.01), tmp_path / "run.mcap", paused=True)
    run.wait_until_paused()
    with pytest.raises(BadInput, match=r"no such body(.|\n)*did you mean 'hand'"):
        nuno.drive(run.run, "hnad", wait=LONG)
    with nuno.drive(run.run, "hand") as ball:
        with pytest.raises(BadInput, match="position: not finite"):
            ball.send([np.nan, 0.0, 0.0])
        for shapes in (([0.0, 0.0],), ([0.0, 0.0, 0.0], [0.0, 0.0, 1.0]), ([[0.0, 0.0, 0.0]] * 2,)):
            with pytest.raises(BadInput, match="of another shape"):
                ball.send(*shapes)
        assert ball.add("attach: {body: hand, vertices: [40]}")["vertices"] == 1.0
        with pytest.raises(BadInput, match="held already"):
            ball.add("attach: {body: hand, vertices: [40]}")
    run.control("resume")
    run.join()


def test_by_the_clock_the_newest_poses_are_taken(tmp_path: Path) -> None:
    """Frames wait for the clock by themselves; of what lies there at the first the last is followed."""
    run = Run(hand(tmp_path, frames="clock"), tmp_path / "run.mcap", paused=True)
    run.wait_until_paused()
    send(run, f"nuno/{run.run}/poses/hand", *({"position": p, "rotation": r} for p, r in poses()))
    assert run.report["clock"]["frames"] == 20 and run.report["wall_seconds"] > 0.39
    told = run.report["followed"]["hand"]
    assert told["heard"] == 20 == told["used"] + told["left_out"] and told["used"] + told["without"] == 20
    assert places(tmp_path / "run.mcap")[-1].tolist() == poses()[-1][0]


def test_the_documentations_program_moves_its_hand(tmp_path: Path) -> None:
    """Where the ball was lies on the curve that the program sends."""
    program = blocks(ROOT / "docs" / "how-to" / "robots.md", "py")[0]
    loaded = scene_file.read(shipped.find("hand"), ["duration=1.5 s"])
    run = LiveRun(loaded, Options(record=tmp_path / "run.mcap"), Deployment(paused=True))
    run.wait_until_paused()
    script, ready = tmp_path / "hand.py", tmp_path / "ready"
    program = program.replace('"last"', repr(run.run)).replace("< 3:", "< 1:")
    script.write_text(program.replace("    while", f"    open({str(ready)!r}, 'w').close()\n    while"))
    with subprocess.Popen([sys.executable, str(script)]) as process:
        wait_until(ready.exists)
        run.control("resume")
        assert run.join().state == "done"
        assert process.wait(60) == 0
    x, _, z = places(tmp_path / "run.mcap").T
    moved, followed = z < 0.3, run.report["followed"]["hand"]
    assert followed["refused"] == 0 and followed["behind"] < 5 and moved.sum() > 10
    # On its way to the first pose it goes as fast as it may, and is behind; there it stays until it hears more.
    off = moved & (np.abs(x - 0.1 * np.sin(4.0 * (0.3 - z) / 0.1)) > 1e-9)
    assert len(np.unique(x[off])) <= followed["behind"]


def test_joints_keep_together_on_their_way() -> None:
    """Of all the one with the farthest way decides; rotations stay unit ones, and neither is ever faster than told."""
    random = np.random.default_rng(3)
    for _ in range(50):
        turns = random.normal(size=(2, 4, 4))
        turns /= np.linalg.norm(turns, axis=2, keepdims=True)
        start, goal = random.normal(size=(2, 4, 3))
        live = Live(turns[0].copy(), start.copy(), fastest=2.0, fastest_turn=3.0)
        left = 1.0
        for _ in range(1000):
            before = live.rotation.copy(), live.translation.copy()
            left = live.follow(turns[1], goal, 0.02)
            ways = np.linalg.norm(live.translation - before[1], axis=1)
            assert ways.max() <= 0.04 * (1 + 1e-12)
            assert np.abs(np.linalg.norm(live.rotation, axis=1) - 1.0).max() < 1e-12
            angles = 2.0 * np.arccos(np.clip(np.abs((live.rotation * before[0]).sum(axis=1)), 0.0, 1.0))
            assert angles.max() < 0.06 * (1 + 1e-6)
            if left == 0.0:
                break
        assert left == 0.0
        assert (live.translation.tolist(), live.rotation.tolist()) == (goal.tolist(), turns[1].tolist())


def in_lockstep(scene: Path, record: Path) -> str:
    """The digest of a run whose ball takes hold of the sheet at one frame and lets go at another, with whatever has
    come before each of them.
    """
    changes = {6: "attach: {body: hand, vertices: [40]}", 12: "release: {body: hand}"}
    run = Run(scene, record)
    with nuno.drive(run.run, "hand", wait=LONG) as ball, nuno.watch(run.run, "sim/status") as heard:
        for frame, (position, rotation) in enumerate(poses(), 1):
            if frame in changes:
                assert ball.add(changes[frame])["vertices"] == 1
            ball.send(position, rotation)
            next((one for one in heard if one.frame >= frame), None)
    assert run.join().state == "done"
    told = run.report["followed"]["hand"]
    assert (told["used"], told["without"]) == (20, 0) and told["silence"] < LONG
    return str(run.report["digest"])


def test_a_program_in_step_ends_in_the_same_bits(tmp_path: Path) -> None:
    """What is added between two poses changes the cloth between their two frames, and is answered at once."""
    scene = hand(tmp_path)
    digests = [in_lockstep(scene, tmp_path / f"{name}.mcap") for name in ("one", "two")]
    assert digests[0] == digests[1]
    for name in ("one", "two"):
        with open_recording(tmp_path / f"{name}.mcap") as recording:
            added = [event.frame for event in recording.events() if event.text == "add"]
        assert added == [5, 11]
    assert nuno.verify(tmp_path / "one.mcap").frame is None


@pytest.mark.parametrize("ahead", [False, True])
def test_an_addition_comes_after_the_frames_of_the_poses_before_it(tmp_path: Path, ahead: bool) -> None:
    """However many of them wait, and however slow the frames are; its answer has the last one."""
    changes = {6: "attach: {body: hand, vertices: [40]}", 12: "release: {body: hand}"}
    run = Run(hand(tmp_path), tmp_path / "run.mcap")
    with nuno.drive(run.run, "hand", wait=LONG) as ball:
        said = {}
        for frame, (position, rotation) in enumerate(poses(), 1):
            ball.send(position, rotation)
            if frame in changes:
                said[frame] = ball.add(changes[frame])["frame"]
            elif not ahead:
                run.wait(lambda frame=frame: run.frame >= frame)
    assert run.join().state == "done" and said == {6: 6, 12: 12}
    with open_recording(run.record) as recording:
        assert [event.frame for event in recording.events() if event.text == "add"] == [6, 12]
    assert run.report["followed"]["hand"]["used"] == 20


def test_an_addition_waits_for_a_paused_run_and_ends_with_it(tmp_path: Path) -> None:
    """Without poses it is made in the pause; by the clock, where no frame waits, it is not delayed."""
    run = Run(hand(tmp_path), tmp_path / "run.mcap", paused=True)
    run.wait_until_paused()
    with nuno.drive(run.run, "hand") as ball:
        assert ball.add("attach: {body: hand, vertices: [40]}")["frame"] == 0
        ball.send(*poses()[0])
        threading.Timer(0.3, run.step_to, [1]).start()
        assert ball.add("release: {body: hand}")["frame"] == 1
        ball.send(*poses()[1])
        threading.Timer(0.3, run.stop).start()
        with pytest.raises(RunFailed):
            ball.add("attach: {body: hand, vertices: [40]}")
    clock = Run(hand(tmp_path, frames="clock"), tmp_path / "clock.mcap", paused=True)
    clock.wait_until_paused()
    with nuno.drive(clock.run, "hand") as ball:
        ball.send(*poses()[0])
        assert ball.add("attach: {body: hand, vertices: [40]}")["frame"] == 0
    clock.stop()


def test_a_frame_that_waits_can_be_paused_and_stopped(tmp_path: Path) -> None:
    """It has the next poses all the same; and a run that is stopped ends in order, with what came for its bodies."""
    run = Run(hand(tmp_path), tmp_path / "run.mcap")
    with nuno.drive(run.run, "hand", wait=LONG) as ball:
        ball.send(*poses()[0])
        run.wait(lambda: run.frame >= 1)
        assert run.control("pause")["frame"] == 1
        ball.send(*poses()[1])
        assert run.control("status")["frame"] == 1
        run.control("resume")
        run.wait(lambda: run.frame >= 2)
        assert run.stop().state == "stopped"
    assert places(run.record)[1:].tolist() == [position for position, _ in poses()[:2]]
    assert run.report["followed"]["hand"]["used"] == 2


def test_a_program_that_has_died_and_poses_for_nobody_are_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the key that is listened to, once each."""
    monkeypatch.setattr("nuno.collision.messages.WAITING_AFTER", 0.3)
    run = Run(hand(tmp_path), tmp_path / "run.mcap", paused=True)
    run.wait_until_paused()
    key = f"nuno/{run.run}/poses/hand"
    sent = [json.dumps({"position": p, "rotation": r}) for p, r in poses()[:2]]
    with spoke(run.endpoint) as session:
        for name in (key, key.replace("hand", "hnd"), key):
            for payload in sent:
                session.put(name, payload)
        run.control("resume")
        run.wait(lambda: run.frame >= 4)
        time.sleep(1.0)
        run.stop()
    with open_recording(run.record) as recording:
        said = [event.text for event in recording.events() if event.kind == "warning"]
    assert sum(f"poses come for 'hnd', and no body follows them: hand by {key}" in text for text in said) == 1
    assert sum(f"no poses of frame 5 by {key} yet" in text and "has the program" in text for text in said) == 1


def test_silence_that_ends_a_run_is_no_service_that_died(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It ends in order: with its report, what came for its bodies, and a checkpoint to go on from."""
    run = Run(hand(tmp_path, silence=0.2, silent="stop"), tmp_path / "run.mcap", paused=True)
    run.wait_until_paused()
    send(run, f"nuno/{run.run}/poses/hand", *({"position": p, "rotation": r} for p, r in poses()[:7]))
    outcome = run.join()
    assert outcome.state == "failed" and outcome.error == ""
    assert outcome.problem.startswith("failed: the body hand has heard nothing for 0.2")
    assert run.report["followed"]["hand"]["used"] == 7
    with nuno.open(run.record) as recording:
        assert recording.last_checkpoint().frame == 7
    with pytest.raises(RunFailed, match=r"^failed: the body hand has heard nothing for .*silent: stop"):
        nuno.run(hand(tmp_path, silence=0.01, silent="stop"), record=tmp_path / "stopped.mcap")
    assert main(["info", str(tmp_path / "stopped.mcap")]) == 0
    said = capsys.readouterr().out
    assert "0 poses came" in said and "silent: stop" in said and "1 sent, 1 recorded" in said


def test_bodies_are_waited_for_together(tmp_path: Path) -> None:
    """A frame waits as long as the longest silence, not as long as all of them."""
    moved = {"plugin": "topic", "frames": "poses", "silence": 0.3}
    ball = {"collider": {"plugin": "sphere", "radius": 0.03}, "motion": moved}
    bodies = [{"name": name} | ball for name in ("left", "right")]
    cloth = [{"name": "cloth", "model": SHEET}]
    scene = write_scene(tmp_path, objects=cloth, bodies=bodies, solver="symplectic_euler", duration=0.06)
    done = nuno.run(scene, progress=False)
    assert done.report["followed"]["left"]["without"] == done.report["followed"]["right"]["without"] == 3
    assert 0.9 <= done.report["parts_seconds"]["bodies"] < 1.5


def test_by_the_clock_silence_begins_with_the_first_poses(tmp_path: Path) -> None:
    """Until then the body waits where the scene has it, whatever silence brings later."""
    early = nuno.run(hand(tmp_path, frames="clock", silence=0.1, silent="stop"), progress=False)
    assert early.state == "done" and early.report["followed"]["hand"]["without"] == 20
    run = Run(hand(tmp_path, frames="clock", silence=0.1, silent="stop"), tmp_path / "run.mcap", paused=True)
    run.wait_until_paused()
    send(run, f"nuno/{run.run}/poses/hand", {"position": [0.0, 0.0, 0.1], "rotation": [1, 0, 0, 0]})
    assert run.join().state == "failed" and "silent: stop" in run.join().problem


@pytest.mark.full
def test_the_documentations_environment_is_the_same_after_each_reset(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the bit, whatever became of the one before: given up on its way, or gone to its end."""
    tool = tmp_path / "nuno"
    tool.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m nuno "$@"\n')
    tool.chmod(0o755)
    monkeypatch.setenv("PATH", os.pathsep.join([str(tmp_path), os.environ["PATH"]]))
    (program,) = blocks(ROOT / "docs" / "how-to" / "robots.md", "python")
    known: dict[str, Any] = {}
    exec(program.replace("300\n", "12\n").replace("duration=3 s", "duration=0.12 s"), known)
    env, seen = known["Env"](runs.new_id("env")), list[Any]()
    for steps in (4, 11):
        seen.append([env.reset()])
        for number in range(steps):
            x, reward, over = env.step([0.0, -0.1, 0.3 - 0.03 * number])
            seen[-1].append(x)
    env.close()
    assert over and env.run.poll() is not None and reward > 0.0
    assert all((one == other).all() for one, other in zip(*seen, strict=False))


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
        assert said == {"vertices": 1, "held": 1, "frame": 0} and all(type(number) is int for number in said.values())
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


@pytest.mark.parametrize(
    ("sent", "problem"),
    {
        b'{"position": [0, 1, 0], "orientation": [1, 0, 0, 0]}': "orientation: Extra inputs are not permitted",
        b'{"position": [0, 1, 0], "rotations": [[1, 0, 0, 0]]}': "position and rotations: give",
        b'{"position": [0, 1, 0], "positions": [[0, 1, 0]]}': "position and positions: give",
        b'{"positions": [[0, 1, 0]], "rotations": [[1, 0, 0, 0]], "rotation": [1, 0, 0, 0]}': "rotation: Extra inputs",
        b'{"position": ["0", 1, 0]}': "positions.0.0: Input should be a valid number",
        b'{"position": [true, 1, 0]}': "positions.0.0: Input should be a valid number",
        b'{"position": [0, 1, 0], "rotation": ["1", 0, 0, 0]}': "rotations.0.0: Input should be a valid number",
    }.items(),
)
def test_a_pose_with_other_fields_or_texts_for_numbers_is_refused(sent: bytes, problem: str) -> None:
    with pytest.raises(BadInput, match=re.escape(problem)):
        read_poses(sent, ("hand",))


def test_two_programs_that_move_one_body_at_once_are_reported(tmp_path: Path) -> None:
    """One that takes over from another is not."""
    run = Run(hand(tmp_path), tmp_path / "run.mcap", paused=True)
    run.wait_until_paused()
    with nuno.drive(run.run, "hand") as one, nuno.drive(run.run, "hand") as other:
        for frame, sender in enumerate([one, one, other, other, one, other]):
            sender.send([0.0, 0.0, 0.2])
            run.step_to(frame + 1)
            warnings = [event.text for event in events_of(run.record) if event.kind == "warning"]
            assert sum("the body hand is moved by several programs" in text for text in warnings) == (frame > 3)
    run.stop()
    assert run.report["followed"]["hand"]["mixed"] == 2
    assert any("2 by an earlier sender after another's" in text for _, text in lines(run.report))


def events_of(path: Path) -> list[Event]:
    """Return the events of a run's recording so far."""
    with open_recording(part_of(path)) as recording:
        return recording.events()
