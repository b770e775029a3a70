"""MCAP files: a writer that copies no payloads, and the layout of a file, from a scan that trusts no length in it.

Rejected: the mcap library's writer, which copies a message into its chunk and the chunk into a
record: it allocates twice a checkpoint's payload, where a tenth is allowed
(tests/services/test_recording.py, `test_payloads_are_not_copied`). Here a chunk is a list of
references to payloads until it is written; the small records are the library's own.
Chunks are not compressed: mantissas of moving vertices do not shrink, and the solver needs the
cores. Messages that only repeat others for viewers have compressed chunks of their own: the
topology of a mesh, which each of its messages repeats, then costs nothing. Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import NoneType
from typing import Any, BinaryIO, NamedTuple, cast

import psutil
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.reader import FOOTER_SIZE, SeekingReader
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import StreamReader
from mcap.summary import Summary

from nuno_schemas.errors import BadInput

MAGIC = b"\x89MCAP0\r\n"
BINARY = "application/octet-stream"
CHUNK_BYTES = 4 * 2**20
PACKED_BYTES, PACKED_WINDOW, LARGE = 8 * 2**20, 23, 4096
"""Size of a compressed chunk, unpacked [bytes], logarithm of the window in which repetitions are found, and least size
of a message whose packed size is found at once.
"""
LATEST = 2**32 * 10**9
"""Upper limit of times [ns]: the formats of recordings and exports have seconds in 32 bits."""
_MESSAGE = struct.Struct("<BQHIQQ")
_CHUNK = struct.Struct("<BQQQQII")
_RECORD_HEAD = 9
"""Bytes of any record before its body: opcode and length."""
INDEX_ENTRY = 16
"""Bytes of a message's index."""
REPEATS = "repeats"
"""Metadata of channels whose messages only repeat others, for viewers: readers of recordings leave them out."""


class Shown(NamedTuple):
    """A protobuf message for viewers: its topic, type, the FileDescriptorSet that describes it, and its bytes."""

    topic: str
    name: str
    schema: bytes
    payload: bytes


def _packer() -> Any:
    """Return a compressor that finds what repeats at a long distance, fast."""
    import zstandard

    settings = zstandard.ZstdCompressionParameters.from_level(1, window_log=PACKED_WINDOW, enable_ldm=True)
    return zstandard.ZstdCompressor(compression_params=settings).compressobj()


def record_bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


@dataclass
class _OpenChunk:
    """Records waiting to be written, by reference, or compressed where `packer` is a zstd compressor."""

    packer: Any = None
    pieces: list[bytes] = field(default_factory=list)
    size: int = 0
    packed: int = 0
    """Bytes of all pieces."""
    crc: int = 0
    start: int = 0
    end: int = 0
    places: dict[int, list[tuple[int, int]]] = field(default_factory=lambda: defaultdict(list))
    """(log time, offset in the chunk) of each message, by channel."""

    def add(self, piece: bytes) -> None:
        self.size += len(piece)
        self.crc = zlib.crc32(piece, self.crc)
        self._keep(piece if self.packer is None else self.packer.compress(piece))

    def _keep(self, piece: bytes) -> None:
        self.pieces.append(piece)
        self.packed += len(piece)

    def close(self) -> None:
        """Finish compression."""
        self._keep(b"" if self.packer is None else self.packer.flush())

    def add_message(self, channel: int, sequence: int, log_time: int, publish_time: int, payload: bytes) -> None:
        self.start = min(self.start, log_time) if self.places else log_time
        self.end = max(self.end, log_time)
        self.places[channel].append((log_time, self.size))
        length = _MESSAGE.size - _RECORD_HEAD + len(payload)
        self.add(_MESSAGE.pack(Opcode.MESSAGE, length, channel, sequence, log_time, publish_time))
        self.add(payload)
        if self.packer is not None and len(payload) > LARGE:  # so that its packed size is known
            self._keep(self.packer.flush(1))


