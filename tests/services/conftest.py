"""What tests of services share."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh
from browser import Page
from live_run import Run, start_long
from refusals import Refused
from studio_desk import served as desk_served
from studio_desk import write_sheet

from nuno.bus.sessions import spoke
from nuno.studio.desk import Desk
from nuno.studio.processes import Workshop
from nuno.studio.server import Server


class Shared:
    """A workshop that outlasts the desk that uses it, and takes its plans and previews apart as two would."""

    def __init__(self, workshop: Workshop) -> None:
        self._workshop = workshop

    def make(self, page: str, *task: Any) -> Any:
        return self._workshop.make(f"{id(self)} {page}", *task)

    def forget(self, page: str) -> None:
        self._workshop.forget(f"{id(self)} {page}")

    def close(self) -> None:
        """Nothing: it is another one's."""


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Ctrl-C raises KeyboardInterrupt, as at a terminal: what a shell starts in the background ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> Refused:
    return Refused(capfd, tmp_path)


@pytest.fixture
def paused(tmp_path: Path) -> Iterator[tuple[Run, zenoh.Session]]:
    """A run of 20,000 frames, paused after its first ones, and a foreign session beside it."""
    run = start_long(tmp_path)
    run.control("pause")
    with spoke(run.endpoint) as session:
        yield run, session
    if run.thread.is_alive():
        run.stop()


@pytest.fixture(scope="session")
def workshop() -> Iterator[Workshop]:
    """One for all desks: its process takes seconds to begin."""
    one = Workshop("building it", 300.0, "wait for longer")
    yield one
    one.close()


@pytest.fixture(autouse=True)
def _shared(workshop: Workshop, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nuno.studio.desk.Workshop", lambda *_: Shared(workshop))


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    """The studio's, in a folder of its own with one scene in it."""
    monkeypatch.chdir(tmp_path)
    write_sheet(tmp_path)
    one = Desk()
    yield one
    one.close()


@pytest.fixture
def served(desk: Desk) -> Iterator[tuple[Desk, Server]]:
    """The desk and its page."""
    with desk_served(desk) as server:
        yield desk, server


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """Of a browser; no script of it may fail, and nothing may be refused to it."""
    with Page(tmp_path_factory.mktemp("browser"), 1300, 820) as one:
        yield one
        assert one.said == []
