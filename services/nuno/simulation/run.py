"""Simulation of a scene's cloth, frame by frame, independent of the bus."""

from __future__ import annotations

import contextlib
import json
import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from copy import copy, deepcopy
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from nuno.bus.encodings import decode_points, encode_points
from nuno.collision.bodies import shared_bodies, surface
from nuno.collision.crossings import find_crossings, mesh_of
from nuno.collision.distance import body_distances
from nuno.collision.messages import decode_poses
from nuno.plugin_contract.values import ContractError, check_array
from nuno.recording.recorded import Arrays, Checkpoint
from nuno.runtime.stepper import Stepped, Stepper, copy_into, fitting, hash_of, limited, too_slow
from nuno.scene.chosen_plugins import Chosen
from nuno.scene.override import SETTABLE, apply_override, overridden, parts_of
from nuno.scene.scene_file import Loaded, coarser, load
from nuno.scene.step import choose_step, find_limit
from nuno.simulation import cloth
from nuno.simulation.cloth import build_fabric, join_fabrics
from nuno.simulation.costs import Costs, FrameStart, Stage
from nuno.simulation.operations import carry, fabric_arrays, fabric_from, frames_bound, parse
from nuno.simulation.relax import BALANCED, EXACT, REST_SPEED, Relaxation, Stillness, damped, unsettled
from nuno.simulation.renumbering import (
    RenumberedSolver,
    find_numbers,
    invert,
    keep_numbers,
    renumber,
    require_any_numbering,
    takes_any_numbering,
)
from nuno.simulation.solver_selection.cloth import decide
from nuno_schemas.bodies import Geometry, Poses
from nuno_schemas.errors import BadInput, RunFailed, nearest
from nuno_schemas.fabric import Fabric, Float, Int, State
from nuno_schemas.layout import Bounds
from nuno_schemas.messages import CHECKPOINT, STATE, STATUS, Event
from nuno_schemas.operation import Outcome, arranges
from nuno_schemas.plugin import Rested
from nuno_schemas.scene import Fading
from nuno_schemas.system import Forces, StepLimit, StepReport, System, Touched

# Energy that grows without work, by which a run is seen to diverge.

NEAREST = 0.95
"""Share of the limit above which the bound on the energy is constant."""
FINER = 8
"""Steps in place of one, in a frame that is simulated again."""
MARGIN = 1.25
"""Factor over the energy bound of a stable step, for its errors of higher order."""


class EnergyGrowth:
    """The energy of a run [J] against its bound.

    Symplectic Euler keeps H = T + U - h v F / 2 of a mode, h being the step, while T + U comes to H / (1 - r) at a
    share r of the limit, and H is at most T + U + 2 r sqrt(T U) of the start; leapfrog keeps T + U nearer. Only more
    than that, for all energy in the fastest mode, is growth.

    account  (2,) kinetic, elastic and gravitational energy of the start, and the largest kinetic and elastic energy
             that gravity has allowed so far; a resumed run continues with it
    """

    def __init__(self, energy: Mapping[str, float], share: float, least: float) -> None:
        """energy: by kind at the start; share: of the longest stable step; least: energy that is never growth [J]."""
        inner, kinetic, r = internal(energy), energy.get("kinetic", 0.0), min(share, NEAREST)
        swing = 2.0 * r * math.sqrt(max(kinetic * (inner - kinetic), 0.0)) / inner if inner > 0.0 else 0.0
        self.factor, self.least = MARGIN * (1.0 + swing) / (1.0 - r), least
        self.account: Float = np.array([sum(energy.values()), inner])

    def exceeds(self, energy: Mapping[str, float]) -> bool:
        """Return whether energy [J] by kind exceeds the bound; false where it is not finite."""
        self.account[1] = max(self.account[1], self.account[0] - energy.get("gravitational", 0.0))
        return self.is_more(energy, float(self.account[1]))

    def is_more(self, energy: Mapping[str, float], available: float) -> bool:
        """Return whether no stable step turns the `available` energy [J] into this energy [J] by kind."""
        return internal(energy) > self.factor * available + self.least

    def allow(self, energy: Mapping[str, float]) -> None:
        """Raise the bound to this energy [J] by kind, as the result of work."""
        self.account[:] = np.maximum(self.account, [sum(energy.values()), internal(energy)])


