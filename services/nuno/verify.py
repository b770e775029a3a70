"""Re-simulates a recording and compares it, frame by frame, to the last bit."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from nuno.recording.provenance import plugins, versions
from nuno.recording.reader import Recording
from nuno.recording.recorded import Arrays, Recorded
from nuno.recording.restore import restored_scene
from nuno.scene.scene_file import Loaded
from nuno_schemas.errors import BadInput

Progress = Callable[[float], None]
MEMORY = "the solver's memory, "
"""Of contact, friction, earlier steps: no part of a digest, and what all later frames depend on."""


@dataclass(frozen=True)
class Difference:
    """The first value, in the order of the array, that is another one in the recording.

    frame      where it was seen: of what differs in a frame whose float64 state is not kept, a later one
    quantity   position, velocity, mobile dye, fixed dye, an array of the solver's memory; or number of values
    index      in words: vertex 3, axis y
    kept       where the recorded value is from: a checkpoint (float64), or what was published (float32)
    number     of values that differ, of `of`; farthest: the largest of their differences
    """

    frame: int
    quantity: str
    index: str
    here: float
    recorded: float
    kept: str
    number: int
    of: int
    farthest: float


@dataclass(frozen=True)
class Verification:
    """What a comparison found.

    compared is the number of frames that were compared and equal, of a dyed garment the cloth's, and dyed that of
    its dye; frame the first one that differs (None: all are equal), by its digest or by what is kept of it.
    part is what differs, cloth or dye. difference is None also where digests differ and nothing that is kept up to
    the recording's end shows how. others are versions, the processor and plugins that the recording was made with and
    that are not those here, where it differs.
    """

    compared: int
    frame: int | None = None
    t: float = 0.0
    part: str = ""
    difference: Difference | None = None
    dyed: int = 0
    others: tuple[str, ...] = ()


class Again(ABC):
    """What one service stepped, stepped again."""

    part: str
    """cloth or dye"""
    status: str
    published: str
    checkpoint: str
    """Topics of its digests, of its float32 and of its float64 arrays."""

    @abstractmethod
    def __init__(self, recording: Recording, loaded: Loaded, threads: int, start: Recorded | None = None) -> None:
        """From a checkpoint's message on, or else from the start. Raises BadInput."""

    @property
    @abstractmethod
    def frame(self) -> int:
        """Number of the present frame."""

    @property
    @abstractmethod
    def t(self) -> float:
        """Its time [s]."""

    @abstractmethod
    def go_to(self, frame: int) -> None:
        """Step to a frame, with what was changed before it."""

    @abstractmethod
    def change(self) -> None:
        """Make the changes of the present frame."""

    @property
    @abstractmethod
    def changing(self) -> bool:
        """Whether changes of the present frame are still to be made."""

    @abstractmethod
    def digest(self) -> str:
        """Of the present state."""

    @abstractmethod
    def arrays(self) -> Arrays:
        """The present state, float64, by quantity."""

    @abstractmethod
    def shown(self, payload: bytes) -> tuple[Arrays, Arrays]:
        """The present state as it would be published, and as it was, by quantity."""

    @abstractmethod
    def kept(self, message: Recorded) -> tuple[str, Arrays]:
        """A checkpoint's digest and arrays, by quantity."""

    @abstractmethod
    def name(self, quantity: str, index: Sequence[int]) -> str:
        """An index in words."""


def verify(recording: Recording, threads: int = 0, progress: Progress | None = None) -> Verification:
    """Simulate a recording's scene again, with its control events, and compare all that is kept of each frame:
    its digest, what was published, and checkpoints.

    `progress` is told each time [s]. Raises BadInput for a recording without scene or digests.
    """
    with restored_scene(recording) as loaded:
        found = Verification(0)
        if loaded.scene.moves:
            from nuno.simulation.verify import ClothAgain

            found = compare(recording, ClothAgain(recording, loaded, threads), progress)
        if found.frame is None and loaded.dye is not None:
            from nuno.dye.verify import DyeAgain

            dyed = compare(recording, DyeAgain(recording, loaded, threads), progress)
            found = replace(dyed, compared=found.compared, dyed=dyed.compared) if loaded.scene.moves else dyed
        return found if found.frame is None else replace(found, others=_others(recording, loaded))


