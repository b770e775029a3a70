"""What goes wrong around a run ends in a word, an exit code and a recording that can be read."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import garment_scene
import pytest
from live_run import wait_until
from recorded_sheet import Sheet, items, metadata
from scenes import BALL, write_scene

import nuno
from nuno.bus.messages import Bus, Inbox
from nuno.bus.sessions import hub_at
from nuno.cli import main
from nuno.recorder import service as recording_service
from nuno.recording.reader import shortcoming
from nuno.recording.writer import RecordingWriter, part_of
from nuno.runtime import supervisor
from nuno.runtime.service import SUPERVISOR, Options
from nuno.runtime.supervisor import Deployment, Outcome, Supervisor
from nuno.scene import scene_file
from nuno.viewer.service import Viewer
from nuno_schemas.errors import BadInput, RunFailed
from soak.processes import Processes


@pytest.mark.parametrize("early", [True, False])
def test_a_viewer_that_dies_does_not_end_the_run(early: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor is it waited for, though the run would otherwise wait until it has written each frame; and what it says
    before the recorder listens is not missed in the recording.
    """
    said: list[str] = []

    def fail(self: Viewer, *arguments: object) -> None:
        raise OSError("no more colours")

    def listen_late(*arguments: Any) -> Inbox:
        wait_until(lambda: any("without a view" in line for line in said))
        return Inbox(*arguments)

    monkeypatch.setattr(Viewer, "__init__" if early else "show", fail)
    if early:
        monkeypatch.setattr(recording_service, "Inbox", listen_late)
    options = Options(record=tmp_path / "run.mcap", save=tmp_path / "run.rrd")
    outcome = supervisor.supervise(
        scene_file.read(write_scene(tmp_path)),
        options,
        progress=lambda s: said.append(s) if isinstance(s, str) else None,
    )
    assert any("the run goes on without a view" in line and "no more colours" in line for line in said)
    assert outcome.state == "failed" and "run.rrd is not whole" in outcome.error
    with nuno.open(tmp_path / "run.mcap") as recording:
        assert recording.complete
        assert recording.metadata["end"]["state"] == "done"
        assert sum(1 for _ in recording.frames()) == 26


def test_when_the_supervisor_is_killed_nothing_stays_behind(tmp_path: Path) -> None:
    scene = write_scene(tmp_path, bodies=BALL, duration=400.0)
    with Processes(tmp_path) as run:
        run.supervise(scene, "--processes", "--no-view")
        assert run.wait_for("0.00 of")
        run.children["supervisor"].kill()
        assert run.wait_end(20.0) < 20.0
        assert run.stop() == []
    with nuno.open(run.record) as recording:
        assert not recording.complete
        assert next(recording.frames()).number == 0


@pytest.mark.full
def test_a_service_that_dies_as_it_starts_holds_nobody_up(tmp_path: Path) -> None:
    """The others are ready only when the run has failed already, and its supervisor does not wait for them."""
    scene = write_scene(tmp_path, bodies=BALL)
    with Processes(tmp_path) as run:
        run.supervise(scene, "--processes", "--no-view")
        wait_until(lambda: run.find("recorder") is not None)
        recorder = run.find("recorder")
        assert recorder is not None
        recorder.kill()
        assert run.wait_end(20.0) < 20.0
        assert run.code() == 1
        assert "the recorder service ended before it was ready: ended by SIGKILL" in run.said()


def test_a_service_ends_with_its_supervisor_though_it_never_met_it(tmp_path: Path) -> None:
    """It is still looking for the hub, which it would do for longer."""
    words = ["serve", "recorder", str(write_scene(tmp_path)), "--run", "r", "--connect", "tcp/127.0.0.1:1"]
    code = """
import sys
from nuno.cli import main, serve
serve.PATIENCE, serve.FINISH_TIMEOUT = 1e6, 1e6
main(sys.argv[1:])
"""
    command = [sys.executable, "-c", code, *words, "--record", str(tmp_path / "r.mcap"), "--lifeline"]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as child:
        assert child.stdin is not None
        child.stdin.close()
        assert child.wait(60.0) == 1


@pytest.mark.usefixtures("interruptible")
@pytest.mark.quick(word=["interrupted"])
@pytest.mark.parametrize(
    ("number", "word", "by"),
    [(signal.SIGTERM, "terminated", "SIGTERM or SIGHUP"), (signal.SIGINT, "interrupted", "SIGINT (Ctrl-C)")],
)
def test_a_signal_ends_a_run_in_order(number: signal.Signals, word: str, by: str, tmp_path: Path) -> None:
    scene = write_scene(tmp_path, duration=400.0)
    with Processes(tmp_path) as run:
        run.supervise(scene, "--no-view")
        assert run.wait_for("0.00 of")
        run.children["supervisor"].send_signal(number)
        assert run.wait_end(20.0) < 20.0
        assert run.code() == 1
        assert run.said().splitlines()[-1] == f"{word} by {by} before its end"
        assert f"the services end in order: {word} (once more, and they end at once)" in run.said()
    with nuno.open(run.record) as recording:
        assert recording.metadata["end"]["state"] == recording.report()["state"] == word
        assert shortcoming(recording) == f"INCOMPLETE: its run was {word} by {by}"
        last = [frame.number for frame in recording.frames()][-1]
        assert recording.report()["simulated_seconds"] == pytest.approx(last / 50)
        assert len(recording.report()["digest"]) == 32
        point = recording.last_checkpoint(recording.common_checkpoint().t)
        assert point.frame == last > 0, "it can be gone on from where it was"


