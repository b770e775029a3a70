"""Changes to what stands inside containers, whose lengths and checksums are then made to fit again.

Bytes changed at random in a PNG, a zip archive or an MCAP file would be found by the checksum and reach no reader. So
each container is taken apart into named parts, a part is doubled, dropped, exchanged or changed in its own way, and
the parts are put together again.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from random import Random
from typing import Any

import numpy as np

from nuno.bus.encodings import decode_arrays, encode_arrays
from soak.fuzz.mutate import mutate_bytes, mutate_text

PNG = b"\x89PNG\r\n\x1a\n"
MCAP = b"\x89MCAP0\r\n"
CHUNK, DATA_END, FOOTER = 6, 15, 2
BIG = (0, 1, 2, 4, 8, 16, 2**16, 2**31 - 1, 2**31, 2**32 - 1)
OBJECT = b"cos\nsystem\n(S'exit 1'\ntR."
"""A pickle that would run a command if it were ever read."""
BOMB = 60_000_000
"""Zeros that take 60 kB when they are packed."""
KINDS = ("|O", ">f8", "<f4", "<f2", "<i8", "<u8", ">i4", "|b1", "<U4", "|V8", "<c16", "<M8[s]", "|S0", "<f16")
SHAPES = ("()", "(0,)", "(-1, 3)", "(2**40,)", "(True, 3)", "(1.5,)", f"({2**63},)", f"({2**70}, 3)",
          "(1000000000000, 3)", "(3, 2)", "(1, 1, 1, 2)", f"({'1, ' * 40})")  # fmt: skip
VALUES = (float("nan"), float("inf"), -1.0, 0.0, 1e308, 1e-320, 2.0**40, 1.0)

Parts = list[tuple[Any, bytes]]


@dataclass(frozen=True)
class Container:
    """How a file is taken apart and put together.

    split   parts of a file, each a name and bytes
    join    a file of parts
    change  a part's bytes in another way, given its name
    names   what a part may be called besides
    """

    split: Callable[[bytes], Parts]
    join: Callable[[Parts, Random], bytes]
    change: Callable[[Any, bytes, Random], bytes]
    names: tuple[Any, ...]

    def mutate(self, data: bytes, random: Random) -> bytes:
        """A change to one part, or to which parts there are; now and then to the file's bytes."""
        try:
            parts = self.split(data)
        except Exception:  # what was changed before need not be a container any more
            parts = []
        if not parts or random.random() < 0.12:
            return mutate_bytes(data, random)
        self.mutate_parts(parts, random)
        return self.join(parts, random)

    def mutate_parts(self, parts: Parts, random: Random) -> None:
        place, how = random.randrange(len(parts)), random.randrange(8)
        name, body = parts[place]
        if how == 0:
            parts.insert(random.randrange(len(parts) + 1), parts[place])
        elif how == 1:
            del parts[place]
        elif how == 2:
            parts[place] = random.choice((*self.names, random.choice(parts)[0])), body
        else:
            parts[place] = name, self.change(name, body, random)


def _bomb(random: Random) -> bytes:
    return bytes(BOMB) if random.random() < 0.002 else b""


def _png_split(data: bytes) -> Parts:
    found: Parts = []
    at = len(PNG)
    while at + 12 <= len(data) and len(found) < 100:
        length = struct.unpack_from(">I", data, at)[0]
        found.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    return found


def _png_join(parts: Parts, random: Random) -> bytes:
    packed = (struct.pack(">I", len(b)) + kind + b + struct.pack(">I", zlib.crc32(kind + b)) for kind, b in parts)
    return PNG + b"".join(packed)


def _png_change(kind: bytes, body: bytes, random: Random) -> bytes:
    if kind == b"IHDR" and len(body) == 13:
        fields = list(struct.unpack(">IIBBBBB", body))
        place = random.randrange(7)
        fields[place] = random.choice(BIG) & (0xFFFFFFFF if place < 2 else 0xFF)
        return struct.pack(">IIBBBBB", *fields)
    if kind == b"IDAT" and random.random() < 0.7:
        with contextlib.suppress(zlib.error):
            body = zlib.decompressobj().decompress(body, 100_000)
        return zlib.compress(_bomb(random) or mutate_bytes(body, random), 1)
    packed = b"a\0\0" + zlib.compress(_bomb(random) or random.randbytes(9))
    return random.choice((packed, random.randbytes(random.randrange(70)), mutate_bytes(body, random)))


