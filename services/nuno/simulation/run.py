"""Simulation of a scene's cloth, frame by frame, independent of the bus."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from copy import copy, deepcopy
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.bus.encodings import decode_points, encode_points
from nuno.collision.bodies import build_bodies
from nuno.collision.messages import decode_poses
from nuno.recording.recorded import Arrays, Checkpoint
from nuno.runtime.stepper import Stepped, copy_into, fitting, hash_of
from nuno.scene.override import apply_override, overridden, parts_of
from nuno.scene.scene_file import Loaded, load
from nuno.scene.step import choose_step, find_limit
from nuno.simulation.changing import Changing
from nuno.simulation.cloth import build
from nuno.simulation.cloth.numbering import renumber, require_any_numbering
from nuno.simulation.coarse_start import settle
from nuno.simulation.costs import Costs, FrameStart, Stage
from nuno.simulation.energy_growth import FINER, EnergyGrowth, internal
from nuno.simulation.operations import carry
from nuno.simulation.relax import BALANCED, REST_SPEED, Relaxation, Stillness, damped, unsettled
from nuno.simulation.solver_selection.cloth import decide
from nuno_schemas.bodies import Geometry, Poses
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Int, State
from nuno_schemas.layout import Bounds
from nuno_schemas.messages import CHECKPOINT, STATE, STATUS, Event
from nuno_schemas.operation import arranges
from nuno_schemas.system import Forces, StepLimit, StepReport, System, Touched

SETTABLE = ("gravity", "damping", "forces")
"""Fields that `set` may change while a run goes on."""
RELAXATION = "relaxation"
"""Name of the array `Relaxation.memory` in the solver's memory."""
ENERGY = "energy"
"""Name of the array `EnergyGrowth.account` in a checkpoint."""


