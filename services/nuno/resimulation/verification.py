"""Verification of a recording: it is simulated again and compared, frame by frame, to the last bit."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby

import numpy as np

from nuno.bus.encodings import BadMessage
from nuno.recording.reader import NOTHING, Lacks, Recording, find_lacks, shortcoming
from nuno.recording.recorded import Arrays, Recorded
from nuno.runtime.service import check_threads
from nuno.runtime.stepper import Resimulation, Stepper
from nuno.scene.provenance import plugins, versions
from nuno.scene.recorded_scene import restored_scene
from nuno.scene.scene_file import Loaded
from nuno_schemas.errors import BadInput, RunFailed

Progress = Callable[[float], None]
MEMORY = "the solver's memory, "
"""Prefix of quantities of contact, friction and earlier steps: not in the digest, but all later frames need them."""
NUMBERS = ("frame", "t", "steps", "dt")
"""Numbers of a checkpoint, besides its arrays."""
MANY = 100
"""Factor over the recorded steps a frame from which the scene counts as another."""


@dataclass(frozen=True)
class Difference:
    """The first value, in the order of the array, that differs in the recording.

    frame      where it was seen: a later one if the float64 state of the first different frame is not recorded
    quantity   position, velocity, mobile dye, fixed dye, an array of the solver's memory; or number of values
    index      in words: vertex 3, axis y
    kept       source of the recorded value: a checkpoint (float64), or a published message (float32)
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
    """The result of a comparison.

    compared is the number of compared and equal frames, for a dyed garment the cloth's, and dyed that of its dye; frame
    is the first different one (None: all are equal), by its digest or its recorded data. part is the part that differs,
    cloth or dye. difference is None also where digests differ and no recorded data up to the end shows how. others are
    versions, processor and plugins of the recording that differ here, if the frames do. published and kept count
    further compared messages: positions or amounts, and checkpoints. lacks are missing messages; incomplete says why
    the recording is not complete (cut, damaged, its run terminated), and is empty where it is.
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
    """Return functions that make the steppers of a scene's cloth and dye, at the start and without services, by name.

    Each raises BadInput for a scene that cannot start.
    """
    makers: dict[str, Callable[[], Stepper]] = {}
    if loaded.scene.moves:
        from nuno.simulation.run import Simulation

        makers[Simulation.part] = partial(Simulation.with_bodies, loaded, threads)
    if loaded.dye is not None:
        from nuno.dye.run import DyeRun

        makers[DyeRun.part] = partial(DyeRun, loaded, threads)
    return makers


def verify(recording: Recording, threads: int = 0, progress: Progress | None = None) -> Verification:
    """Simulate a recording's scene again, with its control events, and compare all recorded data of each frame:
    its digest, published arrays, and checkpoints.

    `progress` is called with each time [s]. Raises BadInput for a recording without scene or digests.
    """
    check_threads(threads)
    with restored_scene(recording) as loaded:
        loaded.settled = None  # from the scene alone
        lacks = find_lacks(recording)
        result = Verification(0, lacks=lacks, incomplete=shortcoming(recording, lacks))
        for part, make in steppers(loaded, threads).items():
            part_result = compare(recording, Resimulation(recording, make()), progress)
            dyed = part == "dye" and loaded.scene.moves
            counted = replace(part_result, compared=result.compared, dyed=part_result.compared) if dyed else part_result
            kept, published = result.kept + part_result.kept, result.published + part_result.published
            result = replace(counted, published=published, kept=kept, lacks=lacks, incomplete=result.incomplete)
            if result.frame is not None:
                return replace(result, others=_others(recording, loaded))
        return result


def compare(recording: Recording, resimulation: Resimulation, progress: Progress | None = None) -> Verification:
    """Step through the frames of a recording. Raises BadInput where it has no digests, RunFailed where
    damage hides them.
    """
    result, equal, stepper = None, 0, resimulation.stepper
    seen = Counter[str]()
    for digest, frame, messages in _frames(recording, stepper):
        resimulation.go_to(frame)
        equal_digest = resimulation.comes_to(digest) if result is None else stepper.digest() == digest
        difference = _first_difference(recording, resimulation, digest, messages)
        if result is None and (difference is not None or not equal_digest):
            result = Verification(equal, frame, stepper.t, stepper.part)
        if result is not None and difference is not None:
            return replace(result, difference=difference)
        equal += 1
        seen.update(message.topic for message in messages)
        if progress is not None:
            progress(stepper.t)
    if not equal:
        if recording.recovered:
            why = recording.damage or "cut short, or still being written"
            raise RunFailed(f"{recording.path}: no frame is left to compare, for it is {why}")
        raise BadInput("the recording holds no digests to compare", str(recording.path))
    return result or Verification(equal, published=seen[stepper.published.name], kept=seen[stepper.kept.name])


def _frames(recording: Recording, stepper: Stepper) -> Iterator[tuple[str, int, list[Recorded]]]:
    """Yield digest, number and messages of each frame with a status. Raises BadInput for a frame that the scene does
    not have, or with far fewer steps than the scene's, which might take forever.
    """
    rate, last = stepper.loaded.scene.frame_rate, stepper.loaded.scene.frames
    topics = (stepper.status.name, stepper.published.name, stepper.kept.name)
    for _, group in groupby(recording.messages(topics), key=lambda message: message.log_time):
        messages = list(group)
        head = next((m for m in messages if m.topic == stepper.status.name), None)
        status = {} if head is None else recording.said(head)
        if head is not None and status["digest"]:
            with recording.damage_reported(head):
                # Times are whole nanoseconds.
                if not (abs(head.t * rate - status["frame"]) < 1e-6 + 1e-9 * rate and 0 <= status["frame"] <= last):
                    raise BadMessage(f"frame {status['frame']} is not of that time, or beyond the scene's last, {last}")
                if stepper.steps > MANY * status["steps"] > 0:
                    raise BadMessage(f"a frame of {status['steps']} steps, of which the scene has {stepper.steps:,}")
            yield status["digest"], status["frame"], messages


def _first_difference(
    recording: Recording, resimulation: Resimulation, digest: str, messages: list[Recorded]
) -> Difference | None:
    """Return the first difference of the state from the frame's recorded float64 arrays, or else published ones."""
    stepper = resimulation.stepper
    for message in (m for m in messages if m.topic == stepper.kept.name):
        theirs, ours = recording.checkpoint(message), stepper.keep()
        for name in NUMBERS[: 2 if resimulation.changing else None]:
            here, there = ours.text[name], theirs.text.get(name, math.nan)
            if here != there:
                what, gap = f"{name} of the checkpoint", abs(here - there)
                return Difference(stepper.frame, what, "beside its arrays", here, there, "checkpoint", 1, 1, gap)
        pairs = [(ours.state, theirs.state)]
        if not resimulation.changing:  # otherwise it may include its changes, which rebuild the solver's memory
            pairs.append((ours.memory, theirs.memory))
        # A checkpoint after a change in this frame has another state.
        for (here, there), memory in zip(pairs, ("", MEMORY), strict=False):
            if theirs.digest == digest and (found := _compare(stepper, here, there, "checkpoint", memory)):
                return found
    for message in (m for m in messages if m.topic == stepper.published.name):
        with recording.damage_reported(message):
            here, there = stepper.decode(bytes(stepper.encode())), stepper.decode(message.payload)
        if found := _compare(stepper, here, there, "published"):
            return found
    return None


def _compare(stepper: Stepper, ours: Arrays, theirs: Arrays, kept: str, memory: str = "") -> Difference | None:
    """Return the first difference of arrays; `memory` is the prefix of quantities outside the state."""
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
    differing = [(name, was) for name, was in recorded.items() if was != here.get(name)]
    differing += recording.metadata.get("resumed", {}).items()
    return tuple(f"{name} {was}, here {here.get(name, 'none')}" for name, was in differing)