class McapFile:
    """Writes MCAP to a seekable stream. Any method may raise the stream's OSError."""

    def __init__(self, stream: BinaryIO, profile: str = "nuno", library: str = "nuno") -> None:
        self._stream = stream
        self._chunk = _OpenChunk()
        self._repeats = _OpenChunk(_packer())
        """Messages that repeat others."""
        self.repeated = 0
        """Bytes of these messages in the file."""
        self._shown: dict[tuple[str, str], int] = {}
        """Their channels, by topic and type."""
        self._schemas: dict[str, Schema] = {}
        self._described: set[tuple[str, bool]] = set()
        """Schemas in chunks of either kind."""
        self._channels: list[Channel] = []
        self._chunk_indexes: list[ChunkIndex] = []
        self._attachment_indexes: list[McapRecord] = []
        self._metadata_indexes: list[McapRecord] = []
        self._counts: dict[int, int] = defaultdict(int)
        self._crc = 0
        self._write(MAGIC, record_bytes(Header(profile, library)))

    def _write(self, *pieces: bytes) -> int:
        """Write bytes and add them to the checksum of all data; return their number."""
        for piece in pieces:
            self._crc = zlib.crc32(piece, self._crc)
        self._stream.writelines(pieces)
        return sum(map(len, pieces))

    def add_channel(self, topic: str, encoding: str, schema: str, schema_encoding: str, schema_data: bytes) -> int:
        """Add a channel and return its id; a schema is written once."""
        return self._add_channel(self._chunk, topic, encoding, Schema(0, schema_data, schema_encoding, schema), {})

    def _add_channel(self, chunk: _OpenChunk, topic: str, encoding: str, schema: Schema, marks: dict[str, str]) -> int:
        if schema.name not in self._schemas:
            schema.id = len(self._schemas) + 1
            self._schemas[schema.name] = schema
        if (schema.name, bool(marks)) not in self._described:  # chunks of either kind may come first
            self._described.add((schema.name, bool(marks)))
            chunk.add(record_bytes(self._schemas[schema.name]))
        channel = Channel(len(self._channels) + 1, topic, encoding, marks, self._schemas[schema.name].id)
        self._channels.append(channel)
        chunk.add(record_bytes(channel))
        return len(self._channels)

    def add_message(self, channel: int, sequence: int, log_time: int, publish_time: int, payload: bytes) -> None:
        """Queue a message; times in ns. The payload must not change before `flush`."""
        self._chunk.add_message(channel, sequence, log_time, publish_time, payload)
        self._counts[channel] += 1

    def add_shown(self, shown: Shown, log_time: int, publish_time: int) -> None:
        """Queue a message that only repeats others; times in ns."""
        if (key := (shown.topic, shown.name)) not in self._shown:
            schema = Schema(0, shown.schema, "protobuf", shown.name)
            self._shown[key] = self._add_channel(self._repeats, shown.topic, "protobuf", schema, {REPEATS: "true"})
        packed = self._repeats.packed
        self._repeats.add_message(self._shown[key], 0, log_time, publish_time, shown.payload)
        self._counts[self._shown[key]] += 1
        self.repeated += self._repeats.packed - packed + INDEX_ENTRY
        if self._repeats.size >= PACKED_BYTES:
            self._repeats = self._write_chunk(self._repeats)

    @property
    def pending(self) -> int:
        """Size of the chunk in progress [bytes]; `flush` is due at CHUNK_BYTES."""
        return self._chunk.size

    def add_metadata(self, name: str, data: dict[str, str]) -> None:
        offset = self._stream.tell()
        length = self._write(record_bytes(Metadata(name, data)))
        self._metadata_indexes.append(MetadataIndex(offset, length, name))

    def add_attachment(self, name: str, source: bytes | Path) -> None:
        """Attach bytes, or a file in pieces: a net's arrays would not fit a second time."""
        offset = self._stream.tell()
        # opcode, length | times, name, type | size of the data (here 0), checksum
        empty = record_bytes(Attachment(0, 0, name, BINARY, b""))
        size = len(source) if isinstance(source, bytes) else source.stat().st_size
        head = empty[9:-12] + struct.pack("<Q", size)
        self._write(empty[:1] + struct.pack("<Q", len(head) + size + 4) + head)
        crc, written = zlib.crc32(head), 0
        for piece in _pieces(source):
            self._write(piece)
            crc, written = zlib.crc32(piece, crc), written + len(piece)
        if written != size:
            raise OSError(f"{name} changed while it was read")
        self._write(struct.pack("<I", crc))
        length = self._stream.tell() - offset
        self._attachment_indexes.append(AttachmentIndex(offset, length, 0, 0, size, name, BINARY))

    def flush(self, last: bool = False) -> None:
        """Write the chunk in progress and its message indexes, and flush the stream; the first and the `last` time also
        write the messages that repeat others.
        """
        self._chunk = self._write_chunk(self._chunk)
        if last or not any(index.compression for index in self._chunk_indexes):
            self._repeats = self._write_chunk(self._repeats)
        self._stream.flush()

    def _write_chunk(self, chunk: _OpenChunk) -> _OpenChunk:
        """Write a chunk with messages and its message indexes; return the next one of its kind."""
        if not chunk.places:
            return chunk
        chunk.close()
        size, kind, offset = chunk.packed, "zstd" if chunk.packer else "", self._stream.tell()
        length = _CHUNK.size - _RECORD_HEAD + len(kind) + 8 + size
        head = _CHUNK.pack(Opcode.CHUNK, length, chunk.start, chunk.end, chunk.size, chunk.crc, len(kind))
        self._write(head, kind.encode(), size.to_bytes(8, "little"), *chunk.pieces)
        place = after = self._stream.tell()
        index_places: dict[int, int] = {}
        for channel, places in chunk.places.items():
            index_places[channel] = place
            place += self._write(record_bytes(MessageIndex(channel, places)))
        length, ends = after - offset, (chunk.end, place - after)
        self._chunk_indexes.append(ChunkIndex(length, offset, kind, size, *ends, index_places, chunk.start, chunk.size))
        return _OpenChunk(_packer() if kind else None)

    def finish(self) -> None:
        """Write the last chunk, the summary and the footer."""
        self.flush(last=True)
        self._stream.write(record_bytes(DataEnd(self._crc)))
        start = self._stream.tell()
        groups: list[tuple[Opcode, list[McapRecord]]] = [
            (Opcode.SCHEMA, list(self._schemas.values())),
            (Opcode.CHANNEL, list(self._channels)),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, list(self._chunk_indexes)),
            (Opcode.ATTACHMENT_INDEX, self._attachment_indexes),
            (Opcode.METADATA_INDEX, self._metadata_indexes),
        ]
        summary, offsets = b"", b""
        for opcode, records in groups:
            data = b"".join(map(record_bytes, records))
            if data:
                offsets += record_bytes(SummaryOffset(opcode, start + len(summary), len(data)))
            summary += data
        footer = record_bytes(Footer(start, start + len(summary), 0))[:-4]
        crc = zlib.crc32(summary + offsets + footer)
        self._stream.write(summary + offsets + footer + struct.pack("<I", crc) + MAGIC)
        self._stream.flush()

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachment_indexes),
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=len(self._chunk_indexes),
            message_count=sum(self._counts.values()),
            message_end_time=max((chunk.message_end_time for chunk in self._chunk_indexes), default=0),
            message_start_time=min((chunk.message_start_time for chunk in self._chunk_indexes), default=0),
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._schemas),
        )


