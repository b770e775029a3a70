"""What is stepped frame by frame, cloth or dye, independent of how it is sent; also from a recording's checkpoint."""

from __future__ import annotations

import hashlib
import math
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
import psutil
from numpy.typing import NDArray

from nuno.formatting import data_size, factor, roughly
from nuno.plugin_contract.values import ContractError, check_array
from nuno.recording.reader import CHANGES, Recording, control_events, describe_changes, open_recording
from nuno.recording.recorded import MEMORY, Arrays, Checkpoint, Recorded
from nuno.scene.provenance import assets
from nuno.scene.scene_file import Loaded
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Memory
from nuno_schemas.messages import Event, Topic

COPIED, CALLS = 1e8, 600_000
"""Most bytes copied before a frame, for each second of the last one, which takes a few hundredths of its time; the
overhead of Python costs as much as this many bytes.
"""


@dataclass
class Stepped:
    """A stepped frame: its number, the solver's report, wall time [s] and the state's hash."""

    number: int
    report: Any
    seconds: float
    digest: str


GROWN, FEW = 4, 1000
"""Factor and surplus by which a scene's vertices may exceed the recorded ones: models count roughly."""
FINEST = 1000
"""Most steps in place of one after changes during a run."""


FILE, STATUS, MESSAGE, SHOWN = 20_000, 530, 50, 30_000
"""Bytes of a file beside its messages, of a frame's status with its message, of a message beside its payload, and of
bodies for viewers, for whom all else takes a twentieth more.
"""


