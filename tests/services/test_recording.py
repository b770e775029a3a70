"""A recording holds exactly what was written; rewritten by another program it reads the same."""

from __future__ import annotations

import json
import struct
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from recorded_sheet import GEOMETRY_VALUE, RATE, REPORT_TEXT, Sheet, items, metadata, poses, status, write

from nuno.bus.encodings import BadMessage, encode_arrays, encode_points
from nuno.collision.messages import decode_geometry
from nuno.recording.mcap_file import FREE, MOST_TOPICS, PACKED, McapFile
from nuno.recording.reader import END, open_recording
from nuno.recording.recorded import Recorded
from nuno.recording.writer import RecordingWriter, check_target, part_of
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import CHECKPOINT, GEOMETRY, STATE, STATUS, Header, Status


@pytest.fixture
def sheet() -> Sheet:
    return Sheet()


def test_reads_back_byte_for_byte(tmp_path: Path, sheet: Sheet) -> None:
    files = {"check.png": b"\x00\x01" * 500, "empty.npz": b""}
    written = write(tmp_path / "a.mcap", sheet, 20, files)
    with open_recording(tmp_path / "a.mcap") as recording:
        assert [(m.topic, m.seq, m.payload) for m in recording.messages()] == [(t, h.seq, p) for t, h, p in written]
        assert {name: recording.attachment(name) for name in recording.attachments} == files
        assert recording.metadata["run"] == metadata()["run"]
        assert recording.scene["name"] == "waving"
        assert recording.report() == REPORT_TEXT
        assert recording.complete
        assert not recording.recovered
        assert recording.span == (0.0, pytest.approx(19 / RATE, abs=1e-9))


def test_a_stock_reader_sees_the_same(tmp_path: Path, sheet: Sheet) -> None:
    written = write(tmp_path / "a.mcap", sheet, 20, {"f": b"abc"})
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        found = [(c.topic, m.sequence, m.data) for _, c, m in reader.iter_messages(log_time_order=False)]
        schemas = {c.topic: s for s, c, _ in reader.iter_messages() if s is not None}
        assert [a.data for a in reader.iter_attachments()] == [b"abc"]
        assert [m.name for m in reader.iter_metadata()] == ["run", "scene", END]
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(written)
    assert found == [(t, h.seq, p) for t, h, p in written]
    assert json.loads(schemas[STATUS.name].data) == Status.model_json_schema()
    assert (schemas[STATE.name].name, schemas[STATE.name].encoding) == ("foxglove.PointCloud", "protobuf")


def test_log_time_is_simulation_time(tmp_path: Path, sheet: Sheet) -> None:
    write(tmp_path / "a.mcap", sheet, 20)
    with open_recording(tmp_path / "a.mcap") as recording:
        assert [m.log_time for m in recording.messages([STATE.name])] == [round(k / RATE * 1e9) for k in range(20)]
        # A message outside any frame stands where it happened.
        assert [m.log_time for m in recording.messages(["run/report"])] == [round(19 / RATE * 1e9)]


def test_frames_keep_float32_about_an_origin(tmp_path: Path, sheet: Sheet) -> None:
    write(tmp_path / "a.mcap", sheet, 20)
    with open_recording(tmp_path / "a.mcap") as recording:
        frames = list(recording.frames())
    assert [f.number for f in frames] == list(range(20))
    assert [f.digest for f in frames] == [f"digest-{k}" for k in range(20)]
    for k, frame in enumerate(frames):
        assert np.abs(frame.x - sheet.x(k / RATE)).max() <= 2.0**-24 * 1.1


def test_checkpoints_keep_every_bit(tmp_path: Path, sheet: Sheet) -> None:
    write(tmp_path / "a.mcap", sheet, 25, checkpoint_every=10)
    with open_recording(tmp_path / "a.mcap") as recording:
        assert [c.frame for c in recording.checkpoints()] == [9, 19, 24]
        for point in recording.checkpoints():
            t = point.frame / RATE
            assert point.t == t
            assert point.x.tobytes() == sheet.x(t).tobytes()
            assert point.v.tobytes() == sheet.v(t).tobytes()
            assert (point.memory["anchor"] == point.frame).all()
        assert recording.last_checkpoint().frame == 24
        assert recording.last_checkpoint(before=0.4).frame == 19
        with pytest.raises(BadInput, match="no checkpoint"):
            recording.last_checkpoint(before=0.1)


