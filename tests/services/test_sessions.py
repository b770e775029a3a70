"""Where a run listens."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from scenes import write_scene

import nuno
from nuno.wire import sessions
from nuno.wire.sessions import ATTEMPTS, PortTaken, hub_at


@pytest.fixture
def taken() -> Iterator[int]:
    """A port at which another program listens."""
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        yield int(other.getsockname()[1])


def test_a_port_that_is_taken_in_between_is_given_up_for_another(
    taken: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As when two runs that start at once find the same port free."""
    found = iter([taken, taken, sessions.free_port()])
    monkeypatch.setattr(sessions, "free_port", lambda: next(found))
    assert nuno.run(write_scene(tmp_path, duration=0.1)).state == "done"
    assert list(found) == []


def test_a_port_is_not_looked_for_for_ever(taken: int, monkeypatch: pytest.MonkeyPatch) -> None:
    tried = []
    monkeypatch.setattr(sessions, "free_port", lambda: tried.append(taken) or taken)
    with pytest.raises(PortTaken), hub_at(None):
        pass
    assert len(tried) == ATTEMPTS


def test_a_port_that_was_asked_for_is_taken_or_not(taken: int) -> None:
    with pytest.raises(PortTaken, match="another program listens there"), hub_at(f"tcp/127.0.0.1:{taken}"):
        pass
