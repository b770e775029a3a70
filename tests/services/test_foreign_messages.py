"""Broken, replayed and foreign messages and questions: counted, refused, and never part of the result."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import zenoh
from foreign import DEEP, header, key, put, replies, session_answer, settle, undisturbed
from live_run import Run

import nuno
from nuno.bus.encodings import BadMessage, check_protobuf, decode_arrays, decode_points, encode_arrays, encode_points
from nuno.bus.messages import Bus, Inbox, Message, Query
from nuno.bus.sessions import free_port, hub
from nuno.collision.messages import decode_geometry, decode_poses
from nuno.runtime import supervisor
from nuno_schemas.errors import RunFailed
from nuno_schemas.messages import ACK, STATE, Event


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


def test_payloads_that_are_cut_or_changed_never_decode_to_something_else() -> None:
    """Every prefix of a real payload is refused, whichever byte it is cut at."""
    arrays = encode_arrays({"rotation": np.array([[1.0, 0, 0, 0]]), "translation": np.zeros((1, 3))}, {"t": 0.5})
    points = encode_points(np.arange(12.0).reshape(4, 3), 0.5)
    for payload, decode in ((arrays, decode_arrays), (arrays, decode_poses), (points, decode_points)):
        decode(payload)
        check_protobuf(payload)
        refused = 0
        for end in range(len(payload)):
            try:
                decode(payload[:end])  # type: ignore[operator]
            except BadMessage:
                refused += 1
            else:
                # A cut between two fields is a whole protobuf message, of less.
                check_protobuf(payload[:end] or payload)
        assert refused > 0.9 * len(payload)


def test_arrays_that_lie_about_themselves_are_refused() -> None:
    from nuno.bus.encodings import _arrays_class

    def message(text: str = "{}", **array: Any) -> bytes:
        found = _arrays_class()(text=text)
        if array:
            found.arrays.add(**array)
        return bytes(found.SerializeToString())

    huge = 2**32 - 1
    for payload in (
        message(name="x", dtype="object", shape=[1], data=b"12345678"),
        message(name="x", dtype="float64", shape=[2], data=b"12345678"),
        message(name="x", dtype="float64", shape=[huge] * 4, data=b""),
        message(name="x", dtype="float64", shape=[huge, huge, huge, 0], data=b""),
        message(name="x", dtype="float64", shape=[1] * 100, data=b"12345678"),
        message(text="[]"),
        message(text="nonsense"),
        message(text="[" * 100_000),
    ):
        with pytest.raises(BadMessage):
            decode_arrays(payload)
    for text in ('{"t": null}', '{"t": "x"}', '{"t": 0, "bodies": 7, "frames": 7}'):
        for decode in (decode_poses, decode_geometry):
            with pytest.raises(BadMessage):
                decode(message(text, name="rotation", dtype="float64", shape=[0, 4], data=b""))


@contextmanager
def inbox(run: str = "run") -> Iterator[tuple[Inbox, Callable[..., None]]]:
    """An inbox for sim/state and acks, and a way to put messages of any number into it."""
    with hub(f"tcp/127.0.0.1:{free_port()}") as session:
        bus = Bus(session, run, "reader")
        box = Inbox(bus, [STATE, ACK])

        def put(seq: int, payload: bytes = b"x", topic: str = STATE.name) -> None:
            session.put(bus.key(topic), payload, attachment=header(run, seq=seq))

        yield box, put


def numbers(box: Inbox, count: int) -> dict[str, list[int]]:
    """Numbers of the next `count` messages by topic, between which no order is kept."""
    found: dict[str, list[int]] = {}
    for _ in range(count):
        message = box.get(10.0)
        assert isinstance(message, Message)
        found.setdefault(message.topic, []).append(message.header.seq)
    return found


def test_a_gap_is_counted_as_missing_and_the_late_message_refused() -> None:
    with inbox() as (box, put):
        for seq in (0, 1, 5, 3, 6, 6, 0, 7):
            put(seq)
        put(2, topic=ACK.name)
        assert numbers(box, 6) == {STATE.name: [0, 1, 5, 6, 7], ACK.name: [2]}
        assert box.counts.missing == {STATE.name: 3, ACK.name: 2}
        assert box.counts.refused == {STATE.name: 3}
        assert box.counts.received == {STATE.name: 5, ACK.name: 1}


def test_the_number_of_a_refused_message_is_expected_again() -> None:
    with inbox() as (box, put):
        put(0)
        put(4, b"broken")
        put(1)
        assert numbers(box, 1) == {STATE.name: [0]}
        broken = box.get(10.0)
        assert isinstance(broken, Message)
        assert box.counts.missing[STATE.name] == 3
        box.refuse(broken)
        assert numbers(box, 1) == {STATE.name: [1]}
        assert box.counts.missing[STATE.name] == 0
        assert box.counts.refused == {STATE.name: 1}
        assert box.counts.received == {STATE.name: 2}


def test_an_answer_that_cannot_be_read_fails_plainly() -> None:
    with hub(f"tcp/127.0.0.1:{free_port()}") as session:
        bus = Bus(session, "run", "asker")
        for payload in (b"", b"[1]", DEEP, os.urandom(50)):
            queryable = session.declare_queryable(bus.key("control"), lambda q, p=payload: q.reply(q.key_expr, p))
            with pytest.raises(RunFailed, match="control cannot be read"):
                bus.ask_json("control", {}, 5.0)
            queryable.undeclare()


def test_a_question_on_its_way_while_an_inbox_closes_is_dropped() -> None:
    """Whoever asks would otherwise wait for an answer until the time is over."""
    dropped: list[str] = []
    query = SimpleNamespace(drop=lambda: dropped.append("dropped"))
    with inbox() as (box, _):
        box.close()
        box._ask(Query("poses", "nuno/run/poses", query))  # type: ignore[arg-type]
        assert dropped == ["dropped"] and box.get(0.0) is None