class Stepper(ABC):
    """A scene's cloth, or its dye: a state, a solver with its memory, and the present frame.

    dt is the step [s]; a frame has `steps` of them.
    """

    part: ClassVar[str]
    """cloth or dye"""
    service: ClassVar[str]
    """The service that steps it."""
    status: ClassVar[Topic]
    published: ClassVar[Topic]
    kept: ClassVar[Topic]
    """Topics of each frame's status, and of its float32 and its float64 arrays."""
    quantities: ClassVar[Mapping[str, str]]
    """Names of the state's arrays in words."""

    loaded: Loaded
    frame: int
    memory: Memory
    steps: int
    dt: float

    leave: NDArray[np.int64]
    """(1,) nonzero tells the solver to abandon its frame, as in nuno_schemas.system.System"""
    steered: tuple[str, ...] = ()
    """Changes of the scene by control requests so far, in words."""
    ahead: tuple[Event, ...] = ()
    """Recorded changes of the scene that a resumed or repeated run is still to make, each at its frame, in order."""
    resumed: Mapping[str, Any] = MappingProxyType({})
    """Recorded status of the frame that the run resumes from; empty for one from the start."""
    taken: float = math.inf
    """Wall time of the last frame [s]."""
    begun: Checkpoint | None = None
    """Copy of the state before the last frame, should that be abandoned or unstable; None where none was made."""

    @property
    def t(self) -> float:
        """Time of the scene [s], from the frame number so that it never drifts."""
        return float(self.frame / self.loaded.scene.frame_rate)

    @property
    def finished(self) -> bool:
        """Whether the scene's last frame is done."""
        return self.frame >= self.loaded.scene.frames

    @abstractmethod
    def arrays(self) -> Arrays:
        """Return the float64 state itself, by name."""

    @abstractmethod
    def step(self) -> Stepped:
        """Step one frame."""

    @abstractmethod
    def present(self) -> Stepped:
        """Return the present frame, without a step; compiles the kernels of a step."""

    def first(self) -> Stepped:
        """Return the present frame as a run begins with it: a resumed one with the steps that the frame has taken."""
        frame, recorded = self.present(), self.resumed
        report = replace(frame.report, **{name: recorded[name] for name in ("steps", "counts") if name in recorded})
        return replace(frame, report=report, seconds=recorded.get("step_seconds", frame.seconds))

    @abstractmethod
    def about(self) -> str:
        """Return how the solver's kernels run, in words."""

    @abstractmethod
    def set(self, item: str) -> None:
        """Change a field of the running scene. Raises BadInput."""

    @abstractmethod
    def add(self, item: str) -> dict[str, Any]:
        """Add an item, `list: {...}`, to the running scene; return its field and `new` value, and the item that repeats
        it where that is another. Raises BadInput.
        """

    def alter_due(self) -> bool:
        """Apply what the scene itself changes before the next frame; return whether there was anything."""
        return False

    @abstractmethod
    def resume(self, point: Checkpoint, changes: Sequence[Event] = ()) -> None:
        """Continue from a checkpoint, with the control events of this service until then, in order.

        Raises BadInput where it does not fit.
        """

    @abstractmethod
    def encode(self) -> bytes | bytearray:
        """Return the state as it is published, float32."""

    @staticmethod
    @abstractmethod
    def decode(payload: bytes) -> Arrays:
        """Return a published state, by the names of its arrays. Raises BadMessage."""

    @abstractmethod
    def place(self, index: Sequence[int]) -> str:
        """Return an index of one of the state's arrays in words."""

    def digest(self) -> str:
        """Return the hash of the float64 state: equal digests mean equal bits."""
        return hash_of([np.int64(self.frame), *self.digested()])

    def digested(self) -> Iterable[NDArray[Any]]:
        """Return the arrays of the digest, besides the frame's number."""
        return self.arrays().values()

    def keep(self) -> Checkpoint:
        """Return a copy of the whole present state, which continues to the same bits."""
        point = self._copy()
        point.text["digest"] = self.digest()
        return point

    def _copy(self) -> Checkpoint:
        arrays, text = self.whole()
        return Checkpoint({name: values.copy(order="K") for name, values in arrays.items()}, deepcopy(text))

    def whole(self) -> tuple[Arrays, dict[str, Any]]:
        """Return arrays and text of a checkpoint, but for its digest; the arrays are the state's own, which the next
        frame changes.
        """
        arrays = self.arrays() | {MEMORY + name: values for name, values in self.memory.arrays.items()}
        return arrays, {"t": self.t, "frame": self.frame, "dt": self.dt, "steps": self.steps}

    def begin_frame(self, needed: bool = False) -> None:
        """Keep the present state as `begun`, unless copying takes as long as a frame and is not `needed`."""
        size = CALLS + sum(array.nbytes for array in (*self.memory.arrays.values(), *self.arrays().values()))
        self.begun = self._copy() if needed or size < COPIED * self.taken else None

    def step_back(self) -> None:
        """Go back to the start of an abandoned frame, `begun`, from which the frame is stepped to the same bits."""
        assert self.begun is not None
        self.resume(self.begun)

    def divide_left(self, seconds: float) -> dict[str, float]:
        """Return the shares of parts in the time of an abandoned frame [s], as far as they are known."""
        return {}

    def holds(self) -> str:
        """Return what delays the present frame, in words; called while it is stepped."""
        return ""

    def take_due(self) -> list[Event]:
        """Return the recorded changes of the present frame, each once, in order."""
        due = [event for event in self.ahead if event.frame == self.frame]
        self.ahead = tuple(event for event in self.ahead if event.frame != self.frame)
        return due

    def check_time(self, point: Checkpoint) -> None:
        """Raise BadInput for a checkpoint whose time or step no frame of this scene has."""
        with fitting(self.loaded):
            steps, dt = int(point.text["steps"]), float(point.text["dt"])
            if point.frame < 0 or not math.isclose(point.t * self.loaded.scene.frame_rate, point.frame, abs_tol=1e-6):
                raise ContractError(f"the checkpoint's frame {point.frame} is not at t = {point.t:g} s")
            whole = self.steps * self.dt
            if not (0 < steps <= FINEST * self.steps and math.isclose(steps * dt, whole, rel_tol=1e-9)):
                raise ContractError(
                    f"the checkpoint's {steps} steps of dt = {dt:g} s are no frame, which is {whole:g} s"
                )

    def take_over(self, point: Checkpoint) -> None:
        """Copy state and solver memory from a checkpoint. Raises BadInput where they do not fit, before any change."""
        with fitting(self.loaded):
            check_kept(self.memory, point.memory)
        copy_into(self.arrays(), point.state)
        copy_into(self.memory.arrays, point.memory)
        self.frame = point.frame

    @property
    def checkpoints(self) -> int:
        """Number of checkpoints of a run."""
        return math.ceil(self.loaded.scene.frames / self.loaded.scene.checkpoint_frames)

    def describe_step(self, solver: str, limit: float) -> str:
        """Describe a solver by name, its step and the longest stable one [s], for `nuno plan`."""
        most = f"limit {limit * 1e3:.4g} ms" if math.isfinite(limit) else "nothing limits it"
        return f"{solver}, dt {self.dt * 1e3:.4g} ms, {self.steps} steps a frame; {most}"

    def describe_cost(self, seconds: float, size: int, memory: int, more: str = "") -> list[tuple[str, str]]:
        """Return rows with a run's cost, from a frame's time [s], recorded bytes of the cloth's or dye's arrays, and
        memory, for `nuno plan`.
        """
        scene = self.loaded.scene
        size += FILE + scene.frames * STATUS + sum(file.stat().st_size for file in assets(self.loaded).values())
        size += size // 20 + (SHOWN if scene.bodies else 0)
        rate = factor(1 / scene.frame_rate / seconds)
        return [
            ("frames", f"{scene.frames} in {scene.frames / scene.frame_rate:g} s{more}"),
            ("time", f"{roughly(seconds * scene.frames)}, {rate} real time (by a frame)"),
            ("storage", f"{data_size(size)} recorded, at most {data_size(memory)} of memory for the cloth"),
        ]

    def time_frame(self) -> float:
        """Return the wall time of the second frame from now [s]. Raises BadInput for one that is too long."""
        self.present()  # compiles
        for _ in range(2):
            start = time.perf_counter()
            with limited(self.leave, self.loaded.scene.frame_limit):
                report = self.step().report
            if report.status == "left":
                raise too_slow(self.loaded, f"frame {self.frame + 1} takes longer")
        return max(time.perf_counter() - start, 1e-9)


