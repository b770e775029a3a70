"""Missing and doubled messages of a recording, by their numbers, the closing counts and the frames."""

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
