"""Live views: whatever the viewer does, the run is not held up, and the counts say what was shown."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import psutil
import pytest
from scenes import write_scene
from viewer_run import messages

from nuno.bus.health import Watch
from nuno.bus.messages import Bus, Inbox, Message
from nuno.bus.sessions import free_port, hub
from nuno.runtime.service import Options, ack_topic, run_service
from nuno.scene import scene_file
from nuno.viewer.live import LiveView, Ring, keep_page
from nuno.viewer.stream import SETTINGS, Subject
from nuno_schemas.messages import STATE, STATUS, TOPICS, Topic

FRAMES = 40
SOON = 60.0
"""How long a test waits for what must come: a bound against hanging, not a measurement."""


@contextmanager
def hung_viewer() -> Iterator[str]:
    """The address of one that begins each connection as HTTP/2 asks, and never says another word."""
    kept: list[socket.socket] = []

    def begin(server: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = server.accept()
                kept.append(connection)
                connection.sendall(bytes([0, 0, 0, SETTINGS, 0, 0, 0, 0, 0]))

    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=begin, args=(server,), daemon=True).start()
        yield f"rerun+http://127.0.0.1:{server.getsockname()[1]}/proxy"
        server.shutdown(socket.SHUT_RDWR)
    for connection in kept:
        connection.close()


def topic_of(name: str) -> Topic:
    return TOPICS.get(name) or Topic(name, "json", "nuno.Event")


@dataclass
class Played:
    """What a viewer service answered at the end of a made-up run, and what else was heard."""

    answer: dict[str, Any]
    acknowledged: list[int]
    events: list[str]


def play(folder: Path, options: Options, frames: int = FRAMES) -> Played:
    """Send a run to a viewer service in a thread, as a simulation would."""
    loaded = scene_file.read(write_scene(folder))
    with hub(f"tcp/127.0.0.1:{free_port()}") as session:
        bus = Bus(session, "run", "simulation")
        inbox = Inbox(bus, [ack_topic("viewer"), Topic("run/event/viewer", "json", "nuno.Event")])
        work = threading.Thread(target=run_service, args=("viewer", loaded, session, "run", options), daemon=True)
        work.start()
        assert not Watch(bus).wait_for({"viewer"}, SOON)
        for topic, frame, t, payload in messages(frames, 16, 12):
            bus.publisher(topic_of(topic)).put(payload, frame, t)
        answer = bus.ask_json("finish/viewer", {}, SOON)
        work.join(SOON)
        assert not work.is_alive()
        heard = []
        while isinstance(item := inbox.get(0.2), Message):
            heard.append(item)
    acknowledged = [m.header.frame for m in heard if m.topic.startswith("ack")]
    return Played(answer, acknowledged, [m.payload.decode() for m in heard if not m.topic.startswith("ack")])


def test_a_file_gets_every_frame_and_acknowledges_it(tmp_path: Path) -> None:
    played = play(tmp_path, Options(save=tmp_path / "run.rrd", must_see=("viewer",)))
    assert played.answer["saved"] == played.answer["shown"] == FRAMES
    assert played.acknowledged == list(range(FRAMES))
    assert not any(played.answer["missing"].values())
    assert (tmp_path / "run.rrd").exists()


@pytest.mark.full
def test_a_hung_viewer_does_not_hold_up_a_run_or_the_file_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nuno.viewer.live.FINISH_SECONDS", 1.0)
    with hung_viewer() as address:
        played = play(tmp_path, Options(view=address, save=tmp_path / "run.rrd"))
    assert played.answer["frames"] == played.answer["saved"] == FRAMES
    # rerun takes the first frames for sent while it still waits for its connection; never all of them.
    assert played.answer["shown"] < FRAMES
    assert played.answer["skipped"] == FRAMES - played.answer["shown"]
    assert any("too slow" in event for event in played.events)
    assert played.acknowledged == []


def test_an_absent_viewer_is_said_and_does_not_end_a_run(tmp_path: Path) -> None:
    played = play(tmp_path, Options(view=f"rerun+http://127.0.0.1:{free_port()}/proxy"))
    assert played.answer["frames"] == FRAMES
    assert "no viewer listens" in played.answer["error"]
    assert any("no viewer listens" in event for event in played.events)


def test_a_killed_view_takes_nothing_along() -> None:
    said: list[str] = []
    with hung_viewer() as address:
        live = LiveView(address, Subject(run="run"), lambda kind, text: said.append(text))
        fed = list(messages(FRAMES, 16, 12))
        for i, message in enumerate(fed):
            if i == len(fed) // 2:
                os.kill(live._process.pid, signal.SIGKILL)
                live._process.wait(SOON)
            live.feed(*message)
        live.finish()
    assert live.frames == FRAMES
    assert live.skipped == FRAMES
    assert said == ["the run goes on without a view: it ended unexpectedly"]


SLOW = """#!{python}
import json, sys, time
print(json.dumps({{"connected": True}}), flush=True)
shown = 0
while line := sys.stdin.buffer.readline():
    head = json.loads(line)
    sys.stdin.buffer.read(head["size"])
    if head["topic"] == "{topic}":
        time.sleep({seconds})
        shown += 1
        print(json.dumps({{"shown": shown}}), flush=True)
