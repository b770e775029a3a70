"""Explicit Runge-Kutta methods by their tableaus: stages, one compiled loop of fixed steps, and the methods of nuno.

A method is taken in Nystrom's form: with x' = v, v' = a(x, v) the slopes of x are velocities, which are sums of the
slopes of v themselves. With k_j = a(y_j, u_j), a stage of the method A is

    y_i = x + c_i h v + h^2 sum_j (A A)_ij k_j,    u_i = v + h sum_j A_ij k_j,

the same numbers as the usual form gives (Hairer, Norsett & Wanner 1993, section II.14), from half the memory: each
stage is one pass over the state and those slopes that it has weights for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, ClassVar, NamedTuple

import numpy as np

from nuno_integrators.compiled import Work
from nuno_integrators.explicit.fixed_step import Explicit
from nuno_integrators.explicit.updates import add
from nuno_kernels import block_kernel, kernel
from nuno_kernels.lanes import WIDTH, read, splat, write
from nuno_kernels.step.acceleration import Packed, commit, evaluate
from nuno_kernels.step.blocks import BLOCK
from nuno_kernels.terms import over_blocks
from nuno_schemas.fabric import Float


class Weights(NamedTuple):
    """A tableau in the layout of compiled code: a and aa = A A (rows, rows), c (rows,) the sums of a's rows. The
    result's row follows those of the stages.
    """

    a: Float
    aa: Float
    c: Float


@dataclass(frozen=True)
class Tableau:
    """An explicit Runge-Kutta method for y' = f(y), of stages y_i = y + h sum_j a_ij f(y_j), which begin with y itself.

    a   weights of the second stage and those after it, a row each, of the slopes before it
    b   weights of the result, one for each stage
    """

    a: Sequence[Sequence[float]]
    b: Sequence[float]

    @property
    def stages(self) -> int:
        """Number of stages."""
        return len(self.b)

    @property
    def rows(self) -> Sequence[Sequence[float]]:
        """Weights of each stage and of the result."""
        return (), *self.a, self.b

    @cached_property
    def weights(self) -> Weights:
        """The weights in the layout of compiled code."""
        a = np.zeros((len(self.rows), len(self.rows)))
        for i, row in enumerate(self.rows):
            a[i, : len(row)] = row
        return Weights(a, a @ a, a.sum(axis=1))

    def step(self, x: Float, v: Float, dt: float | Float, slope: Callable[[Float, Float], Float]) -> Float:
        """Return the state (2, ...) after a step of dt from x, v (...), with x'' = slope(x, x')."""
        (a, aa, c), k = self.weights, list[Float]()
        for i in range(self.stages + 1):
            y = x + c[i] * dt * v + dt * dt * sum(aa[i, j] * slope_j for j, slope_j in enumerate(k))
            u = v + dt * sum(a[i, j] * slope_j for j, slope_j in enumerate(k))
            k.append(slope(y, u))
        return np.stack([y, u])

    def amplification(self, omega: float | Float, damping: float | Float, dt: float | Float) -> Float:
        """Return the matrices (2, 2, ...) of one step on x'' = -omega^2 x - damping x', state (x, v)."""
        x, v = np.eye(2).reshape(2, 2, *np.ones(np.ndim(omega * damping * dt), int))
        return self.step(x, v, dt, lambda y, u: -omega * omega * y - damping * u)


class Buffers(NamedTuple):
    """The state (x, v) at a step's start, a stage (y, u), each (3, n), and slopes k (3 s, n)."""

    x: Float
    v: Float
    y: Float
    u: Float
    k: Float


class Stage(NamedTuple):
    """y = x + ch v + h^2 sum position_j k_j and u = v + h sum velocity_j k_j, over the first `slopes` of them."""

    ch: float
    h: float
    position: Float
    velocity: Float
    slopes: int


@block_kernel
def combine_block(block: int, b: Buffers, stage: Stage, y: Float, u: Float) -> None:
    """Compute a stage (y, u) on a block's vertices."""
    x, v, k, position, velocity = b.x, b.v, b.k, stage.position, stage.velocity
    ch, h, count = stage.ch, stage.h, stage.slopes
    low, high = block * BLOCK, min((block + 1) * BLOCK, x.shape[1])
    for row in range(3):
        for p in range(low, high, WIDTH):
            m = min(WIDTH, high - p)
            moved, sped = splat(0.0), splat(0.0)
            for j in range(count):
                if position[j] != 0.0 or velocity[j] != 0.0:
                    slope = read(k, 3 * j + row, p, m)
                    moved = moved + position[j] * slope
                    sped = sped + velocity[j] * slope
            speed = read(v, row, p, m)
            write(y, row, p, m, read(x, row, p, m) + (ch * speed + h * h * moved))
            write(u, row, p, m, speed + h * sped)


combine_blocks = over_blocks(combine_block, "b, stage, y, u")


@kernel
def combine(b: Buffers, stage: Stage, y: Float, u: Float, threads: int | None) -> None:
    """Compute a stage (y, u) (3, n), which may be the state itself, from the state and the slopes in b."""
    combine_blocks(b, stage, y, u, (y.shape[1] + BLOCK - 1) // BLOCK, threads)


@block_kernel
def take_stages(
    b: Buffers, weights: Weights, first: int, end: int, h: float, start: float, span: float, p: Packed
) -> None:
    """Compute stages `first` to `end` - 1 of a step of h from (b.x, b.v), `start` after the beginning of an interval of
    `span`, and their slopes; the last one is left in (b.y, b.u).
    """
    for i in range(first, end):
        s, slope = (start + weights.c[i] * h) / span, b.k[3 * i : 3 * i + 3]
        if i == 0:
            evaluate(b.x, b.v, s, slope, p)
        else:
            combine(b, Stage(weights.c[i] * h, h, weights.aa[i], weights.a[i], i), b.y, b.u, p.threads)
            evaluate(b.y, b.u, s, slope, p)
        if p.frozen_damping != 0.0:
            add(slope, slope, -p.frozen_damping, b.v, p.threads)


@kernel
def advance_runge_kutta(x: Float, v: Float, stages: Float, steps: int, dt: float, p: Packed, weights: Weights) -> None:
    """Take `steps` steps of x, v (3, n) by a tableau of s stages; stages (s + 2, 3, n)."""
    s, span = len(stages) - 2, steps * dt
    b = Buffers(x, v, stages[0], stages[1], stages[2:].reshape((3 * s, x.shape[1])))
    for step in range(steps):
        if p.leave[0] != 0:
            break
        take_stages(b, weights, 0, s, dt, step * dt, span, p)
        combine(b, Stage(dt, dt, weights.aa[s], weights.a[s], s), x, v, p.threads)
        commit(x, v, (step + 1) / steps, p.bodies, p.bodies_on, p.threads)


class RungeKutta(Explicit):
    """An explicit Runge-Kutta method of a fixed step, by its tableau; contact is evaluated at every stage."""

    tableau: ClassVar[Tableau]

    @property
    def room(self) -> int:
        """Number of arrays (3, n) in `stages`: a stage, and all slopes."""
        return self.tableau.stages + 2

    def steps_of(self, work: Work) -> Any:
        return partial(advance_runge_kutta, weights=self.tableau.weights)

    def amplification(self, omega: float | Float, damping: float | Float, dt: float | Float) -> Float:
        return self.tableau.amplification(omega, damping, dt)


class RK4(RungeKutta):
    """The classical method of fourth order: stable for omega dt < 2 sqrt(2) undamped."""

    name: ClassVar[str] = "rk4"
    order: ClassVar[int] = 4
    tableau: ClassVar[Tableau] = Tableau(a=((1 / 2,), (0, 1 / 2), (0, 0, 1)), b=(1 / 6, 1 / 3, 1 / 3, 1 / 6))


class RK4Printed(RK4):
    """RK4 as the skirt paper prints it, kept to show what its slips do.

    The viscous damping is frozen at the step's start, so the method converges at order 1 only, and
    gravity is counted twice. Not meant for simulation.
    """

    name: ClassVar[str] = "rk4_printed"
    order: ClassVar[int] = 1

    def adapt(self, packed: Packed) -> Packed:
        """Remove damping from the acceleration and double gravity."""
        return packed._replace(damping=0.0, frozen_damping=packed.damping, gravity=2.0 * packed.gravity)

    def damped(self, packed: Packed, damping: float) -> Packed:
        return packed if packed.frozen_damping == 0.0 else packed._replace(frozen_damping=damping)

    def amplification(self, omega: float | Float, damping: float | Float, dt: float | Float) -> Float:
        x, v = np.eye(2).reshape(2, 2, *np.ones(np.ndim(omega * damping * dt), int))
        return self.tableau.step(x, v, dt, lambda y, u: -omega * omega * y - damping * v)
