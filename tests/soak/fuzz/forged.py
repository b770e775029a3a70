"""Recordings that are well formed and say what no run has said: messages, metadata, files and topics exchanged.

Each forgery takes a recording apart into what it holds, changes that, and writes it anew with lengths and checksums
that fit. A falsified byte is found by a checksum; a falsified value only by whoever asks what it may be.
"""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from random import Random
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from nuno.bus.encodings import decode_arrays, encode_arrays
from nuno.recording.mcap_file import REPEATS, McapFile
from soak.fuzz.containers import RECORDING, mcap_record, mutate_arrays
from soak.fuzz.mutate import mutate_bytes

VALUES: tuple[Any, ...] = (
    "text",
    None,
    [],
    {},
    -1,
    10**30,
    2**63,
    0,
    0.5,
    True,
    {"a": [{}]},
    "\x1b[2J",
    np.inf,
    np.nan,
)
INTEGERS = (10**9, 5, -7, 2**31 - 1, -(2**31), 1)
NAMES = ("", ".", "a\0b", "x" * 300, "../a", "/etc/a", "\x1b[31mred", "a#b", "a?b", "a*b", "a//b", "/a", "a/", "\ud7ff")
SCENES: tuple[tuple[str, Any], ...] = (
    ("objects.0.model.resolution", [5000, 5000]), ("objects.0.model.resolution", [3, 3]), ("duration", "1e9 s"),
    ("frame_rate", "1e9 Hz"), ("solver.dt", "1e-12 s"), ("solver.plugin", "rk4"), ("record", "text"), ("dye", 3),
    ("view", []), ("objects", None), ("bodies.0.collider.radius", "1e300 m"), ("record.checkpoint_every", 1e-9),
    ("dye.cloth.cells", [5000, 5000]), ("dye.dyes.0.D0", "1e300 m^2/s"), ("dye.cloth.cell_size", "1e-300 m"),
    ("gravity", [0, -1.6, 0]), *(("name", name) for name in NAMES),
)  # fmt: skip
"""Fields of the scene, and what they are changed to."""
MANY, ZEROS = 60_000, 100 << 20
"""Topics, and bytes that pack to almost nothing."""


@dataclass
class Item:
    """One message."""

    topic: str
    encoding: str
    schema: str
    seq: int
    log_time: int
    payload: bytes


@dataclass
class Held:
    """All that a recording holds. Written by the format's own library where `compression` is given."""

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: list[tuple[str, bytes]] = field(default_factory=list)
    items: list[Item] = field(default_factory=list)
    compression: CompressionType | None = None

    @classmethod
    def of(cls, data: bytes) -> Held:
        """What is in a file, but for what it repeats for viewers."""
        reader, held = make_reader(io.BytesIO(data)), cls()
        for record in reader.iter_metadata():
            held.metadata[record.name] = dict(record.metadata)
        held.attachments = [(one.name, one.data) for one in reader.iter_attachments()]
        for schema, channel, m in reader.iter_messages(log_time_order=False):
            if REPEATS in channel.metadata:
                continue
            name = schema.name if schema else ""
            held.items.append(Item(channel.topic, channel.message_encoding, name, m.sequence, m.log_time, m.data))
        return held

    def write(self) -> bytes:
        """The same as a file."""
        stream, channels = io.BytesIO(), dict[str, int]()
        if self.compression is not None:
            return self._write_compressed(stream)
        file = McapFile(stream)
        for name, fields in self.metadata.items():
            file.add_metadata(name, fields)
        for name, data in self.attachments:
            file.add_attachment(name, data)
        for one in self.items:
            if one.topic not in channels:
                channels[one.topic] = file.add_channel(one.topic, one.encoding, one.schema, "jsonschema", b"{}")
            file.add_message(channels[one.topic], one.seq, one.log_time, 0, one.payload)
        file.finish()
        return stream.getvalue()

    def _write_compressed(self, stream: io.BytesIO) -> bytes:
        assert self.compression is not None
        writer, channels = Writer(stream, compression=self.compression), dict[str, int]()
        writer.start("nuno", "forged")
        for name, fields in self.metadata.items():
            writer.add_metadata(name, fields)
        for name, data in self.attachments:
            writer.add_attachment(0, 0, name, "", data)
        for one in self.items:
            if one.topic not in channels:
                channels[one.topic] = writer.register_channel(one.topic, one.encoding, 0)
            writer.add_message(channels[one.topic], one.log_time, one.payload, 0, one.seq)
        writer.finish()
        return stream.getvalue()

    def some(self, random: Random, *topics: str) -> Item:
        """A message, of these topics if there is one."""
        return random.choice([one for one in self.items if one.topic.endswith(topics)] or self.items)


