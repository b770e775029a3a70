"""Processes that compile kernels side by side, on all cores.

numba compiles in one thread: its lock is global. A process that has compiled for PATIENCE starts others, has them
compile what it calls, and loads what they leave in the cache. They get no data, but a kernel's name and the types of
its arguments. A kernel that is called by address and says what it returns need not be compiled before its callers are:
its symbol is all that they need. Such ones go back to the process that started the others, and on to the next free
one, so that a step's kernels are found by compiling the step, and compiled side by side.

Not chosen: processes that are given a list of the kernels that a system will need. Contact makes lists of pairs, and a
method looks for its step, before there is a system; and each method, collider and dye would have to foretell its own.
"""

from __future__ import annotations

import contextlib
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from pkgutil import resolve_name
from typing import Any

import numba

from nuno_kernels.compilation.internals import by_address, compiled_here, term_classes

PATIENCE = 2.0
"""seconds of compilation after which processes are started: who has compiled as long probably will as long again. This
one compiles on until they are ready, for they import what it has imported"""
IDLE = 10.0
"""seconds without work after which they end"""
START = "import sys; sys.path[:] = {path}; from {module} import work; work({pipe}, {folder!r}, {modules})"

Task = tuple[str, bytes]
"""the name of the file that it makes, and what to compile: modules to import before, the kernel's module and name, its
version, and the types of its arguments, pickled"""


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def idle_cores() -> int:
    """Return how many cores other programs leave, by the load of the last minute: on busy ones processes would only
    import what they need.
    """
    return cores() - int(os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0)


class Workers:
    """The processes of this one, each served by a thread; they end when they are idle, or with this process."""

    def __init__(self) -> None:
        self.started, self.ready, self.compiled, self.enlisted = 0, 0, 0.0, 0
        self.lock, self.waiting, self.made = threading.Lock(), queue.SimpleQueue[Task](), dict[str, Future[None]]()

    def compile(self, task: Task) -> None:
        """Have a task compiled, and wait for that; return at once while no process is ready."""
        with self.lock:
            if self.started == 0 and compiled_here()[1] - self.compiled > PATIENCE and cores() > 1:
                self.started = max(0, idle_cores())
                for _ in range(self.started):
                    threading.Thread(target=self._serve, daemon=True).start()
            if self.ready == 0:
                return
            made = self._enlist(task)
        made.result()

    def foresee(self, tasks: Callable[[], Iterable[Task | None]]) -> bool:
        """Have tasks compiled that will be waited for later; return whether a process is ready for that."""
        with self.lock:
            if self.ready > 0:
                for task in filter(None, tasks()):
                    self._enlist(task)
            return self.ready > 0

    def _enlist(self, task: Task) -> Future[None]:
        if task[0] not in self.made:
            self.made[task[0]] = Future()
            self.enlisted += 1
            self.waiting.put(task)
        return self.made[task[0]]

    def _serve(self) -> None:
        """Start a process and give it one task after the other; what it finds meanwhile is for all."""
        ready = 0
        try:
            with contextlib.suppress(OSError, EOFError, queue.Empty), _start() as pipe:
                ready = 1 if pipe.recv() is None else 0
                with self.lock:
                    self.ready += ready
                while True:
                    self._give(pipe, self.waiting.get(timeout=IDLE))
        finally:
            with self.lock:
                self.started, self.ready = self.started - 1, self.ready - ready
                if self.ready == 0:  # what there is left to do is for this process
                    for made in self.made.values():
                        if not made.done():
                            made.set_result(None)
                    self.waiting, self.made, self.compiled = queue.SimpleQueue(), {}, compiled_here()[1]

    def _give(self, pipe: Connection[Any, Any], task: Task) -> None:
        try:
            pipe.send(task)
            while (found := pipe.recv()) is not None:
                with self.lock:
                    self._enlist(found)
        finally:
            self.made[task[0]].set_result(None)


WORKERS = Workers()
MODULES: set[str] = set()
"""those that have kernels"""


def functions_compiled() -> int:
    """Return how many functions this process has compiled, or had compiled, and not found in the cache, so far."""
    return compiled_here()[0] + WORKERS.enlisted


