"""Changes to what stands inside containers, whose lengths and checksums are then made to fit again.

Bytes changed at random in a PNG, a zip archive or an MCAP file would be found by the checksum and reach no reader.
"""

from __future__ import annotations

import io
import re
import struct
import zipfile
import zlib
from random import Random
from typing import TypeVar

from nuno_bench.soak.fuzz.mutate_text import mutate_bytes, mutate_text

Part = TypeVar("Part")

PNG = b"\x89PNG\r\n\x1a\n"
MCAP = b"\x89MCAP0\r\n"
CHUNK, DATA_END, FOOTER = 6, 15, 2
BIG = (0, 1, 2**16, 2**31 - 1, 2**31, 2**32 - 1)
OBJECT = b"cos\nsystem\n(S'exit 1'\ntR."
"""A pickle that would run a command if it were ever read."""
BOMB = 60_000_000
"""Zeros that take 60 kB when they are packed."""


def mutate_png(data: bytes, random: Random) -> bytes:
    """A change to one chunk, or to which chunks there are."""
    chunks = list(_png_chunks(data))
    if not chunks or random.random() < 0.15:
        return mutate_bytes(data, random)
    _change_chunk(chunks, random)
    return PNG + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in chunks
    )


def _change_chunk(chunks: list[tuple[bytes, bytes]], random: Random) -> None:
    place = random.randrange(len(chunks))
    kind, body = chunks[place]
    how = random.randrange(6)
    if how < 2:
        _double_or_drop(chunks, place, how == 0, random)
    elif kind == b"IHDR" and len(body) == 13:
        fields = list(struct.unpack(">IIBBBBB", body))
        fields[how % 2] = random.choice((*BIG, 4, 8)) if how < 4 else fields[how % 2]
        fields[2 + random.randrange(5)] = random.choice((0, 1, 2, 3, 4, 6, 8, 16, 255))
        chunks[place] = kind, struct.pack(">IIBBBBB", *fields)
    elif kind == b"IDAT" and how < 5:
        chunks[place] = kind, zlib.compress(_bomb(random) or mutate_bytes(_unpacked(body), random), 1)
    elif how == 5:
        extra = random.choice((b"tRNS", b"PLTE", b"gAMA", b"zTXt", b"iTXt", b"acTL", b"eXIf", b"iCCP", b"IDAT"))
        packed = b"a\0\0" + zlib.compress(_bomb(random) or random.randbytes(9))
        chunks.insert(place, (extra, random.choice((packed, random.randbytes(random.randrange(70))))))
    else:
        chunks[place] = kind, mutate_bytes(body, random)


def _double_or_drop(parts: list[Part], place: int, double: bool, random: Random) -> None:
    """Put one part in once more anywhere, or take it out."""
    if double:
        parts.insert(random.randrange(len(parts) + 1), parts[place])
    else:
        del parts[place]


def _png_chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    found: list[tuple[bytes, bytes]] = []
    at = len(PNG)
    while at + 12 <= len(data) and len(found) < 100:
        length = struct.unpack_from(">I", data, at)[0]
        found.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    return found


def _bomb(random: Random) -> bytes:
    return bytes(BOMB) if random.random() < 0.002 else b""


def _unpacked(body: bytes) -> bytes:
    try:
        return zlib.decompressobj().decompress(body, 100_000)
    except zlib.error:
        return body


