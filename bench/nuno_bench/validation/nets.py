"""Laws of nets that fly, swing and turn: order on a nonlinear problem, invariants, symmetry, forces."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_bench.piles import DOWN, G, build_model
from nuno_bench.validation.law import NONE, Laws, Measurement, SolverRun, fit_order, make_fabric
from nuno_bench.validation.oscillator import KEEPS_ANGULAR_MOMENTUM, order_found
from nuno_schemas.fabric import Fabric, Float, Springs
from nuno_schemas.system import System

laws = Laws()
ROUNDING = 1e-10
"""Share of a quantity that rounding over some hundred steps may change."""
DURATION = 0.2
Long = NDArray[np.floating[Any]]
COLUMNS = 6
"""Columns of the extrapolation table: order 12. More would cost digits: the scheme's weights alternate and grow."""


def random_net(n: int, springs: int, seed: int, c: float = 0.0) -> tuple[Float, Springs]:
    """Vertices in a box of 1 m and distinct random springs, 1 to 100 N/m, near their rest length."""
    rng = np.random.default_rng(seed)
    position = rng.uniform(0.0, 1.0, (n, 3))
    every = np.array([(i, j) for i in range(n) for j in range(i + 1, n)], np.int32)
    pairs = every[rng.permutation(len(every))[:springs]]
    length = np.linalg.norm(position[pairs[:, 1]] - position[pairs[:, 0]], axis=1)
    rest = length * rng.uniform(0.8, 1.1, springs)
    return position, Springs.from_pairs(pairs, rng.uniform(1.0, 100.0, springs), rest, c * rng.uniform(0.5, 1, springs))


def swinging_net() -> System:
    """Twelve vertices, two of them pinned; damped springs, gravity and viscous damping."""
    position, springs = random_net(12, 40, 11, c=0.3)
    pinned = np.arange(12) < 2
    velocity = np.random.default_rng(2).standard_normal((12, 3)) * ~pinned[:, None]
    return System(make_fabric(position, springs, 1.0, pinned, velocity), DOWN, 0.8)


@cache
def _swung() -> Float:
    """x and v (2, n, 3) of the swinging net at its end."""
    return solve(swinging_net(), DURATION, 40)


@laws("order, net", "forces by their definition, extrapolated to order 12")
def measure_order(plugin: Any) -> Measurement:
    """The error on a swinging net after 0.2 s, against an independent solution, falls with the nominal order."""
    first, ratio = {1: (400, 2.0), 2: (50, 2.0), 4: (20, 2.0), 5: (20, 1.5)}.get(plugin.order, (100, 2.0))
    if plugin.order > 5:
        first, ratio = 14, 1.17
    counts, errors = np.round(first * ratio ** np.arange(4)), []
    for count in counts:
        run = SolverRun(plugin, swinging_net())
        run.go(int(count), DURATION / count)
        errors.append(float(np.abs(run.both() - _swung()).max()))
    return order_found(plugin, counts, DURATION, np.array(errors), float(np.abs(_swung()).max()))


@laws("projectile", "closed form")
def measure_projectile(plugin: Any) -> Measurement:
    """A particle flies as x = x0 + v t + g t^2 / 2, v = v0 + g t.

    From order 2 on exactly; a first-order method is off by g t dt / 2 at most.
    """
    count, dt = 100, 0.01
    velocity = np.tile([1.0, 2.0, 0.0], (3, 1))
    run = SolverRun(plugin, System(make_fabric(np.zeros((3, 3)), velocity=velocity), DOWN))
    run.go(count, dt)
    exact = np.array([1.0, 2.0 - 0.5 * G, 0.0])
    allowed = 1e-11 if plugin.order > 1 else 0.5 * G * dt * (1.0 + 1e-9)
    error = max(np.abs(run.state.x - exact).max(), np.abs(run.state.v - [1.0, 2.0 - G, 0.0]).max())
    return Measurement(float(run.state.x[0, 1]), float(exact[1]), float(error), allowed)


def free_net(turn: Float | None = None) -> System:
    """Thirty vertices of uneven mass that fly about; turned as a whole by an orthogonal matrix."""
    position, springs = random_net(30, 150, 3)
    velocity = np.random.default_rng(1).standard_normal((30, 3))
    mass = np.random.default_rng(2).uniform(0.5, 2.0, 30)
    q = np.eye(3) if turn is None else turn
    return System(make_fabric(position @ q.T, springs, mass, velocity=velocity @ q.T), NONE)


@laws("sideways drift", "momentum")
def measure_drift(plugin: Any) -> Measurement:
    """The centre of mass of a net that vibrates and falls does not move sideways."""
    fabric = free_net().fabric
    weight = fabric.mass[:, None] / fabric.mass.sum()
    still = fabric.velocity - (weight * fabric.velocity).sum(axis=0)
    run = SolverRun(plugin, System(replace(fabric, velocity=still), DOWN))
    run.go(400, 1e-3)
    moved = (weight * (run.state.x - fabric.position)).sum(axis=0)
    fell = abs(float(moved[1])) or np.nan
    aside = float(np.abs(moved[[0, 2]]).max())
    return Measurement(aside, 0.0, aside / fell, ROUNDING)


@laws("momentum", "Newton's third law")
def measure_momentum(plugin: Any) -> Measurement:
    """A free net keeps its momentum to rounding, as a share of the sum of its parts' momenta."""
    run = SolverRun(plugin, free_net())
    parts = run.system.fabric.mass[:, None] * run.system.fabric.velocity
    run.go(400, 1e-3)
    change = run.system.fabric.mass[:, None] * run.state.v - parts
    largest = float(np.abs(change.sum(axis=0)).max())
    return Measurement(largest, 0.0, largest / float(np.abs(parts).sum()), ROUNDING)