FOUND: Callable[[Task], None] | None = None
"""in such a process: reports a task that it has found"""


@contextlib.contextmanager
def _start() -> Iterator[Connection[Any, Any]]:
    """Start a process that works until its pipe is closed. It is in a session of its own: Ctrl-C is for this one."""
    ours, its = Pipe()
    with its:
        folder, none = str(numba.config.CACHE_DIR), subprocess.DEVNULL
        script = START.format(path=sys.path, module=__name__, pipe=its.fileno(), folder=folder, modules=sorted(MODULES))
        process = subprocess.Popen(
            [sys.executable, "-P", "-c", script], pass_fds=[its.fileno()], start_new_session=True,
            stdin=none, stdout=none, stderr=none,
        )  # fmt: skip
    try:
        yield ours
    finally:
        ours.close()
        process.wait()


def work(handle: int, folder: str, modules: list[str]) -> None:
    """Import modules, and compile what comes by a pipe until that is closed."""
    global FOUND
    pipe: Connection[Any, Any] = Connection(handle)
    tasks = queue.SimpleQueue[Task]()
    numba.config.CACHE_DIR, FOUND = folder, pipe.send

    def listen() -> None:
        with contextlib.suppress(EOFError, OSError):
            while True:
                tasks.put(pipe.recv())
        os._exit(0)  # in the middle of a compilation, too

    threading.Thread(target=listen, daemon=True).start()
    for one in modules:
        with contextlib.suppress(Exception):
            resolve_name(one)
    pipe.send(None)
    while True:
        with contextlib.suppress(Exception):  # whoever needs it meets the error, and reports it
            needed, module, name, version, kinds = ForkingPickler.loads(tasks.get()[1])
            for one in needed:
                resolve_name(one)
            kernel = resolve_name(f"{module}:{name}")
            kernel = kernel if version == "Python" else by_address(kernel)
            kernel.overloads.pop(kinds, None)  # it may be declared
            kernel.compile(kinds, here=True)
        pipe.send(None)


def compile_side_by_side(dispatcher: Any, declare: Callable[[Any], None] | None = None) -> Any:
    """Have another process compile what a cached function lacks in the cache.

    `declare` lets others call it that are compiled here, but not run.
    """
    if not hasattr(dispatcher._cache, "path"):
        return dispatcher
    MODULES.add(dispatcher.py_func.__module__)
    compile_here = dispatcher.compile

    def compile_once(kinds: Any, here: bool = False) -> Any:
        if here or (FOUND and not declare) or tuple(kinds) in dispatcher.overloads:
            return compile_here(kinds)
        if task := _missing(dispatcher, kinds):
            if FOUND and declare:
                FOUND(task)
                return declare(kinds)
            WORKERS.compile(task)
        return compile_here(kinds)

    dispatcher.compile = compile_once
    return dispatcher


def compile_all(calls: Sequence[tuple[Any, tuple[Any, ...]]]) -> None:
    """Compile functions for arguments of given types, side by side as soon as processes are ready."""
    foreseen = FOUND is not None
    for dispatcher, kinds in calls:
        foreseen = foreseen or WORKERS.foresee(lambda: (_missing(*call) for call in calls))
        dispatcher.compile(kinds)


def _missing(dispatcher: Any, kinds: tuple[Any, ...]) -> Task | None:
    """Return the task of compiling what a function lacks, None for nothing."""
    if kinds in dispatcher.overloads or not hasattr(dispatcher._cache, "path"):
        return None
    path = dispatcher._cache.path(kinds, dispatcher.targetctx.codegen())
    return None if path.exists() else _task(dispatcher, path.name, kinds)


def _task(dispatcher: Any, file: str, kinds: Any) -> Task | None:
    """Return the task for another process; None for a function that another cannot find."""
    function, version = dispatcher.py_func, dispatcher._cache.version
    if function.__module__ == "__main__" or "<" in function.__qualname__ or version == "part":
        return None
    modules = {kind.registered_by for kind in term_classes(kinds)}
    try:
        return file, bytes(ForkingPickler.dumps((modules, function.__module__, function.__qualname__, version, kinds)))
    except Exception:  # whatever a type raises that cannot be pickled
        return None
