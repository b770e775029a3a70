"""Tasks on the workers of a Dask cluster, where one machine is outgrown."""

from __future__ import annotations

import asyncio
import importlib.util
import logging
import pickle
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Future
from typing import Any

from nuno_bench.sweep.executor import Done, Found, Lost, Task, as_completed, versions
from nuno_schemas.errors import BadInput, RunFailed

CONNECT_SECONDS, WORKER_SECONDS = 4.0, 60.0
"""How long a scheduler may take to answer, and be without a worker: a cluster that grows by need starts with none."""
START = "dask scheduler   # and on each machine, with nuno installed: dask worker tcp://HOST:8786"


class Cluster:
    """A client of the scheduler at `address`. As many tasks are handed out as the workers have threads.

    A task whose worker is lost is run again by the scheduler, as often as its own allowed-failures says.
    Raises BadInput where nothing answers, no worker comes, or a worker has other versions than this process.
    """

    def __init__(self, address: str) -> None:
        if importlib.util.find_spec("distributed") is None:
            raise BadInput("Dask is not installed", field="--dask", value=address, remedy="pip install 'nuno[sweep]'")
        self.address, self._versions, self._there = address, versions(), make_attempt()
        # What goes wrong is said here; its own log would show traces beside it.
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        self._client = _connect(address)
        self._executor = self._client.get_executor(pure=False)
        try:
            self._client.wait_for_workers(1, timeout=WORKER_SECONDS)
            for found in self._client.run(self._there, b"", self._versions).values():
                self._value(found)
        except TimeoutError:
            self.close()
            raise BadInput("the Dask cluster has no worker", field="--dask", value=address,
                           limit=f"waited {WORKER_SECONDS:g} s", remedy=START) from None  # fmt: skip
        except BaseException:
            self.close()
            raise

    @property
    def where(self) -> str:
        threads = self._client.nthreads()
        return f"a Dask cluster at {self.address}, {len(threads)} workers of {sum(threads.values())} threads"

    @property
    def width(self) -> int:
        return max(1, sum(map(int, self._client.nthreads().values())))

    def run(self, call: Callable[[Task], Found], tasks: Iterable[Task]) -> Iterator[Done[Task, Found]]:
        from distributed.scheduler import KilledWorker

        def submit(task: Task) -> Future[Any]:
            with warnings.catch_warnings():
                # A scene's files go with its task: workers have no other way to them.
                warnings.filterwarnings("ignore", "Sending large graph")
                payload = pickle.dumps((call, task))
                future: Future[Any] = self._executor.submit(self._there, payload, self._versions)
                return future

        try:
            for task, future in as_completed(submit, tasks, lambda: self.width, self._check_workers):
                try:
                    yield task, self._value(future.result())
                except KilledWorker as error:
                    times = error.allowed_failures + 1
                    yield task, Lost(f"its worker ended, {times} times, the last one at {error.last_worker.address}")
        except (OSError, CancelledError) as error:
            raise RunFailed(f"the connection to the Dask scheduler at {self.address} was lost") from error

    def close(self) -> None:
        self._client.close(timeout=CONNECT_SECONDS)

    def _value(self, found: tuple[str, dict[str, str], Any]) -> Any:
        """The result of a task. Raises BadInput where its worker has other versions."""
        worker, there, value = found
        if there != self._versions:
            names = [name for name in {**self._versions, **there} if there.get(name) != self._versions.get(name)]
            said = "; ".join(f"{name}: {self._versions.get(name)} here, {there.get(name)} there" for name in names)
            raise BadInput(f"the worker {worker} has other versions than this process, and its results may differ",
                           field="--dask", value=said, remedy="install the same versions on all machines")  # fmt: skip
        return value

    def _check_workers(self) -> None:
        if not self._client.nthreads():
            raise RunFailed(f"the Dask cluster at {self.address} has no worker any more")


def _connect(address: str) -> Any:
    import distributed

    async def ask() -> str:
        """What kind of server is there."""
        async with distributed.rpc(address, timeout=CONNECT_SECONDS) as server:
            return str((await server.identity())["type"])

    try:
        # A client would wait for ever for somebody who accepts a connection and then says nothing.
        kind = asyncio.run(asyncio.wait_for(ask(), CONNECT_SECONDS))
        if kind != "Scheduler":
            raise ValueError(f"a {kind} answers there")
        return distributed.Client(address, timeout=CONNECT_SECONDS, set_as_default=False, name="nuno")
    except (OSError, ValueError, TypeError, TimeoutError) as error:
        said = str(error).splitlines()[0] if str(error) else "no answer"
        raise BadInput(f"no Dask scheduler can be reached: {said}", field="--dask", value=address,
                       limit=f"waited at most {CONNECT_SECONDS:g} s",
                       remedy=f"start one with {START}") from None  # fmt: skip


def make_attempt() -> Callable[..., tuple[str, dict[str, str], Any]]:
    """What a worker is asked to do: its address, its versions, and the result where they are those wanted.

    Made in a function, it is sent by value, and the task as bytes: a scheduler needs no nuno then, and a
    worker without it can say so. A message that a worker cannot load would leave its task waiting for ever.
    Dask itself sets `dask_worker` where all workers are asked.
    """

    def attempt_there(
        payload: bytes, wanted: dict[str, str], dask_worker: Any = None
    ) -> tuple[str, dict[str, str], Any]:
        import pickle

        from distributed import get_worker

        worker = str((dask_worker or get_worker()).address)
        try:
            from nuno_bench.sweep import executor

            there = executor.versions()
            asked = payload and there == wanted
            return worker, there, executor.attempt(*pickle.loads(payload)) if asked else None
        except ImportError as error:
            return worker, wanted | {"nuno": f"none ({error})"}, None

    return attempt_there