TOO_SLOW = 2
"""What `System.leave` is where a frame has taken too long."""
FASTER = "coarser cloth and accuracy: preview make frames faster"


def too_slow(loaded: Loaded, problem: str) -> BadInput:
    """Return the error for a frame that takes longer than the scene allows."""
    limit, remedy = f"{loaded.scene.frame_limit:g} s", f"{FASTER}; or give a larger limit"
    return loaded.at("frame_limit", BadInput(problem, limit=limit, remedy=remedy))


@contextmanager
def limited(leave: NDArray[np.int64], seconds: float | None) -> Iterator[None]:
    """Have solvers abandon what takes longer than a wall time [s], by `leave` of their System; None is no limit."""
    if seconds is None:
        yield
        return

    def end() -> None:
        leave[0] = leave[0] or TOO_SLOW

    timer = threading.Timer(seconds, end)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()
        leave[leave == TOO_SLOW] = 0


@contextmanager
def fitting(loaded: Loaded) -> Iterator[None]:
    """Raise any error about recorded data as BadInput."""
    try:
        yield
    except BadInput:
        raise
    except (ContractError, KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError) as error:
        text = f"it lacks {error}" if isinstance(error, KeyError) else str(error)
        problem, remedy = f"the recording is damaged: {text}", "take another copy, or run its scene again"
        raise BadInput(problem, loaded.file, remedy=remedy) from None


def check_kept(memory: Memory, recorded: Arrays) -> None:
    """Raise ContractError for entries outside the bounds of a solver's memory, `Memory.bounds`."""
    for name, values in recorded.items():
        if name in memory.bounds:
            check_array(MEMORY + name, values, values.dtype.type, values.shape, memory.bounds[name])
        elif name in memory.arrays and values.dtype.kind in "iu":
            raise ContractError(f"{MEMORY}{name} holds integers that its solver gives no bounds for, in Memory.bounds")


def require_memory(loaded: Loaded, field: str, number: int, noun: str, size: int, remedy: str) -> None:
    """Raise BadInput, at the scene's `field`, for vertices or cells that need more memory than is free, or are far more
    than those of the scene's recording.
    """
    value, known = f"{number:,} {noun}", loaded.recorded_sizes.get(noun)
    if known is not None and number > GROWN * known + FEW:
        remedy = "take another copy of the recording"
        error = BadInput("the scene is not the one that was recorded", value=value, limit=f"{known:,}", remedy=remedy)
        raise loaded.at(field, error)
    available = psutil.virtual_memory().available
    if size > available:
        value, limit = f"{value}, about {size / 2**30:.1f} GiB", f"{available / 2**30:.1f} GiB are free"
        error = BadInput("the scene does not fit in memory", value=value, limit=limit, remedy=remedy)
        raise loaded.at(field, error)


def hash_of(arrays: Iterable[NDArray[Any] | np.generic]) -> str:
    """Return a hash of the bits of arrays."""
    hasher = hashlib.blake2b(digest_size=16)
    for values in arrays:
        hasher.update(np.ascontiguousarray(values).data)
    return hasher.hexdigest()


