"""What a method does to one mode: its amplification against the exact one, and its energy over 100,000 steps."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from nuno import registry
from nuno_bench.sweep.executor import Executor, Lost
from nuno_bench.sweep.kept import Kept
from nuno_bench.validation.laws.base import NONE, Broken, Run, make_fabric
from nuno_bench.validation.laws.nets import random_net
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Springs
from nuno_schemas.system import System

STEPS, CHUNK = 100_000, 1000
OUT_OF_TIME = "the budget of time"
SHARE = 0.5
"""omega dt of the fastest mode in the long run: a quarter of leapfrog's limit."""


@dataclass(frozen=True)
class Amplification:
    """|eigenvalue| and frequency of a measured step over h = omega dt (m,), the exact ones being 1 and 1."""

    solver: str
    h: Float
    size: Float
    frequency: Float
    stated: float
    """Largest difference between measured and stated matrix over all h."""


@dataclass(frozen=True)
class Drift:
    """Energy over that at the start, minus 1, after so many steps (m,); why it ended early, or ""."""

    solver: str
    steps: Float
    change: Float
    ended: str


def measure_amplification(plugin: Any) -> Amplification:
    """One step from (1, 0) and one from (0, 1) on x'' = -x, at each h."""
    springs = Springs.from_pairs(np.array([[0, 1], [0, 2]], np.int32), np.ones(2), np.zeros(2), np.zeros(2))
    x, v = np.zeros((4, 3)), np.zeros((4, 3))
    x[1, 0], v[2, 0] = 1.0, 1.0
    # A held vertex far away makes the cloth large, and with it the error that adaptive methods allow.
    x[3, 1] = 1e12 if plugin.adaptive else 0.0
    system = System(make_fabric(x, springs, 1.0, np.array([True, False, False, True]), v), NONE)
    h = np.geomspace(0.03, 30.0, 61)
    size, frequency, apart = [], [], 0.0
    for dt in h:
        try:
            run = Run(plugin, system)
            if run.go(1, float(dt)).steps != 1:
                raise Broken("it takes shorter steps of its own choice")
        except (Broken, BadInput):
            size.append(math.nan)
            frequency.append(math.nan)
            continue
        matrix = np.stack([run.state.x[1:3, 0], run.state.v[1:3, 0]])
        stated = plugin.amplification(1.0, 0.0, float(dt))
        apart = max(apart, float(np.abs(matrix - stated).max() / np.abs(stated).max()))
        values = np.linalg.eigvals(matrix)
        size.append(float(np.abs(values).max()))
        frequency.append(float(np.abs(np.angle(values)).max() / dt))
    return Amplification(str(plugin.name), h, np.array(size), np.array(frequency), apart)


def measure_drift(plugin: Any, seconds: float) -> Drift:
    """A free net of twelve vertices at omega dt = SHARE, undamped, looked at every thousand steps."""
    position, springs = random_net(12, 40, 11)
    velocity = 0.2 * np.random.default_rng(2).standard_normal((12, 3))
    system = System(make_fabric(position, springs, 1.0, velocity=velocity), NONE)
    run = Run(plugin, system)
    omega = float(plugin.limit(run.config, system, run.state).omega)
    start, change, ended, begin = run.energy(), [0.0], "", time.perf_counter()
    while len(change) * CHUNK <= STEPS and not ended:
        try:
            run.go(CHUNK, SHARE / omega)
            change.append(run.energy() / start - 1.0)
        except Broken as error:
            ended = str(error).split(":")[0]
        if not np.isfinite(change[-1]) or change[-1] > 1e6:
            ended = "diverged"
        elif time.perf_counter() - begin > seconds and len(change) * CHUNK <= STEPS:
            ended = OUT_OF_TIME
    return Drift(str(plugin.name), CHUNK * np.arange(len(change), dtype=float), np.array(change), ended)


@dataclass(frozen=True)
class Modes:
    """Both of a solver."""

    amplification: Amplification
    drift: Drift

    def json(self) -> dict[str, Any]:
        """Arrays as lists."""
        return {name: {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(part).items()}
                for name, part in vars(self).items()}  # fmt: skip

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Modes:
        def arrays(name: str) -> dict[str, Any]:
            return {k: np.array(v, float) if isinstance(v, list) else v for k, v in data[name].items()}

        return Modes(Amplification(**arrays("amplification")), Drift(**arrays("drift")))


def measure_mode(task: tuple[str, float]) -> Modes:
    """Both of a solver by name, whose long run may take so many seconds."""
    plugin = registry.load("nuno.integrators", task[0])
    return Modes(measure_amplification(plugin), measure_drift(plugin, task[1]))


def measure_modes(
    solvers: Sequence[str], kept: Kept, seconds: float, executor: Executor, told: Callable[[str], None]
) -> tuple[list[Modes], list[str]]:
    """Of every solver, and who has none and why; whole ones are kept as they come.

    The long runs share `seconds`, the cheap ones first, so that others have what is left.
    """
    known = [Modes.from_json(line["modes"]) for line in kept.lines if "modes" in line]
    found = {modes.drift.solver: modes for modes in known}
    wanted = sorted(
        (name for name in solvers if name not in found),
        key=lambda name: not registry.load("nuno.integrators", name).explicit,
    )
    end, omissions = time.monotonic() + seconds, []

    def tasks() -> Iterator[tuple[str, float]]:
        for i, name in enumerate(wanted):
            side = min(executor.width, len(wanted) - i)
            yield name, side * max(0.0, end - time.monotonic()) / (len(wanted) - i)

    for (name, _), modes in executor.run(measure_mode, tasks()):
        left = max(0.0, end - time.monotonic())
        told(f"{name}: a mode, and energy over {STEPS:,} steps ({left:.0f} s left of the solvers' modes at most)")
        if isinstance(modes, BadInput | Lost):
            why = modes.problem if isinstance(modes, BadInput) else modes.reason
            omissions.append(f"modes and energy of {name}: {why}")
            continue
        found[name] = modes
        if modes.drift.ended != OUT_OF_TIME:
            kept.add({"modes": modes.json()})
    return [found[name] for name in solvers if name in found], omissions
