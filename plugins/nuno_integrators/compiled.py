"""The base of all integrators: the system in the kernels' layout, its limits, and the report of a frame."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any, ClassVar, Literal

import numba
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from nuno_integrators.diagnostics import (
    describe_nonfinite,
    find_first,
    find_forces,
    find_nonfinite,
    find_touched,
    profile_steps,
    unbalance,
    undisturbed,
)
from nuno_integrators.packing import (
    hold_over,
    making_lists,
    pack,
    reads_time,
    silence,
    silence_bodies,
    thread_count,
)
from nuno_kernels import threads_available
from nuno_kernels.forces.energy import measure_energy
from nuno_kernels.forces.python import raise_error
from nuno_kernels.step.acceleration import Packed, evaluate
from nuno_kernels.terms import call_each, kernels_of
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Fabric, Float, Int, Memory, State
from nuno_schemas.layout import Bounds
from nuno_schemas.system import Forces, StepLimit, StepReport, System, Term, Touched

# The number of threads that steps fastest at present, which depends on the machine's load, not on the mesh alone.
#
# Threads meet after every pass over the vertices. Where another process has one of the cores, each meeting waits
# for it, and two threads are several times slower than one; where it has not, they are up to twice as fast. The
# result is the same to the last bit, so the number may change from frame to frame by what the frames took.

TRY_AGAIN = 24
"""frames after which the other number is tried for one"""
SLOWER = 1.2
"""factor by which one frame may raise the known time of a number of threads"""
BETTER = 0.95
"""share of the present time that a change must promise: times vary by a few percent"""


class ThreadTuning:
    """Chooses between one thread and `most` by the time that an evaluation took with each."""

    def __init__(self, most: int) -> None:
        self.most, self.threads, self.used, self.frames = most, most, most, 0
        self.taken: dict[int, float] = {}

    def choose(self) -> int:
        """Return the threads for the next frame. The first one is not counted: its data are not yet in the caches."""
        self.frames += 1
        other = 1 if self.threads == self.most else self.most
        again = self.frames == 3 or self.frames % TRY_AGAIN == 0
        self.used = other if again else self.threads
        return self.used

    def took(self, seconds: float, work: int) -> None:
        """Note the time of the frame just chosen for, and its work (steps, or evaluations)."""
        if work < 1 or self.frames == 1:
            return
        # A single slow frame is a disturbance; a second one is a change.
        self.taken[self.used] = min(seconds / work, SLOWER * self.taken.get(self.used, math.inf))
        best = min(self.taken, key=self.taken.__getitem__)
        if self.taken[best] < BETTER * self.taken.get(self.threads, 0.0):
            self.threads = best


AGAIN = 5.0
"""Steps that took this long [s] are not repeated to find where vertices became non-finite."""


@dataclass
class Work:
    """Buffers of one system, rows (3, n): the state's own x and v while a method works on it, and stages."""

    packed: Packed
    x: Float = field(init=False)
    v: Float = field(init=False)
    stages: Float
    arrays: dict[str, NDArray[Any]] = field(init=False)
    """the terms' and the method's arrays that are part of the state"""
    tuning: ThreadTuning | None = field(default=None, init=False)
    """None where one thread runs"""

    def __post_init__(self) -> None:
        if self.packed.threads is not None:
            self.tuning = ThreadTuning(self.packed.threads)

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that are part of the state."""
        return {}

    def bounds(self) -> dict[str, Bounds]:
        """Return the bounds of their entries."""
        return {}


@dataclass(frozen=True)
class StepResult:
    """The result of a method's steps: `problem` is empty where they succeeded."""

    steps: int
    problem: str = ""
    totals: Mapping[str, int] = field(default_factory=dict)