def internal(energy: Mapping[str, float]) -> float:
    """Return the sum of kinetic and elastic energy [J]."""
    return sum(energy.values()) - energy.get("gravitational", 0.0)


RELAXATION = "relaxation"
"""Name of the array `Relaxation.memory` in the solver's memory."""
ENERGY = "energy"
"""Name of the array `EnergyGrowth.account` in a checkpoint."""
NUMBERS = "numbers"
"""Name of the array `Simulation.numbers` in a checkpoint."""


class Simulation(Stepper):
    """A scene's cloth, its solver and its state.

    `poses` are those of the bodies now, and `find_poses` returns those at the end of a frame, by its number; by default
    the bodies stay at their start.
    """

    part, service = "cloth", "simulation"
    status, published, kept = STATUS, STATE, CHECKPOINT
    quantities = MappingProxyType({"x": "position", "v": "velocity"})

    solver: Chosen
    """The scene's integrator; it takes states in the user's order."""
    numbers: Int | None
    """(n,) the vertex at each position of the stepped fabric, None where that keeps the user's order."""
    applied: int
    """Number of the scene's operations that have been applied."""
    rested: Sequence[Rested]
    """Coarse state at rest of each object, empty where the scene has none."""

    def __init__(
        self, loaded: Loaded, geometry: Geometry | None, poses: Poses | None, threads: int,
        leave: NDArray[np.int64] | None = None,
    ) -> None:  # fmt: skip
        """`leave` as in System."""
        self.leave = np.zeros(1, np.int64) if leave is None else leave
        self.loaded, self.geometry, self.threads = decide(loaded), geometry, threads or os.cpu_count() or 1
        simulate = partial(Simulation, geometry=geometry, poses=poses, threads=threads, leave=self.leave)
        self.rested, settled = settle(self.loaded, simulate)
        self.fabric, self.pieces, arranged = cloth.build_with_facts(self.loaded, geometry, poses, self.rested)
        self.arranged = [*settled, *arranged]
        if loaded.scene.until == "balance":
            problem = "" if self.fabric.bears_tension else "cloth without springs or membrane has no tension to balance"
            if not hasattr(loaded.integrator.plugin, "unbalance"):
                problem = f"the solver {loaded.integrator.name} does not tell how far cloth is from balance"
            if problem:
                raise loaded.at("until", BadInput(problem, value="balance", remedy="take until: rest"))
        self.start_poses = self.before = self.poses = poses
        self.find_poses: Callable[[int], Poses | None] = lambda frame: poses
        self.body_notes: tuple[str, ...] = ()
        self.begin_unchanged()
        self.state: State = cloth.start_state(self.fabric)
        self.frame, self.balanced = 0, False
        """Whether the cloth of a scene until balance is balanced."""
        self.costs = Costs()
        self.idle = 0
        """Frames without steps, since nothing would have changed."""
        self._still = False
        self.left: FrameStart | None = None
        """The start of an abandoned frame in which more than gravity does work."""
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
    def with_bodies(cls, loaded: Loaded, threads: int = 0, leave: NDArray[np.int64] | None = None) -> Simulation:
        """Return a simulation that poses the scene's bodies itself; live ones as recorded, else where they start."""
        if not loaded.scene.bodies:
            return cls(loaded, None, None, threads, leave)
        bodies, rate = shared_bodies(loaded), loaded.scene.frame_rate

        def find(frame: int) -> Poses:
            if frame not in loaded.recorded_poses:
                return bodies.poses(frame / rate)
            with fitting(loaded):
                return decode_poses(loaded.recorded_poses[frame], len(bodies.geometry.frames))

        simulation = cls(loaded, bodies.geometry, find(0), threads, leave)
        simulation.find_poses, simulation.body_notes = find, bodies.notes
        return simulation

    def _prepare(self, arrays: dict[str, NDArray[Any]], source: Int | None = None) -> None:
        """Build system, step and memory from the scene; `arrays` is solver memory to keep, and `source` (n,) the former
        position of each vertex, in the order of the steps.
        """
        fabric, bodies = renumber(self.fabric, self.numbers), (self.geometry, self.start_poses)
        self.solver = self.loaded.integrator
        if self.numbers is not None:
            self.solver = replace(self.solver, plugin=RenumberedSolver(self.solver.plugin, self.numbers))
        self._still, self.growth = False, None
        system = cloth.build_system(self.loaded, fabric, self.pieces, *bodies, self.threads)
        self.system = replace(system, leave=self.leave)
        # The limit comes before the solver's memory: both at once would be a run's peak.
        start = self.state if self.frame == 0 or self.changes else cloth.start_state(self.fabric)
        self.limit = find_limit(self.loaded, self.solver.plugin, self.system, start)
        self.steps, self.dt = choose_step(self.loaded, self.limit.dt, self.limit.resolved)
        self._prepare_memory()
        if source is not None:
            kept = {name: values for name, values in arrays.items() if name in self.memory.arrays}
            arrays = {name: carry(values, self.memory.arrays[name], source) for name, values in kept.items()}
        copy_into(self.memory.arrays, arrays, some=True)

    def _prepare_memory(self) -> None:
        """Make new memory of the solver."""
        self.memory = self.solver.plugin.prepare(self.loaded.integrator.config, self.system, self.state)
        self.costs.begin(self.memory.lists)
        # A run that goes on from a checkpoint must come to rest in the same frame.
        scene = self.loaded.scene
        self.stillness = Stillness(scene.frame_rate, self.fabric.number, scene.rest_speed or REST_SPEED * self._size)
        if scene.until == "rest":
            self.memory.arrays.update(self.stillness.memory)
            self.memory.bounds["rest_frames"] = Bounds(0)
        self.relaxation = None
        if self.loaded.scene.damping == "auto":
            inertia = np.where(self.fabric.pinned, 0.0, self.fabric.mass)
            self.relaxation = Relaxation(self.loaded.scene.frame_rate, inertia)
            self.memory.arrays[RELAXATION] = self.relaxation.memory
            self.memory.bounds[RELAXATION] = Bounds(0.0)

    def arrays(self) -> Arrays:
        """Return the state itself: x (n, 3) [m] and v (n, 3) [m/s]."""
        return {"x": self.state.x, "v": self.state.v}

    def encode(self) -> bytes | bytearray:
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
        begin = time.perf_counter()
        end = self.find_poses(self.frame + 1)
        posed = time.perf_counter() - begin
        frame = self.advance(self.poses, end)
        frame.seconds += posed
        if frame.report.status != "left":
            self.before, self.poses = self.poses, end
        return frame

    def present(self) -> Stepped:
        """Return the present frame, without a step; compiles the kernels of a step."""
        return Stepped(self.frame, self.measure(self.poses), 0.0, self.digest())

    def present_forces(self) -> Forces:
        """Return the forces in the present state, at the end of its frame."""
        return self.forces(None if self.before is None or self.poses is None else (self.before, self.poses))

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
            if self.relaxation is not None or isinstance(self.loaded.scene.damping, Fading):
                self.system = damped(self.system, self.loaded.scene, self.frame, self.relaxation)
            if self.growth is None:
                self._begin_growth()
            does_work = bool(not unmoved or self.system.terms or self.fabric.yarns is not None)
            self.begin_frame(needed=does_work and (self.growth is not None or bool(self.memory.lists)))
            self.state.begun = (self.begun.arrays["x"], self.begun.arrays["v"]) if self.begun else None
            report = self.solver.plugin.advance(self.system, self.state, self.memory, poses, self.steps, self.dt)
            begun = FrameStart(self.begun, poses) if does_work and self.begun else None
            if report.status == "left":
                self.left = begun
                return Stepped(self.frame, report, time.perf_counter() - begin, self.digest())
            self.costs.after(report, begun)
            report = self._judge(report, begun)
            # Frames after one that changes nothing change nothing either.
            self._still = bool(before) and self.memory.timeless and report.status == "ok" and before == self._content()
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

    def _judge(self, report: StepReport, begun: FrameStart | None) -> StepReport:
        """Return the report of a frame, diverged where its step has added energy; `begun` is its start, None for one in
        which only gravity does work.
        """
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
        free, loose = int((~self.fabric.pinned).sum()), getattr(self.solver.config, "residual", 0.0) > EXACT
        problem = unsettled(share, self.state, self.pieces, free, loose)
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
        return self.memory.about

    def divide(self, seconds: float) -> dict[str, float]:
        """Return the time of each part of the steps [s], of all their `seconds`."""
        chosen, pair = self.solver, (self.poses, self.poses) if self.poses else None
        profile = getattr(chosen.plugin, "profile", None)
        each = {} if profile is None else profile(self.system, self.state, self.memory, pair)
        return self.costs.divide(each, Stage(chosen, self.system, self.steps, self.dt), seconds)

    def divide_left(self, seconds: float) -> dict[str, float]:
        """Return the share of each term with neighbour lists in the time of an abandoned frame [s], but for one without
        which the frame is not done in time.
        """
        stage, shares = Stage(self.solver, self.system, self.steps, self.dt), dict[str, float]()
        if (left := self.left) is None:
            return shares
        for name in self.memory.lists:
            report = stage.replay(left, (name,))[1]
            if report.status != "left":
                shares[name] = max(0.0, 1.0 - report.seconds["steps"] / seconds)
        return shares

    def step_back(self) -> None:
        """Go back to the start of an abandoned frame, with new memory of the solver: see StepReport.status."""
        assert self.begun is not None
        self._prepare_memory()
        self.take_over(self.begun)

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
        """Return the forces in the present state, with bodies as at the end of the frame of these poses."""
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
        adaptive = changed.loaded.scene.damping == "auto"
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
        # A change that is refused has altered only the copy.
        vars(self).update(vars(changed))

    def begin_unchanged(self) -> None:
        """Start with the cloth of the scene, before any operation."""
        self.numbers = find_numbers(self.fabric, self.pieces) if takes_any_numbering(self.loaded) else None
        self.changes: list[dict[str, Any]] = []
        """Changes by operations, in order: frame, t [s], operation, object and its facts."""
        self.applied = 0
        self.crests: list[Int] = []
        """(5, c) for each change, the vertices of its object that measure its height: on the line, to the left and to
        the right of it, and before and after on it; c may be 0."""
        self._fabrics: list[Fabric] | None = None
        scene, earlier = self.loaded.scene, dict[tuple[str, str], list[Any]]()
        names = [spec.name for spec in scene.objects]
        for i in self._order():
            chosen, name = self.loaded.operations[i], scene.operations[i].object or names[0]
            before = earlier.setdefault((chosen.name, name), [])
            with self.loaded.errors_at(f"operations[{i}]"):
                if hasattr(chosen.plugin, "require"):
                    chosen.plugin.require(chosen.config, self.parts()[names.index(name)], tuple(before))
            before.append(chosen.config)

    def _order(self) -> list[int]:
        """Return the numbers of the scene's operations by their times."""
        operations = self.loaded.scene.operations
        return sorted(range(len(operations)), key=lambda i: float(operations[i].at))

    def add(self, item: str) -> dict[str, Any]:
        """Apply an operation, `wrinkle: {...}`, at once; return its object, its facts and the item that repeats it.
        Raises BadInput.
        """
        index, chosen, item = parse(item, self.loaded)
        self._alter(index, chosen)
        return {"field": self.changes[-1]["object"], "new": self.changes[-1]["facts"], "item": item}

    def due(self, frame: int) -> int:
        """Return the number of the scene's operations whose time is at most that of `frame`."""
        rate = self.loaded.scene.frame_rate
        return sum(round(float(applied.at) * rate) <= frame for applied in self.loaded.scene.operations)

    def alter_due(self) -> bool:
        """Apply the scene's operations that are due; return whether there were any. Raises BadInput."""
        scene, before = self.loaded.scene, self.applied
        names = [spec.name for spec in scene.objects]
        for i in self._order()[before : self.due(self.frame)]:
            name = scene.operations[i].object or names[0]
            with self.loaded.errors_at(f"operations[{i}]"):
                if not arranges(self.loaded.operations[i].plugin):  # an arrangement is built into the cloth
                    self._alter(names.index(name), self.loaded.operations[i])
            self.applied += 1
        return self.applied > before

    def rehearse(self) -> None:
        """Compile the kernels that later operations need, by applying each to a copy of the present cloth: the run does
        not wait for the compiler then. The same holds for an attachment to a body that another program moves.

        An operation that would be refused now is skipped.
        """
        scene = self.loaded.scene
        names = [spec.name for spec in scene.objects]
        for applied, chosen in zip(scene.operations, self.loaded.operations, strict=True):
            if round(float(applied.at) * scene.frame_rate) <= self.frame:
                continue
            trial = copy(self)
            with contextlib.suppress(BadInput):
                trial._alter(names.index(applied.object or names[0]), chosen)
                trial.measure(self.poses)
        first = self.parts()[0] if self.loaded.live else None
        if first is not None and (free := np.flatnonzero(~first.pinned[first.named()])).size:
            trial = copy(self)
            with contextlib.suppress(BadInput):
                trial.add(f"attach: {{body: {json.dumps(self.loaded.live[0])}, vertices: [{free[0]}]}}")
                trial.measure(self.poses)

    def parts(self) -> list[Fabric]:
        """Return the present fabric of each object."""
        if len(self.pieces) == 1:
            return [self.fabric]
        if self._fabrics is None:  # joined fabrics are copies: parts are kept only where one changes
            self._fabrics = cloth.build_fabrics(self.loaded, self.geometry, self.start_poses, self.rested)
        return self._fabrics

    def _alter(self, index: int, chosen: Chosen) -> None:
        """Apply an operation to one object; a refused one changes nothing. Raises BadInput."""
        piece, fabrics = self.pieces[index], list(self.parts())
        vertices = slice(piece.start, piece.stop)
        state = State(self.state.x[vertices].copy(), self.state.v[vertices].copy(), self.state.t)
        outcome = self._apply(chosen, fabrics[index], state)
        changed_cloth = outcome.changed
        if changed_cloth is None:
            raise BadInput("the operation changed nothing", value=chosen.name)
        fabrics[index] = changed_cloth.fabric
        moved = np.where(changed_cloth.source >= 0, changed_cloth.source + piece.start, -1)
        source = np.concatenate([np.arange(piece.start), moved, np.arange(piece.stop, self.fabric.number)])
        x, v = (
            np.concatenate([old[: piece.start], new, old[piece.stop :]])
            for old, new in ((self.state.x, changed_cloth.state.x), (self.state.v, changed_cloth.state.v))
        )
        change = {"frame": self.frame, "t": self.t, "operation": chosen.name, "object": piece.name}
        changed = copy(self)
        changed.changes = [*self.changes, change | {"facts": dict(outcome.facts)}]
        changed.crests = [*self.crests, np.asarray(outcome.arrays.get("crests", np.zeros((5, 0))), np.int32)]
        try:
            changed._take(fabrics, State(x, v, self.state.t))
            changed._require_apart((source < 0) | (x != self.state.x[source]).any(axis=1))
            if self.numbers is not None:
                changed.numbers = keep_numbers(self.numbers, source, changed.pieces)
                before = source[changed.numbers]
                source = np.where(before >= 0, invert(self.numbers)[before], -1)
            changed._prepare(self.memory.arrays, source.astype(np.int32))
        except BadInput as error:
            if error.field != "solver.dt":
                raise
            problem = "the changed cloth would make the present step unstable"
            remedy = "solver: {dt: auto}, a smaller dt, a line of fewer small triangles, or springs: paper"
            raise BadInput(problem, value=f"{self.dt:g} s", limit=error.limit, remedy=remedy) from None
        # A step never grows during a run, and changed cloth is no longer at rest.
        if self.steps > changed.steps:
            changed.steps, changed.dt = self.steps, self.dt
        changed.stillness.begin(changed.state.x)
        changed.balanced = False
        changed.changes[-1]["measured"] = [changed.heights(len(changed.changes) - 1)]
        # A change that is refused has altered only the copy.
        vars(self).update(vars(changed))

    def _require_apart(self, moved: NDArray[np.bool_]) -> None:
        """Raise BadInput where an operation has moved vertices (n,) and the cloth there passes through cloth or a body
        that it meets by cloth contact, which would hold it there.
        """
        scene, x, faces, n = self.loaded.scene, self.state.x, self.fabric.faces, self.fabric.number
        if self.loaded.cloth_contact is None or not moved.any():
            return
        if scene.met_bodies and self.geometry is not None and self.poses is not None:
            solid = surface(self.geometry.of_bodies(scene.met_bodies))
            x, faces = np.concatenate([x, solid.at(self.poses)]), np.concatenate([faces, solid.faces + np.int32(n)])
        sizes = [*(piece.stop - piece.start for piece in self.pieces), len(x) - n]
        piece, moved = np.repeat(np.arange(len(sizes)), sizes), np.pad(moved, (0, len(x) - n))
        meet = np.pad(scene.meet(), (0, 1), constant_values=True)
        found = find_crossings(x, mesh_of(faces))
        through = moved[found.edges].any(axis=1) | moved[found.triangles].any(axis=1)
        through &= meet[piece[found.edges[:, 0]], piece[found.triangles[:, 0]]]
        if through.any():
            value = f"{np.count_nonzero(through)} edges through triangles, one at {found.places[through][0].round(4)} m"
            remedy = "a smaller height, or a line elsewhere"
            raise BadInput("the cloth would pass through cloth or a body that it meets", value=value, remedy=remedy)

    def _apply(self, chosen: Chosen, fabric: Fabric, state: State) -> Outcome:
        """Return the outcome of an operation on one object, and on the body that it names. Raises BadInput."""
        if not hasattr(chosen.plugin, "apply_beside"):
            outcome: Outcome = chosen.plugin.apply(chosen.config, fabric, state, None)
            return outcome
        name, bodies = chosen.plugin.body(chosen.config), [body.name for body in self.loaded.scene.bodies]
        if name not in bodies or self.geometry is None or self.poses is None:
            remedy = nearest(name, bodies) if bodies else "give the scene the body"
            raise BadInput("there is no such body", field="body", value=name, remedy=remedy)
        outcome_on_body: Outcome = chosen.plugin.apply_beside(
            chosen.config, fabric, state, body_distances(state.x, self.geometry, self.poses, name)
        )
        return outcome_on_body

    def heights(self, number: int) -> dict[str, float]:
        """Return the mean height of a raised line over the chord across it, along the normal to chord and line, and the
        length of that chord [m]; empty for a change without crests. Both follow the moving cloth.
        """
        crest = self.crests[number]
        if not crest.size:
            return {}
        start = next(piece.start for piece in self.pieces if piece.name == self.changes[number]["object"])
        top, one, other, before, after = self.state.x[start + crest]
        normal = np.cross(other - one, after - before)
        height = np.abs(np.einsum("ck,ck->c", top - one, normal)) / np.linalg.norm(normal, axis=1)
        return {"height": float(height.mean()), "width": float(np.linalg.norm(other - one, axis=1).mean())}

    def wrinkles(self) -> dict[str, float]:
        """Return `heights` of all changes, as 0_height, 0_width and so on."""
        heights = ((i, self.heights(i)) for i in range(len(self.changes)))
        return {f"{i}_{name}": value for i, values in heights for name, value in values.items()}

    def _take(self, fabrics: list[Fabric], state: State) -> None:
        """Replace the objects by these fabrics, in `state`."""
        self._fabrics = fabrics if len(fabrics) > 1 else None
        self.fabric = join_fabrics(fabrics, self.loaded.scene.name)
        self.pieces = cloth.place_pieces(self.loaded, fabrics)
        self.state = state

    def altered(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Return arrays and text for a checkpoint: the changed objects, and the order of vertices in the steps."""
        names = [piece.name for piece in self.pieces]
        changed = sorted({names.index(change["object"]) for change in self.changes})
        fabrics = self.parts() if changed else []
        arrays = {f"fabric/{i}/{name}": a for i in changed for name, a in fabric_arrays(fabrics[i]).items()}
        arrays |= {f"fabric/crests/{i}": crest for i, crest in enumerate(self.crests)}
        if self.numbers is not None:
            arrays[NUMBERS] = self.numbers
        origins = {str(i): dict(fabrics[i].origin) for i in changed}
        bound = {str(i): frames_bound(fabrics[i]) for i in changed}
        return arrays, {"changes": self.changes, "applied": self.applied, "origins": origins, "bound": bound}

    def adopt(self, point: Checkpoint) -> None:
        """Take objects and step from a checkpoint that `altered` was written to. Raises BadInput."""
        with fitting(self.loaded):
            names = (name for name in point.arrays if name == NUMBERS or name.startswith("fabric/"))
            rebuilt = self._adopt({name: point.arrays[name].copy() for name in names}, deepcopy(point.text))
        if rebuilt:
            self._prepare({})
            self.steps, self.dt = int(point.text["steps"]), float(point.text["dt"])

    def _adopt(self, arrays: dict[str, NDArray[Any]], text: dict[str, Any]) -> bool:
        """Return whether the stepped fabric is another now. Any error may show a broken checkpoint."""
        origins: dict[str, dict[str, float]] = text.get("origins", {})
        # The solver's memory is in the order of the recording's steps, the user's where that has no numbers.
        before, self.numbers = self.numbers, arrays.get(NUMBERS)
        if origins:
            self._adopt_fabrics(arrays, text, origins)
        elif np.array_equal(cast(Any, before), cast(Any, self.numbers)):  # so is None to None
            return False
        if self.numbers is not None:
            check_array(NUMBERS, self.numbers, np.int32, (self.fabric.number,))
            if not np.array_equal(np.sort(self.numbers), np.arange(self.fabric.number)):
                raise ContractError(f"{NUMBERS} does not name each vertex once")
        return True

    def _adopt_fabrics(
        self, arrays: dict[str, NDArray[Any]], text: dict[str, Any], origins: dict[str, dict[str, float]]
    ) -> None:
        self.applied = int(text["applied"])
        fabrics = list(self.parts())
        for number, origin in origins.items():
            fabric_values = {n.split("/", 2)[2]: a for n, a in arrays.items() if n.startswith(f"fabric/{number}/")}
            bound = text.get("bound", {}).get(number, frames_bound(fabrics[int(number)]))
            fabrics[int(number)] = fabric_from(fabric_values, fabrics[int(number)], origin, bound)
            from nuno.plugin_contract.guards import check_fabric  # it imports the types of all plugins, dye's too

            check_fabric(fabrics[int(number)])
        sizes = {piece.name: fabric.number for piece, fabric in zip(self.pieces, fabrics, strict=True)}
        self.changes = list(text["changes"])
        self.crests = [arrays[f"fabric/crests/{i}"] for i in range(len(self.changes))]
        for i, (change, crest) in enumerate(zip(self.changes, self.crests, strict=True)):
            check_array(f"fabric/crests/{i}", crest, np.int32, (5, None), Bounds(0, sizes[change["object"]] - 1))
        self._take(fabrics, cloth.start_state(join_fabrics(fabrics, self.loaded.scene.name)))


# A coarse start: cloth comes to rest on fewer vertices first, where its model allows that. A frame of a garment at
# half the length of edges takes five to ten times as long, and the motion that is left from the coarse rest is small.
#
# Meshes of several sizes also agree better so: friction holds cloth where it came to lie, and meshes that start apart
# hang differently by as much as friction bears.

LONGEST = 6.0
"""Longest time of the coarse start [s], after which its state is taken even in motion. It does not depend on the
scene's duration, so that a run that is resumed for longer has the same start."""


def settle(
    loaded: Loaded, simulate: Callable[[Loaded], Simulation]
) -> tuple[tuple[Rested, ...], tuple[dict[str, Any], ...]]:
    """Let a scene come to rest on fewer vertices, while its bodies stand where they start; return the coarse state at
    rest of each object, and the facts for the report, both empty where no model asks for it.

    Raises BadInput where these vertices are too few, or a force knows vertices by number, and RunFailed where a step
    fails.
    """
    coarse = coarser(loaded)
    if coarse is None:
        return (), ()
    stops = np.cumsum([model.plugin.count(model.config, coarse.files) for model in coarse.models]).tolist()
    if loaded.settled is not None and len(loaded.settled[0]) == stops[-1]:
        return _split(coarse, stops, *loaded.settled), ()
    coarsened = next(i for i, model in enumerate(loaded.models) if model is not coarse.models[i])
    if not takes_any_numbering(loaded):
        error_of_force = BadInput("a force knows vertices by number: on coarser triangles they are others",
                            remedy="leave it out")  # fmt: skip
        raise loaded.at(f"objects[{coarsened}].model.coarse", error_of_force)
    begin = time.perf_counter()
    try:
        simulation = simulate(coarse)
    except BadInput as error:
        if not (error.field or "").startswith(("objects", "cloth_contact")):
            raise
        build_fabric(loaded)  # raises for faults at any size of triangles
        remedy, value = "make their sides shorter, or leave it out", loaded.models[coarsened].given.get("coarse")
        problem = BadInput(f"on such triangles {error.problem}", value=value, remedy=remedy)
        raise loaded.at(f"objects[{coarsened}].model.coarse", problem) from error
    while not simulation.stillness.rests and simulation.frame < LONGEST * loaded.scene.frame_rate:
        with limited(simulation.leave, loaded.scene.frame_limit):
            report = simulation.step().report
        if report.status == "left" and not simulation.leave[0]:
            raise too_slow(loaded, f"on coarser triangles frame {simulation.frame + 1} takes longer")
        if report.status != "ok":
            raise RunFailed(f"on coarser triangles, frame {simulation.frame}: {report.message or report.status}")
    facts = {
        "vertices": float(simulation.fabric.number), "frames": float(simulation.frame),
        "rested": float(simulation.stillness.rests), "seconds": time.perf_counter() - begin,
    }  # fmt: skip
    objects = _split(coarse, stops, simulation.fabric.position, simulation.state.x)
    return objects, ({"operation": "coarse", "object": "", "facts": facts},)


def _split(coarse: Loaded, stops: list[int], start: Float, x: Float) -> tuple[Rested, ...]:
    """Split the start and the rest of all vertices (n, 3) [m] by object."""
    bounds = zip(coarse.models, [0, *stops[:-1]], stops, strict=True)
    return tuple(Rested(model.config, start[a:b].copy(), x[a:b].copy()) for model, a, b in bounds)
