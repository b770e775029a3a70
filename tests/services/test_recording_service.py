"""The recorder: everything that was sent is in the file, or the file says what is not."""

from __future__ import annotations

import errno
import json
import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import zenoh
from live_run import Run, wait_until
from recorded_sheet import REPORT_TEXT, Item, Sheet, items, metadata
from scenes import write_scene

import nuno
from nuno.bus.health import Watch
from nuno.bus.messages import Bus, Inbox, Message, Publisher
from nuno.bus.sessions import free_port, hub
from nuno.cli import main
from nuno.recorder import service
from nuno.recording.mcap_file import McapFile
from nuno.recording.reader import END, count_gaps, find_lacks, open_recording, shortcoming
from nuno.recording.writer import RecordingWriter, part_of, topic_of
from nuno.report.run_report import lines
from nuno.runtime import supervisor as oversight
from nuno.runtime.service import SUPERVISOR, Context, Options, ack_topic
from nuno.scene import scene_file, shipped
from nuno.scene.provenance import describe_run
from nuno.simulation.run import Simulation
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import EVENT, REPORT, STATE, STATUS, Ack, Header, Topic

RUN = "waving-run"


@pytest.fixture(scope="module")
def loaded() -> scene_file.Loaded:
    return scene_file.read(shipped.find("hanging-sheet"))


@dataclass
class Recorder:
    """The service in a thread, a supervisor, and the buses of those that talk to it."""

    session: zenoh.Session
    context: Context
    supervisor: Bus
    simulation: Bus
    acks: Inbox
    errors: list[Exception] = field(default_factory=list)
    thread: threading.Thread = field(init=False)

    def __post_init__(self) -> None:
        self.thread = threading.Thread(target=self._main, daemon=True)
        self.thread.start()

    def _main(self) -> None:
        try:
            service.main(self.context)
        except (BadInput, RunFailed) as error:
            self.errors.append(error)

    def publish(self, messages: list[Item]) -> dict[str, int]:
        """Send messages; how many of each topic."""
        for name, header, payload in messages:
            topic = topic_of(name)
            assert topic is not None
            self.simulation.publisher(topic).put(payload, header.frame, header.t, header.digest)
        return {name: p.sent for name, p in self.simulation.publishers.items()}

    def finish(self, expected: dict[str, int]) -> dict[str, Any]:
        question = {"expected": expected, "state": "done", "report": REPORT_TEXT}
        answer = self.supervisor.ask_json("finish/recorder", question, 20.0)
        self.thread.join(10.0)
        return answer


@contextmanager
def recorder(loaded: scene_file.Loaded, path: Path) -> Iterator[tuple[Recorder, zenoh.LivelinessToken]]:
    """A recorder that is ready, and the token that keeps it running."""
    with hub(f"tcp/127.0.0.1:{free_port()}") as session:
        supervisor = Bus(session, RUN, SUPERVISOR)
        token = supervisor.alive()
        acks = Inbox(supervisor, [ack_topic("recorder")])
        context = Context(loaded, Bus(session, RUN, "recorder"), Options(record=path))
        running = Recorder(session, context, supervisor, Bus(session, RUN, "simulation"), acks)
        assert Watch(supervisor).wait_for({"recorder"}, 20.0) == set()
        yield running, token
        assert not running.thread.is_alive()


def sent_items(frames: int = 20) -> list[Item]:
    return [item for item in items(Sheet(), frames) if item[0] != REPORT.name]


def test_records_and_acknowledges_all(tmp_path: Path, loaded: scene_file.Loaded) -> None:
    sent = sent_items()
    with recorder(loaded, tmp_path / "a.mcap") as (running, _):
        expected = running.publish(sent)
        answer = running.finish(expected | {"ack/collision": 20})
        acked = [running.acks.get(timeout=5.0) for _ in range(20)]
    assert answer["complete"]
    assert answer["missing"] == {}
    assert answer["messages"] == len(sent) + 1
    assert answer["bytes"] == (tmp_path / "a.mcap").stat().st_size
    assert all(isinstance(ack, Message) for ack in acked)
    assert [Ack.model_validate_json(a.payload).frame for a in acked if isinstance(a, Message)] == list(range(20))
    with open_recording(tmp_path / "a.mcap") as recording:
        assert [(m.topic, m.payload) for m in recording.messages()][:-1] == [(t, p) for t, _, p in sent]
        assert recording.complete
        assert recording.report() == REPORT_TEXT
        assert recording.scene == loaded.data
        assert recording.metadata[END]["digest"] == "digest-19"
        assert recording.metadata["run"]["seed"] == str(loaded.scene.seed)
        assert "nuno.models/sheet" in recording.metadata["plugins"]
        assert recording.metadata["versions"]["numpy"]