def test_bodies_and_fabric(tmp_path: Path, sheet: Sheet) -> None:
    write(tmp_path / "a.mcap", sheet, 20)
    with open_recording(tmp_path / "a.mcap") as recording:
        arrays, text = recording.fabric()
        assert (arrays["faces"] == sheet.faces).all()
        assert text["vertices"] == sheet.number
        found = recording.last(GEOMETRY.name)
        assert found is not None
        assert decode_geometry(found.payload).frames == GEOMETRY_VALUE.frames
        assert (recording.poses(0.2)[0]["translation"] == poses(0.2).translation).all()


def test_series_are_the_reports(tmp_path: Path, sheet: Sheet) -> None:
    write(tmp_path / "a.mcap", sheet, 20)
    with open_recording(tmp_path / "a.mcap") as recording:
        series = recording.series()
    expected = [status(k, k / RATE) for k in range(20)]
    assert list(series["frame"]) == list(range(20))
    assert list(series["t"]) == [s.t for s in expected]
    assert list(series["energy_kinetic"]) == [s.energy["kinetic"] for s in expected]
    assert list(series["stretch"]) == [s.stretch for s in expected]
    assert list(series["depth"]) == [1e-4 * k for k in range(20)]
    assert series["inside"].dtype == np.int64


def test_time_range_and_topics(tmp_path: Path, sheet: Sheet) -> None:
    write(tmp_path / "a.mcap", sheet, 20)
    with open_recording(tmp_path / "a.mcap") as recording:
        assert [m.seq for m in recording.messages([STATE.name], start=0.1, end=0.2)] == [5, 6, 7, 8, 9]
        assert [m.topic for m in recording.messages(["run/event/*"])] == ["run/event/simulation"]
        assert recording.counts[STATE.name] == 20
        assert list(recording.messages(["no/such"])) == []


def test_chunk_order_is_message_order(tmp_path: Path) -> None:
    """Frames larger than a chunk and small reports keep their order across chunks."""
    big = Sheet(200, 200)
    written = write(tmp_path / "a.mcap", big, 24, checkpoint_every=4)
    with open_recording(tmp_path / "a.mcap") as recording:
        assert len(recording.layout.chunks) > 3
        assert [(m.topic, m.seq) for m in recording.messages()] == [(t, h.seq) for t, h, _ in written]


def test_overhead_of_frames_and_checkpoints(tmp_path: Path) -> None:
    """At most 5 % over 12 bytes a vertex a frame, and 48 bytes a vertex a checkpoint."""
    n, frames = 12288, 30
    x = np.random.default_rng(1).normal(size=(n, 3))
    empty = _size(tmp_path / "empty.mcap", n, [], frames)
    with_frames = _size(tmp_path / "frames.mcap", n, [(STATE.name, encode_points(x, 0.0))] * frames, frames)
    assert with_frames - empty <= 1.05 * 12 * n * frames
    point = encode_arrays({"x": x, "v": x}, {"t": 0.0, "frame": 0, "digest": "0" * 32})
    with_point = _size(tmp_path / "point.mcap", n, [(CHECKPOINT.name, point)], frames)
    assert with_point - empty <= 48 * n + 2048


def _size(path: Path, n: int, messages: list[tuple[str, bytes]], frames: int) -> int:
    """Bytes of a file with `frames` status reports, which every run has, and the messages."""
    writer = RecordingWriter(path, metadata(), {})
    for k in range(frames):
        header = Header(run="r", service="s", seq=k, frame=k, t=k / RATE)
        writer.write(STATUS.name, header, status(k, k / RATE).model_dump_json().encode())
        if k < len(messages):
            writer.write(messages[k][0], header, messages[k][1])
    return writer.finish({}).stat().st_size


def test_payloads_are_not_copied(tmp_path: Path) -> None:
    """What the writer allocates beside a checkpoint of 4.8 MB is less than a tenth of it."""
    payload = bytes(4_800_000)
    writer = RecordingWriter(tmp_path / "a.mcap", metadata(), {})
    tracemalloc.start()
    writer.write(CHECKPOINT.name, Header(run="r", service="s", seq=0, frame=0, t=0.0), payload)
    writer.finish({})
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 480_000


