"""Wrong questions to the services of a run: answered, counted, and without effect."""

from __future__ import annotations

import json
import os
from pathlib import Path

import zenoh
from foreign import DEEP, key, replies, session_answer, undisturbed
from live_run import Run

from nuno.collision.messages import decode_poses
from nuno.runtime import supervisor

CONTROLS: list[object] = [
    {"action": "step", "frames": "many"},
    {"action": "step", "frames": -1},
    {"action": "step", "frames": 0},
    {"action": "step", "frames": 1.5},
    {"action": "step", "frames": True},
    {"action": "step", "frames": 10**30},
    {"action": "step", "frames": [1]},
    {"action": ["stop"]},
    {"action": None},
    {"action": "dance"},
    {"action": "set"},
    {"action": "set", "item": 7},
    {"action": "set", "item": {"gravity": 0}},
    {"action": "set", "item": "gravity=[0, .nan, 0]"},
    {"action": "set", "item": "gravity=" + "[" * 5000},
    {"action": "set", "item": "duration=1"},
    {"action": "set", "item": "damping=1 kg"},
    {},
    [],
    "stop",
    7,
    None,
]


def test_wrong_questions_are_answered_and_change_nothing(paused: tuple[Run, zenoh.Session], tmp_path: Path) -> None:
    run, session = paused
    before = run.wait_until_paused()
    for question in (*(json.dumps(c).encode() for c in CONTROLS), b"", os.urandom(100), DEEP, None):
        (answer,) = replies(session, key(run, "control"), question)
        assert json.loads(answer)["ok"] is False, question
        assert json.loads(answer)["error"]
    for service in ("simulation", "collision", "recorder"):
        for payload in (b"", os.urandom(100), DEEP, b"[]", b"7", b'{"expected": {"sim/state": "x"}}', b'{"error": 3}'):
            assert "not a question to finish" in replies(session, key(run, f"finish/{service}"), payload)[0]
    for frame in ("x", -1, 10**12, 10**400, 1.5, True, None, [1]):
        (answer,) = replies(session, key(run, "collision/ask/poses"), json.dumps({"frame": frame}).encode())
        assert "by frame, 0 to 20000" in answer
    for payload in (b"", os.urandom(100), DEEP, b"[]"):
        assert "by frame" in replies(session, key(run, "collision/ask/poses"), payload)[0]
    # Good questions, but more of them and further ahead than the service keeps poses for.
    for frame in range(19_000, 19_040):
        decode_poses(session_answer(session, key(run, "collision/ask/poses"), json.dumps({"frame": frame}).encode()))
    assert run.wait_until_paused() == before
    run.control("step", frames=5)
    frame = run.wait_until_paused()
    outcome = run.stop()
    assert outcome.state == "stopped", outcome.error
    assert frame == before + 5
    assert outcome.summary["digest"] == undisturbed(tmp_path, frame).digest
    assert outcome.services["collision"]["refused"]["collision/ask/poses"] == 12


def test_arguments_of_a_request_cannot_pose_as_fields_of_the_event(paused: tuple[Run, zenoh.Session]) -> None:
    run, _ = paused
    run.wait_until_paused()
    request = {"action": "pause", "frame": 10**9, "text": "stop", "kind": "end", "t": "x", "self": 1, "service": "no"}
    assert supervisor.control(run.run, run.endpoint, request)["ok"]
    assert run.stop().state == "stopped"