def _zip_split(data: bytes) -> Parts:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return [(item.filename, archive.read(item)[:100_000]) for item in archive.infolist()[:40]]


def _zip_join(parts: Parts, random: Random) -> bytes:
    stream = io.BytesIO()
    packing = random.choice((zipfile.ZIP_STORED, zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2))
    with zipfile.ZipFile(stream, "w", packing) as archive:
        for name, body in parts:
            archive.writestr(zipfile.ZipInfo(name or "x"), body, packing)
    return stream.getvalue()


def _npy_change(name: str, body: bytes, random: Random) -> bytes:
    """Another dtype, order or shape in the header of a .npy, its length made to fit; or another first value."""
    how = random.randrange(6)
    if len(body) < 12 or body[:6] != b"\x93NUMPY" or how == 0:
        return _bomb(random) or mutate_bytes(body, random)
    length = struct.unpack_from("<H", body, 8)[0]
    head, values = body[10 : 10 + length].decode("latin-1"), body[10 + length :]
    if how == 1:
        head = re.sub(r"'descr': [^,]*,", f"'descr': {random.choice(KINDS)!r},", head)
        values = OBJECT if "|O" in head else values
    elif how == 2:
        head = re.sub(r"'shape': \(.*?\)", f"'shape': {random.choice(SHAPES)}", head)
    elif how == 3:
        values = struct.pack("<d", random.choice(VALUES)) + values[8:]
    elif how == 4:
        values = struct.pack("<q", random.choice((-1, 2**31, 2**63 - 1, -(2**63), 3))) + values[8:]
    else:
        head = mutate_text(head.encode(), random, ("True", "'", "(", "\n")).decode("utf-8", errors="replace")
    packed = head.rstrip().encode("utf-8", errors="replace")
    packed += b" " * (-(len(packed) + 11) % 64) + b"\n"
    return body[:8] + struct.pack("<H", len(packed) & 0xFFFF) + packed + values


def mcap_record(code: int, body: bytes) -> bytes:
    """A record's bytes."""
    return struct.pack("<BQ", code, len(body)) + body


def mcap_records(data: bytes) -> Parts:
    """Opcode and body of the records of a file, behind its magic, or of a chunk."""
    found: Parts = []
    at = 0
    while at + 9 <= len(data) and len(found) < 200:
        code, length = struct.unpack_from("<BQ", data, at)
        found.append((code, data[at + 9 : at + 9 + length]))
        at += 9 + length
    return found


def _mcap_join(records: Parts, random: Random) -> bytes:
    """Checksums and the footer are made to fit, or left out."""
    end = next((i for i, (code, _) in enumerate(records) if code == DATA_END), len(records))
    kept = [
        [mcap_record(*one) for one in some if one[0] != FOOTER] for some in (records[: end + 1], records[end + 1 :])
    ]
    body, summary = MCAP + b"".join(kept[0]), b"".join(kept[1])
    if random.random() < 0.3:
        return body
    footer = struct.pack("<BQQQ", FOOTER, 20, len(body) if summary else 0, 0)
    return body + summary + footer + struct.pack("<I", zlib.crc32(summary + footer)) + MCAP


def _mcap_change(code: int, body: bytes, random: Random) -> bytes:
    """Of a chunk one of its records, or what its head says of them."""
    if code != CHUNK or len(body) <= 40:
        return mutate_bytes(body, random) if random.random() < 0.4 else mutate_text(body, random, MCAP_WORDS)
    if inside := mcap_records(body[40:]):
        RECORDING.mutate_parts(inside, random)
    data = b"".join(mcap_record(*record) for record in inside)
    times = struct.pack("<QQ", *random.choices((0, 1, 2**63, 2**64 - 1), k=2)) if random.random() < 0.3 else body[:16]
    size, length = (random.choice((len(data),) * 9 + (0, 2**40, 2**63)) for _ in range(2))
    name = random.choice((b"",) * 9 + (b"zstd", b"lz4"))
    head = struct.pack("<QII", size, zlib.crc32(data), len(name)) + name + struct.pack("<Q", length)
    return times + head + data


