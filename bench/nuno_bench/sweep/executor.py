"""Executors of a sweep's points: in this process, in several processes, or on a Dask cluster.

A task is plain data, computed by a function of a module: both can be pickled, and neither needs a path of this machine.
Results have the same bits on every executor; only times differ.
"""

from __future__ import annotations

import argparse
import asyncio
import fcntl
import gc
import hashlib
import importlib.util
import json
import logging
import multiprocessing
import os
import platform
import signal
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from nuno.plugin_contract import registry
from nuno.scene import scene_file
from nuno.scene.provenance import assets
from nuno.scene.scene_file import Loaded
from nuno_bench import machine, options
from nuno_schemas.errors import BadInput, RunFailed

Task = TypeVar("Task")
Found = TypeVar("Found")
PACKAGES = ("nuno", "numpy", "numba", "llvmlite")
"""Packages on which the bits of a result depend."""
PATIENCE = 60.0
"""Time without a result after which the workers are checked [s]."""


Done = tuple[Task, Found | BadInput | RunFailed]
"""A task and its result: RunFailed if its process was lost in every attempt."""


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


def _alone(call: Callable[[Task], Found], task: Task) -> Found | BadInput | RunFailed:
    pool = _start(1)
    try:
        return pool.submit(attempt, call, task).result()
    except BrokenProcessPool:
        return RunFailed("its process was lost twice, the second time while no other ran (out of memory?)")
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


# Choice of a sweep's executor by a command's arguments: this process, several processes, or a Dask cluster.

CONNECT_SECONDS, WORKER_SECONDS = 4.0, 60.0
"""Longest wait for a scheduler's answer, and for its first worker [s]: an adaptive cluster starts with none."""
START = "dask scheduler   # and on each machine, with nuno installed: dask worker tcp://HOST:8786"


def add_executor_arguments(parser: argparse.ArgumentParser) -> None:
    options.add_count(parser, "--jobs", "processes on this machine (default: all cores)")
    parser.add_argument(
        "--dask", metavar="ADDRESS", help="a Dask scheduler whose workers compute the points: tcp://HOST:8786"
    )


@contextmanager
def open_executor(args: argparse.Namespace) -> Iterator[Executor]:
    """Yield the executor chosen by the arguments, by default on all cores.

    Raises BadInput for invalid numbers and combinations, and, within seconds, if a cluster cannot be reached or has
    another version of nuno.
    """
    with closing(choose_executor(args.jobs, args.dask)) as made:
        yield made


def choose_executor(jobs: int | None, dask: str | None) -> Executor:
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
                    last = error.last_worker.address
                    yield task, RunFailed(f"its worker ended, {times} times, the last one at {last}")
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


# Input and storage of a sweep: a scene with its files as plain data, and finished results, line by line on disk.


@dataclass(frozen=True)
class PackedScene:
    """A scene's text, the user's overrides, and its files by their names in the scene.

    name  name of the scene in errors
    """

    name: str
    text: str
    overrides: tuple[str, ...]
    files: tuple[tuple[str, bytes], ...]

    @property
    def digest(self) -> str:
        """Digest of everything but the name, which identifies a sweep's results."""
        return hashlib.blake2b(repr((self.text, self.overrides, self.files)).encode(), digest_size=16).hexdigest()


def pack(path: Path, overrides: Sequence[str] = ()) -> PackedScene:
    """Read a scene and the files that it names. Raises BadInput for a scene that is refused."""
    return pack_loaded(scene_file.read(path, overrides))


def pack_loaded(loaded: Loaded) -> PackedScene:
    """Pack a loaded scene, and read the files that it names. Raises BadInput."""
    files = sorted(assets(loaded).items())
    for name, _ in files:
        if Path(name).is_absolute():
            remedy = "name it from the scene's folder on"
            raise BadInput("a file is named by a path of this machine alone", loaded.file, value=name, remedy=remedy)
    content = tuple((name, place.read_bytes()) for name, place in files)
    return PackedScene(loaded.file, loaded.path.read_text(encoding="utf-8-sig"), tuple(loaded.overrides), content)


@contextmanager
def unpacked(packed: PackedScene, overrides: Sequence[str] = ()) -> Iterator[Loaded]:
    """Yield the scene, with its files in a temporary folder. Raises BadInput.

    A name such as `../mesh.obj` was refused when the scene was packed: no file is written outside the folder.
    """
    with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
        scene = Path(folder) / "scene.yaml"
        for name, content in (*packed.files, (scene.name, packed.text.encode())):
            (target := Path(folder) / name).parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)
        yield scene_file.read(scene, [*packed.overrides, *overrides], named=packed.name)


def require_kept(paths: Sequence[Path]) -> None:
    """Raise BadInput if there is no sweep to resume."""
    if not any(path.is_file() for path in paths):
        raise BadInput("there is no sweep to go on with", field="--resume", value=", ".join(map(str, paths)),
                       remedy="leave --resume out, or name the --out that it was started with")  # fmt: skip


class SweepFile(AbstractContextManager["SweepFile"]):
    """JSON objects, one per line, after a line that identifies their sweep; locked until `with` ends and adds FINISHED.

    lines  finished results of an interrupted sweep: empty unless it is resumed
    """

    FINISHED: ClassVar = {"finished": True}

    def __init__(self, path: Path, identity: Mapping[str, Any], resume: bool, say: Callable[[str], object]) -> None:
        """Start a new file, or continue an existing one if `resume`; call `say` where a finished sweep is replaced.

        Raises BadInput if another sweep writes there, kept rows would be lost or mixed, or nothing can be written.
        """
        self.path, self.lines = path, list[dict[str, Any]]()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._stream = path.open("a+", encoding="utf-8", errors="replace")
            try:
                self._begin(dict(identity), resume, say)
            except BaseException:
                self._stream.close()  # a traceback that is kept would keep the lock, too
                raise
        except OSError as error:
            problem, remedy = f"cannot write there: {error.strerror}", "choose a folder that can be written"
            if isinstance(error, BlockingIOError):
                problem, remedy = "another sweep is writing there", "wait for its end, or give another --out"
            raise BadInput(problem, field="--out", value=str(path.parent), remedy=remedy) from None

    def _begin(self, head: dict[str, Any], resume: bool, say: Callable[[str], object]) -> None:
        fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._stream.seek(0)
        for line in self._stream.read().split("\n"):
            # The last line may be half written; what it held is measured again.
            with suppress(ValueError):
                self.lines.append(json.loads(line))
        before = self.lines.pop(0) if self.lines else {}
        other = ", ".join(name for name, value in head.items() if before.get(name) != value)
        finished, self.lines = self.FINISHED in self.lines, [line for line in self.lines if line != self.FINISHED]
        if (lost := not (resume or finished) and bool(self.lines)) or (resume and before and other):
            problem = "an interrupted sweep would be lost" if lost else "what was kept belongs to another sweep"
            remedy = f"{'' if other else 'continue it with --resume, '}give another --out, or remove {self.path}"
            raise BadInput(problem, str(self.path), field="--out" if lost else "--resume",
                           limit=f"it has another {other}" if other else None, remedy=remedy)  # fmt: skip
        if finished and not resume:
            say(f"the finished sweep in {self.path} is replaced")
            self.lines = []
        self._stream.truncate(0)
        for one in (head, *self.lines):
            self.add(one)

    def add(self, data: Mapping[str, Any]) -> None:
        self._stream.write(json.dumps(dict(data)) + "\n")
        self._stream.flush()

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with self._stream:
            if kind is None:
                self.add(self.FINISHED)
