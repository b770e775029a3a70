"""A scene as a problem for solvers: cloth or dye, run without services and observed at every frame.

The cloth, its forces and the bodies' poses are built once for a scene and shared by all its runs;
a solver's memory, such as friction anchors, belongs to one run.
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import psutil
from pydantic import BaseModel

from nuno.dye.run import DyeRun
from nuno.plugin_contract import registry
from nuno.process import attended
from nuno.scene.chosen_plugins import Chosen
from nuno.scene.scene_file import Loaded
from nuno.scene.step import choose_step
from nuno.simulation import cloth
from nuno_bench.machine import cores
from nuno_schemas.bodies import Poses
from nuno_schemas.dye import DyeReport, DyeState
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Fabric, Float, Int
from nuno_schemas.system import StepLimit, StepReport, System

POSITIONS = "positions"
KEPT_TRAJECTORIES = 4
"""Number of trajectories in memory: reference, its check, its twin and the run that is judged."""


@dataclass(frozen=True)
class Problem:
    """A scene ready to be run by any solver; poses are those of all frames, None without bodies."""

    loaded: Loaded
    system: System
    poses: tuple[Poses | None, ...]
    group: ClassVar[str] = "nuno.integrators"
    leading: ClassVar[str] = POSITIONS
    observables: ClassVar[Mapping[str, str]] = {
        "energy": "all energy",
        "centre": "centre of mass",
        "drop": "way of the centre of mass along gravity",
        "strain": "mean strain of the springs",
    }
    """Observables of the whole cloth, with descriptions."""
    scaled: ClassVar[str] = (
        "Errors are shares of the cloth's size (positions, centre of mass, drop), of the largest change of any kind of "
        "energy (energy), or strains; each is the root mean square over the frames."
    )

    @property
    def fabric(self) -> Fabric:
        return self.system.fabric

    @property
    def frame(self) -> float:
        """Length of a frame [s]."""
        return 1.0 / float(self.loaded.scene.frame_rate)

    @property
    def frames(self) -> int:
        return len(self.poses) - 1

    @cached_property
    def free(self) -> Any:
        """(n,) bool: vertices that are neither held nor carried."""
        return ~self.fabric.pinned

    @cached_property
    def size(self) -> float:
        """Diagonal of the cloth's bounding box at the start [m], 1 without cloth."""
        if self.fabric.number == 0:
            return 1.0
        return float(np.linalg.norm(np.ptp(self.fabric.position, axis=0))) or 1.0

    @property
    def preset(self) -> tuple[str, Mapping[str, Any]]:
        """The scene's own solver, and its configuration."""
        solver = self.loaded.scene.solver
        return solver.plugin, solver.config

    def describe(self) -> str:
        """Describe the size of the problem."""
        return f"{self.fabric.number:,} vertices"

    def limit(self, plugin: Any, config: BaseModel) -> StepLimit:
        """Return a solver's limit at the start. Raises BadInput if it refuses the scene."""
        limit: StepLimit = plugin.limit(config, self.system, cloth.start_state(self.fabric))
        return limit

    def own_steps(self, limit: StepLimit) -> int:
        """Return the steps per frame of the scene's own solver. Raises BadInput if no step is stable."""
        return choose_step(self.loaded, limit.dt, limit.resolved)[0]

    def run(self, plugin: Any, config: BaseModel, steps: int, most_seconds: float = math.inf) -> Run:
        """Run the scene by one solver, with `simulate`."""
        return simulate(self, plugin, config, steps, most_seconds=most_seconds)

    def first_call(self, plugin: Any, config: BaseModel, steps: int, taken: int) -> tuple[float, float]:
        """Return the wall time of a solver's first call, with compiling or loading, and of `taken` of its steps [s].

        Raises BadInput if the solver refuses its configuration.
        """
        state = cloth.start_state(self.fabric)
        memory = plugin.prepare(config, self.system, state)
        dt, moments = self.frame / steps, [time.perf_counter()]
        with np.errstate(all="ignore"):
            for count in (0, 1, taken):
                plugin.advance(self.system, state, memory, self.still(), count, dt)
                moments.append(time.perf_counter())
        return moments[2] - moments[0], moments[3] - moments[2]

    def scales(self, reference: Series) -> dict[str, float]:
        """Return the scales of errors: the cloth's size [m]; the largest change of any kind of energy in the
        reference [J]; 1 for strains.
        """
        change = float(np.abs(reference.parts - reference.parts[0]).max(initial=0.0)) or 1.0
        sizes = dict.fromkeys((reference.leading, "centre", "drop"), self.size)
        return {**sizes, "energy": change, "strain": 1.0}

    def pair(self, frame: int) -> tuple[Poses, Poses] | None:
        """Return the poses at the start and the end of a frame."""
        start, end = self.poses[frame], self.poses[frame + 1]
        return (start, end) if start is not None and end is not None else None

    def still(self) -> tuple[Poses, Poses] | None:
        """Return the poses of the start twice, for measuring without a step."""
        start = self.poses[0]
        return (start, start) if start is not None else None


