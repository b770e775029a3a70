"""Chunks of a recording: their records, as they are or compressed, and the messages among them."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO, cast

import psutil
from mcap.opcode import Opcode

from nuno.recording.mcap_file import CHUNK_HEAD, MESSAGE_HEAD

PIECE = 1 << 20
"""Bytes that are unpacked at once."""
_RECORD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")
_LENGTH = struct.Struct("<Q")
_MESSAGE = struct.Struct("<HIQQ")


class Damaged(Exception):
    """Bytes that are not what they should be; never leaves this package."""


@dataclass(frozen=True)
class RawMessage:
    """A message of a chunk: the payload is a view into it."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    payload: memoryview


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


def fits(crc: int, data: bytes | memoryview, before: int = 0) -> bool:
    """Whether a checksum is that of data that comes after data of checksum `before`. By the format, 0 stands for none:
    what other programs write may have none.
    """
    return crc in (0, zlib.crc32(data, before))


def chunk_times(body: bytes) -> tuple[int, int]:
    """First and last log time [ns] of a chunk's body."""
    start, end = struct.unpack_from("<QQ", body)
    return start, end


def chunk_records(body: bytes) -> memoryview:
    """The records of a chunk's body, whose checksum fits. Raises Damaged."""
    if len(body) < CHUNK_HEAD:
        raise Damaged("a chunk is cut")
    _, _, size, crc, named = _CHUNK.unpack_from(body)
    at = _CHUNK.size + named
    name = bytes(body[_CHUNK.size : at])
    if at + _LENGTH.size > len(body) or at + _LENGTH.size + _LENGTH.unpack_from(body, at)[0] != len(body):
        raise Damaged("a chunk has the wrong length")
    data = memoryview(body)[at + _LENGTH.size :]
    if name:
        data = _unpack(name.decode(errors="replace"), data, size)
    if len(data) != size:
        raise Damaged(f"a chunk holds {len(data)} bytes of {size}")
    if not fits(crc, data):
        raise Damaged("a chunk's checksum does not fit")
    return data


def _unpack(compression: str, data: memoryview, size: int) -> memoryview:
    """At most `size` bytes and a piece, whatever the data would unpack to. Raises Damaged."""
    if size > psutil.virtual_memory().available:
        raise Damaged(f"a chunk would unpack to {size} bytes, more than the memory that is free")
    unpacked = bytearray()
    try:
        with _opened(compression, io.BytesIO(data)) as stream:
            while len(unpacked) <= size and (piece := stream.read(PIECE)):
                unpacked += piece
    except Exception as error:  # each of the libraries has errors of its own, and lz4 none but RuntimeError
        raise Damaged(f"a chunk cannot be unpacked: {error}") from None
    return memoryview(unpacked)


def _opened(compression: str, packed: io.BytesIO) -> BinaryIO:
    """What unpacks a stream as the format names it: https://mcap.dev/spec/registry. Raises Damaged."""
    if compression == "lz4":
        import lz4.frame

        return cast(BinaryIO, lz4.frame.open(packed))
    if compression == "zstd":
        import zstandard

        return cast(BinaryIO, zstandard.open(packed))
    raise Damaged(f"{compression!r} is none of lz4 and zstd")


def chunk_messages(body: bytes, channels: frozenset[int]) -> Iterator[RawMessage]:
    """The messages of some channels in a chunk's body, in order. Raises Damaged."""
    for opcode, _, record in records(chunk_records(body)):
        if opcode == Opcode.MESSAGE and len(record) >= MESSAGE_HEAD:
            channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(record)
            if channel in channels:
                yield RawMessage(channel, sequence, log_time, publish_time, record[MESSAGE_HEAD:])


def channel_of(message: memoryview) -> int:
    """The channel of a message record's body."""
    return int(_MESSAGE.unpack_from(message)[0])
