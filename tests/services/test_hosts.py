"""A run on hosts between which the way is long, or cut: the same digests, or a clear end that can be resumed."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from pathlib import Path

import pytest
from relay import Relay, relay

from nuno.bus import sessions
from nuno.bus.sessions import free_port, hub, spoke
from nuno.cli import main
from nuno.runtime import runs, supervisor
from nuno.runtime.service import Options, run_service
from nuno.runtime.supervisor import Deployment, Outcome
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
