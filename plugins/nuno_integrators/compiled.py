"""What the integrators share: a system in the kernels' layout, its limits, and the report of a frame."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numba
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from nuno_integrators.forces import find_forces, find_touched, undisturbed
from nuno_integrators.nonfinite import find_first, find_lost, say_lost
from nuno_integrators.profile import profile_steps
from nuno_integrators.residual import unbalance
from nuno_integrators.stability import measure_rates, stable_step
from nuno_integrators.thread_tuning import ThreadTuning
from nuno_kernels import threads_available
from nuno_kernels.forces.energy import measure_energy
from nuno_kernels.step.acceleration import Extra, Packed, evaluate
from nuno_kernels.step.packing import (
    call_each,
    hold_over,
    making_lists,
    pack,
    python_terms,
    silence,
    silence_bodies,
    thread_count,
    to_rows,
)
from nuno_kernels.terms import kernels_of
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Fabric, Float, Int, Memory, State
from nuno_schemas.layout import Bounds
from nuno_schemas.system import Forces, StepLimit, StepReport, System, Term, Touched

AGAIN = 5.0
"""Steps that took this long [s] are not taken again to see where vertices were lost."""


@dataclass
class Work:
    """Kernel layout of one system: x, v and the stages' buffers are rows (3, n)."""

    packed: Packed
    x: Float
    v: Float
    stages: Float
    pace: ThreadTuning | None = field(default=None, init=False)
    """None where one thread runs."""

    def __post_init__(self) -> None:
        if self.packed.threads is not None:
            self.pace = ThreadTuning(self.packed.threads)

    def kept(self) -> dict[str, NDArray[Any]]:
        """Arrays that are part of the state."""
        return {}

    def bounds(self) -> dict[str, Bounds]:
        """Bounds of their entries."""
        return {}


@dataclass(frozen=True)
class Told:
    """What a method says of the steps it took: `problem` is empty where all is well."""

    steps: int
    problem: str = ""
    totals: Mapping[str, int] = field(default_factory=dict)


