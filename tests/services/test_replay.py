"""A replay publishes the same bytes in the same order, and loses nothing."""

from __future__ import annotations

import json
import threading
import types
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh
from recorded_sheet import RATE, Sheet, items, metadata, write

from nuno.bus.health import measure
from nuno.bus.messages import Bus, Inbox, Message
from nuno.bus.sessions import free_port, hub
from nuno.cli import main
from nuno.exports.cloth import read_frame
from nuno.process import Terminated
from nuno.recording.reader import END, Recording, open_recording
from nuno.recording.writer import RecordingWriter
from nuno.replay import publisher as replay_module
from nuno.replay.publisher import WINDOW, Replay
from nuno.runtime.service import ack_topic
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import BODIES, FABRIC, GEOMETRY, STATE, STATUS, Ack, Topic

FRAMES = 40


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Recording]:
    path = tmp_path_factory.mktemp("replay") / "a.mcap"
    write(path, Sheet(), FRAMES)
    with open_recording(path) as opened:
        yield opened


@pytest.fixture
def session() -> Iterator[zenoh.Session]:
    with hub(f"tcp/127.0.0.1:{free_port()}") as opened:
        yield opened


def everything(session: zenoh.Session) -> Inbox:
    return Inbox(Bus(session, "again", "listener"), [Topic("**", "json", "")])


def received(inbox: Inbox, number: int) -> list[Message]:
    messages = [inbox.get(timeout=10.0) for _ in range(number)]
    assert inbox.get(timeout=0.05) is None
    return [m for m in messages if isinstance(m, Message)]


def test_same_bytes_in_the_same_order(session: zenoh.Session, recording: Recording) -> None:
    inbox = everything(session)
    replay = Replay(rate=None)
    replay.run(Bus(session, "again", "replay"), recording)
    expected = list(recording.messages())
    messages = received(inbox, len(expected))
    assert [(m.topic, m.payload) for m in messages] == [(m.topic, m.payload) for m in expected]
    assert replay.sent == recording.counts
    assert sum(inbox.counts.missing.values()) == sum(inbox.counts.refused.values()) == 0
    states = [m.header for m in messages if m.topic == STATE.name]
    assert [(h.run, h.seq, h.frame, h.digest) for h in states] == [
        ("again", k, k, f"digest-{k}") for k in range(FRAMES)
    ]
    assert [h.t for h in states] == pytest.approx([k / RATE for k in range(FRAMES)], abs=1e-9)


def test_a_slow_subscriber_that_acknowledges_is_never_outrun(session: zenoh.Session, recording: Recording) -> None:
    """It acknowledges late; at no time are more than WINDOW frames out."""
    bus = Bus(session, "again", "slow")
    inbox = Inbox(bus, [STATE])
    replay = Replay(rate=None, must_see=("slow",))
    out: list[int] = []
    payloads: list[bytes] = []

    def slow() -> None:
        with bus.alive():
            for frame in range(FRAMES):
                message = inbox.get(timeout=10.0)
                assert isinstance(message, Message)
                threading.Event().wait(0.002)
                payloads.append(message.payload)
                out.append(replay.sent[STATE.name] - frame)
                ack = Ack(service="slow", frame=frame).model_dump_json().encode()
                bus.publisher(ack_topic("slow")).put(ack, frame)
            finished.wait(10.0)

    finished = threading.Event()
    thread = threading.Thread(target=slow, daemon=True)
    thread.start()
    replay.run(Bus(session, "again", "replay"), recording)
    # The replay ends when its last frame is acknowledged.
    assert len(payloads) == FRAMES
    finished.set()
    thread.join(10.0)
    assert payloads == [m.payload for m in recording.messages([STATE.name])]
    # One more may have been published between the arrival of a frame and the look at the count.
    assert max(out) <= WINDOW + 1
    assert max(out) > 1


def test_a_subscriber_that_dies_ends_the_replay(session: zenoh.Session, recording: Recording) -> None:
    bus = Bus(session, "again", "mortal")
    token = bus.alive()
    threading.Timer(0.3, token.undeclare).start()
    with pytest.raises(RunFailed, match="mortal service died"):
        Replay(rate=None, must_see=("mortal",)).run(Bus(session, "again", "replay"), recording)


def test_seek_sends_what_a_viewer_needs_first(session: zenoh.Session, recording: Recording) -> None:
    inbox = everything(session)
    replay = Replay(rate=None, start=0.5)
    replay.run(Bus(session, "again", "replay"), recording)
    messages = received(inbox, sum(replay.sent.values()))
    assert [m.topic for m in messages[:3]] == [FABRIC.name, GEOMETRY.name, BODIES.name]
    assert messages[2].payload == list(recording.messages([BODIES.name], end=0.5))[-1].payload
    rest = list(recording.messages(start=0.5))
    assert [(m.topic, m.payload) for m in messages[3:]] == [(m.topic, m.payload) for m in rest]
    assert [m.header.frame for m in messages if m.topic == STATE.name] == list(range(25, FRAMES))


def test_later_passes_go_on_numbering_until_they_are_stopped(session: zenoh.Session, recording: Recording) -> None:
    inbox, bus = Inbox(Bus(session, "again", "listener"), [STATE]), Bus(session, "again", "replay")
    replay = Replay(rate=None)
    seen: list[float] = []

    def progress(t: float) -> None:
        seen.append(t)
        if len(seen) == 2 * FRAMES + 5:
            replay.stop.set()

    passed = []
    while not replay.stop.is_set():
        replay.run(bus, recording, progress)
        passed.append(measure(bus).frames)
    assert passed == [FRAMES, 2 * FRAMES - 1, 2 * FRAMES + 3]
    assert measure(bus).frame == 4
    frames = [m.header.frame for m in received(inbox, 2 * FRAMES + 5)]
    assert frames == [*range(FRAMES), *range(FRAMES), *range(5)]
    assert inbox.counts.missing[STATE.name] == 0
    assert seen[FRAMES] == 0.0


