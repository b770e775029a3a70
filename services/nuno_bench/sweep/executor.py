"""Where the points of a sweep are computed: in this process, in several of this machine, or on a Dask cluster.

A task is plain data, and what computes it a function of a module: both can be pickled, and neither needs a path of
this machine. Results are the same bits wherever they come from; only times differ.
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
"""Those on which the bits of a result depend."""
PATIENCE = 60.0
"""How long nothing may be done before it is asked whether anybody is left who does it [s]."""


@dataclass(frozen=True)
class Lost:
    """A task whose process was lost whenever it was tried."""

    reason: str

    def __str__(self) -> str:
        return self.reason


Done = tuple[Task, Found | BadInput | Lost]
"""A task and what came of it."""


class Executor:
    """Computes tasks one after another, in this process; others derive from it.

    `where` says in words where; `width` is how many tasks go on at once, now.
    """

    where = "one after another"
    width = 1

    def run(self, call: Callable[[Task], Found], tasks: Iterable[Task]) -> Iterator[Done[Task, Found]]:
        """Each task with what `call` makes of it, as they are done; a BadInput that it raises is a result.

        Tasks are taken from the iterable only when they can be started. A task whose process is lost is run
        again. Raises RunFailed where no task can be computed any more; what else `call` raises ends the run.
        """
        for task in tasks:
            yield task, attempt(call, task)

    def close(self) -> None:
        """End what goes on."""


class Processes(Executor):
    """So many processes of this machine, started when there is work for them; they end with this one."""

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
                found = future.result()
            except BrokenProcessPool:
                # A lost process takes all that its pool was at along, and whose it was is not said: each is
                # tried again by itself.
                found = _alone(call, task)
            yield task, found

    def close(self) -> None:
        _kill(self._pool)
        del self._pool
        gc.collect()  # its semaphores go with it, also where the program ends without looking back


def as_completed(
    submit: Callable[[Task], Future[Any]],
    tasks: Iterable[Task],
    width: Callable[[], int],
    check: Callable[[], None] = lambda: None,
) -> Iterator[tuple[Task, Future[Any]]]:
    """Each task with its future, which is done; at most `width()` go on at once.

    `check` is called where nothing was done for PATIENCE seconds, and raises where nothing will be.
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
    """A process ends with the one that started it, whose part it is to handle an interrupt."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_follow, daemon=True).start()


def _follow() -> None:
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(1)


def _kill(pool: ProcessPoolExecutor) -> None:
    """End its processes, whatever they are at; a shutdown would wait for them (Python 3.14 has kill_workers)."""
    for process in list((pool._processes or {}).values()):
        process.kill()
        process.join()
    pool.shutdown(cancel_futures=True)  # its semaphores are the system's


def attempt(call: Callable[[Task], Found], task: Task) -> Found | BadInput:
    """What `call` makes of a task, or why the task is refused."""
    try:
        return call(task)
    except BadInput as error:
        return error


def versions() -> dict[str, str]:
    """Versions of everything that a result may depend on, by name; of solvers those of their packages."""
    found = {"Python": ".".join(platform.python_version_tuple()[:2])}
    found |= {name: version(name) for name in PACKAGES}
    for group, kind in (("nuno.integrators", "solver"), ("nuno.dye_solvers", "dye solver")):
        names = sorted(registry.installed(group))
        found |= {f"{kind} {name}": registry.package_version(group, name) for name in names}
    return found
