"""A cut or damaged recording reads up to its last whole chunk, and never reads wrong."""

from __future__ import annotations

import errno
import io
import json
import os
import signal
import struct
import subprocess
import sys
import tracemalloc
from pathlib import Path

import pytest
from mcap.reader import FOOTER_SIZE
from recorded_sheet import Item, Sheet, items, metadata, write
from scenes import write_scene

import nuno
from nuno import output_files
from nuno.cli import main
from nuno.recording import writer as writer_module
from nuno.recording.mcap_file import MAGIC
from nuno.recording.reader import END, Recording, open_recording, shortcoming
from nuno.recording.writer import RecordingWriter, check_target, part_of
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import STATE

SHEET = Sheet(3, 2)
FRAMES = 12

CHILD = """
import sys, time
from pathlib import Path
from recorded_sheet import Sheet, items, metadata
from nuno.recording import writer
writer.FLUSH_SECONDS = float("inf")
recording = writer.RecordingWriter(Path(sys.argv[1]), metadata(), {"f": b"attached"})
messages = [m for m in items(Sheet(3, 2), 12) if m[0] != "run/report"]
for message in messages:
    recording.write(*message)
for message in messages[:20]:
    recording.write(*message)
print("written", flush=True)
time.sleep(60)
"""


def found(recording: Recording) -> list[tuple[str, int, bytes]]:
    return [(m.topic, m.seq, m.payload) for m in recording.messages()]


def plain(written: list[Item]) -> list[tuple[str, int, bytes]]:
    return [(topic, header.seq, payload) for topic, header, payload in written]


@pytest.fixture
def many_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, list[tuple[str, int, bytes]]]:
    """A finished file in which every message is a chunk."""
    monkeypatch.setattr(writer_module, "FLUSH_SECONDS", -1.0)
    written = write(tmp_path / "whole.mcap", SHEET, FRAMES, {"f": b"attached"})
    return tmp_path / "whole.mcap", plain(written)


def test_a_killed_writer_leaves_what_it_flushed(tmp_path: Path) -> None:
    """The closing event flushes; the twenty messages after it wait in memory and are lost."""
    path = tmp_path / "a.mcap"
    with subprocess.Popen(
        [sys.executable, "-c", CHILD, str(path)], stdout=subprocess.PIPE, cwd=Path(__file__).parent, text=True
    ) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "written\n"
        child.send_signal(signal.SIGKILL)
    assert not path.exists()
    expected = plain([m for m in items(SHEET, FRAMES) if m[0] != "run/report"])
    with open_recording(part_of(path)) as recording:
        assert found(recording) == expected
        assert recording.recovered
        assert not recording.complete
        assert recording.attachment("f") == b"attached"


@pytest.mark.quick(every=[101])
@pytest.mark.parametrize("every", [17, 101])
def test_truncation_anywhere_reads_a_prefix(many_chunks: tuple[Path, list[tuple[str, int, bytes]]], every: int) -> None:
    """At each so many bytes, which are fewer than a chunk's 217, and at each of the last."""
    path, whole = many_chunks
    data = path.read_bytes()
    cut = path.with_name("cut.mcap")
    numbers = []
    for size in sorted({*range(0, len(data), every), *range(len(data) - 120, len(data))}):
        cut.write_bytes(data[:size])
        try:
            with open_recording(cut) as recording:
                messages = found(recording)
                assert recording.recovered
                assert not recording.complete
                assert recording.layout.readable <= size
        except BadInput:
            messages = []
        assert messages == whole[: len(messages)]
        numbers.append(len(messages))
    assert numbers == sorted(numbers)
    assert numbers[-1] == len(whole)
    assert len(set(numbers)) > 0.9 * len(whole)


@pytest.mark.quick(every=[101])
@pytest.mark.parametrize("every", [19, 101])
def test_a_changed_byte_never_reads_as_a_wrong_message(
    many_chunks: tuple[Path, list[tuple[str, int, bytes]]], every: int
) -> None:
    path, whole = many_chunks
    data = path.read_bytes()
    changed = path.with_name("changed.mcap")
    numbers = []
    with open_recording(path) as recording:
        recording_begins = recording.layout.chunks[0].chunk_start_offset
    for place in range(0, len(data), every):
        changed.write_bytes(data[:place] + bytes([data[place] ^ 0x55]) + data[place + 1 :])
        try:
            with open_recording(changed) as recording:
                messages = found(recording)
                assert recording.recovered and not recording.complete and shortcoming(recording)
                assert recording.damage or place > len(data) - 60, "only the last bytes may look like a file's cut end"
        except BadInput:  # as a file that is cut so early
            assert place < recording_begins
            continue
        assert messages == whole[: len(messages)]
        numbers.append(len(messages))
    # The index of single messages, names and versions are not needed to read them all.
    assert max(numbers) == len(whole) and len(set(numbers)) > 0.9 * min(len(whole), len(data) / every)