def _pieces(source: bytes | Path) -> Iterator[bytes]:
    if isinstance(source, bytes):
        yield source
        return
    with source.open("rb") as stream:
        while piece := stream.read(1 << 20):
            yield piece


# Layout of a recording, from a scan of the whole file.
#
# Records are the mcap library's. No length in the file is trusted before it is compared with the file's size, and no
# chunk before its checksum matches: the library returns cut records silently, and unpacks a chunk to any size.
# Rejected: the index alone, which needs less reading; but only a full read shows that the file is whole. It serves for
# lists of many recordings, which vouch for none: it takes as long for any size of file.

UNPACKED_PIECE = 1 << 20
"""Bytes that are unpacked in one read."""
MOST_TOPICS, PRIVATE = 1000, 0x80
FREE, PACKED = 1 << 24, 200
"""A file may unpack to FREE bytes plus PACKED times its size: moving cloth packs to a half, cloth at rest to 1%."""
_RECORD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<HIQQ")

OTHER_RECORDS = (Header, Schema, Channel, Message, MessageIndex, DataEnd, NoneType)
"""Other allowed records in the data; private ones of other programs begin at PRIVATE."""


class Damaged(Exception):
    """The file has invalid bytes; this error is internal to the package."""


class _Absent(Damaged):
    """The end of the file is missing."""


