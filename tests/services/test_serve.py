"""Services that are started by hand: what they say, and how they end."""

from __future__ import annotations

import io
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from live_run import wait_until
from scenes import write_scene

import nuno
from nuno.bus.sessions import free_port, hub
from nuno.cli import main, serve
from nuno.process import Terminated
from nuno.simulation.run import Simulation
from nuno_schemas.errors import RunFailed


class ByHand:
    """Commands of one run, each in a thread of its own, at a hub that they share."""

    def __init__(self, folder: Path, endpoint: str) -> None:
        self.folder, self.endpoint = folder, endpoint
        self.threads: dict[str, threading.Thread] = {}
        self.codes: dict[str, int] = {}

    def start(self, name: str, *command: str) -> None:
        line = [*command, str(self.folder / "scene.yaml"), "--run", "r1", "--connect", self.endpoint]
        line += ["--record", str(self.folder / "r1.mcap")]

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