def mutate_npz(data: bytes, random: Random) -> bytes:
    """A change to an array's header or values, or to which arrays there are."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            parts = [(item.filename, archive.read(item)[:100_000]) for item in archive.infolist()[:40]]
    except Exception:
        return mutate_bytes(data, random)
    if not parts or random.random() < 0.15:
        return mutate_bytes(data, random)
    place = random.randrange(len(parts))
    name, body = parts[place]
    how = random.randrange(8)
    if how == 0:
        parts.append((random.choice((name, "x.npy", "other", "../a.npy", "/x.npy", "x")), body))
    elif how == 1:
        del parts[place]
    elif how == 2:
        parts[place] = name, random.choice(parts)[1]
    elif how == 3:
        parts[place] = name, _bomb(random) or mutate_bytes(body, random)
    else:
        parts[place] = name, _header_changed(body, random)
    stream = io.BytesIO()
    packing = random.choice((zipfile.ZIP_STORED, zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2))
    with zipfile.ZipFile(stream, "w", packing) as archive:
        for name, body in parts:
            info = zipfile.ZipInfo(name or "x")
            archive.writestr(info, body, packing)
    found = stream.getvalue()
    return mutate_bytes(found, random) if random.random() < 0.1 else found


def _header_changed(body: bytes, random: Random) -> bytes:
    """Another dtype, order or shape in the header of a .npy, its length made to fit."""
    if len(body) < 12 or body[:6] != b"\x93NUMPY":
        return mutate_bytes(body, random)
    length = struct.unpack_from("<H", body, 8)[0]
    head, values = body[10 : 10 + length].decode("latin-1"), body[10 + length :]
    how = random.randrange(6)
    if how == 0:
        kinds = ("|O", ">f8", "<f4", "<f2", "<i8", "<u8", ">i4", "|b1", "<U4", "|V8", "<c16", "<M8[s]", "|S0", "<f16")
        head = re.sub(r"'descr': [^,]*,", f"'descr': {random.choice(kinds)!r},", head)
        values = OBJECT if "|O" in head else values
    elif how == 1:
        head = head.replace("False", "True")
    elif how == 2:
        head = re.sub(r"'shape': \(.*?\)", f"'shape': {_shape(random)}", head)
    elif how == 3:
        values = struct.pack("<d", random.choice((float("nan"), float("inf"), -1.0, 1e308, 0.0, 1e-320))) + values[8:]
    elif how == 4:
        values = struct.pack("<q", random.choice((-1, 2**31, 2**63 - 1, -(2**63), 3))) + values[8:]
    else:
        head = mutate_text(head.encode(), random).decode("latin-1")
    packed = head.rstrip().encode("utf-8", errors="replace")
    packed += b" " * (-(len(packed) + 11) % 64) + b"\n"
    return body[:8] + struct.pack("<H", len(packed) & 0xFFFF) + packed + values


def _shape(random: Random) -> str:
    one = ("0", "1", "2", "3", "4", "-1", "1000000000000", "2**40", "True", "1.5", str(2**63), str(2**70))
    return "(" + "".join(f"{random.choice(one)}, " for _ in range(random.choice((0, 1, 1, 2, 2, 3, 4, 40)))) + ")"


def mutate_mcap(data: bytes, random: Random) -> bytes:
    """A change to one record, in a chunk or outside; checksums and the footer are made to fit, or left out."""
    records = mcap_records(data[len(MCAP) :])
    if not records or random.random() < 0.1:
        return mutate_bytes(data, random)
    end = next((i for i, (code, _) in enumerate(records) if code == DATA_END), len(records))
    _change_record(records, random)
    body = MCAP + b"".join(mcap_record(code, content) for code, content in records[: end + 1] if code != FOOTER)
    summary = b"".join(mcap_record(code, content) for code, content in records[end + 1 :] if code != FOOTER)
    if random.random() < 0.3:
        return body
    footer = struct.pack("<BQQQ", FOOTER, 20, len(body) if summary else 0, 0)
    return body + summary + footer + struct.pack("<I", zlib.crc32(summary + footer)) + MCAP


def mcap_record(code: int, body: bytes) -> bytes:
    """A record's bytes."""
    return struct.pack("<BQ", code, len(body)) + body


def mcap_records(data: bytes) -> list[tuple[int, bytes]]:
    """Opcode and body of the records of a file, behind its magic, or of a chunk."""
    found: list[tuple[int, bytes]] = []
    at = 0
    while at + 9 <= len(data) and len(found) < 200:
        code, length = struct.unpack_from("<BQ", data, at)
        found.append((code, data[at + 9 : at + 9 + length]))
        at += 9 + length
    return found


def _change_record(records: list[tuple[int, bytes]], random: Random) -> None:
    place = random.randrange(len(records))
    code, body = records[place]
    how = random.randrange(8)
    if how < 2:
        _double_or_drop(records, place, how == 0, random)
    elif code == CHUNK and len(body) > 40:
        inside = mcap_records(body[40:])
        if inside:
            _change_record(inside, random)
        data = b"".join(mcap_record(*record) for record in inside)
        times = random.choice(
            (body[:16], body[:16], struct.pack("<QQ", *random.choices((0, 1, 2**63, 2**64 - 1), k=2)))
        )
        size, length = (random.choice((len(data),) * 9 + (0, 2**40, 2**63)) for _ in range(2))
        name = random.choice((b"",) * 9 + (b"zstd", b"lz4"))
        head = times + struct.pack("<QII", size, zlib.crc32(data), len(name)) + name + struct.pack("<Q", length)
        records[place] = code, head + data
    elif how < 5:
        records[place] = code, mutate_text(body, random, ("{", '"frame":', "null", "[]", "nuno", "../"))
    elif how == 5:
        records[place] = random.choice((code, 0, 1, 3, 4, 5, 8, 10, 11, 12, 255)), body
    else:
        records[place] = code, mutate_bytes(body, random)