@pytest.mark.parametrize(
    ("topic", "changes"),
    [
        (STATE.name, {"t": float("nan")}),
        (STATE.name, {"t": float("inf")}),
        (STATE.name, {"t": -1.0}),
        (STATE.name, {"t": 1e300}),
        (STATE.name, {"seq": 2**32}),
        (STATE.name, {"seq": -1}),
        ("ack/recorder", {}),
        ("no/such/topic", {}),
    ],
)
def test_what_cannot_be_recorded_is_refused(
    tmp_path: Path, sheet: Sheet, topic: str, changes: dict[str, float]
) -> None:
    writer = RecordingWriter(tmp_path / "a.mcap", metadata(), {})
    good = Header(run="r", service="s", seq=0, frame=0, t=0.0)
    writer.write(STATE.name, good, b"before")
    with pytest.raises(BadMessage):
        writer.write(topic, good.model_copy(update=changes), b"bad")
    writer.write(STATE.name, good.model_copy(update={"seq": 1}), b"after")
    with open_recording(writer.finish({})) as recording:
        assert [m.payload for m in recording.messages()] == [b"before", b"after"]


def test_a_target_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    (tmp_path / "notes.mcap").write_text("my notes")
    (tmp_path / "busy.mcap.part").write_bytes(b"unfinished")
    (tmp_path / "folder.mcap").mkdir()
    before = sorted(tmp_path.rglob("*"))
    for name in ("missing/a.mcap", "file/a.mcap", "notes.mcap", "busy.mcap", "folder.mcap", "a.txt"):
        with pytest.raises(BadInput) as caught:
            check_target(tmp_path / name)
        assert caught.value.remedy
    check_target(tmp_path / "good.mcap")
    assert sorted(tmp_path.rglob("*")) == before
    assert (tmp_path / "notes.mcap").read_text() == "my notes"
    assert (tmp_path / "busy.mcap.part").read_bytes() == b"unfinished"


def test_a_new_run_replaces_an_old_recording_only_when_it_is_whole(tmp_path: Path, sheet: Sheet) -> None:
    path = tmp_path / "a.mcap"
    write(path, sheet, 5)
    old = path.read_bytes()
    writer = RecordingWriter(path, metadata(), {})
    for topic, header, payload in items(sheet, 3):
        writer.write(topic, header, payload)
    assert path.read_bytes() == old
    writer.finish({})
    assert path.read_bytes() != old
    assert not part_of(path).exists()


def test_a_message_has_the_time_that_it_was_written_with() -> None:
    for k in range(2000):
        assert Recorded("sim/state", 0, round(k / 100 * 1e9), 0, b"").t == k / 100


@pytest.mark.parametrize("checksums", [True, False])
@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD, CompressionType.NONE])
def test_what_a_stock_writer_made_of_a_recording_reads_the_same(
    tmp_path: Path, sheet: Sheet, compression: CompressionType, checksums: bool
) -> None:
    """Compressed, in chunks of another size; by the format a checksum of 0 stands for none."""
    files = {"check.png": bytes(1000)}
    written = write(tmp_path / "a.mcap", sheet, 20, files)
    plain = [(topic, header.seq, payload) for topic, header, payload in written]
    options = {"chunk_size": 4096, "compression": compression, "enable_crcs": checksums}
    with open_recording(rewritten(tmp_path / "a.mcap", **options)) as recording:
        assert len(recording.layout.chunks) > 3
        assert [(m.topic, m.seq, m.payload) for m in recording.messages()] == plain
        assert {name: recording.attachment(name) for name in recording.attachments} == files
        assert recording.complete and not recording.recovered
        assert recording.last_checkpoint().x.tobytes() == sheet.x(19 / RATE).tobytes()
        chunks = recording.layout.chunks
    # Cut in the middle of a chunk: found without an index up to there.
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((tmp_path / "b.mcap").read_bytes()[: chunks[2].chunk_start_offset + 50])
    with open_recording(cut) as recording:
        assert recording.recovered and len(recording.layout.chunks) == 2
        found = [(m.topic, m.seq, m.payload) for m in recording.messages()]
        assert found and found == plain[: len(found)]


def rewritten(path: Path, **options: Any) -> Path:
    """A recording, read and written by the format's own library."""
    target = path.with_name("b.mcap")
    with path.open("rb") as source, target.open("wb") as stream:
        reader, writer = make_reader(source), Writer(stream, **options)
        writer.start("nuno", "test")
        for data in reader.iter_metadata():
            writer.add_metadata(data.name, data.metadata)
        for file in reader.iter_attachments():
            writer.add_attachment(file.create_time, file.log_time, file.name, file.media_type, file.data)
        schemas, channels = dict[int, int](), dict[int, int]()
        for schema, channel, m in reader.iter_messages(log_time_order=False):
            assert schema is not None
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                own = schemas[schema.id]
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, own)
            writer.add_message(channels[channel.id], m.log_time, m.data, m.publish_time, m.sequence)
        writer.finish()
    return target