MCAP_WORDS = ("{", '"frame":', "null", "[]", "nuno", "../")
IMAGE = Container(_png_split, _png_join, _png_change, (b"tRNS", b"PLTE", b"gAMA", b"zTXt", b"iTXt", b"acTL", b"eXIf"))
ARRAYS = Container(_zip_split, _zip_join, _npy_change, ("x.npy", "other", "../a.npy", "/x.npy", "x"))
RECORDING = Container(lambda data: mcap_records(data[len(MCAP) :]), _mcap_join, _mcap_change,
                      (0, 1, 3, 4, 5, 8, 10, 11, 12, 255))  # fmt: skip


def mutate_glb(data: bytes, random: Random) -> bytes:
    """The text of a glTF file, whose lengths are made to fit, or its bytes."""
    if data[:4] != b"glTF" or len(data) <= 20 or random.random() < 0.3:
        return mutate_bytes(data, random)
    length = struct.unpack_from("<I", data, 12)[0]
    text, rest = mutate_text(data[20 : 20 + length], random, GLTF_WORDS), data[20 + length :]
    text += b" " * (-len(text) % 4)
    return data[:8] + struct.pack("<II", 20 + len(text) + len(rest), len(text)) + b"JSON" + text + rest


GLTF_WORDS = (
    '"count":999999999999', '"byteOffset":-1', '"byteLength":1e12', '"sparse":{}', '"uri":"file:///etc/passwd"',
    '"mode":1', "null", "[]", "{}", "-1", '"children":[0]', '"matrix":[0]', '"scale":[0,0,0]', '"type":"VEC4"',
    '"componentType":5121',
)  # fmt: skip
JSON_WORDS = (
    "null", "true", "[]", "{}", "-1", "1e400", "NaN", "Infinity", '""', '"\\ud800"', '"frame":', '"t":', '"run":',
    '"action":"step"', '"action":"set"', '"action":"add"', '"frames":1e9', '"item":"solver.dt=1"', '"state":"done"',
    "9" * 5000, '"args":{}', '"expected":{"a":-1}', '"lines":', '"points":', '"height":', '"do":"check"', '"shape":0',
)  # fmt: skip


def mutate_json(data: bytes, random: Random) -> bytes:
    return mutate_text(data, random, JSON_WORDS)


def mutate_arrays(data: bytes, random: Random) -> bytes:
    """A change to one array of a message, or to its text; to its bytes where it holds none."""
    try:
        arrays, text = decode_arrays(data)
        if random.random() < 0.25:
            return mutate_bytes(data, random)
        if not arrays or random.random() < 0.3:
            return encode_arrays(arrays, dict(json.loads(mutate_json(json.dumps(text).encode(), random))))
    except (ValueError, TypeError, RecursionError):  # BadMessage is a ValueError
        return mutate_bytes(data, random)
    name, how = random.choice(list(arrays)), random.randrange(7)
    values = arrays.pop(name)
    if how == 1:
        name = random.choice(("x", "other", *arrays))
    with np.errstate(all="ignore"):
        if how == 2:
            kind = random.choice(("float64", "float32", "int64", "int32", "uint8", "int8", "bool"))
            values = values.astype(kind)
        elif how == 3:
            values = values[: random.randrange(len(values) + 1)] if values.ndim else values.reshape(1)
        elif how == 4:
            values = values.reshape(-1) if random.random() < 0.5 else values[None]
        elif how == 5:
            values = np.concatenate([values, values]) if values.ndim else np.stack([values, values])
        elif how == 6 and values.size:
            values = values.copy()
            values.flat[random.randrange(values.size)] = np.float64(random.choice(VALUES)).astype(values.dtype)
    return encode_arrays(arrays | ({name: values} if how else {}), text)