def _set(data: Any, path: list[str], value: Any) -> None:
    """Change what stands at a path, if it is there."""
    for key in path[:-1]:
        data = data[int(key)] if isinstance(data, list) else data.get(key)
        if not isinstance(data, list | dict):
            return
    if isinstance(data, dict):
        data[path[-1]] = value


def _say(item: Item, change: Callable[[dict[str, Any]], object]) -> None:
    """Change the mapping that a message of text holds; JSON's own 1e400 is Python's Infinity."""
    said = json.loads(item.payload)
    change(said)
    item.payload = json.dumps(said).replace("Infinity", "1e400").encode()


def drop_topic(held: Held, random: Random) -> None:
    gone = held.some(random, "state", "status", "checkpoint", "concentration").topic
    held.items = [one for one in held.items if one.topic != gone]


def rename_topic(held: Held, random: Random) -> None:
    old = held.some(random).topic
    new = random.choice([one for one in (*NAMES, "sim/other", "sim/state", "run/report") if one != old])
    for one in held.items:
        one.topic = new if one.topic == old else one.topic


def drop_message(held: Held, random: Random) -> None:
    held.items.remove(held.some(random, "state", "status", "concentration", "checkpoint"))


def double_message(held: Held, random: Random) -> None:
    one = held.some(random, "state", "status", "concentration")
    held.items.insert(held.items.index(one), one)


def retype_field(held: Held, random: Random) -> None:
    """A field of a status, a report or an event, whatever it is; or one of a table in it."""
    one = held.some(random, "status", "report", "event/simulation", "event/dye")

    def change(said: dict[str, Any]) -> None:
        inside = [value for value in said.values() if isinstance(value, dict) and value]
        place = random.choice(inside) if inside and random.random() < 0.3 else said
        name = random.choice(list(place))
        if random.random() < 0.2:
            del place[name]
        else:
            place[name] = random.choice(VALUES)

    _say(one, change)


def exchange_payload(held: Held, random: Random) -> None:
    held.some(random).payload = random.choice((held.some(random).payload, b"", b"\xff" * 40, b"[" * 100_000))


def change_array(held: Held, random: Random) -> None:
    one = held.some(random, "checkpoint", "fabric", "geometry", "bodies", "cloth", "concentration")
    one.payload = mutate_arrays(one.payload, random)


def falsify_memory(held: Held, random: Random) -> None:
    """Integers that are indices, and numbers that are clocks and counts."""
    one = held.some(random, "checkpoint")
    try:
        arrays, text = decode_arrays(one.payload)
    except ValueError:
        return
    names = [name for name, values in arrays.items() if name.startswith("memory/") and values.size]
    if not names:
        return
    chosen = random.choice([name for name in names if arrays[name].dtype.kind in "iu"] or names)
    values, before = arrays[chosen].copy(), arrays[chosen].tobytes()
    usual = INTEGERS if values.dtype.kind in "iu" else (np.nan, np.inf, -1e300, 1e300, -1.0, 0.0)
    while values.tobytes() == before:
        values.flat[random.randrange(values.size)] = random.choice(usual)
    one.payload = encode_arrays(arrays | {chosen: values}, text)


def falsify_checkpoint(held: Held, random: Random) -> None:
    """What stands beside its arrays."""
    one = held.some(random, "checkpoint")
    try:
        arrays, text = decode_arrays(one.payload)
    except ValueError:
        return
    name = random.choice(["t", "frame", "dt", "steps"])
    text[name] = random.choice((*VALUES, 2 * text[name], 1e-12, 10**9)) if name in text else 0
    one.payload = encode_arrays(arrays, text)


