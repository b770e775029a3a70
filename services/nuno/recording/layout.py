"""Where everything stands in a recording: from the index of a finished file, else by a scan.

No length in the file is believed before it is compared with the file's size, and no chunk
before its checksum fits.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections import Counter, defaultdict
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

from nuno.recording.chunks import Damaged, channel_of, chunk_records, chunk_times, fits, records
from nuno.recording.mcap_file import MAGIC, MESSAGE_HEAD
from nuno_schemas.errors import BadInput

T = TypeVar("T")
FOOTER_BYTES = 29
_RECORD = struct.Struct("<BQ")


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
        return _from_scan(stream, size, path)


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


def _from_index(stream: BinaryIO, size: int) -> Layout:
    tail_size = FOOTER_BYTES + len(MAGIC)
    tail = read_at(stream, Place(size - tail_size, tail_size), size)
    if tail[:9] != _RECORD.pack(Opcode.FOOTER, FOOTER_BYTES - 9) or not tail.endswith(MAGIC):
        raise Damaged("no footer")
    footer = parse(Footer.read, tail[9:])
    summary = read_at(stream, Place(footer.summary_start, size - tail_size - footer.summary_start), size)
    if not fits(footer.summary_crc, tail[: FOOTER_BYTES - 4], zlib.crc32(summary)):
        raise Damaged("the index's checksum does not fit")
    layout, found = Layout(size, indexed=True, readable=size), Counter[int]()
    told: Statistics | None = None
    for opcode, _, body in records(memoryview(summary)):
        found[opcode] += 1
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
            told = parse(Statistics.read, body)
            layout.counts = told.channel_message_counts
        else:
            _add_channel(layout, opcode, body)
    # Other programs may leave out any part of an index; what is not in it is to be found all the same.
    whole = told is not None and (told.chunk_count, told.attachment_count, told.metadata_count) == (
        found[Opcode.CHUNK_INDEX], found[Opcode.ATTACHMENT_INDEX], found[Opcode.METADATA_INDEX]
    )  # fmt: skip
    if not whole or not all(chunk.channels for chunk in layout.chunks) or (layout.counts and not layout.chunks):
        raise Damaged("the index leaves something out")
    return layout


def _from_scan(stream: BinaryIO, size: int, path: Path) -> Layout:
    """Everything up to the first record that is cut or damaged: what a killed writer left.

    Raises BadInput for messages without chunks: nothing would tell damaged ones from others.
    """
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
            elif opcode == Opcode.MESSAGE and not layout.chunks:
                problem, remedy = "its messages stand outside of chunks", "write it with chunks"
                raise BadInput(problem, str(path), limit=f"{size} bytes", remedy=remedy)
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
            found[channel_of(record)] += 1
        else:
            _add_channel(layout, opcode, record)
    layout.chunks.append(ChunkPlace(place.offset, place.length, *chunk_times(body), frozenset(found)))
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
    if len(body) < 4 or not fits(struct.unpack("<I", body[-4:])[0], memoryview(body)[:-4]):
        raise Damaged("an attachment's checksum does not fit")

    record = parse(Attachment.read, body)
    return str(record.name), bytes(record.data)
