"""What a recording lacks, found in the file itself: numbers that are left out, by topic."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from nuno.recording.reader import END, Recording
from nuno.recording.recorded import Recorded
from nuno.words import counted


@dataclass(frozen=True)
class Gap:
    """Messages `first` to `last` of a topic are not there; before the message of time `t` [s]."""

    topic: str
    first: int
    last: int
    t: float

    @property
    def number(self) -> int:
        return self.last - self.first + 1

    def __str__(self) -> str:
        numbers = f"number {self.first}" if self.number == 1 else f"numbers {self.first} to {self.last}"
        return f"{self.topic}: {numbers}, before {self.t:g} s"


def find_gaps(recording: Recording) -> list[Gap]:
    """Every gap, in the file's order. Reads the whole file. Raises BadInput."""
    return gaps_of(recording.messages())


def gaps_of(messages: Iterable[Recorded]) -> list[Gap]:
    """Every gap in messages as they stand in a file.

    Every sender numbers each of its topics from 0 on. A run that goes on from another's checkpoint counts anew; the
    part that was copied ends where the checkpoint stood, and lacks nothing before it.
    """
    following: dict[str, int] = {}
    gaps = []
    for message in messages:
        expected = following.get(message.topic, 0)
        if message.seq > expected:
            gaps.append(Gap(message.topic, expected, message.seq - 1, message.t))
        following[message.topic] = message.seq + 1
    return gaps


def missing(recording: Recording) -> dict[str, int]:
    """How many messages of each topic are not there; empty where none is known to be.

    A recorder that was asked to finish knew what had been sent, also after the last message that came. Of a run that
    was killed only the file tells, and of what it does not reach nobody knows.
    """
    if "missing" in recording.metadata.get(END, {}):
        return recording.missing
    counts: dict[str, int] = {}
    for gap in find_gaps(recording):
        counts[gap.topic] = counts.get(gap.topic, 0) + gap.number
    return counts


def shortcoming(recording: Recording) -> str:
    """Why a recording is not complete, in one line for a person; empty where it is."""
    if recording.complete:
        return ""
    lost = counted(missing(recording))
    if recording.recovered:
        seen = f"cut short at {recording.span[1]:g} s, and read up to its last whole chunk"
    else:
        seen = "" if lost else "its run failed"
    return "INCOMPLETE: " + "; ".join(text for text in (seen, f"missing: {lost}" if lost else "") if text)
