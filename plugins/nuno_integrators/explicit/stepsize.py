"""The compiled loop of an adaptive method: stages, error estimate, PI control of the step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_integrators.compiled import source_of
from nuno_integrators.explicit.combine import Buffers, Stage, combine, square
from nuno_kernels import block_kernel, kernel, shared_source
from nuno_kernels.step.acceleration import Extra, Packed, commit, evaluate
from nuno_kernels.step.blocks import Long, copy_rows
from nuno_schemas.fabric import Float

SAFETY, SHRINK, GROW = 0.9, 0.2, 10.0
"""Hairer's factors: the safety factor on the estimated step, and the bounds on its change from one step to the next"""
SMALLEST = 1e-10
"""share of the interval below which a step is given up"""
LANDED = 1e-9
"""share of a step by which it may miss the end of an interval and still count as ending there"""


class Pair(NamedTuple):
    """A tableau in the layout of compiled code; see nuno_integrators.explicit.tableaux.Tableau."""

    stages: int
    estimate: int
    a: Float
    aa: Float
    c: Float
    errors: Float
    position_errors: Float


class Interval(NamedTuple):
    """Limits of an interval's steps: its length [s], the longest step [s], whether one must land on the interval's end,
    and the error allowed for a step [m], times the root of the number of vertices.
    """

    span: float
    longest: float
    landing: bool
    allowed: float


AT, PENDING, NEXT, BEFORE = 0, 1, 2, 3
"""Places in `control` (4,): where the pending step starts, seconds after the start of the interval; its
length, 0 for none; the step to try next; the error of the last accepted step, as a share of the allowed."""

ACCEPTED, REJECTED = 0, 1
"""Places in `counts` (2,)."""


@block_kernel
def attempt(
    b: Buffers, pair: Pair, first: int, stages: int, h: float, start: float, span: float, p: Packed, extra: Extra
) -> None:
    """Compute stages `first` to `stages` - 1 of a step of h from (b.x, b.v); the last leaves the end in (b.y, b.u)."""
    for i in range(first, stages):
        s = (start + pair.c[i] * h) / span
        if i == 0:
            evaluate(b.x, b.v, s, b.k[0], p, extra)
        else:
            combine(b, Stage(pair.c[i] * h, h, pair.aa[i], pair.a[i], i), b.y, b.u, p.threads)
            evaluate(b.y, b.u, s, b.k[i], p, extra)


attempt_interpreted = source_of(attempt, True)


@shared_source
def estimated(b: Buffers, pair: Pair, which: int, h: float, threads: int | None) -> float:
    """Return one of the pair's estimates [m], root of the sum over vertices: h times velocities, and positions."""
    velocity = np.sqrt(square(b.flat, pair.errors[which], b.sums, b.wait, threads))
    return float(h * h * (velocity + np.sqrt(square(b.flat, pair.position_errors[which], b.sums, b.wait, threads))))


@shared_source
def estimate_error(b: Buffers, pair: Pair, h: float, allowed: float, p: Packed) -> float:
    """Return the estimated error over the allowed: root mean square of positions and of h times velocities.

    `allowed` is in metres times the root of the number of vertices. Of two estimates e5 and e3 the
    error is e5^2 / sqrt(e5^2 + e3^2 / 100) (Hairer, Norsett & Wanner 1993, section II.10).
    """
    total = estimated(b, pair, 0, h, p.threads)
    if pair.errors.shape[0] == 2 and total > 0.0:
        other = estimated(b, pair, 1, h, p.threads)
        total = total * total / np.sqrt(total * total + 0.01 * other * other)
    return float(total / allowed)


@kernel
def choose_length(wish: float, left: float, longest: float, landing: bool) -> float:
    """Return the next step's length; one that must land on the end takes half the way if two are left."""
    h = min(wish, longest)
    if landing and h > left * (1.0 - LANDED):
        return left
    if landing and h > 0.5 * left:
        return 0.5 * left
    return h


@kernel
def take(control: Float, h: float, error: float, alpha: float, again: bool) -> None:
    """Leave an accepted step of h pending, and choose the next; `again` after a rejected one."""
    error = max(error, 1e-4)
    wish = SAFETY * control[BEFORE] ** 0.04 / error**alpha
    factor = min(1.0 if again else GROW, max(SHRINK, wish))
    # A step cut short by the interval's end does not hold back the next.
    control[NEXT] = max(h * factor, control[NEXT]) if h < control[NEXT] and factor > 1.0 else h * factor
    control[BEFORE] = error
    control[PENDING] = h


@kernel
def advance_adaptive(
    b: Buffers, pair: Pair, control: Float, counts: Long, interval: Interval, p: Packed, extra: Extra
) -> bool:
    """Step to the end of an interval, until the pending step ends at or beyond it.

    A step that is accepted stays pending until the next is tried, so that the state at the end of the interval can be
    read inside of it. False where the step has become too small.
    """
    span, stages = interval.span, pair.stages
    alpha = 1.0 / (pair.estimate + 1) - 0.75 * 0.04
    first, again = 0, False
    while True:
        h = control[PENDING]
        if h > 0.0:
            over = control[AT] + h - span
            if over > LANDED * h:
                return True
            control[AT] += h
            control[PENDING] = 0.0
            copy_rows(b.y, b.x)
            copy_rows(b.u, b.v)
            commit(b.x, b.v, control[AT] / span, p.bodies, p.bodies_on, p.threads)
            # The last slope is the next step's first, unless bodies have moved vertices or anchors.
            first = 0
            if not p.moved:
                copy_rows(b.k[stages - 1], b.k[0])
                first = 1
            if over > -LANDED * h:
                control[AT] = 0.0
                return True
        h = choose_length(control[NEXT], span - control[AT], interval.longest, interval.landing)
        if p.leave[0] != 0 or not h > SMALLEST * span:
            return False
        if extra is None:
            attempt(b, pair, first, stages, h, control[AT], span, p, None)
        else:
            attempt_interpreted(b, pair, first, stages, h, control[AT], span, p, extra)
        error = estimate_error(b, pair, h, interval.allowed, p)
        if error <= 1.0:
            counts[ACCEPTED] += 1
            take(control, h, error, alpha, again)
            again = False
        else:
            counts[REJECTED] += 1
            # NaN compares false with everything: such a step is shortened as far as allowed.
            control[NEXT] = h * (max(SHRINK, SAFETY / error**alpha) if error < 1e30 else SHRINK)
            first, again = 1, True
