"""A zenoh configuration reaches every part of a run: a hub that asks for a password lets only them in."""

from __future__ import annotations

import json
import threading
from pathlib import Path

import pytest
from scenes import BALL, write_scene

import nuno
from nuno.bus.messages import Bus, Inbox, Message
from nuno.bus.query import Query
from nuno.bus.sessions import free_port, hub, spoke
from nuno.cli import main
from nuno.runtime import runs, supervisor
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import STATE


@pytest.fixture
def config(tmp_path: Path) -> str:
    """A configuration by which a hub asks for a password, and a spoke gives it."""
    (tmp_path / "users.txt").write_text("anna:secret")
    user = {"user": "anna", "password": "secret", "dictionary_file": str(tmp_path / "users.txt")}
    path = tmp_path / "zenoh.json5"
    path.write_text(json.dumps({"transport": {"auth": {"usrpwd": user}}}))
    return str(path)


def test_who_has_no_password_is_not_let_in(config: str) -> None:
    """What the other tests rest on."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with hub(endpoint, config):
        with spoke(endpoint, config):
            pass
        with pytest.raises(BadInput, match="something listens there"), spoke(endpoint):
            pass


@pytest.mark.full
def test_services_in_processes_of_their_own_are_let_in(config: str, tmp_path: Path) -> None:
    record = tmp_path / "run.mcap"
    scene = write_scene(tmp_path, bodies=BALL, duration=0.1)
    command = ["run", str(scene), "--processes", "--config", config, "--record", str(record), "--no-view"]
    assert main(command) == 0
    with nuno.open(record) as recording:
        assert recording.complete


def test_control_is_let_in(config: str, capsys: pytest.CaptureFixture[str]) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with hub(endpoint, config) as session, runs.announced("guarded", endpoint):
        inbox = Inbox(Bus(session, "guarded", "simulation"), [])
        inbox.answer("control")
        answer = {"ok": True, "state": "paused", "frame": 3, "frames": 25, "t": 0.06}

        def reply() -> None:
            question = inbox.get(20.0)
            assert isinstance(question, Query)
            question.answer_json(answer)

        thread = threading.Thread(target=reply, daemon=True)
        thread.start()
        assert main(["control", "guarded", "status", "--config", config]) == 0
        thread.join(20.0)
        assert "paused at frame 3 of 25" in capsys.readouterr().out
        assert main(["control", "guarded", "status"]) == 2


@pytest.mark.full
def test_a_replay_asks_for_the_password(config: str, tmp_path: Path) -> None:
    record = tmp_path / "run.mcap"
    nuno.run(write_scene(tmp_path, duration=0.1), record=record)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    flags = ["--listen", endpoint, "--run", "again", "--no-view", "--rate", "0.04", "--config", config]
    command = ["replay", str(record), *flags]
    thread = threading.Thread(target=main, args=(command,), daemon=True)
    thread.start()
    with spoke(endpoint, config, supervisor.CONNECT_PATIENCE) as session:
        inbox = Inbox(Bus(session, "again", "listener"), [STATE], newest_only=True)
        assert isinstance(inbox.get(20.0), Message)
        with pytest.raises(BadInput, match="something listens there"), spoke(endpoint):
            pass
    thread.join(30.0)
    assert not thread.is_alive()
