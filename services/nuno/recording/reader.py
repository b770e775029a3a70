"""Reader of recordings: messages, frames, checkpoints and what is missing; cut or damaged ones are read up to there."""

from __future__ import annotations

import contextlib
import fcntl
import json
import math
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from mcap.records import Attachment, ChunkIndex, Message
from numpy.typing import NDArray

from nuno.bus.encodings import MOST_TEXT, BadMessage, decode_arrays, decode_points
from nuno.formatting import counted, plain
from nuno.process import SIGNALS
from nuno.recording.mcap_file import REPEATS, Damaged, Layout, read_index, read_layout, read_messages, read_record
from nuno.recording.recorded import Arrays, Checkpoint, Frame, Recorded
from nuno.recording.writer import RecordingWriter, check_payload, part_of, topic_of
from nuno_schemas import SCHEMA_VERSION
from nuno_schemas.bodies import all_rotations
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.messages import (
    BODIES,
    CHECKPOINT,
    CHECKPOINTS,
    CONCENTRATION,
    CONTACT,
    DYE_CHECKPOINT,
    DYE_STATUS,
    EVENT,
    FABRIC,
    GEOMETRY,
    PENETRATION,
    REPORT,
    STATE,
    STATUS,
    STATUSES,
    Contact,
    Event,
    Header,
)  # fmt: skip

MOST_FRAMES = 2**31


END = "end"
"""Name of the closing metadata, which only a finished recording has."""
SERIES = ("frame", "t", "steps", "step_seconds", "stretch", "time", "balance")
"""Fields of a status that are columns, where it has them."""
SERVICE_COLUMNS = ("steps", "step_seconds")
"""Columns of each service; those of a garment's dye are dye_steps, dye_step_seconds."""
TABLES = ("energy", "wrinkles", "mobile", "fixed", "supplied")
"""Mappings in a status: each entry is a column, `energy_kinetic`."""