def compare(recording: Recording, again: Again, progress: Progress | None = None) -> Verification:
    """Step through the frames of a recording. Raises BadInput where it has no digests."""
    found, equal = None, 0
    for digest, frame, messages in _frames(recording, again):
        again.go_to(frame)
        if again.digest() != digest and found is None:
            # A change made before the first frame, of this run or of a resumed one, is in that frame already.
            again.change()
        difference = _first_difference(again, digest, messages)
        if found is None and (difference is not None or again.digest() != digest):
            found = Verification(equal, frame, again.t, again.part)
        if found is not None and difference is not None:
            return replace(found, difference=difference)
        equal += 1
        if progress is not None:
            progress(again.t)
    if not equal:
        raise BadInput("the recording holds no digests to compare", str(recording.path))
    return found or Verification(equal)


def _frames(recording: Recording, again: Again) -> Iterator[tuple[str, int, list[Recorded]]]:
    """Digest and number of each frame whose status is there, and what is kept of it."""
    topics = (again.status, again.published, again.checkpoint)
    for _, group in groupby(recording.messages(topics), key=lambda message: message.log_time):
        messages = list(group)
        status = next((recording.json(m.payload) for m in messages if m.topic == again.status), {})
        if status.get("digest"):
            yield str(status["digest"]), int(status["frame"]), messages


def _first_difference(again: Again, digest: str, messages: list[Recorded]) -> Difference | None:
    """Of the state here from what is kept of the frame: of its float64 arrays, or else of what was published."""
    for message in (m for m in messages if m.topic == again.checkpoint):
        of, theirs = again.kept(message)
        ours = again.arrays()
        if again.changing:  # it may be kept with its changes, which make the solver's memory anew
            ours, theirs = ({n: a for n, a in kept.items() if not n.startswith(MEMORY)} for kept in (ours, theirs))
        # That of a change made after the frame is of another state.
        if of == digest and (found := _compare(again, ours, theirs, "checkpoint")):
            return found
    for message in (m for m in messages if m.topic == again.published):
        if found := _compare(again, *again.shown(message.payload), "published"):
            return found
    return None


def _compare(again: Again, ours: Arrays, theirs: Arrays, kept: str) -> Difference | None:
    for quantity in {**theirs, **ours}:
        here, recorded = (np.asarray(arrays.get(quantity, ()), np.float64) for arrays in (ours, theirs))
        if here.shape != recorded.shape:
            sizes = float(here.size), float(recorded.size)
            shapes = f"here of shape {here.shape}, recorded {recorded.shape}"
            return Difference(again.frame, f"number of values ({quantity})", shapes, *sizes, kept, 1, 1, 0.0)
        bits = [np.ascontiguousarray(array).view(np.uint64) for array in (here, recorded)]
        differs = bits[0] != bits[1]  # a NaN is equal to itself, and 0.0 is not -0.0
        if differs.any():
            first = tuple(int(i) for i in np.unravel_index(int(np.argmax(differs)), differs.shape))
            with np.errstate(invalid="ignore"):
                farthest = float(np.abs(here - recorded)[differs].max())
            values = float(here[first]), float(recorded[first])
            index = f"entry {first}" if quantity.startswith(MEMORY) else again.name(quantity, first)
            return Difference(again.frame, quantity, index, *values, kept, int(differs.sum()), differs.size, farthest)
    return None


def remembered(memory: Arrays) -> Arrays:
    """A solver's memory, by quantity."""
    return {MEMORY + name: values for name, values in memory.items()}


def _others(recording: Recording, loaded: Loaded) -> tuple[str, ...]:
    here = versions() | plugins(loaded)
    recorded = recording.metadata.get("versions", {}) | recording.metadata.get("plugins", {})
    return tuple(
        f"{name} {was}, here {here.get(name, 'none')}" for name, was in recorded.items() if was != here.get(name)
    )