def make_problem(loaded: Loaded, threads: int = 0) -> Problem:
    """Build cloth, bodies and forces; `threads` (0: all cores) step them, with the same bits for any number.

    Raises BadInput for a scene without free vertices, or too large for the memory.
    """
    system, bodies = cloth.build_scene(loaded, threads or cores())
    fabric = system.fabric
    if fabric.number == 0 or bool(fabric.pinned.all()):
        raise BadInput("nothing in the scene can move, so there is no error to measure", loaded.file)
    check_memory(loaded, 3 * fabric.number)
    times = [i / float(loaded.scene.frame_rate) for i in range(loaded.scene.frames + 1)]
    poses = tuple(bodies.poses(t) if bodies else None for t in times)
    return Problem(loaded, system, poses)


def check_memory(loaded: Loaded, numbers: int) -> None:
    """Raise BadInput if this many numbers per frame do not fit into memory, for all runs that are kept."""
    wanted = KEPT_TRAJECTORIES * (loaded.scene.frames + 1) * numbers * 8
    available = psutil.virtual_memory().available
    if wanted > available // 2:
        raise BadInput(
            f"{KEPT_TRAJECTORIES} runs, every frame of them, do not fit in memory",
            loaded.file,
            value=f"{wanted / 2**30:.1f} GiB",
            limit=f"{available / 2**31:.1f} GiB",
            remedy="shorten the run with --duration, or lower the frame rate",
        )


@dataclass(frozen=True)
class Series:
    """Compared quantities at the reached frames.

    leading            name of the quantity x
    t       (f,)       [s]
    x       (f, n, 3)  positions of the free vertices [m]; for dye see nuno_bench.problem
    values  per observable: "centre" (f, 3) centre of mass of the free vertices [m], "drop" (f, 1)
            its way along gravity since the start [m], "energy" (f, 1) kinetic, gravitational and
            elastic together [J], "strain" (f, 1) mean of | |d| / rest - 1 | over all springs
    parts   (f, k)     the energies by kind [J], in one order
    """

    t: Float
    x: Float
    values: Mapping[str, Float]
    parts: Float
    leading: str = POSITIONS


@dataclass(frozen=True)
class Run:
    """One run: its series, its end, and its cost.

    status   "ok", "diverged", "unconverged", "failed" (the solver itself), or "cut" (it exceeded its time)
    seconds  wall time in the solver's own calls [s]
    totals   steps, rejected steps, iterations, as far as the solver counts them
    reports  reports of the reached frames, including the start; of cloth only
    """

    series: Series
    status: str
    message: str
    seconds: float
    totals: Mapping[str, int]
    reports: Sequence[StepReport] = ()