@dataclass
class Layout:
    """The table of contents of a recording; attachments are the positions of their records in the file."""

    size: int
    """Size of the file [bytes]."""
    indexed: bool
    """Whether the file is whole: it was finished, and all checksums match."""
    readable: int
    """Bytes up to the end of the last whole record."""
    damage: str = ""
    """The damage and its place in words; empty for a file that is whole, or only cut."""
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    attachments: dict[str, int] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    unpacked: int = 0
    """Unpacked size of all chunks, as they declare it [bytes]."""


def read_layout(stream: BinaryIO, path: Path) -> Layout:
    """Read the layout of an open file, up to the first record that is cut or damaged. The checksum of an attached file
    is checked only when that is read: its damage hides no message.

    Raises BadInput where the file is no recording, and for messages without chunks, whose damage would not show.
    """
    size = stream.seek(0, io.SEEK_END)
    stream.seek(0)
    if stream.read(len(MAGIC)) != MAGIC:
        remedy = "recordings are written by nuno run --record FILE"
        raise BadInput("not an MCAP file", str(path), limit=f"{size} bytes, of another kind", remedy=remedy)
    layout, record = Layout(size, indexed=False, readable=len(MAGIC)), None
    try:
        while not isinstance(record, DataEnd):
            at = layout.readable
            record, end = read_record(stream, at, size, whole=False)
            if isinstance(record, Chunk):
                layout.unpacked += record.uncompressed_size if record.compression else len(record.data)
                _check_limits(layout, path)
                _add_chunk(layout, record, at, end)
            elif isinstance(record, Metadata):
                layout.metadata[record.name] = record.metadata
            elif isinstance(record, Attachment):
                layout.attachments[record.name] = at
            elif isinstance(record, Message) and not layout.chunks:
                problem, remedy = "its messages stand outside of chunks", "write it with chunks"
                raise BadInput(problem, str(path), limit=f"{size} bytes", remedy=remedy)
            elif not isinstance(record, OTHER_RECORDS):
                raise Damaged(f"no record of data at byte {at:,}")
            layout.readable = end
        _check_end(stream, record, at, size)
        layout.indexed = True
    except Damaged as error:
        ends = size > FOOTER_SIZE and _read_at(stream, size - len(MAGIC), len(MAGIC), size) == MAGIC
        if ends or not isinstance(error, _Absent):
            place = "beside its messages" if isinstance(record, DataEnd) else f"at byte {layout.readable:,} of {size:,}"
            layout.damage = f"damaged {place} ({error})"
    return _check_limits(layout, path)


