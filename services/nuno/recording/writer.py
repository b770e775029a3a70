"""Writer of a run's recording, crash-safe while it grows and renamed at its end."""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

from pydantic import ValidationError

from nuno.bus.encodings import ARRAYS_SCHEMA, BadMessage, arrays_schema, check_protobuf, foxglove_schema
from nuno.process import check_unprotected, hold
from nuno.recording.mcap_file import CHUNK_BYTES, LATEST, MAGIC, McapFile, Shown
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import EVENT, MODELS, TOPICS, Header, Topic

FLUSH_SECONDS = 0.5
"""Most wall time that is lost if the process is killed [s]."""


Repeat = Callable[[str, int, bytes, int, int], Iterable[Shown]]
"""Returns the messages for viewers of a message, by its topic, log time [ns] and payload, and by the bytes so far of
all messages, and of those for viewers as they are in the file.
"""


def topic_of(name: str) -> Topic | None:
    """Return the topic of a recorded message, None for others; each service has its own topic of events."""
    if name.startswith(EVENT.name + "/"):
        return Topic(name, EVENT.encoding, EVENT.schema)
    topic = TOPICS.get(name)
    return topic if topic is not None and topic.recorded else None


def check_payload(topic: Topic, payload: bytes) -> None:
    """Raise BadMessage for bytes that violate their topic's encoding; arrays are not decoded."""
    model = MODELS.get(topic.schema)
    if topic.encoding == "protobuf":
        check_protobuf(payload)
    elif model is not None:
        try:
            model.model_validate_json(payload)
        except ValidationError as error:
            raise BadMessage(f"not a {topic.schema} message: {error}") from None


def schema_of(topic: Topic) -> tuple[str, bytes]:
    """Return encoding and text of a topic's schema."""
    if topic.encoding == "protobuf":
        return "protobuf", arrays_schema() if topic.schema == ARRAYS_SCHEMA else foxglove_schema(topic.schema)
    model = MODELS.get(topic.schema)
    schema = model.model_json_schema() if model else {"title": topic.schema, "type": "object"}
    return "jsonschema", json.dumps(schema).encode()


def part_of(path: Path) -> Path:
    """Return the path of an unfinished recording."""
    return path.with_name(path.name + ".part")


def check_target(path: Path) -> None:
    """Raise BadInput where a recording could not be written; leaves no file."""
    _open(path).close()
    part_of(path).unlink()


def _open(path: Path) -> BinaryIO:
    part = part_of(path)
    try:
        there = path.exists()
        if path.suffix != ".mcap":
            problem = "a recording's name ends in .mcap"
            raise BadInput(problem, field="--record", value=str(path), remedy=f"{path}.mcap")
        if there and not _is_mcap(path):
            problem = "what is there is no recording and would be lost"
            raise BadInput(problem, field="--record", value=str(path), remedy="choose another name")
        check_unprotected(path, "--record")
        stream = part.open("xb")
        hold(stream.fileno())  # readers see by the lock that it grows
        return stream
    except FileExistsError:
        remedy = "it is being written, or its run ended early: choose another name, or move it away"
        raise BadInput("an unfinished recording is there", field="--record", value=str(part), remedy=remedy) from None
    except OSError as error:
        remedy = "choose a folder that exists and can be written, with --record FILE"
        if error.errno == errno.ENAMETOOLONG:
            remedy = "choose a shorter name: 255 bytes at most with .part, which it has until its end"
        problem = f"cannot write there: {error.strerror}"
        raise BadInput(problem, field="--record", value=str(path), remedy=remedy) from None


def _is_mcap(path: Path) -> bool:
    if path.is_fifo():  # opening it waits for a writer
        return False
    with path.open("rb") as stream:
        return stream.read(len(MAGIC)) == MAGIC