@pytest.mark.parametrize("left_out", [{"use_statistics": False}, {"index_types": IndexType.ATTACHMENT}])
def test_an_index_that_leaves_something_out_hides_nothing(
    tmp_path: Path, sheet: Sheet, left_out: dict[str, Any]
) -> None:
    written = write(tmp_path / "a.mcap", sheet, 20)
    with open_recording(rewritten(tmp_path / "a.mcap", **left_out)) as recording:
        assert [m.payload for m in recording.messages()] == [payload for _, _, payload in written]
        assert sum(recording.counts.values()) == len(written)
        assert recording.scene["name"] == "waving"


def test_messages_without_chunks_are_refused_in_words(tmp_path: Path, sheet: Sheet) -> None:
    write(tmp_path / "a.mcap", sheet, 2)
    with pytest.raises(BadInput, match="outside of chunks"):
        open_recording(rewritten(tmp_path / "a.mcap", use_chunking=False))


@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD])
def test_a_compressed_chunk_unpacks_to_no_more_than_it_says(
    tmp_path: Path, sheet: Sheet, compression: CompressionType
) -> None:
    """A chunk of 16 MB of zeros, said to hold a hundredth of it, is damaged, with an index and without; neither figure
    is made room for.
    """
    target = _zeros(tmp_path, 16_000_000, compression)
    with open_recording(target) as recording:
        chunk_at = recording.layout.chunks[0].chunk_start_offset
    data = bytearray(target.read_bytes())
    data[chunk_at + 25 : chunk_at + 33] = (160_000).to_bytes(8, "little")
    for end in (len(data), len(data) - 20):
        target.write_bytes(data[:end])
        with _peak_below(8_000_000), open_recording(target) as recording:
            assert recording.recovered and recording.damage
            assert recording.layout.chunks == [] and recording.layout.readable == chunk_at


@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD])
def test_a_file_that_unpacks_to_far_more_than_itself_is_refused_at_once(
    tmp_path: Path, compression: CompressionType
) -> None:
    target = _zeros(tmp_path, 120 << 20, compression)
    assert target.stat().st_size * PACKED + FREE < 120 << 20
    with _peak_below(4_000_000):
        for data in (target.read_bytes(), target.read_bytes()[:-20]):  # with its index, or without
            target.write_bytes(data)
            with pytest.raises(BadInput, match="bytes, unpacked"):
                open_recording(target)


def _zeros(folder: Path, number: int, compression: CompressionType) -> Path:
    """A recording of so many zeros, compressed."""
    writer = RecordingWriter(folder / "a.mcap", metadata(), {})
    writer.write(CHECKPOINT.name, Header(run="r", service="s", seq=0, frame=0, t=0.0), bytes(number))
    writer.finish({})
    return rewritten(folder / "a.mcap", compression=compression)


@contextmanager
def _peak_below(most: int) -> Iterator[None]:
    """Fails where more bytes are allocated meanwhile."""
    tracemalloc.start()
    yield
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < most


def test_zeros_in_a_chunk_are_no_records(tmp_path: Path, sheet: Sheet) -> None:
    """Each nine of them would be a record of no kind and no length."""
    chunk = struct.pack("<QQQIIQ", 0, 0, 1 << 22, 0, 0, 1 << 22) + bytes(1 << 22)
    write(tmp_path / "a.mcap", sheet, 2)
    data = (tmp_path / "a.mcap").read_bytes()
    with open_recording(tmp_path / "a.mcap") as recording:
        first = recording.layout.chunks[0].chunk_start_offset
    (tmp_path / "b.mcap").write_bytes(data[:first] + struct.pack("<BQ", 6, len(chunk)) + chunk)
    with open_recording(tmp_path / "b.mcap") as recording:
        assert recording.layout.readable == first and list(recording.messages()) == []


def test_more_topics_than_any_run_has_are_refused(tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as stream:
        file = McapFile(stream)
        for name, fields in metadata().items():
            file.add_metadata(name, fields)
        for number in range(MOST_TOPICS + 1):
            file.add_message(file.add_channel(f"topic{number}", "json", "a", "jsonschema", b"{}"), 0, 0, 0, b"{}")
        file.finish()
    with pytest.raises(BadInput, match="1,001 topics"):
        open_recording(tmp_path / "a.mcap")
