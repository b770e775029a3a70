"""Frames that wait for poses: control is answered meanwhile, so that a program in step ends in the same bits."""

from __future__ import annotations

import json
import os
import shlex
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from doc_pages import ROOT, blocks
from live_hand import LONG, SHEET, hand, places, poses, send
from live_run import Run
from scenes import write_scene

import nuno
from nuno.bus.sessions import spoke
from nuno.cli import main
from nuno.recording.reader import open_recording
from nuno.supervision import runs
from nuno_schemas.errors import RunFailed


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
    monkeypatch.setattr("nuno.collision.live.WAITING_AFTER", 0.3)
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
