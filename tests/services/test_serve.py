"""Services that are started by hand, and where a run listens and is found."""

from __future__ import annotations

import fcntl
import io
import json
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import zenoh
from live_run import wait_until
from scenes import write_scene

import nuno
from nuno.bus import sessions
from nuno.bus.sessions import ATTEMPTS, PortTaken, free_port, hub, hub_at
from nuno.cli import main, serve
from nuno.process import Terminated
from nuno.runtime import runs
from nuno.simulation.run import Simulation
from nuno_schemas.errors import BadInput, RunFailed


class ByHand:
    """Commands of one run, each in a thread of its own, at a hub that they share."""

    def __init__(self, folder: Path, endpoint: str) -> None:
        self.folder, self.endpoint = folder, endpoint
        self.threads: dict[str, threading.Thread] = {}
        self.codes: dict[str, int] = {}

    def start(self, name: str, *command: str) -> None:
        line = [*command[:2], str(self.folder / "scene.yaml"), "--run", "r1", "--connect", self.endpoint]
        record = [] if "--record" in command else ["--record", str(self.folder / "r1.mcap")]
        line += [*record, *command[2:]]

        def body() -> None:
            self.codes[name] = main(line)

        self.threads[name] = threading.Thread(target=body, name=name, daemon=True)
        self.threads[name].start()

    def serve(self, *services: str) -> None:
        for name in services:
            self.start(name, "serve", name)

    def code(self, name: str) -> int:
        self.threads[name].join(60.0)
        return self.codes[name]


@pytest.fixture
def by_hand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ByHand]:
    monkeypatch.setattr(serve, "PATIENCE", 1.0)
    write_scene(tmp_path)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with hub(endpoint):
        yield ByHand(tmp_path, endpoint)


def listen(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], bool]:
    """Whether commands have said this from now on, on standard error. Reading what pytest captures, again and again,
    would lose what another thread writes just then.
    """
    heard = io.StringIO()
    monkeypatch.setattr(sys, "stderr", heard)
    return lambda words: words in heard.getvalue()