@pytest.mark.parametrize(
    "tail",
    [
        struct.pack("<BQ", 6, 2**64 - 1) + bytes(100),
        struct.pack("<BQ", 6, 2**62) + bytes(100),
        struct.pack("<BQ", 12, 12) + struct.pack("<III", 2**32 - 1, 2**32 - 1, 0),
        struct.pack("<BQ", 9, 40) + struct.pack("<QQIIQ", 0, 0, 2**32 - 1, 0, 2**63) + bytes(8),
        struct.pack("<BQ", 6, 48) + struct.pack("<QQQIIQ", 0, 0, 2**60, 0, 0, 2**60) + bytes(8),
        bytes(4096),
        b"\xff" * 4096,
    ],
)
def test_lengths_are_not_believed(tmp_path: Path, tail: bytes) -> None:
    """Records that promise more than the file holds allocate nothing and end the file."""
    start = _unfinished(tmp_path)
    path = tmp_path / "long.mcap.part"
    path.write_bytes(start + tail)
    with open_recording(tmp_path / "start.mcap.part") as recording:
        expected = found(recording)
    tracemalloc.start()
    with open_recording(path) as recording:
        assert found(recording) == expected
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2_000_000


def _unfinished(folder: Path) -> bytes:
    writer = RecordingWriter(folder / "start.mcap", metadata(), {})
    for item in items(SHEET, 3):
        writer.write(*item)
    writer.abort()
    return part_of(folder / "start.mcap").read_bytes()


def test_the_index_of_a_whole_file_says_what_a_scan_finds_and_reads_no_message(
    many_chunks: tuple[Path, list[tuple[str, int, bytes]]],
) -> None:
    """So that a list of many recordings opens in no time; of a file without an index all is scanned."""
    path, _ = many_chunks
    with open_recording(path) as whole:
        expected, chunks = (whole.metadata, whole.span), whole.layout.chunks
    data = bytearray(path.read_bytes())
    for chunk in chunks:
        start = chunk.chunk_start_offset + 9
        data[start : chunk.chunk_start_offset + chunk.chunk_length] = bytes(chunk.chunk_length - 9)
    path.write_bytes(data)
    with Recording(path, scan=False) as listed:
        assert (listed.metadata, listed.span) == expected
    with open_recording(path) as damaged:
        assert damaged.damage and not damaged.layout.chunks
    path.write_bytes(data[: chunks[0].chunk_start_offset])
    with Recording(path, scan=False) as cut:
        assert cut.recovered and END not in cut.metadata


@pytest.mark.parametrize(
    "content", [b"", b"\x89", MAGIC, MAGIC + MAGIC, b"hello world" * 100, MAGIC + bytes(range(256)) * 20]
)
def test_other_files_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    with pytest.raises(BadInput) as caught:
        open_recording(path)
    assert "bytes" in str(caught.value)


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "missing.mcap", tmp_path):
        with pytest.raises(BadInput, match="cannot be read"):
            open_recording(path)


class SmallDisk(io.FileIO):
    """A file on a disk with room for `left` bytes."""

    left = 0

    def write(self, data: bytes | memoryview) -> int:  # type: ignore[override]
        if self.left <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        piece = memoryview(data)[: self.left]
        self.left -= len(piece)
        return super().write(piece)


def test_a_full_disk_fails_plainly_and_keeps_what_was_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer_module, "FLUSH_SECONDS", -1.0)
    whole = list(items(SHEET, 4))
    size = write_on(tmp_path / "free.mcap", 10**9, whole, monkeypatch)
    written = []
    for room in range(0, size, 97):
        path = tmp_path / f"{room}.mcap"
        with pytest.raises(RunFailed, match="No space left"):
            write_on(path, room, whole, monkeypatch)
        assert not path.exists()
        try:
            with open_recording(part_of(path)) as recording:
                messages = found(recording)
                # Nothing but whole records is left behind.
                assert recording.layout.readable == recording.layout.size
        except BadInput:
            messages = []
        assert messages == plain(whole)[: len(messages)]
        written.append(len(messages))
    assert written == sorted(written)
    assert written[-1] == len(whole)


def write_on(path: Path, room: int, messages: list[Item], monkeypatch: pytest.MonkeyPatch) -> int:
    def small_disk(target: Path) -> io.BufferedWriter:
        raw = SmallDisk(part_of(target), "xb")
        raw.left = room
        return io.BufferedWriter(raw)

    monkeypatch.setattr(writer_module, "_open", small_disk)
    writer = RecordingWriter(path, metadata(), {})
    for item in messages:
        writer.write(*item)
    return writer.finish({END: {"complete": "true"}}).stat().st_size


