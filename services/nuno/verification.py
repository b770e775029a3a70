"""Re-simulates a recording and compares it, frame by frame, to the last bit."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby

import numpy as np

from nuno.bus.encodings import BadMessage
from nuno.recording.gaps import NOTHING, Lacks, find_lacks, shortcoming
from nuno.recording.reader import Recording
from nuno.recording.recorded import Arrays, Recorded
from nuno.recording.restore import restored_scene
from nuno.scene.provenance import plugins, versions
from nuno.scene.scene_file import Loaded
from nuno.stepping.resimulation import Resimulation
from nuno.stepping.stepper import Stepper
from nuno_schemas.errors import BadInput, RunFailed

Progress = Callable[[float], None]
MEMORY = "the solver's memory, "
"""Of contact, friction, earlier steps: no part of a digest, and what all later frames depend on."""
NUMBERS = ("frame", "t", "steps", "dt")
"""Of a checkpoint, beside its arrays."""
MANY = 100
"""Times as many steps a frame as were recorded are another scene's."""


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
    that are not those here, where it differs. published and kept count what was compared beside the digests: messages
    of positions or amounts, and checkpoints. lacks is what could not be compared, since it is not there; incomplete
    says why the recording is not complete (cut, damaged, its run terminated), and is empty where it is.
    """

    compared: int
    frame: int | None = None
    t: float = 0.0
    part: str = ""
    difference: Difference | None = None
    dyed: int = 0
    others: tuple[str, ...] = ()
    published: int = 0
    kept: int = 0
    lacks: Lacks = NOTHING
    incomplete: str = ""


def steppers(loaded: Loaded, threads: int = 0) -> dict[str, Callable[[], Stepper]]:
    """What makes a scene's cloth and its dye, each at its start and stepped without services, by their names.

    Each raises BadInput for a scene that would not start.
    """
    found: dict[str, Callable[[], Stepper]] = {}
    if loaded.scene.moves:
        from nuno.simulation.run import Simulation

        found[Simulation.part] = partial(Simulation.with_bodies, loaded, threads)
    if loaded.dye is not None:
        from nuno.dye.run import DyeRun

        found[DyeRun.part] = partial(DyeRun, loaded, threads)
    return found


def verify(recording: Recording, threads: int = 0, progress: Progress | None = None) -> Verification:
    """Simulate a recording's scene again, with its control events, and compare all that is kept of each frame:
    its digest, what was published, and checkpoints.

    `progress` is told each time [s]. Raises BadInput for a recording without scene or digests.
    """
    with restored_scene(recording) as loaded:
        loaded.settled = None  # from the scene alone
        lacks = find_lacks(recording)
        found = Verification(0, lacks=lacks, incomplete=shortcoming(recording, lacks))
        for part, make in steppers(loaded, threads).items():
            now = compare(recording, Resimulation(recording, make()), progress)
            dyed = part == "dye" and loaded.scene.moves
            own = replace(now, compared=found.compared, dyed=now.compared) if dyed else now
            kept, published = found.kept + now.kept, found.published + now.published
            found = replace(own, published=published, kept=kept, lacks=lacks, incomplete=found.incomplete)
            if found.frame is not None:
                return replace(found, others=_others(recording, loaded))
        return found


def compare(recording: Recording, again: Resimulation, progress: Progress | None = None) -> Verification:
    """Step through the frames of a recording. Raises BadInput where it has no digests, RunFailed where
    damage hides them.
    """
    found, equal, stepper = None, 0, again.stepper
    seen = Counter[str]()
    for digest, frame, messages in _frames(recording, stepper):
        again.go_to(frame)
        same = again.comes_to(digest) if found is None else stepper.digest() == digest
        difference = _first_difference(recording, again, digest, messages)
        if found is None and (difference is not None or not same):
            found = Verification(equal, frame, stepper.t, stepper.part)
        if found is not None and difference is not None:
            return replace(found, difference=difference)
        equal += 1
        seen.update(message.topic for message in messages)
        if progress is not None:
            progress(stepper.t)
    if not equal:
        if recording.damage:
            raise RunFailed(f"{recording.path}: no frame is left to compare, for it is {recording.damage}")
        raise BadInput("the recording holds no digests to compare", str(recording.path))
    return found or Verification(equal, published=seen[stepper.published.name], kept=seen[stepper.kept.name])


def _frames(recording: Recording, stepper: Stepper) -> Iterator[tuple[str, int, list[Recorded]]]:
    """Digest and number of each frame whose status is there, and what is kept of it. Raises BadInput for a frame that
    the scene has not, or that is not made of steps like the recorded one: it would take another time, or for ever.
    """
    rate, last = stepper.loaded.scene.frame_rate, stepper.loaded.scene.frames
    topics = (stepper.status.name, stepper.published.name, stepper.kept.name)
    for _, group in groupby(recording.messages(topics), key=lambda message: message.log_time):
        messages = list(group)
        said = next((m for m in messages if m.topic == stepper.status.name), None)
        status = {} if said is None else recording.said(said)
        if said is not None and status["digest"]:
            with recording.damage_reported(said):
                # Times are whole nanoseconds.
                if not (abs(said.t * rate - status["frame"]) < 1e-6 + 1e-9 * rate and 0 <= status["frame"] <= last):
                    raise BadMessage(f"frame {status['frame']} is not of that time, or beyond the scene's last, {last}")
                if stepper.steps > MANY * status["steps"] > 0:
                    raise BadMessage(f"a frame of {status['steps']} steps, of which the scene has {stepper.steps:,}")
            yield status["digest"], status["frame"], messages


def _first_difference(
    recording: Recording, again: Resimulation, digest: str, messages: list[Recorded]
) -> Difference | None:
    """Of the state here from what is kept of the frame: of its float64 arrays, or else of what was published."""
    stepper = again.stepper
    for message in (m for m in messages if m.topic == stepper.kept.name):
        theirs, ours = recording.checkpoint(message), stepper.keep()
        for name in NUMBERS[: 2 if again.changing else None]:
            here, there = ours.text[name], theirs.text.get(name, math.nan)
            if here != there:
                what, gap = f"{name} of the checkpoint", abs(here - there)
                return Difference(stepper.frame, what, "beside its arrays", here, there, "checkpoint", 1, 1, gap)
        pairs = [(ours.state, theirs.state)]
        if not again.changing:  # else it may be kept with its changes, which make the solver's memory anew
            pairs.append((ours.memory, theirs.memory))
        # That of a change made after the frame is of another state.
        for (here, there), memory in zip(pairs, ("", MEMORY), strict=False):
            if theirs.digest == digest and (found := _compare(stepper, here, there, "checkpoint", memory)):
                return found
    for message in (m for m in messages if m.topic == stepper.published.name):
        with recording.damage_reported(message):
            here, there = stepper.decode(stepper.encode()), stepper.decode(message.payload)
        if found := _compare(stepper, here, there, "published"):
            return found
    return None


def _compare(stepper: Stepper, ours: Arrays, theirs: Arrays, kept: str, memory: str = "") -> Difference | None:
    """`memory` is what quantities begin with that are not of the state."""
    for name in {**theirs, **ours}:
        here, recorded = (np.asarray(arrays.get(name, ()), np.float64) for arrays in (ours, theirs))
        quantity = memory + name if memory else stepper.quantities[name]
        if here.shape != recorded.shape:
            sizes = float(here.size), float(recorded.size)
            shapes = f"here of shape {here.shape}, recorded {recorded.shape}"
            return Difference(stepper.frame, f"number of values ({quantity})", shapes, *sizes, kept, 1, 1, 0.0)
        bits = [np.ascontiguousarray(array).view(np.uint64) for array in (here, recorded)]
        differs = bits[0] != bits[1]  # a NaN is equal to itself, and 0.0 is not -0.0
        if differs.any():
            first = tuple(int(i) for i in np.unravel_index(int(np.argmax(differs)), differs.shape))
            with np.errstate(invalid="ignore"):
                farthest = float(np.abs(here - recorded)[differs].max())
            values = float(here[first]), float(recorded[first])
            index = f"entry {first}" if memory else stepper.place(first)
            return Difference(stepper.frame, quantity, index, *values, kept, int(differs.sum()), differs.size, farthest)
    return None


def _others(recording: Recording, loaded: Loaded) -> tuple[str, ...]:
    here = versions() | plugins(loaded)
    recorded = recording.metadata.get("versions", {}) | recording.metadata.get("plugins", {})
    return tuple(
        f"{name} {was}, here {here.get(name, 'none')}" for name, was in recorded.items() if was != here.get(name)
    )