def test_a_second_signal_ends_a_process_whatever_it_does() -> None:
    """Here the main thread goes on after each."""
    code = """
import os, signal, threading, time
from nuno.process import ending_at_once
signal.signal(signal.SIGINT, lambda *_: os.write(1, b"once\\n"))  # print may be in the middle of a line
with ending_at_once():
    print("ready", flush=True)
    while True:
        time.sleep(0.01)
"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        assert child.stdout is not None and child.stderr is not None
        assert child.stdout.readline() == b"ready\n"
        child.send_signal(signal.SIGINT)
        assert child.stdout.readline() == b"once\n"
        child.send_signal(signal.SIGINT)
        assert child.wait(20.0) == 1
        assert child.stderr.read() == b"ended at once\n"


def test_a_hub_that_ends_is_named(tmp_path: Path) -> None:
    loaded = scene_file.read(write_scene(tmp_path))
    found: list[Outcome] = []
    with hub_at(None) as (session, endpoint):
        deployment = Deployment(connect=endpoint)
        thread = threading.Thread(target=lambda: found.append(supervisor.supervise(loaded, Options(), deployment)))
        thread.start()
        wait_until(lambda: bool(list(session.liveliness().get("nuno/*/alive/supervisor"))))
    thread.join(20.0)
    assert f"the connection to the hub at {endpoint} broke" in found[0].error


def test_a_run_of_a_name_that_another_host_has_is_refused(tmp_path: Path) -> None:
    """The hub knows who is there; the other's own machine has its note."""
    loaded = scene_file.read(write_scene(tmp_path))
    refused = pytest.raises(BadInput, match="a run of that name is going on")
    with hub_at(None) as (session, endpoint), Bus(session, "r1", SUPERVISOR).alive(), refused:
        supervisor.supervise(loaded, Options(), Deployment(connect=endpoint, run="r1"))


def test_a_hub_that_breaks_as_services_finish_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not the service that was asked just then; and the recorder, which is told nothing more, closes its file."""

    def breaks(self: Supervisor) -> None:
        self.cut_off = lambda: "the connection broke"

    monkeypatch.setattr(Supervisor, "_await_recorder", breaks)
    record = tmp_path / "run.mcap"
    outcome = supervisor.supervise(scene_file.read(write_scene(tmp_path)), Options(record=record))
    assert (outcome.state, outcome.error) == ("failed", "the connection broke")
    with nuno.open(record) as recording:
        assert not recording.complete
        assert sum(1 for _ in recording.frames()) == 26


def test_a_clock_that_is_set_back_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, (before, after) = write_scene(tmp_path), (tmp_path / "before.mcap", tmp_path / "after.mcap")
    undisturbed = nuno.run(scene, record=before)
    looks = itertools.count(1)
    monkeypatch.setattr(time, "time_ns", lambda: 2 * 10**18 - next(looks) * 3600 * 10**9)
    monkeypatch.setattr(time, "time", lambda: time.time_ns() / 1e9)
    run = nuno.run(scene, record=after)
    assert run.digest == undisturbed.digest
    assert run.report["wall_seconds"] > 0.0 and all(seconds >= 0.0 for seconds in run.report["parts_seconds"].values())
    with nuno.open(before) as recording, nuno.open(after) as other:
        assert other.complete
        plain, told = list(recording.messages()), list(other.messages())
    assert [(m.topic, m.seq, m.log_time) for m in told] == [(m.topic, m.seq, m.log_time) for m in plain]
    assert told[-1].publish_time < told[0].publish_time


@pytest.mark.parametrize("moved", [True, False])
def test_a_recording_that_is_moved_or_removed_stops_the_run(moved: bool, tmp_path: Path) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()
    writer = RecordingWriter(folder / "a.mcap", metadata(), {})
    if moved:
        folder.rename(tmp_path / "elsewhere")
    else:
        part_of(folder / "a.mcap").unlink()
        folder.rmdir()
    event = next(m for m in items(Sheet(3, 2), 2) if m[0].startswith("run/event"))
    with pytest.raises(RunFailed, match=r"its file or folder was moved or removed; it is no longer at .*a\.mcap\.part"):
        writer.write(*event)


def test_a_disk_that_is_full_at_the_end_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(handle: int) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr("nuno.recording.writer.os.fsync", fail)
    outcome = supervisor.supervise(scene_file.read(write_scene(tmp_path)), Options(record=tmp_path / "a.mcap"))
    assert outcome.state == "failed"
    assert "recording stopped: No space left on device" in outcome.error


@pytest.mark.parametrize("when", ["measure", "advance"])
def test_a_dyed_run_that_dies_at_once_has_a_report(
    when: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from nuno.simulation.run import Simulation

    def fail(self: Simulation, *poses: object) -> None:
        raise OSError("the loom is on fire")

    monkeypatch.setattr(Simulation, when, fail)
    scene = garment_scene.write(tmp_path)
    assert main(["run", str(scene), "--no-view", "--record", str(tmp_path / "a.mcap")]) == 1
    assert "the loom is on fire" in capsys.readouterr().err


def test_a_run_that_never_began_has_no_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*arguments: object) -> None:
        raise OSError("the loom is on fire")

    monkeypatch.setattr("nuno.simulation.run.Simulation.__init__", fail)
    assert main(["run", str(write_scene(tmp_path)), "--no-view", "--record", str(tmp_path / "a.mcap")]) == 1
    said = capsys.readouterr()
    assert "the loom is on fire" in said.err
    assert "ended while it was prepared, after" in said.out and "stretch" not in said.out


def refusal(capsys: pytest.CaptureFixture[str], recording: Path, *flags: str) -> str:
    """What is said of a recording that cannot be gone on from, and that nothing else is left of the attempt."""
    target = recording.with_name("on.mcap")
    assert main(["run", "--resume", str(recording), "--no-view", "--record", str(target), *flags]) == 2
    assert not target.exists() and not part_of(target).exists()
    return capsys.readouterr().err


@pytest.fixture
def many_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every message is a chunk of its own, so that a recording can be cut between any two."""
    monkeypatch.setattr("nuno.recording.writer.FLUSH_SECONDS", -1.0)