class Recording(contextlib.AbstractContextManager["Recording"]):
    """A recording on disk. Close it, or use it in a `with`.

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
        self._marks: dict[str, dict[int, tuple[int, str]]] = {}
        self._topics = {
            id: channel.topic for id, channel in self.layout.channels.items() if REPEATS not in channel.metadata
        }

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

    @property
    def complete(self) -> bool:
        """Whether the file was finished and, by its recorder's counts, has every sent message.

        `nuno info` and `nuno.verify` count the messages themselves.
        """
        return self.layout.indexed and self.metadata.get(END, {}).get("complete") == "true"

    @property
    def missing(self) -> dict[str, int]:
        """Messages by topic that were sent but never arrived, as the recorder counted them."""
        return self.numbers("missing")

    def numbers(self, name: str) -> dict[str, int]:
        """Return numbers of messages by topic, from a field of the closing metadata."""
        counts = self.json(self.metadata.get(END, {}).get(name, "{}"))
        if not all(type(number) is int and 0 <= number < 2**63 for number in counts.values()):
            raise BadInput("the recording is damaged: no numbers of messages", str(self.path), field=name, value=counts)
        return counts

    @property
    def scene(self) -> dict[str, Any]:
        """The scene's data, as read and overridden."""
        data = self.json(self.metadata.get("scene", {}).get("json", "{}"))
        for name in ("record", "dye", "view"):
            if not isinstance(data.get(name), dict | None):
                raise BadInput("the scene in the recording is damaged", str(self.path), field=name, value=data[name])
        return data

    def frames(self, start: float | None = None, end: float | None = None) -> Iterator[Frame]:
        """Yield published positions with start <= t < end [s] in float32 precision; `nuno.states` has float64 ones."""
        for message in self.messages([STATE.name], start, end):
            number, digest = self.mark(message)
            yield Frame(number, message.t, digest, self.points(message))

    @cached_property
    def dyed_alone(self) -> bool:
        """Whether the scene is dyed cloth that does not move."""
        dye = self.scene.get("dye")
        return isinstance(dye, dict) and dye.get("object") is None

    def marks(self, status: str | None = None) -> dict[int, tuple[int, str]]:
        """Return frame number and digest by log time [ns], from the status of each frame.

        For a dyed garment they are those of the cloth, unless `status` is the dye's topic.
        """
        name = status or (DYE_STATUS.name if self.dyed_alone else STATUS.name)
        if name not in self._marks:
            statuses = ((m.log_time, self.said(m)) for m in self.messages([name]))
            self._marks[name] = {time: (fields["frame"], fields["digest"]) for time, fields in statuses}
        return self._marks[name]

    def mark(self, message: Recorded) -> tuple[int, str]:
        """Return frame number and digest at the time of a message; if no status has this time, the number that the time
        has by the last status (frame k is at k / rate), else the message's own, and no digest.
        """
        marks = self.marks(DYE_STATUS.name if message.topic.startswith("dye/") else None)
        if message.log_time in marks:
            return marks[message.log_time]
        time, (frame, _) = next(reversed(marks.items()), (0, (0, "")))
        if time and frame > 0 and (number := round(message.log_time * frame / time)) < MOST_FRAMES:
            return number, ""
        return message.seq if message.topic == STATE.name else -1, ""

    def no_frame(self, number: int | None, present: Collection[int]) -> BadInput:
        """Return the error for a frame that is not in the recording."""
        limit = f"frames {min(present)} to {max(present)}" if present else "it holds none"
        problem = "no such frame in the recording"
        return BadInput(problem, str(self.path), field="--frame", value=number, limit=limit)

    def fabric(self, t: float | None = None) -> tuple[Arrays, dict[str, Any]]:
        """Return arrays of the cloth (faces, uv, edges, ...) and text, at t [s] or last: operations change it."""
        return self.arrays(self.last(FABRIC.name, t))

    def geometry(self) -> tuple[Arrays, dict[str, Any]]:
        """Return constant arrays of the bodies and text; empty without bodies."""
        return self.arrays(self.last(GEOMETRY.name))

    def poses(self, t: float | None = None) -> tuple[Arrays, dict[str, Any]]:
        """Return rotation (f, 4) and translation (f, 3) [m] of the bodies' frames, at t [s] or last."""
        arrays, text = self.arrays(self.last(BODIES.name, t))
        if {"rotation", "translation"} <= arrays.keys():
            arrays = {**arrays, "rotation": all_rotations(arrays["rotation"], len(arrays["translation"]))}
        return arrays, text

    def checkpoints(self, topic: str = CHECKPOINT.name) -> Iterator[Checkpoint]:
        """Yield float64 states of cloth, or of dye by its topic, in order. Raises BadInput for a damaged one."""
        for message in self.messages([topic]):
            yield self.checkpoint(message)

    def last_checkpoint(self, before: float | None = None, topic: str = CHECKPOINT.name) -> Checkpoint:
        """Return the last checkpoint with t <= before [s]. Raises BadInput where there is none."""
        message = self.last(topic, before)
        if message is None:
            raise self._no_checkpoint()
        return self.checkpoint(message)

    def common_checkpoint(self) -> Recorded:
        """Return the last checkpoint at whose time each stepping service has one. Raises BadInput where there is none.

        Both services publish theirs at the same frames; after a killed run, one may lack its last.
        """
        stepped = {CHECKPOINT.name: not self.dyed_alone, DYE_CHECKPOINT.name: bool(self.scene.get("dye"))}
        topics = [topic for topic in CHECKPOINTS if stepped[topic]]
        before: float | None = None
        for _ in topics:
            candidates = [self.last(topic, before) for topic in topics]
            if any(message is None for message in candidates):
                break
            first = min((m for m in candidates if m is not None), key=lambda m: m.log_time)
            if all(m is not None and m.log_time == first.log_time for m in candidates):
                return first
            before = first.t
        raise self._no_checkpoint()

    def _no_checkpoint(self) -> BadInput:
        problem = "the recording holds no checkpoint: its run ended before the first"
        remedy = "run its scene again; for earlier ones with --set record.checkpoint_every=0.1s"
        if self.damage:
            problem = f"the recording is {self.damage}, and holds no checkpoint before that"
            remedy = "take another copy, or run its scene again"
        return BadInput(problem, str(self.path), remedy=remedy)

    def series(self, end: float | None = None) -> dict[str, NDArray[Any]]:
        """Return columns over the frames, or over those with t < end [s], as `read_series`."""
        try:
            return read_series(self, end)
        except (TypeError, ValueError, OverflowError) as error:
            raise BadInput(f"a status is damaged: {error}", str(self.path)) from None

    def events(self) -> list[Event]:
        """Return the events of services, and control requests, in order. Raises BadInput for a damaged one."""
        topics = [name for name in self.counts if name.startswith(f"{EVENT.name}/")]
        return [Event.model_validate(self.said(message)) for message in self.messages(topics)]

    def report(self) -> dict[str, Any]:
        """Return the closing report; empty if the run was killed."""
        message = self.last(REPORT.name)
        return self.json(message.payload) if message else {}

    def checkpoint(self, message: Recorded) -> Checkpoint:
        """Decode a checkpoint's message. Raises BadInput for a damaged one."""
        arrays, text = self.arrays(message)
        names = ("x", "v") if message.topic == CHECKPOINT.name else ("phi", "fixed")
        try:
            point = Checkpoint(arrays | {name: np.asarray(arrays[name], np.float64) for name in names}, text)
            shapes = [arrays[name].shape for name in names]
            if shapes[0] != shapes[1] or not (len(shapes[0]) == 4 or (names[0] == "x" and shapes[0][1:] == (3,))):
                raise ValueError(f"{names[0]} has shape {shapes[0]} and {names[1]} {shapes[1]}")
            numbers: dict[str, Any] = {name: text.get(name) for name in ("frame", "t", "steps", "dt")}
            if not all(type(n) in (int, float) and 0 <= n < MOST_FRAMES for n in numbers.values()):
                raise ValueError(f"its numbers are {numbers}")
            return point
        except (KeyError, ValueError, TypeError, OverflowError) as error:
            raise BadInput(f"the checkpoint at {message.t:g} s is damaged: {error}", str(self.path)) from None