def test_services_say_who_is_there_and_end_with_0_where_the_run_is_done(
    by_hand: ByHand, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that the run does without is told that it takes no part."""
    said = listen(monkeypatch)
    by_hand.serve("recorder", "collision")
    wait_until(lambda: said("r1 recorder: recorder is ready") and said("collision: collision is ready"))
    by_hand.serve("simulation")
    by_hand.start("run", "run", "--no-view")
    assert [by_hand.code(name) for name in ("run", "simulation", "recorder")] == [0, 0, 0]
    assert by_hand.code("collision") == 1
    assert said("the collision service takes no part")
    assert said("the supervisor has gone: its run ended without this service")
    assert said("r1 recorder: simulation is ready") and said("r1 recorder: the run is over")
    with nuno.open(by_hand.folder / "r1.mcap") as recording:
        assert recording.complete


def test_a_second_service_of_a_name_is_told_so_and_does_not_disturb_the_first(
    by_hand: ByHand, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = listen(monkeypatch)
    by_hand.serve("recorder")
    wait_until(lambda: said("r1 recorder: recorder is ready"))
    by_hand.start("again", "serve", "recorder")
    assert by_hand.code("again") == 2
    assert said("this service of the run is there already")
    by_hand.serve("simulation")
    by_hand.start("run", "run", "--no-view")
    assert [by_hand.code(name) for name in ("run", "simulation", "recorder")] == [0, 0, 0]


@pytest.mark.parametrize(("signal", "word"), [(Terminated, "SIGTERM"), (KeyboardInterrupt, "SIGINT (Ctrl-C)")])
def test_the_run_says_which_service_was_ended_by_what(
    signal: type[BaseException], word: str, by_hand: ByHand, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    def end(self: Simulation, *arguments: Any) -> None:
        raise signal

    monkeypatch.setattr(Simulation, "advance", end)
    by_hand.serve("recorder", "simulation")
    by_hand.start("run", "run", "--no-view")
    assert [by_hand.code(name) for name in ("run", "recorder", "simulation")] == [1, 1, 1]
    assert f"the simulation service died: ended by {word}" in capsys.readouterr().err


def test_services_that_are_left_end_with_1_where_the_run_failed(
    by_hand: ByHand, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(self: Simulation, *arguments: Any) -> None:
        raise RunFailed("the loom is on fire")

    monkeypatch.setattr(Simulation, "advance", fail)
    by_hand.serve("recorder", "simulation")
    by_hand.start("run", "run", "--no-view")
    assert [by_hand.code(name) for name in ("run", "recorder", "simulation")] == [1, 1, 1]
    assert "failed: the run failed: the simulation service died: the loom" in capsys.readouterr().err


def test_a_run_by_the_clock_needs_a_simulation_by_the_clock(
    by_hand: ByHand, capsys: pytest.CaptureFixture[str]
) -> None:
    by_hand.serve("recorder", "simulation")
    by_hand.start("run", "run", "--no-view", "--real-time")
    assert [by_hand.code(name) for name in ("run", "recorder", "simulation")] == [2, 1, 1]
    assert "--real-time: the simulation service does not wait for the clock" in capsys.readouterr().err
    by_hand.serve("recorder")
    by_hand.start("simulation", "serve", "simulation", "--real-time")
    by_hand.start("run", "run", "--no-view", "--real-time")
    assert [by_hand.code(name) for name in ("run", "recorder", "simulation")] == [0, 0, 0]
    assert "frames waited for it" in capsys.readouterr().out


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Recordings that a run draws its last frame and its animation of."""
    drawn = list[Path]()
    monkeypatch.setattr("nuno.exports.pictures.export_picture", lambda path, *_: drawn.append(path))
    monkeypatch.setattr("nuno.exports.animations.export_animation", lambda path, *_, **how: drawn.append(path))
    monkeypatch.setattr("nuno.viewer.live.has_screen", lambda: False)
    return drawn


@pytest.mark.parametrize("there", [False, True])
def test_the_recording_of_the_run_is_drawn_and_no_other(there: bool, by_hand: ByHand, drawn: list[Path]) -> None:
    """The recorder's --record names it; that of the run may name an older recording, or nothing."""
    other = by_hand.folder / "other.mcap"
    if there:
        nuno.run(by_hand.folder / "scene.yaml", record=other)
    by_hand.serve("recorder", "simulation")
    by_hand.start("run", "run", "--report", "--record", str(other), "--mp4", str(by_hand.folder / "a.gif"))
    assert [by_hand.code(name) for name in ("run", "simulation", "recorder")] == [0, 0, 0]
    assert drawn == [by_hand.folder / "r1.mcap"] * 2
    assert runs.find_recording(Path("last")) == by_hand.folder / "r1.mcap"


def test_a_run_without_its_animation_fails(
    by_hand: ByHand, drawn: list[Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The recorder may be on another host."""
    monkeypatch.setattr("nuno.runtime.outcome.Outcome.recording", lambda *_: None)
    by_hand.serve("recorder", "simulation")
    by_hand.start("run", "run", "--no-view", "--mp4", str(by_hand.folder / "a.gif"))
    assert [by_hand.code(name) for name in ("run", "simulation", "recorder")] == [1, 0, 0]
    assert drawn == [] and "no animation: the recording is not here" in capsys.readouterr().err


@pytest.mark.parametrize("option", [("--processes",), ("--listen", "tcp/127.0.0.1:0")])
def test_a_run_of_services_that_wait_starts_none_and_listens_nowhere(
    option: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", str(write_scene(tmp_path)), "--connect", "tcp/127.0.0.1:1", *option]) == 2
    assert f"error: {option[0]}: " in capsys.readouterr().err


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


def test_services_name_the_hub_that_has_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said = listen(monkeypatch)
    write_scene(tmp_path)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with hub(endpoint):
        by_hand = ByHand(tmp_path, endpoint)
        by_hand.serve("recorder", "simulation")
        by_hand.start("run", "run", "--no-view", "--paused")
        wait_until(lambda: said("paused before its first frame"))
    assert [by_hand.code(name) for name in ("run", "recorder", "simulation")] == [1, 1, 1]
    assert said(f"failed: the connection to the hub at {endpoint} broke, or the hub ended")
    assert not said("the supervisor has gone")
