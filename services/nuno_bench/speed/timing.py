"""Timing: a first call that compiles, then repeats that do not."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from numba.core import event


@dataclass
class Compilations:
    """How many functions numba compiled (not: loaded from its cache) while it was watched."""

    number: int = 0


@contextmanager
def watch_compiler() -> Iterator[Compilations]:
    """Count compilations inside the `with`."""
    counted = Compilations()
    with event.install_recorder("numba:compile") as recorder:
        yield counted
        counted.number = sum(1 for _, item in recorder.buffer if item.is_start)


def seconds(call: Callable[[], object]) -> float:
    """Wall time of one call [s]."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def alternate(first: Callable[[], float], second: Callable[[], float], repeats: int) -> tuple[list[float], list[float]]:
    """Samples of two measurements taken in turns, so that a machine that slows down slows both."""
    pairs = [(first(), second()) for _ in range(repeats)]
    return [a for a, _ in pairs], [b for _, b in pairs]
