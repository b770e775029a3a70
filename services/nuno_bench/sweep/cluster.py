"""Tasks on the workers of a Dask cluster, where one machine is outgrown."""

from __future__ import annotations

import asyncio
import importlib.util
import logging
import pickle
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import islice
from typing import Any

from nuno_bench.sweep.executor import Found, Lost, Task, versions
from nuno_schemas.errors import BadInput, RunFailed

CONNECT_SECONDS = 4.0
"""How long a scheduler may take to answer."""
WORKER_SECONDS = 60.0
"""How long a cluster may be without any worker: one that grows by need starts with none."""
LOOK_SECONDS = 1.0
START = "dask scheduler   # and on each machine, with nuno installed: dask worker tcp://HOST:8786"


class Cluster:
    """A client of the scheduler at `address`. As many tasks are handed out as the workers have threads.

    A task whose worker is lost is run again by the scheduler, as often as its own allowed-failures says.
    Raises BadInput where nothing answers, no worker comes, or a worker has other versions than this process.
    """

    def __init__(self, address: str) -> None:
        if importlib.util.find_spec("distributed") is None:
            raise BadInput("Dask is not installed", field="--dask", value=address, remedy="pip install 'nuno[sweep]'")
        self.address, self._versions, self._there, self._key = address, versions(), make_attempt(), 0
        # What goes wrong is said here; its own log would show traces beside it.
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        self._client = _connect(address)
        try:
            self._await_worker()
            self._check_versions()
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

    def run(
        self, call: Callable[[Task], Found], tasks: Iterable[Task]
    ) -> Iterator[tuple[Task, Found | BadInput | Lost]]:
        waiting, pending = iter(tasks), dict[Any, Task]()
        try:
            while True:
                for task in islice(waiting, max(0, self.width - len(pending))):
                    pending[self._submit(call, task)] = task
                if not pending:
                    return
                for future in self._finished(list(pending)):
                    yield pending.pop(future), self._outcome(future)
        except OSError as error:
            raise self._gone() from error
        finally:
            if self._client.status == "running":
                self._client.cancel(list(pending), force=True)

    def close(self) -> None:
        self._client.close(timeout=CONNECT_SECONDS)

    def _submit(self, call: Callable[[Task], Found], task: Task) -> Any:
        self._key += 1
        key = f"nuno-{self._client.id}-{self._key}"
        with warnings.catch_warnings():
            # A scene's files go with its task: workers have no other way to them.
            warnings.filterwarnings("ignore", "Sending large graph")
            payload = pickle.dumps((call, task))
            return self._client.submit(self._there, payload, self._versions, key=key, pure=False)

    def _finished(self, futures: list[Any]) -> list[Any]:
        """Those that are done, at least one. Raises RunFailed where the cluster is gone."""
        import distributed

        alone: float | None = None
        while True:
            try:
                with self._client.as_current():
                    return list(distributed.wait(futures, LOOK_SECONDS, "FIRST_COMPLETED").done)
            except TimeoutError:
                if self._client.status != "running":
                    raise self._gone() from None
            if self._client.nthreads():
                alone = None
                continue
            alone = alone or time.monotonic()
            if time.monotonic() - alone > WORKER_SECONDS:
                raise RunFailed(f"the Dask cluster at {self.address} has had no worker for {WORKER_SECONDS:g} s")

    def _outcome(self, future: Any) -> Any:
        """Its result. Raises RunFailed where the scheduler is gone, BadInput for a worker with other versions."""
        from distributed.scheduler import KilledWorker

        if future.status in ("cancelled", "lost"):
            raise self._gone()
        try:
            found = future.result()
        except KilledWorker as error:
            times = error.allowed_failures + 1
            return Lost(f"its worker ended, {times} times, the last one at {error.last_worker.address}")
        worker, differing, value = found
        if differing:
            raise _foreign(worker, differing)
        return value

    def _gone(self) -> RunFailed:
        return RunFailed(f"the connection to the Dask scheduler at {self.address} was lost")

    def _await_worker(self) -> None:
        try:
            self._client.wait_for_workers(1, timeout=WORKER_SECONDS)
        except TimeoutError:
            raise BadInput("the Dask cluster has no worker", field="--dask", value=self.address,
                           limit=f"waited {WORKER_SECONDS:g} s", remedy=START) from None  # fmt: skip

    def _check_versions(self) -> None:
        for worker, differing, _ in self._client.run(self._there, b"", self._versions).values():
            if differing:
                raise _foreign(worker, differing)


def _connect(address: str) -> Any:
    import distributed

    try:
        # A client would wait for ever for somebody who accepts a connection and then says nothing.
        kind = asyncio.run(asyncio.wait_for(_ask(address), CONNECT_SECONDS))
        if kind != "Scheduler":
            raise ValueError(f"a {kind} answers there")
        return distributed.Client(address, timeout=CONNECT_SECONDS, set_as_default=False, name="nuno")
    except (OSError, ValueError, TypeError, TimeoutError) as error:
        said = str(error).splitlines()[0] if str(error) else "no answer"
        raise BadInput(f"no Dask scheduler can be reached: {said}", field="--dask", value=address,
                       limit=f"waited at most {CONNECT_SECONDS:g} s",
                       remedy=f"start one with {START}") from None  # fmt: skip


async def _ask(address: str) -> str:
    """What kind of server is there."""
    import distributed

    async with distributed.rpc(address, timeout=CONNECT_SECONDS) as server:
        return str((await server.identity())["type"])


def make_attempt() -> Callable[..., tuple[str, dict[str, tuple[str, str]], Any]]:
    """What a worker is asked to do: worker, versions that differ from those wanted (wanted, there), result.

    Made in a function, it is sent by value, and the task as bytes: a scheduler needs no nuno then, and a
    worker without it can say so. A message that a worker cannot load would leave its task waiting for ever.
    Dask itself sets `dask_worker` where all workers are asked.
    """

    def attempt_there(
        payload: bytes, wanted: Mapping[str, str], dask_worker: Any = None
    ) -> tuple[str, dict[str, tuple[str, str]], Any]:
        import pickle

        from distributed import get_worker

        worker = str((dask_worker or get_worker()).address)
        try:
            from nuno_bench.sweep import executor

            found = executor.versions()
            pairs = {name: (value, found.get(name, "not installed")) for name, value in wanted.items()}
            differing = {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}
            if differing or not payload:
                return worker, differing, None
            call, task = pickle.loads(payload)
        except ImportError as error:
            return worker, {"nuno": (wanted["nuno"], f"none ({error})")}, None
        return worker, {}, executor.attempt(call, task)

    return attempt_there


def _foreign(worker: str, differing: Mapping[str, tuple[str, str]]) -> BadInput:
    said = "; ".join(f"{name}: {here} here, {there} there" for name, (here, there) in differing.items())
    return BadInput(f"the worker {worker} has other versions than this process, and its results may differ",
                    field="--dask", value=said, remedy="install the same versions on all machines")  # fmt: skip