class Compiled(ABC):
    """An integrator by compiled steps."""

    name: ClassVar[str]
    Config: ClassVar[type[BaseModel]]
    order: ClassVar[int]
    explicit: ClassVar[bool]
    adaptive: ClassVar[bool] = False
    holds: ClassVar[bool] = True
    """whether its steps are so small that forces far softer than tension may be held over several of them"""

    def prepare(self, config: Any, system: System, state: State, without: Sequence[str] = ()) -> Memory:
        """Return the memory for a system in which the terms named in `without` do nothing. Raises BadInput for a force
        without kernels.
        """
        packed = pack(system)
        packed = silence(self.adapt(hold_over(packed) if self.holds else packed), *without)
        work = self.make_work(config, system, packed)
        work.arrays, bounds = _state_arrays(work)
        return Memory(dict(work.arrays), work, bounds, self.about(system), making_lists(packed), not reads_time(system))

    @abstractmethod
    def make_work(self, config: Any, system: System, packed: Packed) -> Work:
        """Allocate the method's buffers."""

    @abstractmethod
    def go(self, work: Any, packed: Packed, steps: int, dt: float) -> StepResult:
        """Advance work.x and work.v from the start of an interval of steps * dt [s] to its end."""

    def compile(self, work: Any, packed: Packed) -> None:
        """Compile what `go` needs and change nothing, so that compilation does not count as the run's time."""
        self.go(work, packed, 0, 1.0)

    @abstractmethod
    def steps_of(self, work: Any) -> Any:
        """Return a function (x, v, stages, steps, dt, packed) that costs as much as the steps, for `profile`."""

    def adapt(self, packed: Packed) -> Packed:
        """Return the packed system as this method reads it."""
        return packed

    def damped(self, packed: Packed, damping: float) -> Packed:
        """Return the system with another damping, which may change in each frame; an undamped one stays so."""
        return packed if packed.damping == 0.0 else packed._replace(damping=damping)

    @abstractmethod
    def limit(self, config: Any, system: System, state: State) -> StepLimit:
        """Return the largest stable step [s] in the present state, from bounds on its frequency and damping."""

    def advance(
        self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None, steps: int, dt: float
    ) -> StepReport:
        """Advance `state` in place by `steps` steps of `dt` [s]; see nuno_schemas.plugin.Integrator."""
        began = time.perf_counter()
        before = state.begun if state.begun and steps else (state.x.copy(order="F"), state.v.copy(order="F"))
        with _entered(system, state, memory, state.t + steps * dt) as work:
            work.packed = self.damped(work.packed, float(system.damping))
            packed = _set_poses(work.packed, poses)
            call_each(packed, "begin", work.x, steps * dt, packed.threads)
            if steps == 0:
                self.compile(work, packed)
            started = time.perf_counter()
            result = self.go(work, packed, steps, dt) if steps else StepResult(0)
            seconds = time.perf_counter() - started
        if steps and system.leave[0]:
            state.x[...], state.v[...] = before
            return StepReport("left", 0)
        if work.tuning is not None:
            work.tuning.took(seconds, result.totals.get("evaluations", result.steps))
        failure = ""
        if find_nonfinite(work.x, work.v).any():
            failure = self._describe_nonfinite(system, State(*before, state.t), work, poses, steps, dt, seconds)
        state.t += steps * dt
        return _report(system, work, packed, result, failure, time.perf_counter() - began)

    def _describe_nonfinite(
        self, system: System, before: State, work: Work, poses: tuple[Poses, Poses] | None, steps: int, dt: float,
        seconds: float,
    ) -> str:  # fmt: skip
        """Describe the vertices without a finite position or velocity.

        To find the first of them the interval's steps are repeated, with bodies where they were at its start; but not
        if they took long already, and not a single step, which would tell no more than its end.
        """
        nonfinite = find_nonfinite(work.x, work.v)
        first, step = nonfinite, 0
        if steps > 1 and seconds < AGAIN:
            packed = _set_poses(work.packed, poses and (poses[0], poses[0]))

            def go(taken: int, more: int) -> None:
                packed.time[:] = before.t + taken * dt, more * dt
                call_each(packed, "begin", work.x, more * dt, packed.threads)
                self.go(work, packed, more, dt)

            first, step = find_first(before, work.x, work.v, go, steps)
        return describe_nonfinite(system.fabric, before, nonfinite, first, f"in step {step} of {steps}" if step else "")

    def profile(
        self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None
    ) -> Mapping[str, float]:
        """See nuno_schemas.plugin.Inspected."""
        with _entered(system, state.copy(), memory, state.t) as work:
            packed = _set_poses(work.packed, poses)
            return profile_steps(self.steps_of(work), packed, work.x, work.v, work.stages)

    def pinched(self, memory: Memory) -> Sequence[tuple[Int, Float]]:
        """Return pieces (k,) and places (k, 3) [m] of stuck vertices of each term; also within a step."""
        work: Work = memory.work  # type: ignore[assignment]
        return call_each(work.packed, "pinched")

    def unbalance(self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None) -> Float:
        """See nuno_schemas.plugin.Inspected."""
        with _entered(system, state.copy(), memory, state.t) as work:
            packed = _set_poses(work.packed, poses)
            force = np.empty_like(work.x)
            evaluate(work.x, np.zeros_like(work.v), 1.0, force, packed)
            force *= np.where(system.fabric.pinned, 0.0, system.fabric.mass)
            call_each(packed, "unbalance", work.x, force)
            return unbalance(system.fabric, state.x, state.v, force.T)

    def forces(self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None) -> Forces:
        """See nuno_schemas.plugin.Inspected."""
        with _entered(system, state.copy(), memory, state.t) as work:
            packed = undisturbed(work.packed)
            if poses is not None:
                self._begin_at(packed, work, poses[1])
            packed = _set_poses(packed, poses)
            felt = self.felt_at(work, packed), self.unkicked(work)
            return find_forces(system, state, packed, work.x, work.v, poses, *felt)

    def touched(self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses]) -> Touched:
        """See nuno_schemas.plugin.Inspected."""
        with _entered(system, state.copy(), memory, state.t) as work:
            packed = undisturbed(work.packed)
            self._begin_at(packed, work, poses[1])
            free = self.free_forces(system, work, packed)
            _set_poses(packed, poses)
            return find_touched(system, packed, work.x, self.felt_at(work, packed), poses[1], free)

    def _begin_at(self, packed: Packed, work: Any, poses: Poses) -> None:
        """Make the lists of contact, which has none after a change, or from a checkpoint, before its next step."""
        call_each(_set_poses(packed, (poses, poses)), "begin", work.x, 0.0, packed.threads)

    def free_forces(self, system: System, work: Any, packed: Packed) -> Float | None:
        """Return the forces (n, 3) [N] of steps without sliding; None where they are those of the laws."""
        return None

    def felt_at(self, work: Any, packed: Packed) -> Float:
        """Return the velocity (3, n) by which contact was felt at the end of the last step: that of the state."""
        return np.asarray(work.v)

    def unkicked(self, work: Any) -> Collection[str]:
        """Return the parts that feel the state's velocity, where others feel that of `felt_at`."""
        return ()

    def about(self, system: System) -> str:
        """Describe the threads for this system, and what limits them."""
        count, available = thread_count(system), threads_available()
        if count == 1 and available[0] > 1 and system.threads > 1:
            return f"1 thread: {system.fabric.number:,} vertices are fewer than several threads pay for"
        fewer = ", or 1 in frames where that is faster" if count > 1 else ""
        return f"{count} thread{'s' if count > 1 else ''} of {available[0]} ({available[1]}){fewer}"