class Simulation(Changing):
    """A scene's cloth, its solver and its state.

    `poses` are those of the bodies now, and `find_poses` returns those at the end of a frame, by its number; by default
    the bodies stay at their start.
    """

    part, service = "cloth", "simulation"
    status, published, kept = STATUS, STATE, CHECKPOINT
    quantities = MappingProxyType({"x": "position", "v": "velocity"})

    def __init__(
        self, loaded: Loaded, geometry: Geometry | None, poses: Poses | None, threads: int,
        leave: NDArray[np.int64] | None = None,
    ) -> None:  # fmt: skip
        """`leave` as in System."""
        self.leave = np.zeros(1, np.int64) if leave is None else leave
        self.loaded, self.geometry, self.threads = decide(loaded), geometry, threads or os.cpu_count() or 1
        simulate = partial(Simulation, geometry=geometry, poses=poses, threads=threads, leave=self.leave)
        settled = settle(self.loaded, simulate)
        self.rested = settled.objects
        self.fabric, self.pieces, arranged = build.build_with_facts(self.loaded, geometry, poses, self.rested)
        self.arranged = [*settled.facts, *arranged]
        if loaded.scene.until == "balance" and not self.fabric.bears_tension:
            problem, remedy = "cloth without springs or membrane has no tension to balance", "take until: rest"
            raise loaded.at("until", BadInput(problem, value="balance", remedy=remedy))
        self.start_poses = self.before = self.poses = poses
        self.find_poses: Callable[[int], Poses | None] = lambda frame: poses
        self.body_notes: tuple[str, ...] = ()
        self.begin_unchanged()
        self.state: State = build.start_state(self.fabric)
        self.frame, self.balanced = 0, False
        """Whether the cloth of a scene until balance is balanced."""
        self.costs = Costs()
        self.idle = 0
        """Frames without steps, since nothing would have changed."""
        self._still = False
        self._report = StepReport("ok", 0)
        self._size = float(np.linalg.norm(np.ptp(self.fabric.position, axis=0))) if self.fabric.number else 0.0
        self.system: System
        self.limit: StepLimit
        self.growth: EnergyGrowth | None
        """None before the first frame, and after a change of the cloth or of its forces."""
        self._prepare({})
        for operation in (one.plugin for one in self.loaded.operations if not arranges(one.plugin)):
            operation.compile()
        self.alter_due()

    @classmethod
    def with_bodies(cls, loaded: Loaded, threads: int = 0) -> Simulation:
        """Return a simulation that moves the scene's bodies itself, without a collision service."""
        if not loaded.scene.bodies:
            return cls(loaded, None, None, threads)
        bodies, rate = build_bodies(loaded), loaded.scene.frame_rate

        def find(frame: int) -> Poses:
            if frame not in loaded.recorded_poses:
                return bodies.poses(frame / rate)
            with fitting(loaded):
                return decode_poses(loaded.recorded_poses[frame], len(bodies.geometry.frames))

        simulation = cls(loaded, bodies.geometry, find(0), threads)
        simulation.find_poses, simulation.body_notes = find, bodies.notes
        return simulation

    def _prepare(self, arrays: dict[str, NDArray[Any]], source: Int | None = None) -> None:
        """Build system, step and memory from the scene, as in `Changing`."""
        fabric, bodies = renumber(self.fabric, self.numbers), (self.geometry, self.start_poses)
        self._still, self.growth = False, None
        system = build.build_system(self.loaded, fabric, self.pieces, *bodies, self.threads)
        self.system = replace(system, leave=self.leave)
        # The limit comes before the solver's memory: both at once would be a run's peak.
        start = self.state if self.frame == 0 or self.changes else build.start_state(self.fabric)
        self.limit = find_limit(self.loaded, self.solver.plugin, self.system, start)
        self.steps, self.dt = choose_step(self.loaded, self.limit.dt, self.limit.resolved)
        self.memory = self.solver.plugin.prepare(self.loaded.integrator.config, self.system, self.state)
        self.costs.begin(self.loaded.integrator.plugin.making_lists(self.memory))
        # A run that goes on from a checkpoint must come to rest in the same frame.
        scene = self.loaded.scene
        self.stillness = Stillness(scene.frame_rate, self.fabric.number, scene.rest_speed or REST_SPEED * self._size)
        if scene.until == "rest":
            self.memory.arrays.update(self.stillness.memory)
            self.memory.bounds["rest_frames"] = Bounds(0)
        self.relaxation = None
        if _has_adaptive_damping(self.loaded):
            inertia = np.where(self.fabric.pinned, 0.0, self.fabric.mass)
            self.relaxation = Relaxation(self.loaded.scene.frame_rate, inertia)
            self.memory.arrays[RELAXATION] = self.relaxation.memory
            self.memory.bounds[RELAXATION] = Bounds(0.0)
        if source is not None:
            kept = {name: values for name, values in arrays.items() if name in self.memory.arrays}
            arrays = {name: carry(values, self.memory.arrays[name], source) for name, values in kept.items()}
        copy_into(self.memory.arrays, arrays, some=True)

    def arrays(self) -> Arrays:
        """Return the state itself: x (n, 3) [m] and v (n, 3) [m/s]."""
        return {"x": self.state.x, "v": self.state.v}

    def encode(self) -> bytes:
        """Return the positions as they are published, float32."""
        return encode_points(self.state.x, self.t)

    @staticmethod
    def decode(payload: bytes) -> Arrays:
        """Return published positions, x (n, 3) [m]. Raises BadMessage."""
        return {"x": decode_points(payload)}

    def place(self, index: Sequence[int]) -> str:
        """Return an index of x or v in words."""
        return f"vertex {index[0]}, axis {'xyz'[index[1]]}"

    def step(self) -> Stepped:
        """Step one frame, with the bodies at the poses of `find_poses`."""
        end = self.find_poses(self.frame + 1)
        frame = self.advance(self.poses, end)
        self.before, self.poses = self.poses, end
        return frame

    def present(self) -> Stepped:
        """Return the present frame, without a step; compiles the kernels of a step."""
        return Stepped(self.frame, self.measure(self.poses), 0.0, self.digest())

    def present_forces(self) -> Forces:
        """Return the forces in the present state, at the start of the next frame."""
        after = self.find_poses(self.frame + 1)
        return self.forces(None if after is None or self.poses is None else (self.poses, after))

    def present_touched(self) -> Touched | None:
        """Return the contact forces of each body on the cloth in the present state; None without bodies."""
        if self.before is None or self.poses is None:
            return None
        interval = self.before, self.poses
        return self.solver.plugin.touched(self.system, self.state, self.memory, interval)  # type: ignore[no-any-return]

    def advance(self, start: Poses | None, end: Poses | None) -> Stepped:
        """Simulate one frame between two sets of poses."""
        begin = time.perf_counter()
        self.alter_due()
        poses = (start, end) if start is not None and end is not None else None
        unmoved = poses is None or poses[0].same_place(poses[1])
        self.state.t = self.t
        if self._still and unmoved:
            report = replace(self._report, steps=0, totals={}, seconds={})
            self.idle += 1
        else:
            # Cloth with any velocity moves: only standing cloth is hashed.
            before = self._content() if unmoved and not self.state.v.any() else ""
            self.system = damped(self.system, self.loaded.scene, self.frame, self.relaxation)
            self.costs.before(self.state, self.memory, poses)
            begun = self._watch(poses, unmoved)
            report = self.solver.plugin.advance(self.system, self.state, self.memory, poses, self.steps, self.dt)
            if report.status == "left":
                return Stepped(self.frame, report, time.perf_counter() - begin, self.digest())
            self.costs.after(report)
            report = self._judge(report, begun)
            # Frames after one that changes nothing change nothing either.
            timeless = not any(term.in_python for term in self.system.terms)
            self._still = bool(before) and timeless and report.status == "ok" and before == self._content()
            self._report = report
        self.frame += 1
        self.state.t = self.t
        if self.loaded.scene.until == "rest":
            self.stillness.after(self.state.x)
        if self.relaxation is not None:
            self.relaxation.after(self.state)
        if self.loaded.scene.until == "balance" and report.status == "ok":
            report = self._weigh(report, (end, end) if end is not None else None)
        self.taken = time.perf_counter() - begin
        return Stepped(self.frame, report, self.taken, self.digest())

    def _begin_growth(self) -> None:
        """Start to check the energy, for an explicit solver whose step has to be stable."""
        scene = self.loaded.scene
        if self.loaded.integrator.plugin.explicit and not scene.allow_unstable:
            slow = REST_SPEED * self._size + float(np.linalg.norm(scene.gravity)) / scene.frame_rate
            least = 0.5 * float(self.fabric.mass[~self.fabric.pinned].sum()) * slow * slow
            self.growth = EnergyGrowth(self.measure(self.poses).energy, self.dt / self.limit.dt, least)

    def _watch(self, poses: tuple[Poses, Poses] | None, unmoved: bool) -> FrameStart | None:
        """Return the start state of a frame in which more than gravity may do work; None if no check needs it."""
        if self.growth is None:
            self._begin_growth()
        if self.growth is None or (unmoved and not self.system.terms and self.fabric.yarns is None):
            return None
        return FrameStart(self.state.copy(), {name: a.copy() for name, a in self.memory.arrays.items()}, poses)

    def _judge(self, report: StepReport, begun: FrameStart | None) -> StepReport:
        """Return the report of a frame, diverged where its step has added energy; `begun` is from `_watch`."""
        if self.growth is None or (report.status == "ok" and not self.growth.exceeds(report.energy)):
            return report
        message = f"{report.message}; " if report.message else ""
        if report.status == "ok":
            if begun is not None:
                finer = Stage(self.solver, self.system, FINER * self.steps, self.dt / FINER).replay(begun)[1]
                if finer.status == "left":  # the run is to stop: the frame is complete, and nothing shows an error
                    return report
                if finer.status == "ok" and not self.growth.is_more(report.energy, internal(finer.energy)):
                    self.growth.allow(report.energy)
                    return report
            grown, bound = internal(report.energy), self.growth.account[1]
            message = f"the energy has grown to {grown:.3g} J where {bound:.3g} J is all that there was; "
        elif report.status != "diverged":
            return report
        return replace(report, status="diverged", message=message + self._too_long())

    def _too_long(self) -> str:
        """Return why an explicit step may be too long, and the remedy."""
        if self.loaded.integrator.plugin.adaptive:
            return "cloth that is crushed may be stiffer than any step allows: give it a damping_ratio"
        return (
            f"the step of {self.dt:.4g} s is {self.dt / self.limit.dt:.2g} of the limit of the cloth at its start, and "
            "cloth that is stretched, sheared or crushed allows less: give its fabric a damping_ratio of 0.05, or take "
            f"--set solver.dt={0.5 * self.dt:.7g}"
        )

    def _weigh(self, report: StepReport, poses: tuple[Poses, Poses] | None) -> StepReport:
        """Return the report of a frame with the unbalance; unconverged if the last frame is not balanced."""
        share = self.solver.plugin.unbalance(self.system, self.state, self.memory, poses)
        most, beyond = float(share.max()), int((share > BALANCED).sum())
        self.balanced = most <= BALANCED
        report = replace(report, unbalance=most, unsettled=beyond)
        if self.balanced or self.frame < self.loaded.scene.frames:
            return report
        problem = unsettled(share, self.state, self.pieces, int((~self.fabric.pinned).sum()))
        return replace(report, status="unconverged", message=problem)

    @property
    def finished(self) -> bool:
        """Whether the last frame is done, or the cloth rests in a scene until that."""
        scene = self.loaded.scene
        rests = (scene.until == "rest" and self.stillness.rests) or self.balanced
        rests = rests and self.applied == len(scene.operations)
        return rests or super().finished

    def _content(self) -> str:
        """Return a hash of all inputs of the next frame."""
        kept = [array for name, array in self.memory.arrays.items() if name not in self.stillness.memory]
        return hash_of([self.state.x, self.state.v, *kept])

    def about(self) -> str:
        """Return how the solver's kernels run, in words."""
        return str(self.loaded.integrator.plugin.about(self.system))

    def divide(self, seconds: float) -> dict[str, float]:
        """Return the time of each part of the steps [s], of all their `seconds`."""
        chosen, pair = self.solver, (self.poses, self.poses) if self.poses else None
        each = chosen.plugin.profile(self.system, self.state, self.memory, pair)
        return self.costs.divide(each, Stage(chosen, self.system, self.steps, self.dt), seconds)

    def holds(self) -> str:
        """Return which objects are pinched, and where, in words."""
        find = getattr(self.loaded.integrator.plugin, "pinched", None)
        scene, texts = self.loaded.scene, list[str]()
        names = [*(piece.name for piece in self.pieces), *(scene.bodies[i].name for i in scene.met_bodies)]
        for piece, place in () if find is None else find(self.memory):
            counts = np.bincount(piece, minlength=len(names))
            objects = " and ".join(
                f"{number} vertices of {name}" for name, number in zip(names, counts, strict=True) if number
            )
            middle = ", ".join(f"{value:.3g}" for value in (np.median(place, axis=0) if objects else ()))
            texts += [f"{objects} pinched near ({middle}) m: neither cloth nor body gives way there"] if objects else []
        return "; ".join(texts)

    def measure(self, poses: Poses | None) -> StepReport:
        """Return energy and stretch of the present state, without a step."""
        report: StepReport = self.solver.plugin.advance(
            self.system, self.state, self.memory, (poses, poses) if poses else None, 0, self.dt
        )
        return report

    def forces(self, poses: tuple[Poses, Poses] | None) -> Forces:
        """Return the forces in the present state, with bodies as at the start of the frame of these poses."""
        self.system = damped(self.system, self.loaded.scene, self.frame, self.relaxation)
        return self.solver.plugin.forces(self.system, self.state, self.memory, poses)  # type: ignore[no-any-return]

    def whole(self) -> tuple[Arrays, dict[str, Any]]:
        """Return arrays and text of a checkpoint, with the changed objects and the bound on the energy."""
        (arrays, text), (fabrics, changes) = super().whole(), self.altered()
        energy = {} if self.growth is None else {ENERGY: self.growth.account}
        return arrays | fabrics | energy, changes | text

    def resume(self, point: Checkpoint, changes: Sequence[Event] = ()) -> None:
        """Continue from a checkpoint, which contains the changes by operations. Raises BadInput."""
        self.check_time(point)
        for event in changes:
            if event.text == "set":
                self.set(str(event.args["item"]))
        self.adopt(point)
        self.take_over(point)
        self.applied = max(self.applied, self.due(self.frame - 1))
        self.state.t = self.t
        self.before = self.find_poses(max(self.frame - 1, 0))
        self.poses = self.find_poses(self.frame)
        self._begin_growth()
        if self.growth is not None and np.isfinite(point.arrays.get(ENERGY, np.nan)).all():
            copy_into({ENERGY: self.growth.account}, {ENERGY: point.arrays[ENERGY]})

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
        loaded, memory, step = self.loaded, self.memory.arrays, (self.steps, self.dt)
        # With defaults: parts of a field that the scene leaves out can be changed too.
        data = deepcopy(loaded.data) | {field: loaded.value(field)}
        lines = overridden(loaded.lines, apply_override(data, item))
        changed = copy(self)
        changed.loaded = load(data, lines, loaded.file, loaded.files)
        require_any_numbering(self.numbers, changed.loaded, item)
        adaptive = _has_adaptive_damping(changed.loaded)
        try:
            changed._prepare({name: memory[name] for name in memory if name != RELAXATION or adaptive})
            if step[1] > changed.limit.dt and not loaded.scene.allow_unstable:
                raise BadInput("unstable", field="solver.dt", limit=f"{changed.limit.dt:.4g} s")
        except BadInput as error:
            if error.field not in ("solver.dt", "solver.plugin"):
                raise
            problem, remedy = "that would make the present step unstable", "choose a smaller change"
            raise BadInput(problem, field=key, value=f"{step[1]:g} s", limit=error.limit, remedy=remedy) from None
        # The step is kept: `dt: auto` might choose another one for the changed scene.
        changed.steps, changed.dt = step
        self.become(changed)


def _has_adaptive_damping(loaded: Loaded) -> bool:
    """Return whether damping is adaptive."""
    return loaded.scene.damping == "auto"