def copy_into(target: Arrays, source: Arrays, some: bool = False) -> None:
    """Copy the values of arrays of the same names, or of `some` of them. Raises BadInput for other arrays."""
    for name in source if some else target | source:
        here, there = (f"{a[name].dtype} {a[name].shape}" if name in a else "nothing" for a in (target, source))
        if here != there:
            problem, remedy = "the checkpoint does not fit this scene", "resume with the recording's own scene"
            raise BadInput(problem, value=f"{name}, {there}", limit=here, remedy=remedy)
    for name, values in source.items():
        np.copyto(target[name], values)


# Resimulation of a recording from a checkpoint, with the changes that were made during its run.


def changes_of(recording: Recording, service: str) -> list[Event]:
    """Return the control events that changed a service's cloth or dye during the run, in order. Raises BadInput."""
    return [event for event in control_events(recording) if event.service == service and event.text in CHANGES]


def take_up(stepper: Stepper, recording: Recording, point: Checkpoint) -> None:
    """Bring a new stepper to a checkpoint of its scene's recording, with the changes after it `ahead`. Raises BadInput
    where it does not fit.
    """
    changes = changes_of(recording, stepper.service)
    made = [event for event in changes if event.frame <= point.frame]
    stepper.resume(point, made)
    stepper.steered = tuple(describe_changes(made))
    stepper.ahead = tuple(event for event in changes if event.frame > point.frame)


def resume(stepper: Stepper, path: Path) -> None:
    """Bring a new stepper to the last checkpoint of a recording. Raises BadInput."""
    with open_recording(path) as recording:
        point = recording.last_checkpoint(recording.common_checkpoint().t, stepper.kept.name)
        if point.frame > (frames := stepper.loaded.scene.frames):
            problem, remedy = "the recording goes on after the end of the scene", "lengthen it: --set duration=10s"
            value, limit = f"frame {point.frame}", f"{frames} frames"
            raise BadInput(problem, str(path), value=value, limit=limit, remedy=remedy)
        if not all(np.isfinite(values).all() for values in point.state.values()):
            problem, remedy = "the last checkpoint is not finite: its run diverged", "run its scene with a shorter step"
            raise BadInput(problem, str(path), value=f"frame {point.frame}", remedy=remedy)
        take_up(stepper, recording, point)
        status = recording.last(stepper.status.name, point.t)
        said = {} if status is None else recording.said(status)
        stepper.resumed = said if said.get("frame") == point.frame else {}


RECORDED = "resume with the plugins that it was recorded with (nuno info names their versions), or run the scene anew"


def require_recorded(recording: Recording, topic: Topic, here: Mapping[str, NDArray[Any]]) -> None:
    """Raise BadInput where a resumed run's constant arrays are none that were recorded in a topic: the scene's models,
    as of a changed plugin, build something else. What was changed during the run comes from the checkpoint.
    """

    def same(name: str, recorded: Arrays) -> bool:
        there = recorded.get(name, here[name])
        return here[name].shape == there.shape and np.allclose(here[name], there, rtol=1e-5)

    differing: str | None = None
    for message in recording.messages([topic.name]):
        recorded, _ = recording.arrays(message)
        if (differing := next((name for name in here if not same(name, recorded)), None)) is None:
            return
    if differing is not None:
        problem = "the scene's models build other cloth now"
        raise BadInput(problem, str(recording.path), field=differing, remedy=RECORDED)


class Resimulation:
    """Cloth or dye of a recording, which can be stepped to any frame."""

    def __init__(self, recording: Recording, stepper: Stepper, start: Recorded | None = None) -> None:
        """Begin at a checkpoint's message, by default at the scene's start. Raises BadInput."""
        self.stepper = stepper
        stepper.ahead = tuple(changes_of(recording, stepper.service))
        if start is not None:
            take_up(stepper, recording, recording.checkpoint(start))
        stepper.present()

    @property
    def changing(self) -> bool:
        """Whether changes of the present frame are not applied yet."""
        return any(event.frame == self.stepper.frame for event in self.stepper.ahead)

    def change(self) -> None:
        """Apply the changes of the present frame, each once, in order."""
        for event in self.stepper.take_due():
            apply = self.stepper.set if event.text == "set" else self.stepper.add
            apply(str(event.args["item"]))

    def go_to(self, frame: int) -> None:
        """Step to a frame, with the changes before it."""
        while self.stepper.frame < frame:
            self.change()
            self.stepper.step()

    def comes_to(self, digest: str | None) -> bool:
        """Return whether the present state has this digest, before or after the frame's changes.

        The first frame, of this run or of a resumed one, contains the changes before it already.
        """
        if self.stepper.digest() != digest:
            self.change()
        return self.stepper.digest() == digest