"""


def test_a_run_waits_for_all_frames_however_slowly_they_are_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In all for twice as long as it would without a frame."""
    drawer, patience = tmp_path / "drawer", 1.0
    drawer.write_text(SLOW.format(python=sys.executable, topic=STATE.name, seconds=2.0 * patience / FRAMES))
    drawer.chmod(0o755)
    monkeypatch.setattr("nuno.viewer.live.FINISH_SECONDS", patience)
    monkeypatch.setattr("sys.executable", str(drawer))
    live = LiveView("web", Subject(run="run"), lambda kind, text: None)
    for message in messages(FRAMES, 4, 3):
        live.feed(*message)
    live.finish()
    assert (live.frames, live.shown, live.error) == (FRAMES, FRAMES, "")


def test_a_view_ends_with_the_run_that_started_it() -> None:
    """The process between run and viewer ends when its input does, so that none is left behind."""
    with hung_viewer() as address:
        live = LiveView(address, Subject(run="run"), lambda kind, text: None)
        assert live._process.stdin is not None
        live._process.stdin.close()
        assert live._process.wait(SOON) == 0


def test_the_web_view_shows_a_run_and_listens_on_loopback_only() -> None:
    opened = threading.Event()
    live = LiveView("web", Subject(run="run"), lambda kind, text: opened.set())
    try:
        assert opened.wait(SOON)
        assert not live.error
        for message in messages(FRAMES, 16, 12):
            live.feed(*message)
        live.finish()
        assert live.shown == FRAMES
        assert live.pid is not None
        listening = [c.laddr.ip for c in psutil.Process(live.pid).net_connections() if c.status == "LISTEN"]
        assert set(listening) == {"127.0.0.1"}
        assert len(listening) == 2
        with urlopen(live.page.split("?")[0], timeout=SOON) as page:
            assert page.status == 200
    finally:
        if live.pid is not None:
            psutil.Process(live.pid).kill()


@pytest.mark.full
@pytest.mark.parametrize("ends", ["killed", "in order", "terminated"])
def test_the_viewer_stays_open_after_a_run_and_not_after_one_that_was_killed(ends: str) -> None:
    opened = threading.Event()
    live = LiveView("web", Subject(run="run"), lambda kind, text: opened.set())
    assert opened.wait(SOON) and live.pid is not None
    viewer = psutil.Process(live.pid)
    try:
        if ends == "killed":
            assert live._process.stdin is not None
            live._process.stdin.close()  # as the system does for who is killed
        else:
            live.finish()
            assert viewer.is_running()
        if ends == "terminated":
            keep_page("web", {"pid": live.pid}, stays=False)
        live._process.wait(SOON)
        if ends != "in order":
            viewer.wait(SOON)
        assert viewer.is_running() is (ends == "in order")
    finally:
        if viewer.is_running():
            viewer.kill()


def test_the_ring_gives_up_the_oldest_frames_and_nothing_else() -> None:
    ring = Ring(limit=300)
    for frame in range(5):
        ring.put((STATE.name, frame, 0.0, bytes(100)))
        ring.put((STATUS.name, frame, 0.0, bytes(100)))
    ring.put((STATE.name, 5, 0.0, bytes(900)))
    ring.close()
    kept = []
    while (item := ring.get()) is not None:
        kept.append(item)
    assert [frame for topic, frame, _, _ in kept if topic == STATE.name] == [5]
    assert [frame for topic, frame, _, _ in kept if topic == STATUS.name] == list(range(5))


@pytest.mark.full
def test_a_viewer_that_is_open_is_used_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And is not ended with a run that is killed, nor by who did not open it."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))  # viewers are noted there
    views: list[LiveView] = []
    try:
        for _ in range(2):
            opened = threading.Event()
            view = LiveView("web", Subject(run="run"), lambda kind, text, opened=opened: opened.set())
            views.append(view)
            assert opened.wait(SOON) and not view.error
        first, second = views
        assert first.pid is not None and second.pid is None
        assert second.page == first.page
        assert second._process.stdin is not None
        second._process.stdin.close()
        assert second._process.wait(SOON) == 0
        assert psutil.Process(first.pid).is_running()
        first.finish()
    finally:
        for view in views:
            if view.pid is not None:
                psutil.Process(view.pid).kill()
