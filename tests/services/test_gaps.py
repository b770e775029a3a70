"""A recording that lacks messages says so, with their topics and numbers, to whoever uses it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from live_run import Run
from recorded_sheet import Sheet, items, metadata
from scenes import write_scene

import nuno
from nuno.bus.messages import Publisher
from nuno.cli import main
from nuno.recording.gaps import count_gaps, find_lacks, shortcoming
from nuno.recording.reader import open_recording
from nuno.recording.writer import RecordingWriter, part_of
from nuno.report.show import lines
from nuno_schemas.messages import STATE, STATUS

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
