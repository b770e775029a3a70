"""Broken, replayed and foreign messages: dropped, counted, and never part of the result."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
import zenoh
from foreign import DEEP, header, put, settle, undisturbed
from live_run import Run

import nuno
from nuno_schemas.messages import Event


def bad_headers(run: str) -> list[bytes | str | None]:
    """Attachments that no message of this run has."""
    return [
        None,
        b"",
        os.urandom(64),
        DEEP,
        json.dumps({"run": "x" * 1_000_000}),
        header("another-run"),
        header(run, seq=0),  # long gone by
        header(run, seq=-1),
        header(run, seq="many"),
        header(run, seq=1.5),
        header(run, schema_version=2),
        header(run, t="NaN"),
        header(run, frame=None),
        header(run, colour="red"),
        header(run)[:-9],
    ]


TOPICS = ("sim/state", "sim/status", "collision/bodies", "collision/report", "ack/recorder", "ack/collision")


def test_foreign_messages_change_nothing_but_their_count(paused: tuple[Run, zenoh.Session], tmp_path: Path) -> None:
    run, session = paused
    run.wait_until_paused()
    for topic in TOPICS:
        for attachment in bad_headers(run.run):
            put(session, run, topic, os.urandom(100), attachment)
    run.control("step", frames=20)
    # Once more while frames go by: these mix with real messages.
    for topic in TOPICS:
        for attachment in bad_headers(run.run):
            put(session, run, topic, b"", attachment)
    settle(session, run)
    frame = run.wait_until_paused()
    outcome = run.stop()
    assert outcome.state == "stopped", outcome.error
    assert outcome.summary["digest"] == undisturbed(tmp_path, frame).digest
    assert run.report["refused"] == 2 * len(TOPICS) * len(bad_headers(run.run))
    assert run.report["missing"] == 0
    with nuno.open(run.record) as recording, nuno.open(tmp_path / "quiet.mcap") as quiet:
        assert recording.complete
        assert [f.digest for f in recording.frames()] == [f.digest for f in quiet.frames()]


BROKEN = [b"", os.urandom(500), b"{}", b"null", b'{"frame": "x"}', DEEP]


@pytest.mark.parametrize(
    "topic", ["ack/nobody", "ack/recorder", "run/event/nobody", "run/event/simulation", "sim/state"]
)
def test_a_broken_payload_does_not_take_the_place_of_a_message(
    paused: tuple[Run, zenoh.Session], topic: str, tmp_path: Path
) -> None:
    """Valid headers with the very number that comes next, around payloads that are nothing."""
    run, session = paused
    frame = run.wait_until_paused()
    # Frames count from 0, so frame + 1 have been sent; of events, only that of the pause.
    following = {"ack/recorder": frame + 1, "sim/state": frame + 1, "run/event/simulation": 1}.get(topic, 0)
    for payload in BROKEN:
        put(session, run, topic, payload, header(run.run, seq=following, frame=frame + 1))
    settle(session, run)
    run.control("step", frames=20)
    frame = run.wait_until_paused()
    outcome = run.stop()
    assert outcome.state == "stopped", outcome.error
    assert outcome.summary["digest"] == undisturbed(tmp_path, frame).digest
    assert run.report["refused"] == len(BROKEN)
    assert run.report["missing"] == 0
    with nuno.open(run.record) as recording:
        assert recording.complete


def test_nobody_else_can_end_a_run_or_speak_for_its_services(paused: tuple[Run, zenoh.Session]) -> None:
    run, session = paused
    run.wait_until_paused()
    end = Event(frame=1, t=0.0, service="nobody", kind="end", text="done", args={"summary": {"digest": "forged"}})
    lie = end.model_copy(update={"service": "simulation"})
    for event in (end, lie, end.model_copy(update={"kind": "error"})):
        put(session, run, "run/event/nobody", event.model_dump_json(), header(run.run, seq=0))
    ack = {"service": "recorder", "frame": 3}
    for frame in (3, 10**9):
        put(session, run, "ack/nobody", json.dumps(ack | {"frame": frame}), header(run.run, seq=0))
    settle(session, run)
    run.control("step", frames=2)
    run.wait_until_paused()
    outcome = run.stop()
    assert outcome.state == "stopped"
    assert outcome.error == ""
    assert outcome.summary["digest"] != "forged"
    assert run.report["refused"] == 5