def read_index(stream: BinaryIO) -> Layout:
    """Read the layout of an open file from its index, without attachments and counts. Raises Damaged where it has none,
    or the index does not match its checksum.
    """
    size = stream.seek(0, io.SEEK_END)
    at = size - FOOTER_SIZE - len(MAGIC)
    footer, end = read_record(stream, at, size)
    if not isinstance(footer, Footer) or not footer.summary_start:
        raise Damaged("no index")
    index = _read_at(stream, footer.summary_start, end - 4 - footer.summary_start, size)
    if footer.summary_crc != zlib.crc32(index):
        raise Damaged("the index's checksum does not match")
    with _damage():
        stream.seek(0)
        reader = SeekingReader(stream, record_size_limit=size)
        chunks = (reader.get_summary() or Summary()).chunk_indexes
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    return Layout(size, indexed=True, readable=size, chunks=chunks, metadata=metadata)


def _check_limits(layout: Layout, path: Path) -> Layout:
    """Return the layout. Raises BadInput for one that would take far more time and memory than a file of its size."""
    limits = {
        "topics": (len(layout.channels), MOST_TOPICS),
        "bytes, unpacked": (layout.unpacked, FREE + PACKED * layout.size),
    }
    for noun, (number, most) in limits.items():
        if number > most:
            problem, remedy = (f"the recording holds {number:,} {noun}", "record its scene again: no run records that")
            limit = f"{most:,}, of a file of {layout.size:,} bytes"
            raise BadInput(problem, str(path), limit=limit, remedy=remedy)
    return layout


def read_record(stream: BinaryIO, at: int, size: int, whole: bool = True) -> tuple[McapRecord | None, int]:
    """Read the record at a byte of a file, None for an unknown kind; return it and its end. Raises Damaged; the
    checksum of an attached file is checked only if `whole`.
    """
    head = _read_at(stream, at, _RECORD.size, size)
    opcode, length = _RECORD.unpack(head)
    known = opcode in Opcode.__members__.values()
    if not known and opcode < PRIVATE:  # a system that lost power leaves zeros
        raise Damaged(f"no record at byte {at}")
    body = _read_at(stream, at + _RECORD.size, length, size)
    if not known:
        return None, at + _RECORD.size + length
    with _damage():
        record = next(StreamReader(io.BytesIO(head + body), skip_magic=True, emit_chunks=True).records)
    data = memoryview(body)
    if whole and isinstance(record, Attachment) and not _fits(int.from_bytes(data[-4:], "little"), data[:-4]):
        raise Damaged(f"the checksum of the file {record.name} in it does not fit")
    return record, at + _RECORD.size + length


def read_messages(stream: BinaryIO, chunk: ChunkIndex, size: int) -> list[Message]:
    """Read the messages of a chunk, in order. Raises Damaged."""
    record, _ = read_record(stream, chunk.chunk_start_offset, size)
    if not isinstance(record, Chunk):
        raise Damaged(f"no chunk at byte {chunk.chunk_start_offset}")
    return [item for item in _records_of(record) if isinstance(item, Message)]


def _read_at(stream: BinaryIO, at: int, length: int, size: int) -> bytes:
    """Read a piece of a file. Raises Damaged where it is not within the file."""
    if at < 0 or length < 0 or at + length > size:
        raise _Absent(f"{length:,} bytes are to stand at byte {at:,}")
    stream.seek(at)
    return stream.read(length)


@contextmanager
def _damage() -> Iterator[None]:
    """Raise any error of the libraries about invalid bytes as Damaged."""
    try:
        yield
    except Damaged:
        raise
    except Exception as error:
        raise Damaged(f"{type(error).__name__}: {error}") from None


def _fits(crc: int, data: bytes | memoryview) -> bool:
    """Return whether a checksum matches data. In the format, 0 is no checksum: other programs may write none."""
    return crc in (0, zlib.crc32(data))