def test_what_cannot_be_gone_on_from_is_refused(
    many_chunks: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    done, cut = tmp_path / "done.mcap", tmp_path / "cut.mcap.part"
    nuno.run(write_scene(tmp_path), record=done)
    assert "has come to the end of its scene" in refusal(capsys, done)
    assert "goes on after that" in refusal(capsys, done, "--set", "duration=0.2")
    with nuno.open(done) as recording:
        second = recording.layout.chunks[1]
    cut.write_bytes(done.read_bytes()[: second.chunk_start_offset])
    said = refusal(capsys, cut)
    assert "holds no checkpoint" in said and "run its scene again" in said
    cut.write_bytes(done.read_bytes()[:100])
    assert "cut before its first record" in refusal(capsys, cut)


def test_a_run_that_is_killed_is_gone_on_from_though_no_checkpoints_were_asked_for(
    many_chunks: None, tmp_path: Path
) -> None:
    """From that of frame 60: the file is as a kill in frame 63 leaves it."""
    whole = nuno.run(write_scene(tmp_path, duration=1.3, record={}), record=tmp_path / "whole.mcap")
    killed, on = tmp_path / "killed.mcap.part", tmp_path / "on.mcap"
    with nuno.open(whole.path) as recording:
        assert [point.frame for point in recording.checkpoints()] == [60, 65]
        last = next(chunk for chunk in recording.layout.chunks if chunk.message_start_time >= 63 / 50 * 1e9 - 1)
    killed.write_bytes(whole.path.read_bytes()[: last.chunk_start_offset])
    assert main(["run", "--resume", str(killed), "--no-view", "--record", str(on)]) == 0
    with nuno.open(on) as recording:
        assert recording.metadata["end"]["digest"] == whole.digest
        assert sum(1 for _ in recording.frames()) == 66


def test_a_recording_damaged_at_its_end_is_gone_on_from(many_chunks: None, tmp_path: Path) -> None:
    whole = nuno.run(write_scene(tmp_path, bodies=BALL), record=tmp_path / "whole.mcap")
    with nuno.open(whole.path) as recording:
        place = recording.layout.chunks[len(recording.layout.chunks) * 2 // 3]
    data = bytearray(whole.path.read_bytes())
    data[place.chunk_start_offset + place.chunk_length // 2] ^= 0x55
    damaged, on = tmp_path / "damaged.mcap", tmp_path / "on.mcap"
    damaged.write_bytes(data[:-100])
    assert main(["run", "--resume", str(damaged), "--no-view", "--record", str(on)]) == 0
    with nuno.open(damaged) as recording:
        assert 5 < sum(1 for _ in recording.frames()) < 26
    with nuno.open(on) as recording:
        assert recording.metadata["end"]["digest"] == whole.digest
        assert sum(1 for _ in recording.frames()) == 26