class Compiled(ABC):
    """An integrator whose steps are compiled for just the forces of a system."""

    name: ClassVar[str]
    Config: ClassVar[type[BaseModel]]
    order: ClassVar[int]
    explicit: ClassVar[bool]
    adaptive: ClassVar[bool] = False
    holds: ClassVar[bool] = True
    """Whether its steps are so small that forces far softer than tension may be held over several."""

    def prepare(self, config: Any, system: System, state: State, without: Sequence[str] = ()) -> Memory:
        """Memory for this system, in which the terms of some names do nothing. Raises BadInput for a force that no
        kernel knows.
        """
        packed = pack(system)
        packed = silence(self.adapt(hold_over(packed) if self.holds else packed), *without)
        work = self.make_work(config, system, packed)
        arrays, bounds = _own_arrays(packed, work)
        return Memory(arrays, work, bounds)

    @abstractmethod
    def make_work(self, config: Any, system: System, packed: Packed) -> Work:
        """Buffers of the method."""

    @abstractmethod
    def go(self, work: Any, packed: Packed, extra: Extra, steps: int, dt: float) -> Told:
        """Bring work.x and work.v from the start of an interval of steps * dt [s] to its end."""

    @abstractmethod
    def compile(self, work: Any, packed: Packed, extra: Extra) -> None:
        """Compile what `go` needs, changing nothing: a run's own time is then without it."""

    @abstractmethod
    def step_at_rest(self, work: Any, extra: Extra) -> Any:
        """A function (x, v, stages, steps, dt, packed, extra) of the cost of the method's steps, for `profile`."""

    def adapt(self, packed: Packed) -> Packed:
        """The packed system as this method reads it."""
        return packed

    def damped(self, packed: Packed, damping: float) -> Packed:
        """The packed system under another damping, which may change from frame to frame; none stays none."""
        return packed if packed.damping == 0.0 else packed._replace(damping=damping)

    def limit(self, config: Any, system: System, state: State) -> StepLimit:
        """Largest stable step [s] in the present state, from bounds on its frequency and damping."""
        omega, damping = measure_rates(system, state)
        return StepLimit(stable_step(self.amplification, omega, damping, system.damping), omega, damping)

    def advance(
        self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None, steps: int, dt: float
    ) -> StepReport:
        """Advance `state` in place by `steps` steps of `dt` [s]; see nuno_schemas.plugin.Integrator."""
        began = time.perf_counter()
        work: Work = memory.work  # type: ignore[assignment]
        work.packed = self.damped(work.packed, float(system.damping))
        packed = _set_poses(work.packed, poses)
        _restore(packed, work, memory)
        extra = _enter(system, state, work, state.t + steps * dt)
        call_each(packed, "begin", work.x, steps * dt, packed.threads)
        if steps == 0:
            self.compile(work, packed, extra)
        started = time.perf_counter()
        told = self.go(work, packed, extra, steps, dt) if steps else Told(0)
        seconds = time.perf_counter() - started
        if steps and system.leave[0]:
            return StepReport("left", 0)
        if work.pace is not None:
            work.pace.took(seconds, told.totals.get("evaluations", told.steps))
        lost = self._say_lost(system, state, work, poses, steps, dt, seconds)
        state.x[...] = work.x.T
        state.v[...] = work.v.T
        state.t += steps * dt
        return _report(system, work, packed, told, lost, time.perf_counter() - began)

    def _say_lost(
        self, system: System, before: State, work: Work, poses: tuple[Poses, Poses] | None, steps: int, dt: float,
        seconds: float,
    ) -> str:  # fmt: skip
        """What is said of vertices without a finite position or velocity, nothing where there are none.

        To find the first of them the interval's steps are taken again, with bodies where they were at its start: not
        where they took long already, and not of one step alone, which would tell no more than its end.
        """
        lost = find_lost(work.x, work.v)
        first, step = lost, 0
        if lost.any() and steps > 1 and seconds < AGAIN:
            packed = _set_poses(work.packed, poses and (poses[0], poses[0]))

            def go(taken: int, more: int) -> None:
                extra = python_terms(system, before.t + taken * dt, before.t + (taken + more) * dt)
                call_each(packed, "begin", work.x, more * dt, packed.threads)
                self.go(work, packed, extra, more, dt)

            first, step = find_first(before, work.x, work.v, go, steps)
        return say_lost(system.fabric, before, lost, first, f"in step {step} of {steps}" if step else "")

    def profile(
        self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None
    ) -> Mapping[str, float]:
        """See nuno_schemas.plugin.Integrator."""
        work: Work = memory.work  # type: ignore[assignment]
        packed = _set_poses(work.packed, poses)
        _restore(packed, work, memory)
        extra = _enter(system, state, work, state.t)
        return profile_steps(self.step_at_rest(work, extra), packed, work.x, work.v, work.stages, extra)

    def making_lists(self, memory: Memory) -> tuple[str, ...]:
        """See nuno_schemas.plugin.Integrator."""
        work: Work = memory.work  # type: ignore[assignment]
        return making_lists(work.packed)

    def pinched(self, memory: Memory) -> Sequence[tuple[Int, Float]]:
        """Of each term that tells: pieces (k,) and places (k, 3) [m] of vertices that cannot go on; in a step, too."""
        work: Work = memory.work  # type: ignore[assignment]
        return call_each(work.packed, "pinched")

    def unbalance(self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None) -> Float:
        """See nuno_schemas.plugin.Integrator."""
        work: Work = memory.work  # type: ignore[assignment]
        packed = _set_poses(work.packed, poses)
        extra = _enter(system, state, work, state.t)
        force = np.empty_like(work.x)
        evaluate(work.x, np.zeros_like(work.v), 1.0, force, packed, extra)
        force *= np.where(system.fabric.pinned, 0.0, system.fabric.mass)
        call_each(packed, "unbalance", work.x, force)
        return unbalance(system.fabric, state.x, state.v, force.T)

    def forces(self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None) -> Forces:
        """See nuno_schemas.plugin.Integrator."""
        work: Work = memory.work  # type: ignore[assignment]
        packed = _set_poses(undisturbed(work.packed), poses)
        extra = _enter(system, state, work, state.t)
        return find_forces(system, state, packed, work.x, work.v, extra, poses)

    def touched(self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses]) -> Touched:
        """See nuno_schemas.plugin.Integrator."""
        work: Work = memory.work  # type: ignore[assignment]
        packed, extra = undisturbed(work.packed), _enter(system, state, work, state.t)
        # After a change, or from a checkpoint, what makes lists has none before its next step.
        call_each(_set_poses(packed, (poses[1], poses[1])), "begin", work.x, 0.0, packed.threads)
        free = self.free_forces(system, work, packed, extra)
        _set_poses(packed, poses)
        return find_touched(system, packed, work.x, self.felt_at(work, packed, extra), extra, poses[1], free)

    def free_forces(self, system: System, work: Any, packed: Packed, extra: Extra) -> Float | None:
        """(n, 3) forces [N] as steps find them where nothing is slid on; None where that is what their laws say."""
        return None

    def felt_at(self, work: Any, packed: Packed, extra: Extra) -> Float:
        """(3, n) the velocity by which contact was felt at the end of the last step; that of the state unless told."""
        v: Float = work.v
        return v

    def about(self, system: System) -> str:
        """Threads for this system, and what limits them."""
        count, available = thread_count(system), threads_available()
        if count == 1 and available[0] > 1 and system.threads > 1:
            return f"1 thread: {system.fabric.number:,} vertices are fewer than several threads pay for"
        fewer = ", or 1 in frames where that is faster" if count > 1 else ""
        return f"{count} thread{'s' if count > 1 else ''} of {available[0]} ({available[1]}){fewer}"

    @abstractmethod
    def amplification(self, omega: float, damping: float, dt: float) -> Float:
        """(2, 2) matrix of one step on x'' = -omega^2 x - damping x', state (x, v)."""