def open_recording(path: Path | str) -> Recording:
    """Open a recording, finished or not. Raises BadInput."""
    return Recording(path)


@contextmanager
def opened(source: Recording | Path | str) -> Iterator[Recording]:
    """Yield a recording that is open already, or open the one at a path."""
    if isinstance(source, Recording):
        yield source
    else:
        with open_recording(source) as recording:
            yield recording


def read_series(recording: Recording, end: float | None = None) -> dict[str, NDArray[Any]]:
    """Return columns frame, t [s], steps, step_seconds, energy_* [J], stretch, from the collision service depth [m],
    inside, mean [m], and for cloth contact crossings and distance [m]; by body force_BODY_x, _y and _z [N] and
    pressure_BODY, the largest [Pa], where those are recorded; for dye mobile_*, fixed_* and supplied_* by dye, balance,
    and the time of the dyeing [s]; NaN where a value is missing.
    """
    rows: dict[int, dict[str, Any]] = {}
    for message in recording.messages(STATUSES, end=end):
        value = recording.said(message)
        prefix = "dye_" if message.topic == DYE_STATUS.name and not recording.dyed_alone else ""
        row = {prefix + name if name in SERVICE_COLUMNS else name: value[name] for name in SERIES if name in value}
        for name in TABLES:
            table = value.get(name)
            row |= {f"{name}_{key}": number for key, number in table.items()} if isinstance(table, dict) else {}
        rows.setdefault(value["frame"], {}).update(row)
    for message in recording.messages([PENETRATION.name], end=end):
        value = recording.said(message)
        rows.setdefault(value["frame"], {"frame": value["frame"], "t": value["t"]}).update(
            {name: value.get(name) for name in ("depth", "inside", "mean", "area", "area_depth")}
            | {name: value[name] for name in ("crossings", "distance") if value.get(name) is not None}
        )
    for message in recording.messages([CONTACT.name], end=end):
        contact = Contact.model_validate(recording.said(message))
        row = rows.setdefault(contact.frame, {"frame": contact.frame, "t": contact.t})
        for load in contact.bodies:
            row |= {f"force_{load.body}_{axis}": value for axis, value in zip("xyz", load.force, strict=True)}
            row |= {f"pressure_{load.body}": load.pressure}
    names = list(dict.fromkeys(name for row in rows.values() for name in row))
    return {name: _column([rows[frame].get(name) for frame in sorted(rows)]) for name in names}


