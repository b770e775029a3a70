"""Tasks on several processes of this machine."""

from __future__ import annotations

import multiprocessing
import signal
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, cast

from nuno_bench.sweep.executor import Found, Lost, Task, attempt
from nuno_schemas.errors import BadInput

AGAIN = 2
"""How often a task is run again whose process was lost."""


@dataclass
class _Lane:
    """A process, and this end of the pipe to it."""

    process: BaseProcess
    connection: Connection

    def stop(self) -> None:
        self.process.kill()
        self.process.join()
        self.connection.close()


@dataclass
class _Job:
    """A task, and how often its process was lost."""

    task: Any
    lost: int = 0


class Processes:
    """One task at a time for each of `width` processes, started when there is work for them.

    concurrent.futures would give up all tasks when one process dies, and not say whose it was; here each
    process has a pipe of its own, and its end is the end of one task. It ends too when this process is gone.
    """

    def __init__(self, width: int) -> None:
        self.width, self.where = width, f"{width} processes"
        self._idle: list[_Lane] = []

    def run(
        self, call: Callable[[Task], Found], tasks: Iterable[Task]
    ) -> Iterator[tuple[Task, Found | BadInput | Lost]]:
        waiting, again, busy = iter(tasks), deque[_Job](), dict[Connection, tuple[_Lane, _Job]]()
        try:
            while True:
                while len(busy) < self.width and (job := _next(again, waiting)) is not None:
                    lane = self._idle.pop() if self._idle else _start()
                    busy[lane.connection] = (lane, job)
                    with suppress(BrokenPipeError):  # a process that died idle: receiving says so
                        lane.connection.send((call, job.task))
                if not busy:
                    return
                for connection in cast(list[Connection], wait(list(busy))):
                    lane, job = busy.pop(connection)
                    try:
                        whole, found = connection.recv()
                    except (EOFError, ConnectionResetError):
                        lane.process.join()
                        connection.close()
                        job.lost += 1
                        if job.lost <= AGAIN:
                            again.append(job)
                            continue
                        whole, found = True, Lost(_died(lane.process, job.lost))
                    else:
                        self._idle.append(lane)
                    if not whole:
                        raise RuntimeError(f"a point of the sweep failed:\n{found}")
                    yield job.task, found
        finally:
            for lane, _ in busy.values():
                lane.stop()

    def close(self) -> None:
        for lane in self._idle:
            lane.stop()
        self._idle.clear()


def _next(again: deque[_Job], waiting: Iterator[Any]) -> _Job | None:
    """New tasks come before those to be run again: one that kills its process must not keep others waiting."""
    for task in waiting:
        return _Job(task)
    return again.popleft() if again else None


def _died(process: BaseProcess, times: int) -> str:
    code = process.exitcode or 0
    how = f"ended with exit code {code}"
    if code < 0:
        how = f"was ended by {signal.Signals(-code).name}"
        how += " (out of memory?)" if -code == getattr(signal, "SIGKILL", 0) else ""
    return f"its process {how}, {times} times"


def _start() -> _Lane:
    # Fresh interpreters: compiled kernels' threads do not survive a fork.
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs,), daemon=True)
    process.start()
    theirs.close()
    return _Lane(process, ours)


def _serve(connection: Connection) -> None:
    """Compute what comes until the other end is closed. An interrupt is the other end's to handle."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            call, task = connection.recv()
            try:
                answer = (True, attempt(call, task))
            except Exception:
                answer = (False, traceback.format_exc())
            connection.send(answer)
