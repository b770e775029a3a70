"""Choice of a sweep's executor by a command's arguments: this process, several processes, or a Dask cluster."""

from __future__ import annotations

import argparse
import asyncio
import importlib.util
import logging
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import closing, contextmanager
from typing import Any

from nuno_bench import machine, options
from nuno_bench.sweep.executor import Done, Executor, Found, Lost, Processes, Task, as_completed, attempt, versions
from nuno_schemas.errors import BadInput, RunFailed

CONNECT_SECONDS, WORKER_SECONDS = 4.0, 60.0
"""Longest wait for a scheduler's answer, and for its first worker [s]: an adaptive cluster starts with none."""
START = "dask scheduler   # and on each machine, with nuno installed: dask worker tcp://HOST:8786"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    options.add_count(parser, "--jobs", "processes on this machine (default: all cores)")
    parser.add_argument(
        "--dask", metavar="ADDRESS", help="a Dask scheduler whose workers compute the points: tcp://HOST:8786"
    )


@contextmanager
def opened(args: argparse.Namespace) -> Iterator[Executor]:
    """Yield the executor chosen by the arguments, by default on all cores.

    Raises BadInput for invalid numbers and combinations, and, within seconds, if a cluster cannot be reached or has
    another version of nuno.
    """
    with closing(chosen(args.jobs, args.dask)) as made:
        yield made


def chosen(jobs: int | None, dask: str | None) -> Executor:
    """Return an executor of `jobs` processes, by default on all cores, or a cluster's. Raises BadInput."""
    if jobs is not None and dask is not None:
        raise BadInput("either --jobs or --dask says where points are computed", value=f"{jobs}, {dask}")
    if dask is not None:
        return Cluster(dask)
    if jobs is not None and jobs < 1:
        raise BadInput("at least one is needed", field="--jobs", value=jobs)
    number = jobs or machine.cores()
    return Processes(number) if number > 1 else Executor()


class Cluster(Executor):
    """A client of the scheduler at `address`. It submits as many tasks as the workers have threads.

    The scheduler runs a task whose worker is lost again, up to its allowed-failures. Raises BadInput if nothing
    answers, no worker joins, or a worker has other versions than this process.
    """

    def __init__(self, address: str) -> None:
        if importlib.util.find_spec("distributed") is None:
            raise BadInput("Dask is not installed", field="--dask", value=address, remedy="pip install 'nuno[sweep]'")
        # Errors are reported here; Dask's log would add tracebacks. A scene's files are sent with its task, since
        # workers cannot read them otherwise.
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        warnings.filterwarnings("ignore", "Sending large graph")
        self.address, self._client = address, _connect(address)
        self._executor = self._client.get_executor(pure=False)
        try:
            self._client.wait_for_workers(1, timeout=WORKER_SECONDS)
            self._check_versions()
        except TimeoutError:
            self.close()
            raise BadInput("the Dask cluster has no worker", field="--dask", value=address,
                           limit=f"waited {WORKER_SECONDS:g} s", remedy=START) from None  # fmt: skip
        except BaseException:
            self.close()
            raise

    @property
    def where(self) -> str:  # type: ignore[override]
        threads = self._client.nthreads()
        return f"a Dask cluster at {self.address}, {len(threads)} workers of {sum(threads.values())} threads"

    @property
    def width(self) -> int:  # type: ignore[override]
        return max(1, sum(map(int, self._client.nthreads().values())))

    def run(self, call: Callable[[Task], Found], tasks: Iterable[Task]) -> Iterator[Done[Task, Found]]:
        from distributed.scheduler import KilledWorker

        def submit(task: Task) -> Future[Any]:
            future: Future[Any] = self._executor.submit(attempt, call, task)
            return future

        try:
            for task, future in as_completed(submit, tasks, lambda: self.width, self._check_workers):
                try:
                    yield task, future.result()
                except KilledWorker as error:
                    times = error.allowed_failures + 1
                    yield task, Lost(f"its worker ended, {times} times, the last one at {error.last_worker.address}")
        except (OSError, CancelledError) as error:
            raise RunFailed(f"the connection to the Dask scheduler at {self.address} was lost") from error

    def close(self) -> None:
        self._client.close(timeout=CONNECT_SECONDS)

    def _check_versions(self) -> None:
        """Raise BadInput if a present worker has other versions than this process, or no nuno."""
        here = versions()
        for worker, there in self._client.run(versions, on_error="return").items():
            if isinstance(there, Exception):
                there = here | {"nuno": f"none ({there})"}
            if differing := [f"{n}: {here.get(n)} here, {there.get(n)} there" for n in {**here, **there}
                             if there.get(n) != here.get(n)]:  # fmt: skip
                raise BadInput(f"the worker {worker} has other versions than this process, and its results may differ",
                               field="--dask", value="; ".join(differing),
                               remedy="install the same versions on all machines")  # fmt: skip

    def _check_workers(self) -> None:
        if not self._client.nthreads():
            raise RunFailed(f"the Dask cluster at {self.address} has no worker any more")


def _connect(address: str) -> Any:
    import distributed

    async def ask() -> str:
        """Return the kind of the server at the address."""
        async with distributed.rpc(address, timeout=CONNECT_SECONDS) as server:
            return str((await server.identity())["type"])

    try:
        # A client would wait for ever for a server that accepts a connection and never answers.
        kind = asyncio.run(asyncio.wait_for(ask(), CONNECT_SECONDS))
        if kind != "Scheduler":
            raise ValueError(f"a {kind} answers there")
        return distributed.Client(address, timeout=CONNECT_SECONDS, set_as_default=False, name="nuno")
    except (OSError, ValueError, TypeError, TimeoutError) as error:
        reason = str(error).splitlines()[0] if str(error) else "no answer"
        raise BadInput(f"no Dask scheduler can be reached: {reason}", field="--dask", value=address,
                       limit=f"waited at most {CONNECT_SECONDS:g} s",
                       remedy=f"start one with {START}") from None  # fmt: skip