def test_a_lost_message_makes_the_recording_incomplete(tmp_path: Path, loaded: scene_file.Loaded) -> None:
    with recorder(loaded, tmp_path / "a.mcap") as (running, _):
        sent = sent_items()
        running.publish(sent[:30])
        running.simulation.publishers[STATE.name].sent += 2
        answer = running.finish(running.publish(sent[30:]))
    assert answer["missing"] == {STATE.name: 2}
    assert not answer["complete"]
    with open_recording(tmp_path / "a.mcap") as recording:
        assert not recording.complete
        assert not recording.recovered
        assert recording.missing == {STATE.name: 2}
        assert recording.counts[STATE.name] == 20


def test_messages_that_never_come_are_not_waited_for_forever(
    tmp_path: Path, loaded: scene_file.Loaded, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service, "DRAIN_SECONDS", 0.2)
    with recorder(loaded, tmp_path / "a.mcap") as (running, _):
        expected = running.publish(sent_items())
        answer = running.finish(expected | {STATE.name: expected[STATE.name] + 3})
    assert answer["missing"] == {STATE.name: 3}
    assert not answer["complete"]


def test_what_has_arrived_is_written_however_slow_the_disk_is(
    tmp_path: Path, loaded: scene_file.Loaded, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service, "DRAIN_SECONDS", 0.2)
    real = service.RecordingWriter.write

    def slow(writer: service.RecordingWriter, topic: str, header: Header, payload: bytes) -> None:
        time.sleep(0.02)
        real(writer, topic, header, payload)

    monkeypatch.setattr(service.RecordingWriter, "write", slow)
    with recorder(loaded, tmp_path / "a.mcap") as (running, _):
        answer = running.finish(running.publish(sent_items()))
    assert answer["missing"] == {}
    assert answer["complete"]


def test_all_is_in_the_file_when_nothing_comes_any_more(tmp_path: Path, loaded: scene_file.Loaded) -> None:
    """A run that stands still is readable to its last frame after half a second, before it ends."""
    with recorder(loaded, tmp_path / "a.mcap") as (running, _):
        sent = running.publish([item for item in sent_items() if not item[0].startswith(EVENT.name)])

        def written() -> bool:
            with open_recording(part_of(tmp_path / "a.mcap")) as recording:
                return recording.counts == sent

        wait_until(written, 5.0)
        running.finish(sent)


def test_bad_messages_are_dropped_and_counted(tmp_path: Path, loaded: scene_file.Loaded) -> None:
    sent = sent_items(21)
    last = next(k for k, (topic, header, _) in enumerate(sent) if topic == STATE.name and header.seq == 20)
    with recorder(loaded, tmp_path / "a.mcap") as (running, _):
        running.publish(sent[:last])
        put = running.session.put
        key = running.simulation.key(STATE.name)
        good = Header(run=RUN, service="simulation", seq=20, frame=20, t=0.4)
        put(key, b"no header")
        put(key, b"not json", attachment=b"\xff\xfe")
        put(key, b"foreign", attachment=good.model_copy(update={"run": "other"}).model_dump_json())
        put(key, b"again", attachment=good.model_copy(update={"seq": 3}).model_dump_json())
        late = good.model_copy(update={"seq": 99}).model_dump_json().replace("0.4", "NaN")
        put(running.simulation.key("run/event/x"), b"no time", attachment=late)
        expected = running.publish(sent[last:])
        for _ in range(21):
            assert running.acks.get(timeout=5.0) is not None
        answer = running.finish(expected)
    assert answer["counts"][STATE.name] == 21
    with open_recording(tmp_path / "a.mcap") as recording:
        assert [m.payload for m in recording.messages([STATE.name])] == [p for t, _, p in sent if t == STATE.name]
        assert json.loads(recording.metadata[END]["refused"]) == {"run/event/x": 1, STATE.name: 4}


