"""A recording that another program has written anew, compressed or with less of an index, reads the same."""

from __future__ import annotations

import struct
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from recorded_sheet import RATE, Sheet, metadata, write

from nuno.recording.layout import FREE, MOST_TOPICS, PACKED
from nuno.recording.mcap_file import McapFile
from nuno.recording.reader import open_recording
from nuno.recording.writer import RecordingWriter
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import CHECKPOINT, Header


@pytest.fixture
def sheet() -> Sheet:
    return Sheet()


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
