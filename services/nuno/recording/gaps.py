"""What a recording lacks, and what it holds twice: told by its numbers, its closing counts and its frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from nuno.formatting import counted
from nuno.process import SIGNALS
from nuno.recording.reader import END, Recording
from nuno.recording.recorded import Recorded
from nuno_schemas.messages import CONCENTRATION, DYE_STATUS, STATE, STATUS

FRAMES = ((STATUS.name, STATE.name), (DYE_STATUS.name, CONCENTRATION.name))
"""Topics of which each frame has one message."""


@dataclass(frozen=True)
class Lacks:
    """Messages per topic that are not there, and that are there more than once."""

    missing: dict[str, int]
    doubled: dict[str, int]

    def __str__(self) -> str:
        """In words; empty where all is there."""
        lost, twice = counted(self.missing), counted(self.doubled)
        return "; ".join(filter(None, (lost and f"missing: {lost}", twice and f"more than once: {twice}")))


NOTHING = Lacks({}, {})


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


def find_lacks(recording: Recording) -> Lacks:
    """What a recording lacks. Reads all of it.

    A recorder that was asked to finish knew what had been sent, also after the last message that came. It is not
    believed alone: the file may have been changed since. Of a run that was killed only the file tells, and of what it
    does not reach nobody knows.
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
        # What is cut ends between two messages of a frame.
        last = min(max(times[one], default=-1) for one in (status, published)) if recording.recovered else 2**64
        for one, other in ((status, published), (published, status)):
            lost |= Counter({one: sum(t <= last for t in times[other].keys() - times[one].keys())})
    lost |= Counter({status: max(own, default=-1) + 1 - len(own) for status, own in numbers.items()})
    twice = Counter({topic: sum(each.values()) - len(each) for topic, each in times.items()})
    twice |= Counter({topic: found[topic] - number for topic, number in recording.numbers("counts").items()})
    return Lacks(dict(+lost), dict(+twice))


def _uncounted(recording: Recording, found: Mapping[str, int]) -> Counter[str]:
    """What is missing by the closing metadata, of so many messages."""
    counts = {topic: number - found.get(topic, 0) for topic, number in recording.numbers("counts").items()}
    return Counter(recording.missing) | Counter(counts)


def shortcoming(recording: Recording, lacks: Lacks | None = None) -> str:
    """Why a recording is not complete, in one line for a person; empty where it is.

    Without `lacks`, of a recording that was finished only by its closing metadata and its index.
    """
    if lacks is None:
        finished = END in recording.metadata and not recording.recovered
        lacks = Lacks(dict(_uncounted(recording, recording.counts)), {}) if finished else find_lacks(recording)
    if recording.complete and not str(lacks):
        return ""
    if recording.growing:
        seen = f"its run goes on, and is recorded up to {recording.span[1]:g} s"
    elif recording.damage:
        seen = f"{recording.damage}, and read up to {recording.span[1]:g} s"
    elif recording.recovered:
        seen = f"cut short at {recording.span[1]:g} s, and read up to its last whole chunk"
    else:
        state = recording.metadata.get(END, {}).get("state", "")
        ended = f"was {state} by {SIGNALS[state]}" if state in SIGNALS else "" if str(lacks) else "failed"
        seen = ended and f"its run {ended}"
    return "INCOMPLETE: " + "; ".join(filter(None, (seen, str(lacks))))
