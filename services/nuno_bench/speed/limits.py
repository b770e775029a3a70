"""What this machine could do at best, measured in the same run as what it is compared with.

A spring costs one reciprocal square root (its length and the direction), and no rearrangement
avoids it: that throughput over the springs of a vertex is the arithmetic limit of an explicit
step. The memory limit is a triad over arrays that fit no cache.
"""

from __future__ import annotations

import functools
from typing import Any

import numba
import numpy as np

from nuno_bench.machine import cores
from nuno_bench.speed.timing import seconds

LANE = 2048
"""Numbers a thread works on: 16 KiB, inside every first-level cache."""
ROUNDS = 20_000
TRIAD = 16_000_000
REPEATS = 5


@numba.njit(parallel=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _roots(values: Any, rounds: int) -> None:
    """values = 1/sqrt(values + 1/2), again and again: each round needs the last, but no neighbour."""
    for thread in numba.prange(values.shape[0]):
        lane = values[thread]
        for _ in range(rounds):
            for i in range(lane.shape[0]):
                lane[i] = 1.0 / np.sqrt(lane[i] + 0.5)


@numba.njit(parallel=True)  # type: ignore[untyped-decorator]
def _triad(a: Any, b: Any, c: Any) -> None:
    for i in numba.prange(a.shape[0]):
        a[i] = b[i] + 3.0 * c[i]


@functools.cache
def inverse_roots() -> float:
    """Reciprocal square roots a second over all cores, float64, division and root both exact."""
    values = np.ones((cores(), LANE))
    _roots(values, 1)
    return max(values.size * ROUNDS / seconds(lambda: _roots(values, ROUNDS)) for _ in range(REPEATS))


@functools.cache
def bandwidth() -> float:
    """Bytes a second between memory and all cores: two arrays read, one written."""
    a, b, c = np.zeros(TRIAD), np.ones(TRIAD), np.ones(TRIAD)
    _triad(a, b, c)
    return max(3 * 8 * TRIAD / seconds(lambda: _triad(a, b, c)) for _ in range(REPEATS))


def vertex_steps(springs_per_vertex: float) -> float:
    """Most million vertex-steps a second that the reciprocal square roots allow."""
    return inverse_roots() / springs_per_vertex * 1e-6
