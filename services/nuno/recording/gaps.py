"""What a recording lacks, found in the file itself: numbers that are left out, by topic."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from nuno.recording.reader import END, Recording
from nuno.recording.recorded import Recorded
from nuno.words import counted


def count_gaps(messages: Iterable[Recorded]) -> dict[str, int]:
    """How many numbers of each topic are left out before a later one, in messages as they stand in a file.

    Every sender numbers each of its topics from 0 on. A run that goes on from another's checkpoint counts anew; the
    part that was copied ends where the checkpoint stood, and lacks nothing before it.
    """
    following, lost = Counter[str](), Counter[str]()
    for message in messages:
        lost[message.topic] += max(0, message.seq - following[message.topic])
        following[message.topic] = message.seq + 1
    return {topic: number for topic, number in lost.items() if number}


def missing(recording: Recording) -> dict[str, int]:
    """How many messages of each topic are not there; empty where none is known to be.

    A recorder that was asked to finish knew what had been sent, also after the last message that came. Of a run that
    was killed only the file tells, and of what it does not reach nobody knows.
    """
    if "missing" in recording.metadata.get(END, {}):
        return recording.missing
    return count_gaps(recording.messages())


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
