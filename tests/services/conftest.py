"""What tests of services share."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh
from live_run import Run, start_long
from refusals import Refused

from nuno.wire.sessions import spoke


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
