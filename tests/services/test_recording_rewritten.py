"""A recording that another program has written anew, compressed or with less of an index, reads the same."""

from __future__ import annotations

import tracemalloc
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from recorded_sheet import RATE, Sheet, metadata, write

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
    """A chunk of 64 MB of zeros, said to hold a hundredth of it, is damaged; neither figure is made room for."""
    writer = RecordingWriter(tmp_path / "a.mcap", metadata(), {})
    writer.write(CHECKPOINT.name, Header(run="r", service="s", seq=0, frame=0, t=0.0), bytes(64_000_000))
    writer.finish({})
    target = rewritten(tmp_path / "a.mcap", compression=compression)
    with open_recording(target) as recording:
        size_at = recording.layout.chunks[0].chunk_start_offset + 25
    data = bytearray(target.read_bytes())
    data[size_at : size_at + 8] = (640_000).to_bytes(8, "little")
    target.write_bytes(data)
    tracemalloc.start()
    with open_recording(target) as recording, pytest.raises(BadInput, match="damaged"):
        list(recording.messages())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8_000_000