def falsify_scene(held: Held, random: Random) -> None:
    path, value = random.choice(SCENES)
    data = json.loads(held.metadata["scene"]["json"])
    _set(data, path.split("."), value)
    held.metadata["scene"]["json"] = json.dumps(data)


def falsify_metadata(held: Held, random: Random) -> None:
    record = random.choice(list(held.metadata))
    fields = held.metadata[record]
    name = random.choice(list(fields)) if fields else "a"
    fields[name] = random.choice(("", "2", "true", "{", "[]", '{"sim/state": -1}', '{"a": 1e400}', "\x1b[2J"))
    if random.random() < 0.2:
        del held.metadata[record]


def falsify_version(held: Held, random: Random) -> None:
    held.metadata.get("run", {})["schema_version"] = random.choice(("0", "2", "", "text", "9" * 5000))


def falsify_time(held: Held, random: Random) -> None:
    held.some(random).log_time = random.choice((2**64 - 1, 2**63, 2**62, 10**18, 1))


def renumber(held: Held, random: Random) -> None:
    held.some(random).seq = random.choice((2**32 - 1, 0, 7))


def add_files(held: Held, random: Random) -> None:
    for name in random.choice(((random.choice(NAMES),), ("a", "a/b"), ("a/b", "a"), ("a", "a"), ("scene.yaml",))):
        held.attachments.append((name, b"data"))


def compress(held: Held, random: Random) -> None:
    held.compression = random.choice((CompressionType.LZ4, CompressionType.ZSTD, CompressionType.NONE))


def inflate(held: Held, random: Random) -> None:
    """Far more than a file of this size should come to."""
    one = held.items[-1]
    if random.random() < 0.5:
        compress(held, random)
        held.compression = held.compression or CompressionType.ZSTD
        held.items.append(Item(one.topic, one.encoding, one.schema, one.seq + 1, one.log_time, bytes(ZEROS)))
    else:
        held.items += [Item(f"a{i}", "json", "a", 0, one.log_time, b"{}") for i in range(MANY)]


TAKEN_AWAY = (drop_topic.__name__, rename_topic.__name__, drop_message.__name__, double_message.__name__)
"""After these a recording is not complete, whatever it says."""
FORGERIES: dict[Callable[[Held, Random], None], bool] = {
    drop_topic: False, rename_topic: False, drop_message: False, double_message: False, retype_field: True,
    exchange_payload: True, change_array: True, falsify_memory: False, falsify_checkpoint: True, falsify_scene: True,
    falsify_metadata: True, falsify_version: True, falsify_time: True, renumber: True, add_files: True, compress: True,
    inflate: True,
}  # fmt: skip
"""And whether what comes out of it may still be equal to what is simulated again."""
UNEQUAL = tuple(forgery.__name__ for forgery, may in FORGERIES.items() if not may)


def zeros(data: bytes) -> bytes:
    """A chunk of zeros behind the first records of a file."""
    chunk = struct.pack("<QQQIIQ", 0, 0, ZEROS // 32, 0, 0, ZEROS // 32) + bytes(ZEROS // 32)
    return data[: len(data) // 2] + mcap_record(6, chunk)


def forge(data: bytes, random: Random) -> bytes:
    """A recording with one small forgery, or where there is none to take apart, with a change to its records."""
    try:
        held = Held.of(data)
        random.choice([forgery for forgery in FORGERIES if forgery is not inflate])(held, random)
        return held.write()
    except Exception:  # what was changed before need not be a recording any more
        return RECORDING.mutate(data, random)


def damage(data: bytes, random: Random) -> tuple[str, bytes]:
    """A recording that is damaged in some way, whose name comes first: cut, changed in a few bytes, or forged."""
    how = random.random()
    if how < 0.1:
        return "truncated", data[: random.randrange(len(data))]
    if how < 0.2:
        return "bytes", mutate_bytes(data, random)
    if how < 0.22:
        return "zeros", zeros(data)
    forgery = random.choice(list(FORGERIES))
    held = Held.of(data)
    forgery(held, random)
    return forgery.__name__, held.write()