def _check_end(stream: BinaryIO, data_end: DataEnd, at: int, size: int) -> None:
    """Raise Damaged where the data before their end, at byte `at`, or the index after it, do not match their checksums,
    and _Absent where the file is cut after its data. The index itself is not needed.
    """
    crc = 0
    for piece in range(0, at if data_end.data_section_crc else 0, UNPACKED_PIECE):
        crc = zlib.crc32(_read_at(stream, piece, min(UNPACKED_PIECE, at - piece), size), crc)
    begin = end = at + _RECORD.size + 4
    record: McapRecord | None = None
    while not isinstance(record, Footer):
        record, end = read_record(stream, end, size)
    index = _read_at(stream, begin, end - 4 - begin, size)
    if crc != data_end.data_section_crc or not _fits(record.summary_crc, index):
        raise Damaged("a checksum of all data, or of the index, does not fit")
    if _read_at(stream, end, len(MAGIC), size) != MAGIC:
        raise Damaged("other bytes where its end is marked")
    if left := size - end - len(MAGIC):
        raise Damaged(f"{left:,} bytes follow its end")


def _add_chunk(layout: Layout, chunk: Chunk, at: int, end: int) -> None:
    counts: Counter[int] = Counter()
    size = chunk.uncompressed_size
    if not size:  # zeros, as a disk leaves them
        raise Damaged("a chunk without messages")
    for record in _records_of(chunk):
        if isinstance(record, Message):
            counts[record.channel_id] += 1
        else:
            layout.channels[record.id] = record
    layout.counts += counts
    channels, (start, stop) = dict.fromkeys(counts, 0), (chunk.message_start_time, chunk.message_end_time)
    index = ChunkIndex(end - at, at, chunk.compression, len(chunk.data), stop, 0, channels, start, size)
    layout.chunks.append(index)


def _records_of(chunk: Chunk) -> Iterator[Message | Channel]:
    """Yield a chunk's messages and channels, if its checksum matches. Raises Damaged.

    The library's reader loops forever on zeros, and copies each message twice.
    """
    with _damage():
        data = _unpack(chunk) if chunk.compression else chunk.data
        if len(data) != chunk.uncompressed_size:
            raise Damaged(f"a chunk holds {len(data)} bytes, not {chunk.uncompressed_size}")
        if not _fits(chunk.uncompressed_crc, data):
            raise Damaged("the checksum of a chunk does not fit its bytes")
        at = 0
        while at < len(data):
            opcode, length = _RECORD.unpack_from(data, at)
            start, at = at + _RECORD.size, at + _RECORD.size + length
            if opcode == 0 or at > len(data):
                raise Damaged(f"a chunk holds a record of kind {opcode} and {length} bytes")
            if opcode == Opcode.CHANNEL:
                yield Channel.read(ReadDataStream(io.BytesIO(data[start:at])))
            elif opcode == Opcode.MESSAGE:
                channel, sequence, log_time, publish_time = _MESSAGE_HEAD.unpack_from(data, start)
                if not chunk.message_start_time <= log_time <= chunk.message_end_time or log_time >= LATEST:
                    raise Damaged(f"a message of time {log_time} ns in a chunk of others, or too late for any format")
                yield Message(channel, log_time, data[start + _MESSAGE_HEAD.size : at], publish_time, sequence)


def _unpack(chunk: Chunk) -> bytes:
    """Unpack a chunk, at most to its declared size and one piece more. Raises Damaged, and the libraries' errors."""
    opened: Callable[[io.BytesIO], BinaryIO]
    if chunk.uncompressed_size > psutil.virtual_memory().available:
        raise Damaged(f"a chunk would unpack to {chunk.uncompressed_size} bytes, more than the memory that is free")
    # Names of the format: https://mcap.dev/spec/registry.
    if chunk.compression == "lz4":
        import lz4.frame

        opened = lz4.frame.open
    elif chunk.compression == "zstd":
        import zstandard

        opened = cast(Callable[[io.BytesIO], BinaryIO], zstandard.open)
    else:
        raise Damaged(f"{chunk.compression!r} is none of lz4 and zstd")
    unpacked = bytearray()
    with opened(io.BytesIO(chunk.data)) as stream:
        while len(unpacked) <= chunk.uncompressed_size and (piece := stream.read(UNPACKED_PIECE)):
            unpacked += piece
    return bytes(unpacked)