@contextmanager
def _entered(system: System, state: State, memory: Memory, end: float) -> Iterator[Any]:
    """Let a method work on a state, and copy a checkpoint's arrays into its own, for an interval that lasts until `end`
    [s]; yield the method's buffers. Raises the errors of forces in Python.
    """
    work: Work = memory.work  # type: ignore[assignment]
    for name, own in work.arrays.items():
        array = memory.arrays[name]
        if array is not own:
            own[...] = array
            memory.arrays[name] = own
    if work.tuning is not None:
        numba.set_num_threads(work.tuning.choose() if state.t < end else work.tuning.threads)
    work.x, work.v = state.x.T, state.v.T
    work.packed.time[:] = state.t, end - state.t
    yield work
    raise_error(work.packed.bodies, system.leave)


def lacking(terms: Sequence[Term], role: str) -> list[str]:
    """Return the names of the forces, in Python or by blocks, that lack a role (nuno_kernels.terms)."""
    return sorted(
        {
            term.name
            for term in terms
            if callable(term.data)
            or any("block" in part and part.find(role) is None for part in map(kernels_of, term.data))
        }
    )


def cloth_size(fabric: Fabric) -> float:
    """Return the diagonal of the cloth's bounding box at the start [m], 1 if it has no extent."""
    if fabric.number == 0:
        return 1.0
    return float(np.linalg.norm(np.ptp(fabric.position, axis=0))) or 1.0


def _set_poses(packed: Packed, poses: tuple[Poses, Poses] | None) -> Packed:
    """Write the interval into contact and bindings; without poses there are no bodies."""
    if poses is None:
        return silence_bodies(packed)
    call_each(packed, "interval", *poses)
    return packed


def _state_arrays(work: Work) -> tuple[dict[str, NDArray[Any]], dict[str, Bounds]]:
    """Return the terms' and the method's arrays that are part of the state, and the bounds of their entries."""
    arrays: dict[str, NDArray[Any]] = {}
    bounds: dict[str, Bounds] = {}
    for term in {id(term): term for term in (*work.packed.forces, *work.packed.bodies)}.values():
        kernels = kernels_of(term)
        term_bounds = kernels.bounds(term) if kernels.bounds else {}
        for name in kernels.memory:
            key = name.rpartition(".")[2]
            key = key if key not in arrays else f"{key}-{len(arrays)}"
            arrays[key] = attrgetter(name)(term)
            if name in term_bounds or arrays[key].dtype.kind == "f":
                bounds[key] = term_bounds.get(name, Bounds())
    return arrays | work.state_arrays(), bounds | work.bounds()


def _report(system: System, work: Work, packed: Packed, taken: StepResult, failure: str, seconds: float) -> StepReport:
    energy = measure_energy(
        work.x, work.v, system.fabric.mass, packed._replace(gravity=np.asarray(system.gravity, np.float64))
    )
    counts = {"zero_length_springs": int(energy.zero_length)}
    for term_counts in call_each(packed, "counts"):
        counts |= {name: counts.get(name, 0) + number for name, number in term_counts.items()}
    status: Literal["ok", "diverged", "unconverged"] = (
        "diverged" if failure else "unconverged" if taken.problem else "ok"
    )
    message = failure or taken.problem
    times = {"steps": seconds}
    return StepReport(status, taken.steps, message, times, counts, energy.kinds, energy.stretch, taken.totals)