def _column(values: list[Any]) -> NDArray[Any]:
    """Return integers if all are, else float64 with NaN for missing values."""
    if all(isinstance(value, int) for value in values):
        return np.array(values, np.int64)
    return np.array([np.nan if value is None else value for value in values], np.float64)


# Missing and doubled messages of a recording, by their numbers, the closing counts and the frames.

FRAMES = ((STATUS.name, STATE.name), (DYE_STATUS.name, CONCENTRATION.name))
"""Topics with one message for each frame."""


@dataclass(frozen=True)
class Lacks:
    """Numbers of missing and of doubled messages by topic."""

    missing: dict[str, int]
    doubled: dict[str, int]

    def __str__(self) -> str:
        """Return the numbers in words; empty if nothing is missing or doubled."""
        lost, twice = counted(self.missing), counted(self.doubled)
        return "; ".join(filter(None, (lost and f"missing: {lost}", twice and f"more than once: {twice}")))


NOTHING = Lacks({}, {})


def count_gaps(messages: Iterable[Recorded]) -> dict[str, int]:
    """Return how many numbers of each topic are missing before a later one, in messages in the order of a file.

    Every sender numbers each of its topics from 0 on. A resumed run starts at 0 again; the part that it copied ends at
    the checkpoint, and is complete before it.
    """
    following, lost = Counter[str](), Counter[str]()
    for message in messages:
        lost[message.topic] += max(0, message.seq - following[message.topic])
        following[message.topic] = message.seq + 1
    return {topic: number for topic, number in lost.items() if number}


def find_lacks(recording: Recording) -> Lacks:
    """Find the missing and doubled messages of a recording. Reads all of it.

    A recorder that had to finish knew all sent messages, also those after its last. Its counts are not trusted alone:
    the file may have been changed since. After a killed run only the file shows gaps, and its end is unknown.
    """
    found, times = Counter[str](), {topic: Counter[int]() for pair in FRAMES for topic in pair}
    numbers = {status: set[int]() for status, _ in FRAMES}

    def counting() -> Iterable[Recorded]:
        for message in recording.messages():
            found[message.topic] += 1
            if message.topic in times:
                times[message.topic][message.log_time] += 1
            if message.topic in numbers:
                numbers[message.topic].add(recording.said(message)["frame"])
            yield message

    lost = Counter(count_gaps(counting())) | _uncounted(recording, found)
    rare = (recording.scene.get("record") or {}).get("dye_every") is not None
    for status, published in FRAMES[: 1 if rare else 2]:
        # A cut file may end between two messages of a frame.
        last = min(max(times[one], default=-1) for one in (status, published)) if recording.recovered else 2**64
        for one, other in ((status, published), (published, status)):
            lost |= Counter({one: sum(t <= last for t in times[other].keys() - times[one].keys())})
    lost |= Counter({status: max(own, default=-1) + 1 - len(own) for status, own in numbers.items()})
    twice = Counter({topic: sum(each.values()) - len(each) for topic, each in times.items()})
    twice |= Counter({topic: found[topic] - number for topic, number in recording.numbers("counts").items()})
    return Lacks(dict(+lost), dict(+twice))


def _uncounted(recording: Recording, found: Mapping[str, int]) -> Counter[str]:
    """Return the messages that are missing by the closing metadata, given the numbers `found`."""
    counts = {topic: number - found.get(topic, 0) for topic, number in recording.numbers("counts").items()}
    return Counter(recording.missing) | Counter(counts)


