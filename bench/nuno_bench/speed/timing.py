"""Timing of a case, and the limits of this machine, measured in the same run.

A spring costs one reciprocal square root (its length and the direction), and no rearrangement
avoids it: that throughput over the springs of a vertex is the arithmetic limit of an explicit
step. The memory limit is a triad over arrays that fit no cache.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from nuno_bench.machine import cores
from nuno_bench.report.page import Result
from nuno_kernels.compilation.workers import functions_compiled

LANE, ROUNDS = 2048, 20_000
"""Numbers that a thread works on, 16 KiB, inside every first-level cache; and how often."""
TRIAD = 16_000_000
REPEATS = 5


@dataclass
class Compilations:
    """Number of functions that were compiled (not: loaded from the cache) while it was watched."""

    number: int = 0


@contextmanager
def watch_compiler() -> Iterator[Compilations]:
    """Count compilations inside the `with`."""
    counted, before = Compilations(), functions_compiled()
    yield counted
    counted.number = functions_compiled() - before


def seconds(call: Callable[[], object]) -> float:
    """Wall time of one call [s]."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def measure(
    case: str, what: str, unit: str, call: Callable[[], object], repeats: int, work: float | None = None, **about: Any
) -> Result:
    """Samples of a call: its seconds, or `work` over them. A first call, which compiles or loads, is in none.

    `about` are further fields of the result; how many functions the first call compiled is added to its note.
    """
    with watch_compiler() as compiler:
        first = seconds(call)
    samples = [seconds(call) for _ in range(repeats)]
    note = ", ".join(filter(None, [about.pop("note", ""), f"{compiler.number} functions compiled"]))
    values = tuple(samples if work is None else [work / sample for sample in samples])
    return Result(case, what, unit, values, compile_seconds=first, note=note, **about)


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
