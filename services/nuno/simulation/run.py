"""The simulation's work: from a scene to frames, independent of how they are sent."""

from __future__ import annotations

import hashlib
import os
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.cloth import build
from nuno.scene.choose import decide
from nuno.scene.override import apply_override, overridden, parts_of
from nuno.scene.scene_file import Loaded, load
from nuno.scene.step import choose_step
from nuno.simulation.alter import carry
from nuno.simulation.changing import Changing
from nuno.simulation.relax import BALANCED, Relaxation, unsettled
from nuno_schemas.bodies import Geometry, Poses
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Int, Memory, State
from nuno_schemas.system import Forces, StepLimit, StepReport, System

REST_SPEED, REST_TIME = 1e-3, 0.1
"""Cloth rests when no vertex has been faster than this share of the cloth's size a second for this long [s]:
longer than a swing stands still where it turns."""

SETTABLE = ("gravity", "damping", "forces")
"""Fields that `set` may change while a run goes on."""


RELAXATION = "relaxation"
"""Array of the memory that damping which finds its own strength goes on from."""


@dataclass
class Frame:
    """One finished frame."""

    number: int
    report: StepReport
    seconds: float
    digest: str


class Simulation(Changing):
    """A scene's cloth, its solver and its state."""

    def __init__(self, loaded: Loaded, geometry: Geometry | None, poses: Poses | None, threads: int) -> None:
        self.loaded, self.geometry, self.threads = decide(loaded), geometry, threads or os.cpu_count() or 1
        self.fabric: Fabric
        self.fabric, self.pieces = build.build_fabric(loaded, geometry, poses)
        if loaded.scene.until == "balance" and (self.fabric.springs is None or self.fabric.springs.number == 0):
            problem, remedy = "cloth without springs has no tension to be in balance with", "take until: rest"
            raise loaded.at("until", BadInput(problem, value="balance", remedy=remedy))
        self.start_poses = poses
        self.begin_unchanged()
        self.state: State = build.start_state(self.fabric)
        self.frame = 0
        self.balanced = False
        """Whether a scene until balance has come to it."""
        self.idle = 0
        """Frames that were not stepped, since nothing would have changed."""
        self._still = False
        self._report = StepReport("ok", 0)
        self._size = float(np.linalg.norm(np.ptp(self.fabric.position, axis=0))) if self.fabric.number else 0.0
        self.system: System
        self.memory: Memory
        self.limit: StepLimit
        self._prepare({})
        for operation in self.loaded.operations:
            operation.plugin.compile()
        self.alter_due()

    def _prepare(self, arrays: dict[str, NDArray[Any]], source: Int | None = None) -> None:
        """(Re)build what follows from the scene; `arrays` is memory to keep, of vertices that were `source` before."""
        integrator = self.loaded.integrator
        self._still = False
        bodies = (self.geometry, self.start_poses)
        self.system = build.build_system(self.loaded, self.fabric, self.pieces, *bodies, self.threads)
        # The limit comes before the solver's memory: both at once would be a run's peak.
        self.limit = self._find_limit()
        self.steps, self.dt = choose_step(self.loaded, self.limit.dt, self.limit.resolved)
        self.memory = integrator.plugin.prepare(integrator.config, self.system, self.state)
        # A run that goes on from a checkpoint must come to rest in the same frame.
        self.slow_frames = np.zeros(1, np.int64)
        if self.loaded.scene.until == "rest":
            self.memory.arrays["slow_frames"] = self.slow_frames
        self.relaxation = None
        if _finds_damping(self.loaded):
            inertia = np.where(self.fabric.pinned, 0.0, self.fabric.mass)
            self.relaxation = Relaxation(self.loaded.scene.frame_rate, inertia)
            self.memory.arrays[RELAXATION] = self.relaxation.memory
        if source is not None:
            known = {name: values for name, values in arrays.items() if name in self.memory.arrays}
            arrays = {name: carry(values, self.memory.arrays[name], source) for name, values in known.items()}
        self._restore(arrays)

    def _find_limit(self) -> StepLimit:
        integrator = self.loaded.integrator
        try:
            with np.errstate(all="ignore"):
                start = self.state if self.frame == 0 or self.changes else build.start_state(self.fabric)
                found: StepLimit = integrator.plugin.limit(integrator.config, self.system, start)
        except (np.linalg.LinAlgError, ArithmeticError):
            found = StepLimit(np.nan, np.nan, np.nan)
        if np.isnan(found.dt):
            error = BadInput(
                "no stable step can be found: numbers of the scene are too large or too small for float64",
                remedy="look for a stiffness, mass or length that is off by many orders of magnitude",
            )
            raise self.loaded.at("objects", error)
        return found

    def _restore(self, arrays: dict[str, NDArray[Any]]) -> None:
        for name, values in arrays.items():
            target = self.memory.arrays.get(name)
            if target is None or target.shape != values.shape:
                raise BadInput(
                    "the checkpoint does not fit this scene",
                    value=f"memory {name} of shape {values.shape}",
                    remedy="resume with the recording's own scene",
                )
            np.copyto(target, values)

    @property
    def t(self) -> float:
        """Simulation time [s], from the frame number so that it never drifts."""
        return float(self.frame / self.loaded.scene.frame_rate)

    def advance(self, start: Poses | None, end: Poses | None) -> Frame:
        """Simulate one frame between two sets of poses."""
        begin = time.perf_counter()
        self.alter_due()
        poses = (start, end) if start is not None and end is not None else None
        unmoved = poses is None or _same(*poses)
        self.state.t = self.t
        if self._still and unmoved:
            report = replace(self._report, steps=0, totals={}, seconds={})
            self.idle += 1
        else:
            # What has any velocity moves: only standing cloth is worth a hash.
            before = self._content() if unmoved and not self.state.v.any() else ""
            plugin = self.loaded.integrator.plugin
            if self.relaxation is not None:
                self.system = replace(self.system, damping=self.relaxation.damping)
            report = plugin.advance(self.system, self.state, self.memory, poses, self.steps, self.dt)
            # A frame that changes nothing is followed by frames that change nothing.
            timeless = not any(term.in_python for term in self.system.terms)
            self._still = bool(before) and timeless and report.status == "ok" and before == self._content()
            self._report = report
        self.frame += 1
        self.state.t = self.t
        if self.loaded.scene.until == "rest":
            slow = self._size > 0.0 and float(np.abs(self.state.v).max(initial=0.0)) <= REST_SPEED * self._size
            self.slow_frames[0] = self.slow_frames[0] + 1 if slow else 0
        if self.relaxation is not None:
            self.relaxation.after(self.state)
        if self.loaded.scene.until == "balance" and report.status == "ok":
            report = self._weigh(report, (end, end) if end is not None else None)
        return Frame(self.frame, report, time.perf_counter() - begin, self.digest())

    def _weigh(self, report: StepReport, poses: tuple[Poses, Poses] | None) -> StepReport:
        """The report of a frame after which the cloth is in balance, or must be, with what is left to it."""
        plugin = self.loaded.integrator.plugin
        share = plugin.unbalance(self.system, self.state, self.memory, poses)
        most, beyond = float(share.max()), int((share > BALANCED).sum())
        self.balanced = most <= BALANCED
        report = replace(report, unbalance=most, unsettled=beyond)
        if self.balanced or self.frame < self.loaded.scene.frames:
            return report
        problem = unsettled(share, self.state, self.pieces, int((~self.fabric.pinned).sum()))
        return replace(report, status="unconverged", message=problem)

    @property
    def finished(self) -> bool:
        """Whether the scene's last frame is done, or its cloth rests and that is its end."""
        scene = self.loaded.scene
        rests = scene.until == "rest" and self.slow_frames[0] >= REST_TIME * scene.frame_rate
        rests = (bool(rests) or self.balanced) and self.applied == len(scene.operations)
        return rests or self.frame >= scene.frames

    def _content(self) -> str:
        """Hash of all that the next frame follows from."""
        hasher = hashlib.blake2b(digest_size=16)
        kept = (array for array in self.memory.arrays.values() if array is not self.slow_frames)
        for array in (self.state.x, self.state.v, *kept):
            hasher.update(np.ascontiguousarray(array).data)
        return hasher.hexdigest()

    def about(self) -> str:
        """How the solver's kernels run, in words."""
        return str(self.loaded.integrator.plugin.about(self.system))

    def shares(self, poses: Poses | None) -> dict[str, float]:
        """How a step's time divides among its parts, in the present state; the sum is 1."""
        plugin, pair = self.loaded.integrator.plugin, (poses, poses) if poses else None
        parts: dict[str, float] = dict(plugin.profile(self.system, self.state, self.memory, pair))
        total = sum(parts.values()) or 1.0
        return {name: seconds / total for name, seconds in parts.items()}

    def measure(self, poses: Poses | None) -> StepReport:
        """The present state's energy and stretch, without a step."""
        report: StepReport = self.loaded.integrator.plugin.advance(
            self.system, self.state, self.memory, (poses, poses) if poses else None, 0, self.dt
        )
        return report

    def forces(self, poses: tuple[Poses, Poses] | None) -> Forces:
        """What acts in the present state, with bodies as at the start of the frame of these poses."""
        if self.relaxation is not None:
            self.system = replace(self.system, damping=self.relaxation.damping)
        found: Forces = self.loaded.integrator.plugin.forces(self.system, self.state, self.memory, poses)
        return found

    def digest(self) -> str:
        """Hash of the float64 state: equal digests mean equal bits."""
        hasher = hashlib.blake2b(digest_size=16)
        hasher.update(np.int64(self.frame).tobytes())
        hasher.update(np.ascontiguousarray(self.state.x).data)
        hasher.update(np.ascontiguousarray(self.state.v).data)
        return hasher.hexdigest()

    def resume(self, frame: int, x: NDArray[Any], v: NDArray[Any], memory: dict[str, NDArray[Any]]) -> None:
        """Go on from a checkpoint. Raises BadInput if it does not fit."""
        if x.shape != self.state.x.shape or v.shape != self.state.v.shape:
            raise BadInput(
                "the checkpoint does not fit this scene",
                value=f"{x.shape[0]} vertices",
                limit=f"{self.fabric.number}",
                remedy="resume with the recording's own scene",
            )
        np.copyto(self.state.x, x)
        np.copyto(self.state.v, v)
        self.frame = frame
        self.applied = max(self.applied, self.due(frame - 1))
        self.state.t = self.t
        self._restore(memory)

    def set(self, item: str) -> None:
        """Change a field of the running scene, `gravity=[0, -1.6, 0]`. Raises BadInput."""
        key = item.partition("=")[0]
        field = parts_of(key)[0]
        if field not in SETTABLE:
            dyed = "; nuno control RUN add gives its dye supplies and resists" if self.loaded.dye else ""
            raise BadInput(
                "this field cannot change while a run goes on",
                field=field,
                value=item,
                limit=", ".join(SETTABLE),
                remedy=f"stop, and run again with --set{dyed}",
            )
        before, kept, step = self.loaded, self.memory.arrays, (self.steps, self.dt)
        # With defaults: what the scene leaves out can be changed in part as well.
        data = _copied(before.data) | {field: before.value(field)}
        lines = overridden(before.lines, apply_override(data, item))
        changed = load(data, lines, before.file, before.files)
        try:
            self.loaded = changed
            self._prepare({name: kept[name] for name in kept if name != RELAXATION or _finds_damping(changed)})
            if step[1] > self.limit.dt and not before.scene.allow_unstable:
                raise BadInput("unstable", field="solver.dt", limit=f"{self.limit.dt:.4g} s")
        except BadInput as error:
            self.loaded = before
            self._prepare(dict(kept))
            if error.field not in ("solver.dt", "solver.plugin"):
                raise
            problem, remedy = "that would make the present step unstable", "choose a smaller change"
            raise BadInput(problem, field=key, value=f"{step[1]:g} s", limit=error.limit, remedy=remedy) from None
        finally:
            # The step stays what it was, whatever `dt: auto` would choose for the changed scene.
            self.steps, self.dt = step


def _finds_damping(loaded: Loaded) -> bool:
    """Whether damping finds its own strength."""
    return loaded.scene.damping == "auto"


def _same(start: Poses, end: Poses) -> bool:
    """Whether bodies stand still."""
    return np.array_equal(start.rotation, end.rotation) and np.array_equal(start.translation, end.translation)


def _copied(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _copied(value) for key, value in data.items()}
    return [_copied(value) for value in data] if isinstance(data, list) else data
