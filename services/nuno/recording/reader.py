"""Reader of recordings; cut or damaged ones are read up to there."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.recording.file import MOST_FRAMES, RecordedFile
from nuno.recording.recorded import Arrays, Checkpoint, Frame, Recorded
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import (
    BODIES,
    CHECKPOINT,
    CHECKPOINTS,
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
)  # fmt: skip

END = "end"
"""Name of the closing metadata, which only a finished recording has."""
SERIES = ("frame", "t", "steps", "step_seconds", "stretch", "time", "balance")
"""Fields of a status that are columns, where it has them."""
SERVICE_COLUMNS = ("steps", "step_seconds")
"""Columns of each service; those of a garment's dye are dye_steps, dye_step_seconds."""
TABLES = ("energy", "wrinkles", "mobile", "fixed", "supplied")
"""Mappings in a status: each entry is a column, `energy_kinetic`."""


class Recording(RecordedFile):
    """A recording on disk. Close it, or use it in a `with`.

    Raises BadInput as `RecordedFile` does.
    """

    def __init__(self, path: Path | str, scan: bool = True) -> None:
        super().__init__(path, scan)
        self._marks: dict[str, dict[int, tuple[int, str]]] = {}

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
            number, digest = self.marks().get(message.log_time, (message.seq, ""))
            yield Frame(number, message.t, digest, self.points(message))

    @property
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
        return self.arrays(self.last(BODIES.name, t))

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
            {name: value.get(name) for name in ("depth", "inside", "mean")}
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
