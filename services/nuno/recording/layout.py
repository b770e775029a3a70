"""Where everything stands in a recording: from the index of a finished file, else by a scan.

No length in the file is believed before it is compared with the file's size, and no chunk
before its checksum fits.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Footer,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from nuno.recording.mcap_file import CHUNK_HEAD, MAGIC, MESSAGE_HEAD
from nuno_schemas.errors import BadInput

T = TypeVar("T")
FOOTER_BYTES = 29
_RECORD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQIIQ")
_MESSAGE = struct.Struct("<HIQQ")


class Damaged(Exception):
    """Bytes that are not what they should be; never leaves this package."""


@dataclass(frozen=True)
class Place:
    """A record's body in the file."""

    offset: int
    length: int


@dataclass(frozen=True)
class ChunkPlace(Place):
    """A chunk's body, its log times [ns] and the channels it holds."""

    start: int
    end: int
    channels: frozenset[int]


@dataclass
class Layout:
    """The table of contents of a recording."""

    size: int
    """Bytes of the file."""
    indexed: bool
    """Finished, with an index whose checksum fits; else found by scanning."""
    readable: int
    """Bytes up to the end of the last whole record."""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkPlace] = field(default_factory=list)
    attachments: dict[str, Place] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=lambda: defaultdict(int))


@dataclass(frozen=True)
class RawMessage:
    """A message of a chunk: the payload is a view into it."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    payload: memoryview


def read_layout(stream: BinaryIO, path: Path) -> Layout:
    """The layout of an open file. Raises BadInput where it is no recording at all."""
    size = stream.seek(0, io.SEEK_END)
    stream.seek(0)
    if stream.read(len(MAGIC)) != MAGIC:
        remedy = "recordings are written by nuno run --record FILE"
        raise BadInput("not an MCAP file", str(path), limit=f"{size} bytes, of another kind", remedy=remedy)
    try:
        return _from_index(stream, size)
    except Damaged:
        return _from_scan(stream, size)


def read_at(stream: BinaryIO, place: Place, size: int) -> bytes:
    """A record's body. Raises Damaged where it does not lie in the file."""
    if place.offset < 0 or place.length < 0 or place.offset + place.length > size:
        raise Damaged(f"{place.length} bytes at byte {place.offset} of {size}")
    stream.seek(place.offset)
    data = stream.read(place.length)
    if len(data) != place.length:
        raise Damaged(f"{len(data)} of {place.length} bytes at byte {place.offset}")
    return data


def parse(read: Callable[[ReadDataStream], T], body: bytes | memoryview) -> T:
    """A small record by the library's reader. Raises Damaged."""
    try:
        return read(ReadDataStream(io.BytesIO(body)))
    except (McapError, struct.error, ValueError, OverflowError, LookupError, MemoryError) as error:
        raise Damaged(str(error)) from None


def records(data: memoryview) -> Iterator[tuple[int, int, memoryview]]:
    """Opcode, offset and body of each record in a piece of a file. Raises Damaged."""
    at = 0
    while at < len(data):
        if at + _RECORD.size > len(data):
            raise Damaged("a record is cut")
        opcode, length = _RECORD.unpack_from(data, at)
        body = at + _RECORD.size
        if body + length > len(data):
            raise Damaged(f"a record of {length} bytes in {len(data) - body}")
        yield opcode, body, data[body : body + length]
        at = body + length


def chunk_records(body: bytes) -> memoryview:
    """The records of a chunk's body, whose checksum fits. Raises Damaged."""
    if len(body) < CHUNK_HEAD:
        raise Damaged("a chunk is cut")
    _, _, size, crc, compression, length = _CHUNK.unpack_from(body)
    if compression or size != length or CHUNK_HEAD + length != len(body):
        raise Damaged("a chunk is compressed or has the wrong length")
    data = memoryview(body)[CHUNK_HEAD:]
    if zlib.crc32(data) != crc:
        raise Damaged("a chunk's checksum does not fit")
    return data


def chunk_messages(body: bytes, channels: frozenset[int]) -> Iterator[RawMessage]:
    """The messages of some channels in a chunk's body, in order. Raises Damaged."""
    for opcode, _, record in records(chunk_records(body)):
        if opcode == Opcode.MESSAGE and len(record) >= MESSAGE_HEAD:
            channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(record)
            if channel in channels:
                yield RawMessage(channel, sequence, log_time, publish_time, record[MESSAGE_HEAD:])


