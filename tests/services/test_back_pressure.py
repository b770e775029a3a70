"""A run waits for those that it must not lose, names them, and gives up clearly; it waits for nobody else."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from live_run import wait_until
from scenes import BALL, write_scene

import nuno
from nuno.bus import sessions as slow_consumers
from nuno.bus.messages import Bus, Inbox, Message
from nuno.bus.sessions import hub_at, identity, spoke
from nuno.collision.service import Collision
from nuno.recorder.service import Recorder
from nuno.report.run_report import lines, make_report
from nuno.runtime import driver, supervisor
from nuno.runtime import supervisor as oversight
from nuno.runtime.service import Options
from nuno.runtime.stepper import Stepped
from nuno.runtime.supervisor import Outcome
from nuno.scene import scene_file
from nuno.simulation.run import Simulation
from nuno_schemas.messages import STATE

COUNT, SIZE = 400, 100_000
"""Four times what lies between a hub and a session that reads nothing, in its queue and in the system's."""


DEAF = """
import sys, time
from nuno.bus.sessions import spoke

def never(sample):
    print("called", flush=True)
    time.sleep(120)

with spoke(sys.argv[1]) as session:
    session.declare_subscriber(sys.argv[2], never)
    print("listens", flush=True)
    time.sleep(120)
"""
"""A subscriber whose first message never comes to an end.

It is a process of its own, as it is in earnest: sessions of one process share zenoh's few threads, and the one that
never returns may keep another's work with it.
"""


@contextmanager
def deaf(endpoint: str, key: str) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen([sys.executable, "-c", DEAF, endpoint, key], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == "listens\n"
            yield process
        finally:
            process.kill()


def test_who_reads_nothing_is_named_and_holds_up_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slow_consumers, "LOOK_SECONDS", 0.0)
    monkeypatch.setattr(slow_consumers, "BEHIND_SECONDS", 0.05)
    run = "deaf-run"
    with (
        hub_at(None, None, [identity(run, "recorder")]) as (session, endpoint),
        spoke(endpoint, own=identity(run, "recorder")) as trusted,
        deaf(endpoint, f"nuno/{run}/**") as foreign,
    ):
        assert foreign.stdout is not None
        recorder, simulation = Bus(trusted, run, "recorder"), Bus(session, run, "simulation")
        inbox = Inbox(recorder, [STATE])
        sender = simulation.publisher(STATE)
        token = recorder.alive()  # declared after the subscriber, and so known after it
        wait_until(lambda: "recorder" in simulation.present() and len(session.info.transports()) == 2)
        begin = time.monotonic()
        for number in range(COUNT):
            sender.put(bytes(SIZE), number)
        assert foreign.stdout.readline() == "called\n"
        names, early, said = {identity(run, "recorder"): "recorder"}, list[str](), list[str]()
        watch = slow_consumers.SlowConsumers(session, names)
        for number in range(COUNT):
            message = inbox.get(20.0)
            assert isinstance(message, Message)
            assert message.header.seq == number
            watch.look(early.append)  # before zenoh closes a connection that has been silent for ten seconds
        # Blocking for the deaf one would have taken all of SILENCE_SECONDS.
        assert time.monotonic() - begin < 60.0
        assert not inbox.counts.missing[STATE.name]
        # While all was on its way the recorder may have been behind, too; now it is not.
        early = [text for text in early if "recorder" not in text]
        watch, begin = slow_consumers.SlowConsumers(session, names), time.monotonic()

        def is_named() -> bool:
            watch.look(said.append)
            return bool(said) or (bool(early) and time.monotonic() - begin > 1.0)

        wait_until(is_named)
        token.undeclare()
    named = said or early
    assert len(named) == 1
    assert "reads nothing and misses messages" in named[0]
    assert f"process {foreign.pid}," in named[0]


class Watched:
    """A run in threads, of a chain that swings for half a second, and what it said."""

    def __init__(self, folder: Path, **fields: object) -> None:
        self.said: list[str] = []
        self.loaded = scene_file.read(write_scene(folder, **fields))
        self.record = folder / "a.mcap"

    def supervise(self) -> Outcome:
        options = Options(record=self.record)
        return supervisor.supervise(
            self.loaded, options, progress=lambda s: self.said.append(s) if isinstance(s, str) else None
        )


def test_a_slow_recorder_is_waited_for_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driver, "WAITING_AFTER", 0.2)
    real = Recorder.handle

    def slow(recorder: Recorder, message: Message) -> None:
        if message.topic == STATE.name and message.header.frame == 5:
            time.sleep(1.0)
        real(recorder, message)

    monkeypatch.setattr(Recorder, "handle", slow)
    watched = Watched(tmp_path)
    outcome = watched.supervise()
    assert outcome.state == "done", outcome.error
    waiting = [text for text in watched.said if "recorder" in text]
    assert waiting[0].startswith("waiting for the recorder service: frame 5 is not acknowledged yet (given up after")
    assert waiting[1].startswith("the recorder service goes on after")
    with nuno.open(watched.record) as recording:
        assert recording.complete
        assert recording.counts[STATE.name] == 26


def test_a_recorder_that_never_comes_back_ends_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driver, "PATIENCE", 0.3)
    monkeypatch.setattr(oversight, "FINISH_TIMEOUT", 0.3)
    over = threading.Event()
    monkeypatch.setattr(Recorder, "handle", lambda recorder, message: over.wait(5.0))
    watched = Watched(tmp_path)
    threading.Timer(1.0, over.set).start()
    outcome = watched.supervise()
    assert outcome.state == "failed"
    assert outcome.error == "the run gave up: the recorder service has not acknowledged frame 0 within 0.3 s"


@pytest.mark.usefixtures("interruptible")
def test_a_run_that_is_interrupted_in_an_endless_step_says_how_far_it_is_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(oversight, "FINISH_TIMEOUT", 0.3)
    over, real = threading.Event(), Simulation.step

    def slow(simulation: Simulation) -> Stepped:
        if simulation.frame == 5:
            signal.raise_signal(signal.SIGINT)
            over.wait(3.0)
        return real(simulation)

    monkeypatch.setattr(Simulation, "step", slow)
    watched = Watched(tmp_path)
    outcome = watched.supervise()
    over.set()
    assert (outcome.state, outcome.error) == ("interrupted", "interrupted")
    said = dict(lines(make_report(watched.loaded, outcome)))
    assert said["time"].startswith("6 frames are recorded; the service that steps ended, or hung")


@pytest.mark.parametrize(("pause", "ends"), [(0.5, "done"), (2.0, "failed")])
def test_a_slow_collision_service_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pause: float, ends: str
) -> None:
    monkeypatch.setattr("nuno.bus.messages.WAITING_AFTER", 0.2)
    monkeypatch.setattr(driver, "WAITING_AFTER", 0.2)
    monkeypatch.setattr(driver, "PATIENCE", 1.0)
    real = Collision.measure

    def slow(collision: Collision, message: Message) -> None:
        if message.header.frame == 20:
            time.sleep(pause)
        real(collision, message)

    monkeypatch.setattr(Collision, "measure", slow)
    watched = Watched(tmp_path, bodies=BALL)
    outcome = watched.supervise()
    waiting = [text for text in watched.said if text.startswith("waiting for the collision service: ")]
    assert waiting and "is not acknowledged yet" in waiting[0], watched.said
    assert outcome.state == ends
    if ends == "failed":
        assert outcome.error == "the run gave up: the collision service has not acknowledged frame 20 within 1 s"