def observe(problem: Problem, places: Sequence[Float], reports: Sequence[StepReport]) -> Series:
    """Return the series of a run, from the positions (n, 3) and the reports of its frames, including the start."""
    mass, gravity = problem.fabric.mass[problem.free], problem.system.gravity
    x = np.array([one[problem.free] for one in places])
    parts = np.array([[float(report.energy[kind]) for kind in sorted(report.energy)] for report in reports])
    centre = np.einsum("n,fnj->fj", mass, x) / mass.sum()
    values = {"energy": parts.sum(axis=1, keepdims=True), "centre": centre}
    if gravity.any():
        values["drop"] = ((centre - centre[0]) @ (gravity / np.linalg.norm(gravity)))[:, None]
    pairs, rest = lengths_at_rest(problem.fabric)
    if len(rest):
        i, j = pairs[rest > 0.0].T
        strains = (np.abs(np.linalg.norm(one[j] - one[i], axis=1) / rest[rest > 0.0] - 1.0) for one in places)
        values["strain"] = np.array([[one.mean() if one.size else math.nan] for one in strains])
    return Series(problem.frame * np.arange(len(x), dtype=np.float64), x, values, parts)


def lengths_at_rest(fabric: Fabric) -> tuple[Int, Float]:
    """Return the vertices (s, 2) of springs and sides of a membrane's triangles, and their rest lengths [m]."""
    springs, membrane = fabric.springs, fabric.membrane
    parts = [] if springs is None else [(springs.pairs(), springs.per_spring(springs.rest))]
    parts += [] if membrane is None else [membrane.edges()]
    pairs, rest = zip(*parts, strict=True) if parts else ([np.zeros((0, 2), np.int32)], [np.zeros(0)])
    return np.concatenate(pairs), np.concatenate(rest)


def simulate(
    problem: Problem, plugin: Any, config: BaseModel, steps: int, disturbance: Float | None = None,
    most_seconds: float = math.inf,
) -> Run:  # fmt: skip
    """Run a scene by one solver with `steps` steps per frame (for an adaptive one: at least).

    disturbance (n, 3) [m] is added to the positions at the start. A frame that is not done after `most_seconds` in all,
    or at an interrupt, is abandoned. Raises BadInput if the solver refuses its configuration.
    """
    state, leave = cloth.start_state(problem.fabric), np.zeros(1, np.int64)
    if disturbance is not None:
        state.x += disturbance
    system = replace(problem.system, leave=leave)
    memory = plugin.prepare(config, system, state)
    dt, places, reports = problem.frame / steps, list[Float](), list[StepReport]()

    def add(report: StepReport) -> None:
        places.append(state.x.copy())
        reports.append(report)

    def stop() -> None:
        leave[0] = 1

    add(plugin.advance(system, state, memory, problem.still(), 0, dt))

    def advance(frame: int) -> tuple[StepReport, float]:
        state.t, start = (frame - 1) * problem.frame, time.perf_counter()
        report = plugin.advance(system, state, memory, problem.pair(frame - 1), steps, dt)
        return report, time.perf_counter() - start

    timer = threading.Timer(min(most_seconds, threading.TIMEOUT_MAX), stop)
    timer.daemon = True
    timer.start()
    try:
        ended = attended(lambda: advance_all(problem, advance, add, most_seconds), stop)
    finally:
        timer.cancel()
    return Run(observe(problem, places, reports), *ended, reports)


def run_own(loaded: Loaded) -> Run:
    """Run a scene by its own solver, at its own step. Raises RunFailed unless it ends with "ok"."""
    problem, chosen = make_problem(loaded), loaded.integrator
    steps = problem.own_steps(problem.limit(chosen.plugin, chosen.config))
    run = problem.run(chosen.plugin, chosen.config, steps)
    if run.status != "ok":
        raise RunFailed(f"{run.status}: {run.message}")
    return run