def _from_index(stream: BinaryIO, size: int) -> Layout:
    tail_size = FOOTER_BYTES + len(MAGIC)
    tail = read_at(stream, Place(size - tail_size, tail_size), size)
    if tail[:9] != _RECORD.pack(Opcode.FOOTER, FOOTER_BYTES - 9) or not tail.endswith(MAGIC):
        raise Damaged("no footer")
    footer = parse(Footer.read, tail[9:])
    summary = read_at(stream, Place(footer.summary_start, size - tail_size - footer.summary_start), size)
    if zlib.crc32(tail[: FOOTER_BYTES - 4], zlib.crc32(summary)) != footer.summary_crc:
        raise Damaged("the index's checksum does not fit")
    layout = Layout(size, indexed=True, readable=size)
    for opcode, _, body in records(memoryview(summary)):
        if opcode == Opcode.CHUNK_INDEX:
            index = parse(ChunkIndex.read, body)
            place = index.chunk_start_offset + 9, index.chunk_length - 9
            times = index.message_start_time, index.message_end_time
            layout.chunks.append(ChunkPlace(*place, *times, frozenset(index.message_index_offsets)))
        elif opcode == Opcode.ATTACHMENT_INDEX:
            entry = parse(AttachmentIndex.read, body)
            layout.attachments[entry.name] = Place(entry.offset + 9, entry.length - 9)
        elif opcode == Opcode.METADATA_INDEX:
            item = parse(MetadataIndex.read, body)
            _add_metadata(layout, read_at(stream, Place(item.offset + 9, item.length - 9), size))
        elif opcode == Opcode.STATISTICS:
            layout.counts = parse(Statistics.read, body).channel_message_counts
        else:
            _add_channel(layout, opcode, body)
    return layout


def _from_scan(stream: BinaryIO, size: int) -> Layout:
    """Everything up to the first record that is cut or damaged: what a killed writer left."""
    layout = Layout(size, indexed=False, readable=len(MAGIC))
    try:
        for opcode, place in _each_record(stream, size):
            if opcode == Opcode.CHUNK:
                _add_chunk(layout, place, read_at(stream, place, size))
            elif opcode == Opcode.METADATA:
                _add_metadata(layout, read_at(stream, place, size))
            elif opcode == Opcode.ATTACHMENT:
                layout.attachments[attachment(read_at(stream, place, size))[0]] = place
            elif opcode == Opcode.DATA_END:
                break
            layout.readable = place.offset + place.length
    except Damaged:
        pass
    return layout


def _each_record(stream: BinaryIO, size: int) -> Iterator[tuple[int, Place]]:
    """Opcode and body of each whole record. An open chunk of length 2^64 - 1 ends the file."""
    at = len(MAGIC)
    while at + _RECORD.size <= size:
        opcode, length = _RECORD.unpack(read_at(stream, Place(at, _RECORD.size), size))
        at += _RECORD.size
        # Opcode 0 is no record: a system that lost power leaves zeros.
        if opcode == 0 or at + length > size:
            return
        yield opcode, Place(at, length)
        at += length


def _add_chunk(layout: Layout, place: Place, body: bytes) -> None:
    found: dict[int, int] = defaultdict(int)
    for opcode, _, record in records(chunk_records(body)):
        if opcode == Opcode.MESSAGE and len(record) >= MESSAGE_HEAD:
            found[_MESSAGE.unpack_from(record)[0]] += 1
        else:
            _add_channel(layout, opcode, record)
    start, end = _CHUNK.unpack_from(body)[:2]
    layout.chunks.append(ChunkPlace(place.offset, place.length, start, end, frozenset(found)))
    for channel, number in found.items():
        layout.counts[channel] += number


def _add_channel(layout: Layout, opcode: int, body: memoryview) -> None:
    if opcode == Opcode.SCHEMA:
        schema = parse(Schema.read, body)
        layout.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = parse(Channel.read, body)
        layout.channels[channel.id] = channel


def _add_metadata(layout: Layout, body: bytes) -> None:
    record = parse(Metadata.read, body)
    layout.metadata[record.name] = record.metadata


def attachment(body: bytes) -> tuple[str, bytes]:
    """Name and bytes of an attachment's body, whose checksum fits. Raises Damaged."""
    if len(body) < 4 or zlib.crc32(memoryview(body)[:-4]) != struct.unpack("<I", body[-4:])[0]:
        raise Damaged("an attachment's checksum does not fit")

    record = parse(Attachment.read, body)
    return str(record.name), bytes(record.data)