class FakeClock:
    """Wall time that passes only while the replay waits."""

    now = 100.0

    def perf_counter(self) -> float:
        return self.now

    def monotonic(self) -> float:
        return self.now


class FakeStop(threading.Event):
    """Moves the clock by every wait."""

    def __init__(self, clock: FakeClock) -> None:
        super().__init__()
        self.clock = clock

    def wait(self, timeout: float | None = None) -> bool:
        self.clock.now += timeout or 0.0
        return self.is_set()


@pytest.mark.parametrize(("rate", "start"), [(1.0, 0.0), (0.25, 0.0), (4.0, 0.3)])
def test_frames_are_due_at_their_time_over_the_rate(
    session: zenoh.Session, recording: Recording, monkeypatch: pytest.MonkeyPatch, rate: float, start: float
) -> None:
    clock = FakeClock()
    monkeypatch.setattr(
        replay_module, "time", types.SimpleNamespace(perf_counter=clock.perf_counter, monotonic=clock.monotonic)
    )
    due: list[tuple[float, float]] = []
    replay = Replay(rate=rate, start=start, stop=FakeStop(clock))
    replay.run(Bus(session, "again", "replay"), recording, lambda t: due.append((t, clock.now - 100.0)))
    assert len(due) == FRAMES - round(start * RATE)
    assert [wall for _, wall in due] == pytest.approx([(t - start) / rate for t, _ in due], abs=1e-9)


@pytest.mark.parametrize(
    ("rate", "start"), [(0.0, 0.0), (-1.0, 0.0), (float("nan"), 0.0), (1.0, 99.0), (1.0, float("nan"))]
)
def test_a_rate_or_start_out_of_range_is_refused(
    session: zenoh.Session, recording: Recording, rate: float, start: float
) -> None:
    with pytest.raises(BadInput) as caught:
        Replay(rate=rate, start=start).run(Bus(session, "again", "replay"), recording)
    assert caught.value.limit


def test_a_replay_recorded_again_holds_the_same_status(session: zenoh.Session, recording: Recording) -> None:
    inbox = Inbox(Bus(session, "again", "listener"), [STATUS])
    Replay(rate=None).run(Bus(session, "again", "replay"), recording)
    for message in received(inbox, FRAMES):
        assert message.header.digest == f"digest-{message.header.frame}"


def test_states_without_a_status_have_the_frame_of_their_time(session: zenoh.Session, tmp_path: Path) -> None:
    """The last, as in a file that is cut between the two, and one before; messages may be numbered otherwise."""
    write_without(tmp_path / "a.mcap", STATUS.name, (7, FRAMES - 1), number=3)
    inbox = everything(session)
    with open_recording(tmp_path / "a.mcap") as recording:
        assert [frame.number for frame in recording.frames()] == list(range(FRAMES))
        assert read_frame(recording).number == FRAMES - 1
        replay = Replay(rate=None)
        replay.run(Bus(session, "again", "replay"), recording)
    messages = received(inbox, sum(replay.sent.values()))
    for topic in (STATE.name, BODIES.name):
        assert [m.header.frame for m in messages if m.topic == topic] == list(range(FRAMES))
    digests = [m.header.digest for m in messages if m.topic == STATE.name]
    assert digests == [f"digest-{k}" if k not in (7, FRAMES - 1) else "" for k in range(FRAMES)]


def test_a_lost_state_is_missing_among_the_frames_and_named(
    session: zenoh.Session, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Numbers are a replay's own, so that it can begin anywhere and loop."""
    write_without(tmp_path / "a.mcap", STATE.name, (7,))
    inbox = Inbox(Bus(session, "again", "listener"), [STATE])
    with open_recording(tmp_path / "a.mcap") as recording:
        Replay(rate=None).run(Bus(session, "again", "replay"), recording)
    headers = [m.header for m in received(inbox, FRAMES - 1)]
    assert [h.frame for h in headers] == [k for k in range(FRAMES) if k != 7]
    assert [h.seq for h in headers] == list(range(FRAMES - 1))
    assert main(["replay", str(tmp_path / "a.mcap"), "--fast", "--no-view"]) == 0
    assert "1 of sim/state" in capsys.readouterr().err


def write_without(path: Path, topic: str, frames: tuple[int, ...], number: int = 0) -> None:
    """Write a recording that lacks a topic's messages of some frames; its messages are numbered from `number` on."""
    writer, sent = RecordingWriter(path, metadata(), {}), Counter[str]()
    for name, header, payload in items(Sheet(), FRAMES):
        sent[name] += 1
        if name != topic or header.frame not in frames:
            writer.write(name, header.model_copy(update={"seq": header.seq + number}), payload)
    writer.finish({END: {"state": "done", "complete": "true", "missing": "{}", "counts": json.dumps(sent)}})


@pytest.mark.parametrize(("signal", "word"), [(KeyboardInterrupt, "interrupted"), (Terminated, "terminated")])
def test_one_that_is_ended_by_a_signal_says_so(
    signal: type[BaseException], word: str, recording: Recording, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    def end(self: Replay, bus: Bus, recording: Recording) -> None:
        raise signal

    monkeypatch.setattr(Replay, "run", end)
    assert main(["replay", str(recording.path), "--fast", "--no-view"]) == 1
    assert capsys.readouterr().err.endswith(f"{word} before the end of the recording\n")