def shortcoming(recording: Recording, lacks: Lacks | None = None) -> str:
    """Return why a recording is incomplete, in one line; empty if it is complete.

    Without `lacks`, a finished recording is only checked by its closing metadata and its index.
    """
    if lacks is None:
        finished = END in recording.metadata and not recording.recovered
        lacks = Lacks(dict(_uncounted(recording, recording.counts)), {}) if finished else find_lacks(recording)
    if recording.complete and not str(lacks):
        return ""
    if recording.growing:
        reason = f"its run goes on, and is recorded up to {recording.span[1]:g} s"
    elif recording.damage:
        reason = f"{recording.damage}, and read up to {recording.span[1]:g} s"
    elif recording.recovered:
        reason = f"cut short at {recording.span[1]:g} s, and read up to its last whole chunk"
    else:
        state = recording.metadata.get(END, {}).get("state", "")
        ended = f"was {state} by {SIGNALS[state]}" if state in SIGNALS else "" if str(lacks) else "failed"
        reason = ended and f"its run {ended}"
    return "INCOMPLETE: " + "; ".join(filter(None, (reason, str(lacks))))


# What a resumed or repeated run takes from a recording: control events, poses, settled cloth, earlier messages.

SETTLED = "settled_from", "settled"
"""Names of the arrays of `Loaded.settled` in `sim/fabric`."""
CONTROLS = tuple(f"{EVENT.name}/{service}" for service in ("simulation", "dye"))
"""Event topics of the services that answer control requests."""


def control_events(recording: Recording) -> list[Event]:
    """Return the control events of a run, in order: pause, resume, step, stop, set, add."""
    return [event for event in recording.events() if event.kind == "control"]


CHANGES = ("set", "add")
"""Control events that change the scene."""


def describe_changes(events: Iterable[Event]) -> list[str]:
    """Return the control events that change the scene, a line and once each, though two services log some."""
    texts = [f"{e.args.get('item')} at {e.t:.6g} s (frame {e.frame})" for e in events if e.text in CHANGES]
    return list(dict.fromkeys(plain(text).replace("\n", " ") for text in texts))


def recorded_poses(recording: Recording, until: float = math.inf) -> dict[int, bytes]:
    """Return `Loaded.recorded_poses` of a recording, up to a time [s]."""
    marks, poses = recording.marks(), recording.messages([BODIES.name])
    return {marks[m.log_time][0]: m.payload for m in poses if m.log_time in marks and m.t <= until + 1e-9}


def settled_cloth(recording: Recording) -> tuple[Float, Float] | None:
    """Return `Loaded.settled` of a recording."""
    if not recording.counts.get(FABRIC.name):
        return None
    arrays, _ = recording.fabric(0.0)
    start, x = (arrays.get(name, np.zeros(0)) for name in SETTLED)
    return (start, x) if start.shape == x.shape and x.ndim == 2 and x.shape[1] == 3 else None


def before_checkpoint(source: Recording | Path | None, topics: Iterable[str]) -> list[dict[str, Any]]:
    """Return the JSON messages before the first frame of a run that resumes a recording, for its report."""
    if source is None:
        return []
    with opened(source) as recording:
        return [recording.said(message) for message in recording.messages(topics, end=recording.common_checkpoint().t)]


def copy_until(recording: Recording, writer: RecordingWriter) -> None:
    """Write all messages before the last checkpoint, and the checkpoint itself, which a resumed run has in common with
    the recorded one.
    """
    checkpoint = recording.common_checkpoint()
    for message in recording.messages():
        earlier = message.t < checkpoint.t - 1e-9
        # A change made at the checkpoint's frame comes after it.
        same = message.t < checkpoint.t + 1e-9 and message.topic in (*CHECKPOINTS, *CONTROLS)
        if message.topic != REPORT.name and (earlier or same):
            header = Header(run="", service="", seq=message.seq, frame=0, t=message.t)
            writer.write(message.topic, header, message.payload)
            writer.show(message.topic, message.payload)
