"""A run on hosts between which the way is long or cut, and the relay that stands for the way."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from relay import Relay, relay

from nuno.bus import sessions
from nuno.bus.sessions import free_port, hub, spoke
from nuno.cli import main
from nuno.runtime import runs, supervisor
from nuno.runtime.outcome import Outcome
from nuno.runtime.service import Options, run_service
from nuno.runtime.supervisor import Deployment
from nuno.scene import scene_file
from nuno_schemas.errors import RunFailed
from nuno_schemas.messages import FrameStatus
from soak import scenes
from soak.processes import Digests, differing, digests

SERVICES = ("simulation", "collision", "recorder")
DELAY = 0.001
DURATION, CUT_AT = 4.0, 30


class Remote:
    """A run whose services and supervisor each have a way of their own to the hub; one is cut after some frames."""

    def __init__(self, folder: Path, cut: str, seconds: float) -> None:
        self.scene, self.record = scenes.sheet(folder, DURATION), folder / "remote.mcap"
        self.loaded = scene_file.read(self.scene)
        self.cut, self.seconds, self.run = cut, seconds, runs.new_id("remote")
        self.ended: dict[str, str] = {}
        self.cutting: threading.Thread | None = None
        self.ways: dict[str, Relay] = {}

    def serve(self, name: str, endpoint: str) -> None:
        try:
            with spoke(endpoint) as session:
                must_see = ("collision", "recorder")
                run_service(name, self.loaded, session, self.run, Options(record=self.record, must_see=must_see))
            self.ended[name] = ""
        except RunFailed as error:
            self.ended[name] = str(error)

    def note(self, status: FrameStatus | str) -> None:
        if isinstance(status, FrameStatus) and status.frame >= CUT_AT and self.cut and self.cutting is None:
            self.cutting = threading.Thread(target=self.ways[self.cut].cut, args=(self.seconds,))
            self.cutting.start()

    def supervise(self) -> Outcome:
        with ExitStack() as stack:
            port = free_port()
            stack.enter_context(hub(f"tcp/127.0.0.1:{port}"))
            at = {}
            for name in (*SERVICES, "supervisor"):
                self.ways[name] = stack.enter_context(relay(("127.0.0.1", port), DELAY))
                at[name] = f"tcp/127.0.0.1:{self.ways[name].address[1]}"
            threads = [threading.Thread(target=self.serve, args=(name, at[name]), daemon=True) for name in SERVICES]
            for thread in threads:
                thread.start()
            deployment = Deployment(connect=at["supervisor"], run=self.run)
            outcome = supervisor.supervise(self.loaded, Options(record=self.record), deployment, self.note)
            for each in (*threads, *([self.cutting] if self.cutting else [])):
                each.join(30.0)
                assert not each.is_alive(), "nothing hangs"
            return outcome


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Digests:
    """Digests of the same scene in one process."""
    folder = tmp_path_factory.mktemp("alone")
    scene, record = scenes.sheet(folder, DURATION), folder / "alone.mcap"
    assert main(["run", str(scene), "--record", str(record), "--no-view"]) == 0
    return digests(record)


@pytest.mark.quick(cut=["collision"])
@pytest.mark.parametrize("cut", ["collision", "recorder"])
def test_a_short_cut_changes_nothing(cut: str, alone: Digests, tmp_path: Path) -> None:
    remote = Remote(tmp_path, cut, 0.3)
    assert remote.supervise().problem == ""
    assert remote.cutting is not None, "it was cut"
    assert differing(digests(remote.record), alone) == 0


@pytest.mark.full
@pytest.mark.parametrize("cut", ["collision", "supervisor"])
def test_a_long_cut_ends_the_run_which_is_resumed_to_the_same_digests(
    cut: str, alone: Digests, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sessions, "SILENCE_SECONDS", 0.4)
    remote = Remote(tmp_path, cut, 1.5)
    outcome = remote.supervise()
    assert outcome.state == "failed" and outcome.error, "said in words"
    assert set(remote.ended) == set(SERVICES)
    assert all(remote.ended[name] for name in SERVICES if name == cut or cut == "supervisor")
    kept = digests(remote.record)
    assert CUT_AT < len(kept) < len(alone) and kept == alone[: len(kept)]
    resumed = tmp_path / "resumed.mcap"
    assert main(["run", "--resume", str(remote.record), "--record", str(resumed), "--no-view"]) == 0
    assert differing(digests(resumed), alone) == 0


@pytest.fixture
def echo() -> Iterator[tuple[str, int]]:
    """A server that sends back what it gets."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            connection, _ = server.accept()
            with connection:
                while piece := connection.recv(2**16):
                    connection.sendall(piece)
                connection.shutdown(socket.SHUT_WR)

        threading.Thread(target=serve, daemon=True).start()
        yield server.getsockname()[:2]


def there_and_back(address: tuple[str, int], data: bytes) -> bytes:
    with socket.create_connection(address, 20.0) as client:
        threading.Thread(target=lambda: (client.sendall(data), client.shutdown(socket.SHUT_WR)), daemon=True).start()
        found = b"".join(iter(lambda: client.recv(2**16), b""))
    return found


def test_bytes_come_through_in_order_and_as_late_as_it_says(echo: tuple[str, int]) -> None:
    data = np.random.default_rng(0).bytes(2_000_000)
    with relay(echo, delay=0.05) as line:
        begin = time.monotonic()
        assert there_and_back(line.address, data) == data
        assert time.monotonic() - begin >= 0.1, "each way takes 50 ms"
        assert line.forwarded == 2 * len(data)


def test_no_more_than_its_rate_comes_through(echo: tuple[str, int]) -> None:
    data = bytes(400_000)
    with relay(echo, rate=2e6) as line:
        begin = time.monotonic()
        assert there_and_back(line.address, data) == data
        assert time.monotonic() - begin >= (400_000 - 2**16) / 2e6


def test_a_cut_holds_everything_back_and_loses_nothing(echo: tuple[str, int]) -> None:
    with relay(echo) as line, socket.create_connection(line.address, 20.0) as client:
        client.sendall(b"before")
        assert client.recv(100) == b"before"
        cut = threading.Thread(target=line.cut, args=(0.4,))
        begin = time.monotonic()
        cut.start()
        time.sleep(0.05)
        client.sendall(b"meanwhile")
        assert client.recv(100) == b"meanwhile"
        assert time.monotonic() - begin >= 0.4
        cut.join()