def test_frames_of_a_cut_file_keep_their_numbers(many_chunks: tuple[Path, list[tuple[str, int, bytes]]]) -> None:
    path, _ = many_chunks
    cut = path.with_name("cut.mcap.part")
    cut.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with open_recording(cut) as recording:
        numbers = [frame.number for frame in recording.frames()]
        assert numbers == list(range(recording.counts[STATE.name]))


def test_a_recording_that_was_not_finished_is_named(tmp_path: Path) -> None:
    """Who asks for the name that the run was to have is told where its recording is."""
    recording = RecordingWriter(tmp_path / "run.mcap", metadata(), {})
    recording.abort()
    with pytest.raises(BadInput, match="No such file") as caught:
        open_recording(tmp_path / "run.mcap")
    assert str(tmp_path / "run.mcap.part") in str(caught.value.remedy)
    with pytest.raises(BadInput) as caught:
        open_recording(tmp_path / "other.mcap")
    assert "part" not in str(caught.value.remedy)


def test_a_damaged_and_a_cut_recording_read_up_to_the_same_message(
    many_chunks: tuple[Path, list[tuple[str, int, bytes]]], capsys: pytest.CaptureFixture[str]
) -> None:
    """One flipped bit in a chunk, and the same file cut there: the same is read, and each is told as what it is."""
    path, whole = many_chunks
    data = bytearray(path.read_bytes())
    with open_recording(path) as recording:
        place = recording.layout.chunks[len(whole) // 2].chunk_start_offset
    data[place + 100] ^= 1
    path.write_bytes(data)
    cut = path.with_name("cut.mcap")
    cut.write_bytes(data[: place + 100])
    with open_recording(path) as recording, open_recording(cut) as other:
        assert found(recording) == found(other) == whole[: len(whole) // 2]
        assert recording.span == other.span and not other.damage
        assert f"damaged at byte {place:,} of {len(data):,} (the checksum of a chunk" in recording.damage
    assert main(["info", str(path), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["complete"], facts["cut"]) == (False, False) and facts["damage"] == recording.damage
    assert main(["export", str(path), "--csv", str(path.with_suffix(".csv"))]) == 0
    said = capsys.readouterr().err
    assert f"INCOMPLETE: {recording.damage}, and read up to {recording.span[1]:g} s" in said
    assert main(["replay", str(path), "--fast", "--no-view"]) == 0
    assert capsys.readouterr().out == f"{len(whole) // 2} messages, {recording.counts[STATE.name]} frames\n"


def test_a_file_in_a_recording_that_is_damaged_is_refused_by_name_and_hides_no_frame(
    many_chunks: tuple[Path, list[tuple[str, int, bytes]]],
) -> None:
    path, whole = many_chunks
    data = bytearray(path.read_bytes())
    data[data.index(b"attached")] ^= 1
    path.write_bytes(data)
    with open_recording(path) as recording:
        assert found(recording) == whole
        assert recording.damage.startswith("damaged beside its messages") and not recording.complete
        with pytest.raises(BadInput, match="the checksum of the file f in it"):
            recording.attachment("f")


def test_a_file_cut_in_its_index_is_cut_and_one_with_more_bytes_is_damaged(
    many_chunks: tuple[Path, list[tuple[str, int, bytes]]],
) -> None:
    path, whole = many_chunks
    data = path.read_bytes()
    index = len(data) - FOOTER_SIZE - len(MAGIC)
    for left in (*range(index - 40, len(data)), index - 1000):
        path.write_bytes(data[:left])
        with open_recording(path) as recording:
            assert recording.recovered and not recording.damage, left
            assert found(recording) == whole
    path.write_bytes(data + b"more\r\n")
    with open_recording(path) as recording:
        assert "(6 bytes follow its end)" in recording.damage and found(recording) == whole


def test_a_recording_that_lacks_its_last_bytes_is_resumed(tmp_path: Path) -> None:
    result = nuno.run(write_scene(tmp_path, duration=0.1), record=tmp_path / "run.mcap")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(result.path.read_bytes()[:-100])
    with pytest.warns(UserWarning, match="cut short"):
        assert nuno.verify(cut).frame is None
    half = tmp_path / "half.mcap"
    half.write_bytes(result.path.read_bytes()[: result.path.stat().st_size // 2])
    assert main(["verify", str(half)]) == 1
    assert nuno.resume(cut, record=tmp_path / "on.mcap").digest == result.digest


def test_a_pipe_is_no_recording_and_is_not_waited_for(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.mcap"
    os.mkfifo(pipe)
    with pytest.raises(BadInput, match="a pipe or device"):
        open_recording(pipe)
    with pytest.raises(BadInput, match="no recording and would be lost"):
        check_target(pipe)
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(BadInput, match="no csv export and would be lost"):
        output_files.check_target(tmp_path / "pipe.csv", ".csv")
