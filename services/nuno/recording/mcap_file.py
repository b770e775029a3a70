"""One indexed MCAP file, written without copying payloads.

Rejected: the mcap library's writer, which copies a message into its chunk and the chunk into a
record: it allocates twice a checkpoint's payload, where a tenth is allowed
(tests/services/test_recording.py, `test_payloads_are_not_copied`). Here a chunk is a list of
references to payloads until it is written; the small records are the library's own.
Chunks are not compressed: mantissas of moving vertices do not shrink, and the solver needs the
cores. Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

MAGIC = b"\x89MCAP0\r\n"
BINARY = "application/octet-stream"
CHUNK_BYTES = 4 * 2**20
LATEST = 2**32 * 10**9
"""Upper limit of times [ns]: the formats of recordings and exports have seconds in 32 bits."""
_MESSAGE = struct.Struct("<BQHIQQ")
_CHUNK = struct.Struct("<BQQQQIIQ")
_RECORD_HEAD = 9
"""Bytes of any record before its body: opcode and length."""


def record_bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


@dataclass
class _OpenChunk:
    """Records waiting to be written, by reference."""

    pieces: list[bytes] = field(default_factory=list)
    size: int = 0
    crc: int = 0
    start: int = 0
    end: int = 0
    places: dict[int, list[tuple[int, int]]] = field(default_factory=lambda: defaultdict(list))
    """(log time, offset in the chunk) of each message, by channel."""

    def add(self, piece: bytes) -> None:
        self.pieces.append(piece)
        self.size += len(piece)
        self.crc = zlib.crc32(piece, self.crc)

    def add_message(self, channel: int, sequence: int, log_time: int, publish_time: int, payload: bytes) -> None:
        self.start = min(self.start, log_time) if self.places else log_time
        self.end = max(self.end, log_time)
        self.places[channel].append((log_time, self.size))
        length = _MESSAGE.size - _RECORD_HEAD + len(payload)
        self.add(_MESSAGE.pack(Opcode.MESSAGE, length, channel, sequence, log_time, publish_time))
        self.add(payload)


class McapFile:
    """Writes MCAP to a seekable stream. Any method may raise the stream's OSError."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._chunk = _OpenChunk()
        self._schemas: dict[str, Schema] = {}
        self._channels: list[Channel] = []
        self._chunk_indexes: list[ChunkIndex] = []
        self._attachment_indexes: list[McapRecord] = []
        self._metadata_indexes: list[McapRecord] = []
        self._counts: dict[int, int] = defaultdict(int)
        self._crc = 0
        self._write(MAGIC, record_bytes(Header("nuno", "nuno")))

    def _write(self, *pieces: bytes) -> int:
        """Write bytes and add them to the checksum of all data; return their number."""
        for piece in pieces:
            self._crc = zlib.crc32(piece, self._crc)
        self._stream.writelines(pieces)
        return sum(map(len, pieces))

    def add_channel(self, topic: str, encoding: str, schema: str, schema_encoding: str, schema_data: bytes) -> int:
        """Add a channel and return its id; a schema is written once."""
        if schema not in self._schemas:
            self._schemas[schema] = Schema(len(self._schemas) + 1, schema_data, schema_encoding, schema)
            self._chunk.add(record_bytes(self._schemas[schema]))
        channel = Channel(len(self._channels) + 1, topic, encoding, {}, self._schemas[schema].id)
        self._channels.append(channel)
        self._chunk.add(record_bytes(channel))
        return len(self._channels)

    def add_message(self, channel: int, sequence: int, log_time: int, publish_time: int, payload: bytes) -> None:
        """Queue a message; times in ns. The payload must not change before `flush`."""
        self._chunk.add_message(channel, sequence, log_time, publish_time, payload)
        self._counts[channel] += 1

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

    def flush(self) -> None:
        """Write the chunk in progress and its message indexes, and flush the stream."""
        chunk, stream = self._chunk, self._stream
        if chunk.places:
            offset, size, times = stream.tell(), chunk.size, (chunk.start, chunk.end)
            length = _CHUNK.size - _RECORD_HEAD + size
            self._write(_CHUNK.pack(Opcode.CHUNK, length, *times, size, chunk.crc, 0, size), *chunk.pieces)
            place = after = stream.tell()
            index_places: dict[int, int] = {}
            for channel, places in chunk.places.items():
                index_places[channel] = place
                place += self._write(record_bytes(MessageIndex(channel, places)))
            length = after - offset
            index = ChunkIndex(length, offset, "", size, chunk.end, place - after, index_places, chunk.start, size)
            self._chunk_indexes.append(index)
            self._chunk = _OpenChunk()
        stream.flush()

    def finish(self) -> None:
        """Write the last chunk, the summary and the footer."""
        self.flush()
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
