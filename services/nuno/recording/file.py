"""The file of a recording: messages in order or from the end, with every damage reported."""

from __future__ import annotations

import contextlib
import fcntl
import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO, Self

from mcap.records import Attachment, ChunkIndex, Message

from nuno.bus.encodings import MOST_TEXT, BadMessage, decode_arrays, decode_points
from nuno.recording.layout import Damaged, Layout, read_index, read_layout, read_messages, read_record
from nuno.recording.recorded import Arrays, Recorded
from nuno.recording.writer import check_payload, part_of, topic_of
from nuno_schemas import SCHEMA_VERSION
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

MOST_FRAMES = 2**31


class RecordedFile:
    """The messages of a recording, without their meaning. Close it, or use it in a `with`.

    Opening it reads all of it, and a cut or damaged file up to there; with `scan` false only the index, if it has one:
    for its metadata and span, not its messages. Raises BadInput where the file is missing, no recording, or (while
    reading) has impossible values.
    """

    def __init__(self, path: Path | str, scan: bool = True) -> None:
        self.path = Path(path)
        self.owner: object = None
        """Owner of a temporary file, which keeps it until this object is gone."""
        try:
            if self.path.exists() and not (self.path.is_file() or self.path.is_dir()):
                raise BadInput("this is a pipe or device, not a file", str(path), remedy="write it to a file first")
            self._stream: BinaryIO = self.path.open("rb")
        except OSError as error:
            part = part_of(self.path)
            remedy = f"its run did not finish it: read {part}" if part.is_file() else "give the name of a recording"
            raise BadInput(f"cannot be read: {error.strerror}", str(path), remedy=remedy) from None
        try:
            self.layout = self._read_layout(scan)
            if "run" not in self.layout.metadata:
                limits = f"{self.layout.readable:,} of {self.layout.size:,} bytes could be read"
                problem = f"no recording by nuno, or {self.layout.damage or 'cut before its first record'}"
                raise BadInput(problem, str(path), limit=limits)
            self._check_version()
        except BadInput:
            self._stream.close()
            raise
        self._read: tuple[int, list[Message]] = -1, []
        """Position of the chunk that was read last, and its messages."""
        self._topics = {id: channel.topic for id, channel in self.layout.channels.items()}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        self._stream.close()

    def _read_layout(self, scan: bool) -> Layout:
        if not scan:
            with contextlib.suppress(Damaged):
                return read_index(self._stream)
        return read_layout(self._stream, self.path)

    def _check_version(self) -> None:
        version = self.metadata["run"].get("schema_version", "")
        if version != str(SCHEMA_VERSION):
            by = self.metadata.get("versions", {}).get("nuno", "")
            remedy = f"read it with nuno {by}" if by else "read it with the version of nuno that wrote it"
            raise BadInput("a recording of another version", str(self.path), field="schema_version", value=version,
                           limit=f"this nuno reads version {SCHEMA_VERSION}", remedy=remedy)  # fmt: skip

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """All metadata by name: run, scene, versions, plugins and, in a finished file, end."""
        return self.layout.metadata

    @property
    def recovered(self) -> bool:
        """Whether the file is unfinished or damaged, and is read up to its last whole chunk."""
        return not self.layout.indexed

    @property
    def damage(self) -> str:
        """The damage and its place in words; empty for a file that is whole, or only cut."""
        return self.layout.damage

    @cached_property
    def growing(self) -> bool:
        """Whether the file was still being written at the first call: its writer has a lock on it."""
        try:
            fcntl.flock(self._stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
            fcntl.flock(self._stream, fcntl.LOCK_UN)
        except OSError as error:  # another error where a file system has no locks
            return isinstance(error, BlockingIOError)
        return False

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages by topic."""
        totals = Counter[str]()
        for id, topic in self._topics.items():
            totals[topic] += self.layout.counts.get(id, 0)
        return dict(totals)

    @property
    def span(self) -> tuple[float, float]:
        """Simulation time [s] of the earliest and the latest message."""
        chunks = self.layout.chunks
        first = min((chunk.message_start_time for chunk in chunks), default=0)
        return first / 1e9, max((chunk.message_end_time for chunk in chunks), default=0) / 1e9

    @property
    def attachments(self) -> tuple[str, ...]:
        """Names of the files that the scene used."""
        return tuple(self.layout.attachments)

    def attachment(self, name: str) -> bytes:
        with self.damage_reported():
            record, _ = read_record(self._stream, self.layout.attachments[name], self.layout.size)
            if not isinstance(record, Attachment):
                raise Damaged(f"there is no file {name}")
            return bytes(record.data)

    def messages(
        self, topics: Iterable[str] | None = None, start: float | None = None, end: float | None = None
    ) -> Iterator[Recorded]:
        """Yield messages in the order of writing, with start <= t < end [s].

        A topic that ends in "/*" stands for all with that prefix.
        """
        wanted = self._channels(topics)
        first = -1 if start is None else round(start * 1e9)
        last = 2**64 if end is None else round(end * 1e9)
        for chunk in self.layout.chunks:
            if chunk.message_end_time >= first and chunk.message_start_time < last:
                for message in self._in_chunk(chunk, wanted):
                    if first <= message.log_time < last:
                        yield message

    def last(self, topic: str, before: float | None = None) -> Recorded | None:
        """Return the last message of a topic with t <= before [s], read from the end. Raises BadInput."""
        if not isinstance(before, int | float | None):
            raise BadInput("a time is a number [s]", str(self.path), field="t", value=before)
        wanted = self._channels([topic])
        limit = 2**64 if before is None else round(before * 1e9)
        for chunk in reversed(self.layout.chunks):
            if chunk.message_start_time <= limit:
                matches = [m for m in self._in_chunk(chunk, wanted) if m.log_time <= limit]
                if matches:
                    return matches[-1]
        return None

    def _channels(self, topics: Iterable[str] | None) -> frozenset[int]:
        if topics is None:
            return frozenset(self._topics)
        names = tuple(topics)
        return frozenset(
            id for id, topic in self._topics.items()
            if any(topic.startswith(n[:-1]) if n.endswith("/*") else topic == n for n in names)
        )  # fmt: skip

    def _in_chunk(self, chunk: ChunkIndex, wanted: frozenset[int]) -> Iterator[Recorded]:
        """Yield messages of some channels in a chunk; a chunk without them is not read."""
        if wanted.isdisjoint(chunk.message_index_offsets):
            return
        with self.damage_reported():
            at, messages = self._read  # many consecutive frames are in the same chunk
            if at != chunk.chunk_start_offset:
                messages = read_messages(self._stream, chunk, self.layout.size)
                self._read = chunk.chunk_start_offset, messages
            for m in messages:
                if m.channel_id in wanted:
                    yield Recorded(self._topics[m.channel_id], m.sequence, m.log_time, m.publish_time, bytes(m.data))

    def arrays(self, message: Recorded | None) -> tuple[Arrays, dict[str, Any]]:
        """Return arrays and text of a message; empty for None. Raises BadInput where it is damaged."""
        if message is None:
            return {}, {}
        with self.damage_reported(message):
            return decode_arrays(message.payload)

    def points(self, message: Recorded) -> Float:
        """Return the positions (n, 3) [m] in a message of `sim/state`. Raises BadInput where it is damaged."""
        with self.damage_reported(message):
            return decode_points(message.payload)

    def json(self, payload: bytes | str) -> dict[str, Any]:
        """Return the mapping in a message; empty for anything else. Raises BadInput where it is damaged."""
        try:
            if len(payload) > MOST_TEXT:
                raise ValueError(f"a text of {len(payload):,} bytes")
            value = json.loads(payload)
        except (ValueError, RecursionError) as error:
            raise BadInput(f"a message is damaged: {error}", str(self.path)) from None
        return value if isinstance(value, dict) else {}

    def said(self, message: Recorded) -> dict[str, Any]:
        """Return the fields of a JSON message. Raises BadInput for one that violates its schema, or has a bad frame."""
        topic = topic_of(message.topic)
        with self.damage_reported(message):
            value = self.json(message.payload)
            if topic is not None:
                check_payload(topic, message.payload)
            frame, t = value.get("frame", -1), value.get("t", 0.0)
            if not -1 <= frame < MOST_FRAMES or not math.isfinite(t):
                raise BadMessage(f"frame {frame} at {t} s")
        return value

    @contextmanager
    def damage_reported(self, message: Recorded | None = None) -> Iterator[None]:
        """Raise errors of a message, or of the file itself, as BadInput."""
        place = f"{message.topic} {message.seq} at {message.t:g} s: " if message else ""
        try:
            yield
        except (Damaged, BadMessage, IndexError) as error:
            remedy = "the disk or a copy changed it: take another copy"
            raise BadInput(f"the recording is damaged: {place}{error}", str(self.path), remedy=remedy) from None
