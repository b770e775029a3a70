"""Executors of a sweep's points: in this process, in several processes, or on a Dask cluster.

A task is plain data, computed by a function of a module: both can be pickled, and neither needs a path of this machine.
Results have the same bits on every executor; only times differ.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import platform
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from importlib.metadata import version
from itertools import islice
from typing import Any, TypeVar

from nuno import registry
from nuno_schemas.errors import BadInput

Task = TypeVar("Task")
Found = TypeVar("Found")
PACKAGES = ("nuno", "numpy", "numba", "llvmlite")
"""Packages on which the bits of a result depend."""
PATIENCE = 60.0
"""Time without a result after which the workers are checked [s]."""


@dataclass(frozen=True)
class Lost:
    """Result of a task whose process was lost in every attempt."""

    reason: str

    def __str__(self) -> str:
        return self.reason


Done = tuple[Task, Found | BadInput | Lost]
"""A task and its result."""


class Executor:
    """Computes tasks one after another, in this process; base of other executors.

    `where` describes the place; `width` is the present number of simultaneous tasks.
    """

    where = "one after another"
    width = 1

    def run(self, call: Callable[[Task], Found], tasks: Iterable[Task]) -> Iterator[Done[Task, Found]]:
        """Yield each task with the result of `call`, as they finish; a BadInput that it raises is a result.

        Tasks are taken from the iterable only when they can be started. A task whose process is lost is run
        again. Raises RunFailed if no task can be computed any more; other errors of `call` end the run.
        """
        for task in tasks:
            yield task, attempt(call, task)

    def close(self) -> None:
        """End all tasks."""


class Processes(Executor):
    """`width` processes of this machine, started when there is work for them; they end with this one."""

    def __init__(self, width: int) -> None:
        self.width, self.where, self._pool = width, f"{width} processes", _start(width)

    def run(self, call: Callable[[Task], Found], tasks: Iterable[Task]) -> Iterator[Done[Task, Found]]:
        def submit(task: Task) -> Future[Any]:
            try:
                return self._pool.submit(attempt, call, task)
            except BrokenProcessPool:
                self._pool = _start(self.width)
                return self._pool.submit(attempt, call, task)

        for task, future in as_completed(submit, tasks, lambda: self.width):
            try:
                result = future.result()
            except BrokenProcessPool:
                # A lost process ends all tasks of its pool, and the guilty one is unknown: each is tried again
                # by itself.
                result = _alone(call, task)
            yield task, result

    def close(self) -> None:
        _kill(self._pool)
        del self._pool
        gc.collect()  # frees its semaphores, even if the program ends at once


def as_completed(
    submit: Callable[[Task], Future[Any]],
    tasks: Iterable[Task],
    width: Callable[[], int],
    check: Callable[[], None] = lambda: None,
) -> Iterator[tuple[Task, Future[Any]]]:
    """Yield each task with its finished future; at most `width()` run at once.

    `check` is called after PATIENCE seconds without a result, and raises if none will come.
    """
    waiting, busy = iter(tasks), dict[Future[Any], Task]()
    try:
        while True:
            for task in islice(waiting, max(0, width() - len(busy))):
                busy[submit(task)] = task
            if not busy:
                return
            done = wait(busy, PATIENCE, FIRST_COMPLETED).done
            if not done:
                check()
            for future in done:
                yield busy.pop(future), future
    finally:
        for future in busy:
            future.cancel()


def _alone(call: Callable[[Task], Found], task: Task) -> Found | BadInput | Lost:
    pool = _start(1)
    try:
        return pool.submit(attempt, call, task).result()
    except BrokenProcessPool:
        return Lost("its process was lost twice, the second time with no other beside it (out of memory?)")
    finally:
        _kill(pool)


def _start(width: int) -> ProcessPoolExecutor:
    # Fresh interpreters: compiled kernels' threads do not survive a fork.
    return ProcessPoolExecutor(width, multiprocessing.get_context("spawn"), _begin)


def _begin() -> None:
    """Ignore interrupts, which the parent process handles, and end with the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_follow, daemon=True).start()


def _follow() -> None:
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(1)


def _kill(pool: ProcessPoolExecutor) -> None:
    """Kill the pool's processes; a shutdown would wait for them (Python 3.14 has kill_workers)."""
    for process in list((pool._processes or {}).values()):
        process.kill()
        process.join()
    pool.shutdown(cancel_futures=True)  # its semaphores are the system's


def attempt(call: Callable[[Task], Found], task: Task) -> Found | BadInput:
    """Return the result of `call` for a task, or the error that refuses it."""
    try:
        return call(task)
    except BadInput as error:
        return error


def versions() -> dict[str, str]:
    """Return the versions of everything that a result may depend on, by name; of solvers those of their packages."""
    numbers = {"Python": ".".join(platform.python_version_tuple()[:2])}
    numbers |= {name: version(name) for name in PACKAGES}
    for group, kind in (("nuno.integrators", "solver"), ("nuno.dye_solvers", "dye solver")):
        names = sorted(registry.installed(group))
        numbers |= {f"{kind} {name}": registry.package_version(group, name) for name in names}
    return numbers