def test_without_a_supervisor_the_file_is_closed_as_failed(tmp_path: Path, loaded: scene_file.Loaded) -> None:
    sent = sent_items()
    with recorder(loaded, tmp_path / "a.mcap") as (running, token):
        running.publish(sent)
        for _ in range(20):
            assert running.acks.get(timeout=5.0) is not None
        assert not running.context.orphaned()
        token.undeclare()
        running.thread.join(10.0)
    assert [type(error) for error in running.errors] == [RunFailed]
    with open_recording(tmp_path / "a.mcap") as recording:
        assert recording.metadata[END]["state"] == "failed"
        assert not recording.complete
        assert recording.counts[STATE.name] == 20


def test_a_full_disk_ends_the_service(
    tmp_path: Path, loaded: scene_file.Loaded, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = McapFile.flush

    def full(file: McapFile) -> None:
        if file.pending > 10_000:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(file)

    monkeypatch.setattr(McapFile, "flush", full)
    with recorder(loaded, tmp_path / "a.mcap") as (running, _):
        running.publish(sent_items())
        running.thread.join(10.0)
    assert [str(error).split(";")[0] for error in running.errors] == ["recording stopped: No space left on device"]
    assert not (tmp_path / "a.mcap").exists()
    with open_recording(part_of(tmp_path / "a.mcap")) as recording:
        assert recording.recovered


def test_files_of_the_scene_travel_with_it(tmp_path: Path) -> None:
    """Any string of a configuration that names a file beside the scene is attached."""
    (tmp_path / "check.png").write_bytes(b"picture")
    (tmp_path / "secret.txt").write_bytes(b"not named")
    text = shipped.find("hanging-sheet").read_text()
    (tmp_path / "scene.yaml").write_text(text)
    override = "objects.0.model.texture=check.png"
    loaded = scene_file.read(tmp_path / "scene.yaml", [override])
    with recorder(loaded, tmp_path / "a.mcap") as (running, _):
        running.finish(running.publish(sent_items(3)))
    with open_recording(tmp_path / "a.mcap") as recording:
        assert recording.attachments == ("check.png",)
        assert recording.attachment("check.png") == b"picture"


@pytest.mark.quick(late=[[service, oversight]])
@pytest.mark.parametrize("busy", [0.0, 0.3])
@pytest.mark.parametrize("late", [[service], [oversight], [service, oversight]])
def test_the_last_word_of_a_service_that_failed_is_waited_for(
    late: list[ModuleType], busy: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It answers no more how much it sent; what the supervisor hears of it, the recording must have, though both hear
    it late, the recorder was the last to be ready, and the supervisor was kept from listening since.
    """

    def describe(*about: Any) -> dict[str, dict[str, str]]:
        time.sleep(busy)
        return describe_run(*about)

    ask = Bus.ask_json

    def ask_slowly(bus: Bus, name: str, *more: Any) -> dict[str, Any]:
        answer = ask(bus, name, *more)
        if name == "control":
            time.sleep(busy)
        return answer

    class Slow:
        """A session over which errors come late."""

        def __init__(self, session: zenoh.Session) -> None:
            self._session = session

        def declare_subscriber(self, key: str, take: Callable[[zenoh.Sample], None]) -> Any:
            def later(sample: zenoh.Sample) -> None:
                if b"on fire" in sample.payload.to_bytes():
                    threading.Timer(busy + 0.2, take, [sample]).start()
                else:
                    take(sample)

            return self._session.declare_subscriber(key, later)

        def __getattr__(self, name: str) -> Any:
            return getattr(self._session, name)

    def listen_slowly(bus: Bus, topics: list[Topic], *more: Any) -> Inbox:
        monkeypatch.setattr(bus, "session", Slow(bus.session))
        return Inbox(bus, topics, *more)

    def fail(self: Simulation, *poses: object) -> None:
        raise OSError("the loom is on fire")

    for module in late:
        monkeypatch.setattr(module, "Inbox", listen_slowly)
    monkeypatch.setattr(service, "describe_run", describe)
    monkeypatch.setattr(Bus, "ask_json", ask_slowly)
    monkeypatch.setattr(Simulation, "advance", fail)
    path = tmp_path / "run.mcap"
    with pytest.raises(RunFailed, match="on fire"):
        nuno.run(write_scene(tmp_path), record=path)
    with open_recording(path) as recording:
        said = [json.loads(m.payload)["text"] for m in recording.messages() if m.topic == "run/event/simulation"]
        assert "on fire" in said[-1] and recording.metadata[END]["missing"] == "{}"


LOST = {7, 8, 9, 15}
"""Frames whose state vanishes."""


@pytest.fixture(scope="module")
def lossy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording of a run in which messages vanish between publisher and recorder, without a word."""
    folder = tmp_path_factory.mktemp("lossy")
    real = Publisher.put

    def put(self: Publisher, payload: bytes, frame: int = -1, t: float = 0.0, digest: str = "") -> None:
        if self.topic is STATE and frame in LOST:
            self.sent += 1
        else:
            real(self, payload, frame, t, digest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Publisher, "put", put)
        run = Run(write_scene(folder), folder / "lossy.mcap")
        assert run.join().problem == f"failed: {run.record} is not whole: it lacks 4 of sim/state"
    assert run.report["lost"] == {STATE.name: len(LOST)}
    assert ("INCOMPLETE", "the recording lacks 4 of sim/state") in lines(run.report)
    return folder / "lossy.mcap"


def test_every_gap_is_found_in_the_file(lossy: Path) -> None:
    with open_recording(lossy) as recording:
        assert not recording.complete
        assert find_lacks(recording).missing == {STATE.name: len(LOST)}
        assert count_gaps(recording.messages()) == {STATE.name: len(LOST)}
        assert shortcoming(recording) == "INCOMPLETE: missing: 4 of sim/state"
        warnings = [json.loads(m.payload)["text"] for m in recording.messages(["run/event/recorder"])]
    assert warnings == ["3 of sim/state never came: the recording is incomplete"]


def test_commands_say_what_is_missing(lossy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name = str(lossy)
    assert main(["info", name]) == 0
    shown = capsys.readouterr().out
    assert "done, INCOMPLETE: missing: 4 of sim/state" in shown
    assert main(["info", name, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["complete"], facts["cut"], facts["missing"]) == (False, False, {STATE.name: 4})
    csv = lossy.with_suffix(".csv")
    for command in (["verify", name], ["replay", name, "--fast", "--no-view"], ["export", name, "--csv"]):
        assert main([*command, *([str(csv)] if command[0] == "export" else [])]) == 0
        assert f"{lossy}: INCOMPLETE: missing: 4 of sim/state\n" in capsys.readouterr().err


def test_info_tells_the_size_of_a_small_file(lossy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(lossy)]) == 0
    size, unit = re.findall(r"\(([\d.]+) (kB|MB)\)", capsys.readouterr().out)[0]
    assert float(size) * {"kB": 1e3, "MB": 1e6}[unit] == pytest.approx(lossy.stat().st_size, rel=0.01)


def test_of_a_run_that_was_killed_the_file_itself_tells(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = RecordingWriter(path, metadata(), {})
    for topic, header, payload in items(Sheet(), 20):
        if not (topic == STATUS.name and header.seq in LOST):
            writer.write(topic, header, payload)
    writer._flush()  # as by time
    with open_recording(part_of(path)) as recording:
        assert shortcoming(recording).startswith("INCOMPLETE: its run goes on, and is recorded up to 0.38 s; missing:")
    writer._stream.close()  # then the process is killed
    with open_recording(part_of(path)) as recording:
        assert find_lacks(recording).missing == {STATUS.name: 4}
        text = shortcoming(recording)
        assert text.startswith("INCOMPLETE: cut short at 0.38 s, and read up to its last whole chunk; missing: 4 of ")


def test_whole_recordings_have_no_gap(tmp_path: Path) -> None:
    """Nor have those of a run that went on from a checkpoint, where numbers begin anew."""
    folder = tmp_path
    nuno.run(write_scene(folder), record=folder / "a.mcap")
    assert main(["run", "--resume", str(folder / "a.mcap"), "--record", str(folder / "b.mcap"), "--no-view",
                 "--set", "duration=0.7"]) == 0  # fmt: skip
    for name, frames in (("a.mcap", 26), ("b.mcap", 36)):
        with open_recording(folder / name) as recording:
            assert recording.counts[STATE.name] == frames
            assert count_gaps(recording.messages()) == {}
            assert find_lacks(recording).missing == {}
            assert shortcoming(recording) == ""
