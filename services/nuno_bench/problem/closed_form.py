"""Exact motion of scenes that are linear: cloth without springs, and springs that all lie along one line.

On a line a spring's force k (|d| - L) is linear as long as it does not turn over, so that positions
and velocities obey z' = A z + b with constant A. Over a frame the solution is exp(A h), of the
matrix extended by b, whose powers give all frames (Moler & Van Loan 2003, SIAM Review 45, 3-49).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nuno.cloth import build
from nuno_bench.problem.observe import Problem, Run, Watch
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.system import StepReport, System

MOST_VERTICES = 200
"""Larger matrices would lose more to rounding than two numerical references do."""
ON_LINE = 1e-12
"""Share of the size by which a vertex may lie beside the line."""
SCALED = 0.125
"""The Taylor series is summed for matrices of at most this norm: 14 terms leave less than rounding."""
TERMS = 14


@dataclass(frozen=True)
class Linear:
    """z' = a z + b for z = (positions, velocities) of the free vertices: a (2m, 2m); b, start (2m, w); axes (w, 3)."""

    a: Float
    b: Float
    start: Float
    axes: Float


def find_linear(problem: Problem) -> Linear | None:
    """The linear system that a scene is, or None where it is none."""
    system, fabric = problem.system, problem.fabric
    bent = fabric.hinges is not None and fabric.hinges.number > 0
    if bent or system.terms or fabric.number > MOST_VERTICES:
        return None
    state = build.start_state(fabric)
    if fabric.springs is None or fabric.springs.number == 0:
        return _assemble(system, state, np.eye(3), None)
    if fabric.springs.lock is not None or fabric.yarns is not None:
        return None
    pairs = fabric.springs.pairs()
    d = state.x[pairs[:, 1]] - state.x[pairs[:, 0]]
    length = np.linalg.norm(d, axis=1)
    if not length.min() > 0.0:
        return None
    axis = d[0] / length[0]
    beside = np.concatenate([d, state.v, system.gravity[None]])
    off = np.abs(beside - np.outer(beside @ axis, axis)).max()
    return _assemble(system, state, axis[None], np.sign(d @ axis)) if off <= ON_LINE * problem.size else None


def _assemble(system: System, state: State, axes: Float, sign: Float | None) -> Linear:
    fabric = system.fabric
    free = ~fabric.pinned
    m, width = int(free.sum()), len(axes)
    stiffness, damper = np.zeros((2, fabric.number, fabric.number))
    force = np.zeros((fabric.number, width))
    if fabric.springs is not None and sign is not None:
        s = fabric.springs
        values = (s.pairs(), sign, *(s.per_spring(array) for array in (s.k, s.c, s.rest)))
        for (i, j), side, k, c, rest in zip(*values, strict=True):
            for matrix, value in ((stiffness, k), (damper, c)):
                matrix[[i, j], [i, j]] += value
                matrix[[i, j], [j, i]] -= value
            force[[i, j], 0] += np.array([-1.0, 1.0]) * k * rest * side
    # Held vertices act on the free ones through their constant places.
    place, speed = state.x @ axes.T, state.v @ axes.T
    inverse = 1.0 / fabric.mass[free, None]
    rest_force = inverse * (force[free] - stiffness[np.ix_(free, ~free)] @ place[~free]) + system.gravity @ axes.T
    lower = [-inverse * stiffness[np.ix_(free, free)], -inverse * damper[np.ix_(free, free)]]
    lower[1] = lower[1] - system.damping * np.eye(m)
    a = np.block([[np.zeros((m, m)), np.eye(m)], lower])
    return Linear(a, np.vstack([np.zeros((m, width)), rest_force]), np.vstack([place[free], speed[free]]), axes)


def exponential(matrix: Float) -> Float:
    """exp of a square matrix, by scaling and squaring of its Taylor series."""
    norm = float(np.abs(matrix).sum(axis=0).max())
    halvings = max(0, int(np.ceil(np.log2(norm / SCALED)))) if norm > 0.0 else 0
    small = matrix / 2.0**halvings
    total = term = np.eye(len(matrix))
    for i in range(1, TERMS + 1):
        term = term @ small / i
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total


def solve(linear: Linear, h: float, frames: int, parts: int = 1) -> Float:
    """(frames + 1, 2m, w) states at multiples of h, each frame in `parts` equal steps."""
    size, width = linear.start.shape
    extended = np.block([[linear.a, linear.b], [np.zeros((width, size + width))]])
    step = exponential(extended * (h / parts))
    z, states = np.vstack([linear.start, np.eye(width)]), [linear.start]
    for _ in range(frames):
        for _ in range(parts):
            z = step @ z
        states.append(z[:size])
    return np.array(states)


def closed_form(problem: Problem, measure: Callable[[State], StepReport]) -> tuple[Run, Run] | None:
    """A scene's exact motion, computed in two ways that differ by rounding, or None where it has none.

    `measure` gives the energies of a state. None too where a spring turns over, which ends the line.
    """
    linear = find_linear(problem)
    if linear is None:
        return None
    runs = []
    for parts in (1, 3):
        states = solve(linear, problem.frame, problem.frames, parts)
        watch = Watch(problem)
        for z in states:
            state = _placed(problem, linear, z)
            if not np.isfinite(z).all() or not _upright(problem.fabric, state):
                return None
            watch.add(state, measure(state))
        runs.append(Run(watch.series(), "ok", "", 0.0, {}))
    return runs[0], runs[1]


def _placed(problem: Problem, linear: Linear, z: Float) -> State:
    """The state whose free vertices move along the axes as z says."""
    state, m = build.start_state(problem.fabric), len(z) // 2
    free, axes = problem.free, linear.axes
    for array, now in ((state.x, z[:m]), (state.v, z[m:])):
        array[free] += (now - array[free] @ axes.T) @ axes
    return state


def _upright(fabric: Fabric, state: State) -> bool:
    """Whether every spring still points as it did at the start."""
    if fabric.springs is None:
        return True
    i, j = fabric.springs.pairs().T
    return bool((((state.x[j] - state.x[i]) * (fabric.position[j] - fabric.position[i])).sum(axis=1) > 0.0).all())
