"""What the explicit integrators share: one compiled loop over a frame's steps, and its limits."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numba
import numpy as np
from pydantic import BaseModel

from nuno_integrators.profile import profile_steps
from nuno_kernels import threads_available
from nuno_kernels.acceleration import Packed
from nuno_kernels.bindings import set_binding_poses
from nuno_kernels.contact import count_contacts, set_poses
from nuno_kernels.energy import measure_energy
from nuno_kernels.packing import pack, python_terms, silence_bodies, thread_count, to_rows
from nuno_kernels.stability import measure_rates, stable_step
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Float, Memory, State
from nuno_schemas.plugin import Config, StepLimit, StepReport, System

CHECKPOINTED = ("anchor", "anchor_frame")
"""Arrays of the contact tuple that are part of the state."""


class NoConfig(Config):
    """An explicit integrator has nothing to configure but its step."""


@dataclass
class Work:
    """Kernel layout of one system: x, v and the stages' buffers are rows (3, n)."""

    packed: Packed
    x: Float
    v: Float
    stages: Float


class Explicit(ABC):
    """An integrator whose `loop(x, v, stages, steps, dt, packed, extra)` is compiled.

    With a force written in Python the same source runs interpreted, over compiled parts.
    """

    name: ClassVar[str]
    Config: ClassVar[type[BaseModel]] = NoConfig
    order: ClassVar[int]
    explicit: ClassVar[bool] = True
    buffers: ClassVar[int]
    loop: ClassVar[Any]

    def prepare(self, config: BaseModel, system: System, state: State) -> Memory:
        """Memory for this system. Raises BadInput for a force that no kernel knows."""
        packed = self.adapt(pack(system))
        n = system.fabric.number
        arrays = {} if packed.contact is None else {name: getattr(packed.contact, name) for name in CHECKPOINTED}
        work = Work(packed, np.empty((3, n)), np.empty((3, n)), np.empty((self.buffers, 3, n)))
        return Memory(arrays, work)

    def adapt(self, packed: Packed) -> Packed:
        """The packed system as this method reads it."""
        return packed

    def limit(self, config: BaseModel, system: System, state: State) -> StepLimit:
        """Largest stable step [s] in the present state, from bounds on its frequency and damping."""
        omega, damping = measure_rates(system, state)
        return StepLimit(stable_step(self.amplification, omega, damping, system.damping), omega, damping)

    def advance(
        self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None, steps: int, dt: float
    ) -> StepReport:
        """Advance `state` in place by `steps` steps of `dt` [s]; see nuno_schemas.plugin.Integrator."""
        began = time.perf_counter()
        work: Work = memory.work  # type: ignore[assignment]
        packed = _set_poses(work.packed, poses)
        _restore(packed, memory)
        loop, extra = self._enter(system, state, work, state.t + steps * dt)
        loop(work.x, work.v, work.stages, steps, dt, packed, extra)
        state.x[...] = work.x.T
        state.v[...] = work.v.T
        state.t += steps * dt
        return _report(system, work, packed, steps, time.perf_counter() - began)

    def profile(
        self, system: System, state: State, memory: Memory, poses: tuple[Poses, Poses] | None
    ) -> Mapping[str, float]:
        """Wall time of a step by part [s]; see nuno_schemas.plugin.Integrator."""
        work: Work = memory.work  # type: ignore[assignment]
        packed = _set_poses(work.packed, poses)
        _restore(packed, memory)
        loop, extra = self._enter(system, state, work, state.t)
        return profile_steps(loop, packed, work.x, work.v, work.stages, extra)

    def _enter(self, system: System, state: State, work: Work, end: float) -> tuple[Any, Any]:
        """Put the state into the kernels' layout; the loop to call and the forces written in Python."""
        if work.packed.threads is not None:
            numba.set_num_threads(work.packed.threads)
        to_rows(state.x, work.x)
        to_rows(state.v, work.v)
        extra = python_terms(system, state.t, end)
        loop: Any = type(self).loop
        return (loop if extra is None else loop.py_func), extra

    def about(self, system: System) -> str:
        """Threads for this system, and what limits them."""
        count, available = thread_count(system), threads_available()
        if count == 1 and available[0] > 1 and system.threads > 1:
            return f"1 thread: {system.fabric.number:,} vertices are fewer than several threads pay for"
        return f"{count} thread{'s' if count > 1 else ''} of {available[0]} ({available[1]})"

    @abstractmethod
    def amplification(self, omega: float, damping: float, dt: float) -> Float:
        """(2, 2) matrix of one step on x'' = -omega^2 x - damping x', state (x, v)."""


def _set_poses(packed: Packed, poses: tuple[Poses, Poses] | None) -> Packed:
    """Write the interval into contact and bindings; without poses there is nothing to meet or to follow."""
    if poses is None:
        return silence_bodies(packed)
    if packed.contact is not None:
        set_poses(packed.contact, *poses)
    if packed.bindings is not None:
        set_binding_poses(packed.bindings, *poses)
    return packed


def _restore(packed: Packed, memory: Memory) -> None:
    """Take over arrays that a checkpoint put in the place of the solver's own."""
    for name, array in memory.arrays.items():
        own = getattr(packed.contact, name)
        if array is not own:
            own[...] = array
            memory.arrays[name] = own


def _report(system: System, work: Work, packed: Packed, steps: int, seconds: float) -> StepReport:
    energy = measure_energy(
        work.x, work.v, system.fabric.mass, packed._replace(gravity=np.asarray(system.gravity, np.float64))
    )
    counts = {"zero_length_springs": int(energy.zero_length)}
    if packed.contact is not None:
        counts |= count_contacts(packed.contact)
    finite = np.isfinite(work.x).all(axis=0) & np.isfinite(work.v).all(axis=0)
    told = {
        "kinetic": energy.kinetic,
        "gravitational": energy.gravitational,
        "springs": energy.springs,
        "hinges": energy.hinges,
    }
    if finite.all():
        return StepReport("ok", steps, "", {"steps": seconds}, counts, told, energy.stretch)
    first, total = int(np.argmin(finite)), int((~finite).sum())
    message = f"vertex {first} has no finite position or velocity ({total} of {finite.shape[0]} vertices)"
    return StepReport("diverged", steps, message, {"steps": seconds}, counts, told, energy.stretch)