def _enter(system: System, state: State, work: Work, end: float) -> Extra:
    """Put the state into the kernels' layout; the forces written in Python, or None."""
    if work.pace is not None:
        numba.set_num_threads(work.pace.choose() if state.t < end else work.pace.threads)
    to_rows(state.x, work.x)
    to_rows(state.v, work.v)
    return python_terms(system, state.t, end)


def lacking(terms: Sequence[Term], role: str) -> list[str]:
    """Names of the forces, in Python or by blocks, that have nothing for a role (nuno_kernels.terms)."""
    return sorted(
        {
            term.name
            for term in terms
            if callable(term.data)
            or any(part.block is not None and part.find(role) is None for part in map(kernels_of, term.data))
        }
    )


def source_of(loop: Any, extra: object) -> Any:
    """A compiled loop; with a force written in Python the same source runs interpreted, over compiled parts."""
    return loop if extra is None else loop.py_func


def cloth_size(fabric: Fabric) -> float:
    """Diagonal of the cloth's bounding box at the start [m], 1 where it has none."""
    if fabric.number == 0:
        return 1.0
    return float(np.linalg.norm(np.ptp(fabric.position, axis=0))) or 1.0


def _set_poses(packed: Packed, poses: tuple[Poses, Poses] | None) -> Packed:
    """Write the interval into contact and bindings; without poses there is nothing to meet or to follow."""
    if poses is None:
        return silence_bodies(packed)
    call_each(packed, "interval", *poses)
    return packed


def _own_arrays(packed: Packed, work: Work) -> tuple[dict[str, NDArray[Any]], dict[str, Bounds]]:
    """The method's own arrays that are part of the state, and the bounds of their entries."""
    arrays: dict[str, NDArray[Any]] = {}
    bounds: dict[str, Bounds] = {}
    for term in {id(term): term for term in (*packed.forces, *packed.bodies)}.values():
        kernels = kernels_of(term)
        own = kernels.bounds(term) if kernels.bounds else {}
        for name in kernels.memory:
            key = name if name not in arrays else f"{name}-{len(arrays)}"
            arrays[key] = getattr(term, name)
            if name in own or arrays[key].dtype.kind == "f":
                bounds[key] = own.get(name, Bounds())
    return arrays | work.kept(), bounds | work.bounds()


def _restore(packed: Packed, work: Work, memory: Memory) -> None:
    """Take over arrays that a checkpoint put in the place of the method's own."""
    for name, own in _own_arrays(packed, work)[0].items():
        array = memory.arrays[name]
        if array is not own:
            own[...] = array
            memory.arrays[name] = own


def _report(system: System, work: Work, packed: Packed, told: Told, lost: str, seconds: float) -> StepReport:
    energy = measure_energy(
        work.x, work.v, system.fabric.mass, packed._replace(gravity=np.asarray(system.gravity, np.float64))
    )
    counts = {"zero_length_springs": int(energy.zero_length)}
    for found in call_each(packed, "counts"):
        counts |= {name: counts.get(name, 0) + number for name, number in found.items()}
    status: Literal["ok", "diverged", "unconverged"] = "diverged" if lost else "unconverged" if told.problem else "ok"
    message = lost or told.problem
    times = {"steps": seconds}
    return StepReport(status, told.steps, message, times, counts, energy.kinds, energy.stretch, told.totals)
