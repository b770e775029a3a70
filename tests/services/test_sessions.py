"""Where a run listens, and how it is found there."""

from __future__ import annotations

import fcntl
import json
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import zenoh
from scenes import write_scene

import nuno
from nuno.bus import sessions
from nuno.bus.sessions import ATTEMPTS, PortTaken, hub_at
from nuno.runtime import runs
from nuno_schemas.errors import BadInput


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


def test_without_room_for_shared_memory_a_session_does_without(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a container whose /dev/shm is full; the words are zenoh's."""
    real, configs = zenoh.open, []

    def refuse(config: zenoh.Config) -> zenoh.Session:
        configs.append(config.get_json("transport/shared_memory/enabled"))
        if configs[-1] == "true":
            raise zenoh.ZError("Unable to create POSIX shm segment: OS error 12 at /zenoh/shm.rs:1.")
        return real(config)

    monkeypatch.setattr(zenoh, "open", refuse)
    with hub_at(None) as (_, endpoint), sessions.spoke(endpoint) as session:
        assert list(session.info.routers_zid())
    assert configs == ["true", "false", "true", "false"]


def test_a_name_is_one_runs_alone_while_it_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second neither takes the place of the first nor, when it is refused, its note away."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with runs.announced("twin", "tcp/127.0.0.1:1"):
        again = runs.announced("twin", "tcp/127.0.0.1:2")
        with pytest.raises(BadInput, match="a run of that name is going on"), again:
            pass
        assert runs.running() == {"twin": "tcp/127.0.0.1:1"}
    assert runs.running() == {}
    with runs.announced("twin", "tcp/127.0.0.1:2"):
        assert runs.running() == {"twin": "tcp/127.0.0.1:2"}


def test_the_note_of_a_killed_run_is_not_believed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    note = runs.folder() / "dead.json"
    note.write_text(json.dumps({"endpoint": "tcp/127.0.0.1:1"}))
    assert runs.running() == {}
    assert not note.exists()


def test_who_looks_removes_no_note_of_a_run_that_begins_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A dead run's note is opened; before it is locked another look removes it, and a run of that name begins."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    note = runs.folder() / "twin.json"
    note.write_text(json.dumps({"endpoint": "tcp/127.0.0.1:1"}))
    lock, begun = fcntl.flock, ExitStack()

    def flock(stream: Any, how: int) -> None:
        if how & fcntl.LOCK_SH:
            monkeypatch.setattr(fcntl, "flock", lock)
            note.unlink()
            begun.enter_context(runs.announced("twin", "tcp/127.0.0.1:2"))
        lock(stream, how)

    monkeypatch.setattr(fcntl, "flock", flock)
    runs.running()
    with begun:
        assert runs.running() == {"twin": "tcp/127.0.0.1:2"}


def test_a_folder_for_notes_that_cannot_be_made_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "nuno").write_text("in the way")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with pytest.raises(BadInput, match="no folder for running runs"), runs.announced("a", "tcp/127.0.0.1:1"):
        pass


def test_a_second_session_of_one_identity_is_refused_though_it_has_an_hour(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would else join when the first one ends: another run, or the end of this."""
    monkeypatch.setattr(sessions, "HANDOVER", 0.2)
    endpoint, own = f"tcp/127.0.0.1:{sessions.free_port()}", sessions.identity("r1", "recorder")
    with sessions.hub(endpoint), sessions.spoke(endpoint, patience=5.0, own=own):
        with pytest.raises(BadInput, match="there already"), sessions.spoke(endpoint, patience=3600.0, own=own):
            pass
        with sessions.spoke(endpoint, patience=5.0, own=sessions.identity("r1", "dye")):
            pass