@laws("angular momentum", "central forces")
def measure_angular(plugin: Any) -> Measurement:
    """A free net keeps its angular momentum: to rounding by kicks and drifts, else to the nominal order at least."""
    if plugin.name in KEEPS_ANGULAR_MOMENTUM:
        change = _turned(plugin, 400, 0.4)
        return Measurement(change, 0.0, change, ROUNDING)
    first, ratio = {1: (400, 2.0), 2: (60, 2.0), 4: (30, 2.0)}.get(plugin.order, (20, 1.5))
    if plugin.order > 5:
        first, ratio = 10, 1.3
    counts = np.round(first * ratio ** np.arange(4))
    changes = np.array([_turned(plugin, int(count), 0.2) for count in counts])
    if changes.max() < ROUNDING:
        return Measurement(float(changes[0]), 0.0, float(changes[0]), ROUNDING)
    return fit_order(0.2 / counts, changes, plugin.order, least=True)


def _turned(plugin: Any, count: int, duration: float) -> float:
    """Change of the free net's angular momentum over so many steps, as a share of the sum of its parts'."""
    run = SolverRun(plugin, free_net())
    weight = run.system.fabric.mass[:, None]
    before = weight * np.cross(run.state.x, run.state.v)
    run.go(count, duration / count)
    after = weight * np.cross(run.state.x, run.state.v)
    return float(np.abs((after - before).sum(axis=0)).max() / np.abs(before).sum())


@laws("rotation", "isotropy of space")
def measure_rotation(plugin: Any) -> Measurement:
    """A turned net moves as the net does, turned."""
    q, _ = np.linalg.qr(np.random.default_rng(8).standard_normal((3, 3)))
    ends = []
    for turn in (np.eye(3), q):
        run = SolverRun(plugin, free_net(turn))
        run.go(100, 1e-3)
        ends.append(run.state.x @ turn)
    apart = float(np.abs(ends[0] - ends[1]).max())
    return Measurement(apart, 0.0, apart, ROUNDING)


@cache
def _crumpled() -> Fabric:
    """A sheet of denim, 6 x 6, with springs and hinges, crumpled a little."""
    fabric = {"preset": "denim", "damping_ratio": 0}
    piece = build_model("sheet", {"resolution": (6, 6), "size": (0.1, 0.1), "fabric": fabric})
    x = piece.position + 2e-3 * np.random.default_rng(5).standard_normal(piece.position.shape)
    return make_fabric(x, piece.springs, piece.mass, hinges=piece.hinges)


@laws("force, energy", "central differences")
def measure_gradient(plugin: Any) -> Measurement:
    """force = -grad energy, of springs and hinges: from a short step out of rest, and of the reported energy."""
    run = SolverRun(plugin, System(_crumpled(), DOWN))
    fabric = run.system.fabric
    dt, reach = 1e-4 / float(plugin.limit(run.config, run.system, run.state).omega), 1e-7
    run.go(1, dt)
    force = fabric.mass[:, None] * run.state.v / dt
    probe = SolverRun(plugin, run.system)
    slope = np.zeros_like(force)
    for place in np.ndindex(*force.shape):
        energies = []
        for move in (reach, -reach):
            probe.state.x[...], probe.state.v[...] = fabric.position, 0.0
            probe.state.x[place] += move
            energies.append(probe.energy())
        slope[place] = (energies[0] - energies[1]) / (2.0 * reach)
    scale = float(np.abs(force).max())
    return Measurement(scale, float(np.abs(slope).max()), float(np.abs(force + slope).max() / scale), 1e-5)


def slopes(system: System, y: Long) -> Long:
    """(2, n, 3) derivatives of positions and velocities y: of springs, gravity and viscous damping, nothing else."""
    fabric, springs = system.fabric, system.fabric.springs
    (x, v), force = y, np.zeros_like(y[0])
    if springs is not None:
        i, j = springs.pairs().T
        k, rest, c = (springs.per_spring(values) for values in (springs.k, springs.rest, springs.c))
        d = x[j] - x[i]
        length = np.sqrt((d * d).sum(axis=1))
        along = d / length[:, None]
        pull = k * (length - rest) + c * ((v[j] - v[i]) * along).sum(axis=1)
        np.add.at(force, i, pull[:, None] * along)
        np.add.at(force, j, -pull[:, None] * along)
    a = force / fabric.mass[:, None] + system.gravity - system.damping * v
    return np.stack([v, np.where(fabric.pinned[:, None], 0.0, a)])


def solve(system: System, duration: float, spans: int) -> Float:
    """Positions and velocities (2, n, 3) after `duration` [s], in `spans` extrapolated steps of the longest floats.

    Gragg's modified midpoint rule has an error in even powers of its step, which Neville's scheme
    takes away one by one (Hairer, Norsett & Wanner 1993, section II.9).
    """
    y: Long = np.stack([system.fabric.position, system.fabric.velocity]).astype(np.longdouble)
    for _ in range(spans):
        rows: list[list[Long]] = []
        for column in range(COLUMNS):
            row = [_midpoint(system, y, duration / spans, 2 * (column + 1))]
            for back in range(1, column + 1):
                ratio = ((column + 1) / (column + 1 - back)) ** 2
                row.append(row[-1] + (row[-1] - rows[-1][back - 1]) / (ratio - 1.0))
            rows.append(row)
        y = rows[-1][-1]
    return y.astype(np.float64)


def _midpoint(system: System, y: Long, span: float, steps: int) -> Long:
    h = span / steps
    before, now = y, y + h * slopes(system, y)
    for _ in range(steps - 1):
        before, now = now, before + 2.0 * h * slopes(system, now)
    return np.asarray(0.5 * (now + before + h * slopes(system, now)))