def advance_all(
    problem: Any, advance: Callable[[int], tuple[Any, float]], add: Callable[[Any], None], most_seconds: float
) -> tuple[str, str, float, Mapping[str, int]]:
    """Advance frame by frame until the end or a failure; return a run's status, message, seconds and totals.

    `advance` takes the number of the frame at its end, and returns the report and the wall time of the solver's calls;
    `add` keeps the observation of a frame.
    """
    seconds, totals = 0.0, Counter[str]()
    # Overflow in a diverging run is a result, not a reason for a warning.
    with np.errstate(all="ignore"):
        for frame in range(1, problem.frames + 1):
            begun = time.perf_counter()
            try:
                report, taken = advance(frame)
            except RunFailed as error:
                seconds += time.perf_counter() - begun
                return "failed", f"at {frame * problem.frame:.3g} s: {error}", seconds, totals
            seconds += taken
            totals.update({"steps": report.steps} | {name: int(count) for name, count in report.totals.items()})
            abandoned = report.status == "left"
            if not abandoned and report.status != "ok":
                return report.status, f"at {frame * problem.frame:.3g} s: {report.message}", seconds, totals
            if not abandoned:
                add(report)
            if abandoned or (seconds > most_seconds and frame < problem.frames):
                why = f"took more than {most_seconds:.3g} s before {frame * problem.frame:.3g} s"
                return "cut", why, seconds, totals
    return "ok", "", seconds, totals


# A scene of dye run by any dye solver, without services, and what is observed of it at every frame.

AMOUNTS = "amounts"
SCHEME = "explicit"
"""The plainest solver: what errors are measured against is made of it."""