class RecordingWriter:
    """One MCAP file of a run: `path` + ".part" until `finish`, then `path`.

    metadata     name -> fields, written first
    attachments  name -> bytes or path, the files that the scene used
    repeat       returns the messages for viewers of a message

    Raises BadInput where the file cannot be created, RunFailed when writing fails later (disk
    full): the ".part" then ends with its last whole chunk, and can be read.
    """

    def __init__(
        self, path: Path, metadata: dict[str, dict[str, str]], attachments: Mapping[str, bytes | Path],
        repeat: Repeat = lambda *message: (),
    ) -> None:  # fmt: skip
        self.path, self._repeat = path, repeat
        self.counts: dict[str, int] = defaultdict(int)
        self.seconds = 0.0
        self.bytes = 0
        self._stream = _open(path)
        self._last_whole = 0
        self._channels: dict[str, int] = {}
        self._latest = 0
        with self._failing():
            self._file = McapFile(self._stream)
            for name, fields in metadata.items():
                self._file.add_metadata(name, fields)
            for name, data in attachments.items():
                self._file.add_attachment(name, data)
            self._flush()

    def write(self, topic: str, header: Header, payload: bytes) -> None:
        """Add a message; messages older than half a second of wall time are flushed.

        The MCAP sequence is the header's, the log time is simulation time [ns] and the publish
        time wall time [ns]. Messages outside any frame have the latest simulation time, so that
        they keep their order. Raises BadMessage for a topic or header that cannot be
        recorded, RunFailed when the disk is full.
        """
        start = time.perf_counter()
        kind = topic_of(topic)
        if kind is None or not (math.isfinite(header.t) and 0 <= header.t < LATEST * 1e-9 and 0 <= header.seq < 2**32):
            raise BadMessage(f"cannot be recorded: topic {topic!r}, number {header.seq}, time {header.t} s")
        log_time = round(header.t * 1e9)
        if header.frame < 0:
            log_time = max(log_time, self._latest)
        self._latest = max(self._latest, log_time)
        urgent = topic.startswith(EVENT.name)
        with self._failing():
            self._file.add_message(self._channel(kind), header.seq, log_time, time.time_ns(), payload)
            # An event may be the last message for a while (pause) or for good (an error).
            if urgent or self._file.pending >= CHUNK_BYTES or time.monotonic() - self._flushed > FLUSH_SECONDS:
                self._flush()
        self.counts[topic] += 1
        self.bytes += len(payload)
        self.seconds += time.perf_counter() - start

    def show(self, topic: str, payload: bytes) -> None:
        """Add the messages for viewers of the last message, at its time. Raises RunFailed when the disk is full."""
        with self._failing():
            for shown in self._repeat(topic, self._latest, payload, self.bytes, self._file.repeated):
                self._file.add_shown(shown, self._latest, time.time_ns())

    def flush_due(self) -> float:
        """Flush messages after half a second of wall time; return how long they may still wait [s], inf for none.

        Raises RunFailed when the disk is full.
        """
        if self._file.pending:
            left = self._flushed + FLUSH_SECONDS - time.monotonic()
            if left > 0.0:
                return left
            with self._failing():
                self._flush()
        return math.inf

    def finish(self, metadata: dict[str, dict[str, str]], whole: bool = True) -> Path:
        """Write closing metadata and the index, make the file durable, and rename it.

        A file that is not `whole` replaces no other.
        """
        kept = self.path if whole or not self.path.exists() else part_of(self.path)
        with self._failing():
            # The last messages come before the closing metadata, also in a file cut in between.
            self._file.flush(last=True)
            self._flush()
            for name, fields in metadata.items():
                self._file.add_metadata(name, fields)
            self._file.finish()
            os.fsync(self._stream.fileno())
            self._stream.close()
            part_of(self.path).replace(kept)
            _sync_folder(self.path.parent)
        return kept

    @property
    def closed(self) -> bool:
        return self._stream.closed

    def abort(self) -> None:
        """Close the unfinished file, cut after its last whole chunk."""
        if not self.closed:
            _close_cut(self._stream, self._last_whole)

    def discard(self) -> None:
        """Close and remove the unfinished file."""
        self.abort()
        part_of(self.path).unlink(missing_ok=True)

    def _channel(self, topic: Topic) -> int:
        if topic.name not in self._channels:
            self._channels[topic.name] = self._file.add_channel(
                topic.name, topic.encoding, topic.schema, *schema_of(topic)
            )
        return self._channels[topic.name]

    def _flush(self) -> None:
        self._file.flush()
        if not part_of(self.path).exists():
            raise OSError(errno.ENOENT, "its file or folder was moved or removed")
        self._last_whole = self._stream.tell()
        self._flushed = time.monotonic()

    @contextlib.contextmanager
    def _failing(self) -> Iterator[None]:
        """Close the file, and raise RunFailed, where the `with` block cannot write."""
        try:
            yield
        except OSError as error:
            part, end = part_of(self.path), self._last_whole
            self.abort()
            kept = f"{part} reads up to byte {end}" if part.exists() else f"it is no longer at {part}"
            raise RunFailed(f"recording stopped: {error.strerror or error}; {kept}") from None


def _close_cut(stream: BinaryIO, size: int) -> None:
    """Close and cut to `size`: closing writes the buffer, and fails again on a full disk."""
    path = stream.name
    with contextlib.suppress(OSError):
        stream.close()
    if os.path.exists(path):
        os.truncate(path, size)


def _sync_folder(folder: Path) -> None:
    """Make a rename durable, where the system can open a folder."""
    if hasattr(os, "O_DIRECTORY"):
        handle = os.open(folder, os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
