"""An inbox counts what is missing and what it refuses; answers that cannot be read fail plainly."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace

import pytest
from foreign import DEEP, header

from nuno.bus.messages import Bus, Inbox, Message
from nuno.bus.query import Query
from nuno.bus.sessions import free_port, hub
from nuno_schemas.errors import RunFailed
from nuno_schemas.messages import ACK, STATE


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