@dataclass(frozen=True)
class DyeProblem:
    """A scene of dye ready to be run by any solver; see nuno_bench.problem.Problem, which is one of cloth.

    Its series hold mobile and fixed dye of every cell as x (f, dyes * cells, 2), and by dye as values (f, dyes)
    their totals, and the spread [m]: the root mean square distance of dye from its middle.
    """

    loaded: Loaded
    threads: int
    group: ClassVar[str] = "nuno.dye_solvers"
    leading: ClassVar[str] = AMOUNTS
    observables: ClassVar[Mapping[str, str]] = {
        "mobile": "all mobile dye",
        "fixed": "all dye that fibre has taken",
        "spread": "root of the second moment of all dye about its middle",
    }
    scaled: ClassVar[str] = (
        "Errors are shares of the largest root mean square of the cells' amounts (amounts, mobile and fixed dye of "
        "every cell), of all dye (mobile, fixed), or of the largest spread (spread); each is the root mean square over "
        "the frames."
    )

    @property
    def frame(self) -> float:
        """Dyeing in a frame [s]."""
        speed = self.loaded.scene.dye.speed if self.loaded.scene.dye else 1.0
        return float(speed / self.loaded.scene.frame_rate)

    @property
    def frames(self) -> int:
        return int(self.loaded.scene.frames)

    @cached_property
    def start(self) -> DyeRun:
        """The scene at its start, whatever its own solver is."""
        plugin = registry.load(self.group, SCHEME)
        return self.begin(plugin, plugin.Config(), 1)

    @cached_property
    def size(self) -> float:
        """Diagonal of the cloth [m]."""
        cells = self.start.cells
        return float(cells.size * math.hypot(*cells.fibre.shape[1:]))

    @property
    def preset(self) -> tuple[str, Mapping[str, Any]]:
        """The scene's own solver, and its configuration."""
        dye = self.loaded.scene.dye
        return (dye.solver.plugin, dye.solver.config) if dye else ("", {})

    def describe(self) -> str:
        """Describe the size of the problem."""
        return f"{self.start.cells.fibre.size:,} cells, {len(self.start.names)} of dye"

    def limit(self, plugin: Any, config: BaseModel) -> StepLimit:
        """Return a solver's limit; dye has no frequencies. Raises BadInput if the solver refuses the scene."""
        return StepLimit(float(plugin.limit(config, self.start.system)), 0.0, 0.0)

    def own_steps(self, limit: StepLimit) -> int:
        """Return the steps per frame of the scene's own solver. Raises BadInput for a step that is too long."""
        return DyeRun(self.loaded, self.threads).steps

    def begin(self, plugin: Any, config: BaseModel, steps: int) -> DyeRun:
        """The scene at its start, to be run by a solver with so many steps a frame. Raises BadInput."""
        chosen = self.loaded.dye
        if chosen is None:
            raise BadInput("the scene has no dye", self.loaded.file)
        solver = Chosen(self.group, plugin, config, "dye.solver", {})
        return DyeRun(replace(self.loaded, dye=replace(chosen, solver=solver)), self.threads, steps)

    def run(self, plugin: Any, config: BaseModel, steps: int, most_seconds: float = math.inf) -> Run:
        """Run the scene by one solver with `steps` steps a frame. Raises BadInput where it refuses them."""
        dyeing = self.begin(plugin, config, steps)
        rows = [self._observe(dyeing.state)]

        def advance(frame: int) -> tuple[DyeReport, float]:
            found = dyeing.advance()
            return found.report, found.seconds

        ended = advance_all(self, advance, lambda report: rows.append(self._observe(dyeing.state)), most_seconds)
        x, mobile, fixed, spread = (np.array(column) for column in zip(*rows, strict=True))
        values = {"mobile": mobile, "fixed": fixed, "spread": spread}
        t = self.frame * np.arange(len(rows), dtype=np.float64)
        return Run(Series(t, x, values, np.zeros((len(rows), 0)), AMOUNTS), *ended)

    def first_call(self, plugin: Any, config: BaseModel, steps: int, taken: int) -> tuple[float, float]:
        """Return the wall times of a solver's first call and of `taken` steps [s]. Raises BadInput if it refuses."""
        begin = time.perf_counter()
        dyeing = self.begin(plugin, config, steps)
        moments, state = [begin, time.perf_counter()], dyeing.state
        with np.errstate(all="ignore"):
            for count in (1, taken):
                plugin.advance(dyeing.system, state, dyeing.memory, count, dyeing.dt)
                moments.append(time.perf_counter())
        return moments[2] - moments[0], moments[3] - moments[2]

    def scales(self, reference: Series) -> dict[str, float]:
        """Return the scales of errors: the largest root mean square of the amounts, all dye, the largest spread."""
        amounts = float(np.sqrt((reference.x**2).sum(axis=2).mean(axis=1)).max()) or 1.0
        total = float((reference.values["mobile"] + reference.values["fixed"]).max()) or 1.0
        spread = float(reference.values["spread"].max()) or 1.0
        return {AMOUNTS: amounts, "mobile": total, "fixed": total, "spread": spread}

    def _observe(self, state: DyeState) -> tuple[Float, Float, Float, Float]:
        """Amounts (dyes * cells, 2), and by dye: mobile, fixed, spread [m]."""
        total = (state.phi + state.fixed).sum(axis=1)
        moments = [_spread(one) * self.start.cells.size for one in total]
        amounts = np.stack([state.phi.reshape(-1), state.fixed.reshape(-1)], axis=1)
        mobile, fixed = (values.reshape(len(moments), -1).sum(axis=1) for values in (state.phi, state.fixed))
        return amounts, mobile, fixed, np.array(moments)


def make_dye_problem(loaded: Loaded, threads: int = 0) -> DyeProblem:
    """Raises BadInput for a scene without dye, or too large to keep."""
    problem = DyeProblem(loaded, threads or cores())
    check_memory(loaded, 2 * problem.start.state.phi.size)
    return problem


def _spread(amounts: Float) -> float:
    """Root mean square distance [cells] of amounts (ny, nx) from their middle; 0 of none."""
    total = float(amounts.sum())
    if not total > 0.0:
        return 0.0
    square = 0.0
    for axis in (0, 1):
        along = amounts.sum(axis=1 - axis)
        place = np.arange(len(along), dtype=np.float64)
        middle = float(along @ place) / total
        square += float(along @ (place - middle) ** 2) / total
    return math.sqrt(max(0.0, square))


AnyProblem = Problem | DyeProblem


def pose(loaded: Loaded, threads: int = 0) -> AnyProblem:
    """A scene as a problem for solvers: dye where nothing moves, else cloth. Raises BadInput.

    `threads` (0: all cores) step it, to the same bits.
    """
    return make_dye_problem(loaded, threads) if loaded.solver is None else make_problem(loaded, threads)
