"""What a `nuno` process sets up at its start, how it ends, and what it has only while it works."""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import io
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from pathlib import Path
from types import FrameType
from typing import NoReturn, TypeVar

from nuno_schemas.errors import BadInput

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
LARGE, KEPT = 1 << 22, 1 << 25

PREFIX, HIDDEN = "nuno-scratch-", ".nuno-scratch-"
YOUNG = 1.0
"""Seconds in which whoever makes something comes to hold it."""

end_process = os._exit
"""End the process at once, as nobody else may once `os._exit` is refused."""

T = TypeVar("T")
LOOKS = 0.2
"""How often it is looked for signals [s]."""
_refused = threading.local()
_command: int | None = None
"""The process of the `nuno` command."""


def working_folder() -> str:
    """The folder that this process works in; empty where that has been removed."""
    with contextlib.suppress(OSError):
        return os.getcwd()
    return ""


def check_unprotected(path: Path, field: str | None = None) -> None:
    """Raises BadInput for a file that this user may not write; root may write any but one that nobody may write."""
    if path.is_file() and not (path.stat().st_mode & 0o222 and os.access(path, os.W_OK)):
        remedy = "choose another name, or permit it with chmod u+w"
        raise BadInput("the file there is write-protected", field=field, value=str(path), remedy=remedy)


def return_large_arrays() -> None:
    """Give arrays of LARGE bytes and more back to the system when they are freed, and keep the room of smaller ones,
    up to KEPT bytes of it at a time (glibc).

    By default glibc raises the first limit to the largest array ever freed, and then keeps what a run needed only while
    it was prepared: a third of the memory of a large sheet. And it gives back what lies free at the end of its heap
    from 128 KB on: a look at a frame's crossings took two thirds of its time for the same room to be cleared anew.
    """
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, LARGE)
            ctypes.CDLL(None).mallopt(M_TRIM_THRESHOLD, KEPT)


class _Stream(io.TextIOWrapper):
    """Standard output, or standard error, where nothing fails because it cannot be written."""

    fault = ""
    """Why something could not be written."""

    def write(self, text: str) -> int:
        """See io.TextIOWrapper."""
        return self._note(lambda: super(_Stream, self).write(text)) or len(text)

    def flush(self) -> None:
        """See io.TextIOWrapper."""
        self._note(super().flush)

    def close(self) -> None:
        """Only flush: it is the command's, whose plugins may not close it."""
        self.flush()

    def _note(self, do: Callable[[], T]) -> T | None:
        try:
            return do()
        except OSError as error:
            if self.fileno() == 1:
                if not isinstance(error, BrokenPipeError):  # whoever reads has enough
                    self.fault = str(error.strerror)
                raise
        return None


def open_streams() -> None:
    """Open the standard streams that are closed, on nothing: their numbers would be those of the next files and
    sockets, which the system's libraries would then write to. What a stream's encoding lacks is written escaped.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the lowest number that is free
    sys.stdin = sys.stdin or open(0, closefd=False)  # noqa: SIM115
    encoding = getattr(sys.stdout or sys.stderr, "encoding", "utf-8")
    for number, name in (1, "stdout"), (2, "stderr"):
        own = open(number, "wb", closefd=False)  # noqa: SIM115
        stream = _Stream(own, encoding, "backslashreplace", line_buffering=number == 2 or own.isatty())
        setattr(sys, name, stream)


def check_output() -> bool:
    """Whether what was printed could be written so far, to the end of the buffer; what is wrong is said."""
    with contextlib.suppress(OSError, ValueError):
        sys.stdout.flush()
    fault = getattr(sys.stdout, "fault", "")
    if fault:
        print(f"failed: standard output cannot be written: {fault}", file=sys.stderr)
    return not fault


def import_no_own_files() -> None:
    """Have the Python processes that this one starts import no file of the working folder, as a `queue.py` there."""
    os.environ["PYTHONSAFEPATH"] = "1"


def check_compiler() -> None:
    """Raises BadInput for settings of the user's environment by which no kernel is compiled, or none can run."""
    without, threads = os.environ.get("NUMBA_DISABLE_JIT", ""), os.environ.get("NUMBA_NUM_THREADS", "1")
    if without not in ("", "0"):
        problem = "numba is set to compile nothing, and nuno's kernels cannot do without"
        raise BadInput(problem, field="NUMBA_DISABLE_JIT", value=without, remedy="unset NUMBA_DISABLE_JIT")
    if not (threads.isdecimal() and int(threads) > 0):
        remedy = "unset NUMBA_NUM_THREADS; nuno run --threads N limits them for a run"
        problem = "numba needs a whole number of threads, at least 1"
        raise BadInput(problem, field="NUMBA_NUM_THREADS", value=threads, remedy=remedy)


class Terminated(KeyboardInterrupt):
    """The process was asked to end by SIGTERM, which it does as on Ctrl-C."""


SIGNALS = {"interrupted": "SIGINT (Ctrl-C)", "terminated": "SIGTERM"}
"""What becomes of a run that is ended by a signal, by its state."""


def state_of(ended: KeyboardInterrupt) -> str:
    """Which of SIGNALS."""
    return "terminated" if isinstance(ended, Terminated) else "interrupted"


def end_when_terminated() -> None:
    """Take SIGTERM, which service managers and containers send, for what Ctrl-C is: an end in order."""

    def terminate(number: int, frame: FrameType | None) -> NoReturn:
        raise Terminated

    signal.signal(signal.SIGTERM, terminate)


@contextlib.contextmanager
def ending_at_once(after: int = 2) -> Iterator[None]:
    """End the process at the second SIGINT or SIGTERM, whatever it is doing.

    Python runs handlers in the main thread alone, which may be compiling or waiting in foreign code; so a
    thread counts the signals.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    source, sink = os.pipe()
    os.set_blocking(sink, False)
    counter = threading.Thread(target=_count_signals, args=(source, after), name="signals", daemon=True)
    counter.start()
    before = signal.set_wakeup_fd(sink, warn_on_full_buffer=False)
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        os.close(sink)
        counter.join()
        os.close(source)


def attended(work: Callable[[], T], leave: Callable[[], None] = lambda: None) -> T:
    """What `work` gives or raises, from a thread of its own, so that a signal ends it at once, whatever it is doing:
    Python runs handlers in the main thread alone, which may be compiling or in compiled code. `leave` is then called;
    the thread ends with the process at the latest.
    """
    if threading.current_thread() is not threading.main_thread():
        return work()
    done: Future[T] = Future()

    def body() -> None:
        try:
            done.set_result(work())
        except BaseException as error:  # whatever it is, it is raised where it is waited for
            done.set_exception(error)

    try:
        threading.Thread(target=body, name="attended", daemon=True).start()
        while not wait([done], LOOKS).done:  # a signal that came just before is else heard at the end
            pass
        return done.result()
    finally:
        if not done.done():
            leave()


def _count_signals(source: int, after: int) -> None:
    seen = 0
    while numbers := os.read(source, 64):
        seen += sum(number in (signal.SIGINT, signal.SIGTERM) for number in numbers)
        if seen >= after:
            os.write(2, b"ended at once\n")
            end_process(1)


def _fail() -> None:
    os.write(2, b"failed: compiled code has ended the process (exit, or STOP in Fortran)\n")
    end_process(1)


_FAIL = ctypes.CFUNCTYPE(None)(_fail)


def fail_on_exit() -> None:
    """Have C's exit(), which compiled code of a plugin may call with code 0 in the middle of a run, end with code 1.

    The `nuno` command itself ends by `leave`, without it.
    """
    with contextlib.suppress(OSError, AttributeError):
        getattr(ctypes.CDLL(None), "__cxa_atexit")(_FAIL, None, None)


def refuse_exit() -> None:
    """Have `os._exit` raise SystemExit in all of this process, the command's: in threads that plugins start, too."""
    global _command
    _command = os.getpid()
    os._exit = _refuse_exit


@contextlib.contextmanager
def refusing_exit() -> Iterator[None]:
    """Have `os._exit` raise SystemExit in this thread; it stays what it is for others, and for forked processes."""
    os._exit = _refuse_exit
    before = getattr(_refused, "process", None)
    _refused.process = os.getpid()
    try:
        yield
    finally:
        _refused.process = before


def _refuse_exit(status: int) -> NoReturn:
    if os.getpid() in (getattr(_refused, "process", None), _command):
        raise SystemExit(f"os._exit({status})")
    end_process(status)


def hold(handle: int) -> None:
    """Hold an open file or folder until it is closed, or this process has ended. Not by its number: on a folder that
    two hosts share, or two containers, that may be another's.
    """
    with contextlib.suppress(OSError):  # a file system without locks
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def sweep(folder: Path, pattern: str) -> None:
    """Take away what matches in a folder, is this user's, and is held by nobody."""
    for path in folder.glob(pattern):
        with contextlib.suppress(OSError):
            handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
            try:
                state = os.fstat(handle)
                if state.st_uid != os.getuid() or time.time() - state.st_mtime < YOUNG:
                    continue
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(path) if path.is_dir() else path.unlink()
            finally:
                os.close(handle)


@contextlib.contextmanager
def scratch(beside: Path | None = None) -> Iterator[Path]:
    """A new folder, among the system's temporary ones or hidden in another, that is gone afterwards. Raises OSError."""
    folder, prefix = (Path(tempfile.gettempdir()), PREFIX) if beside is None else (beside, HIDDEN)
    sweep(folder, f"{prefix}*")
    with tempfile.TemporaryDirectory(prefix=prefix, dir=folder, ignore_cleanup_errors=True) as name:
        handle = os.open(name, os.O_RDONLY)
        try:
            hold(handle)
            yield Path(name)
        finally:
            os.close(handle)


def leave(code: int) -> NoReturn:
    """End the process without Python's own shutdown.

    zenoh's threads outlive their session. One that meets the interpreter while it shuts down is
    ended by pthread_exit under Rust frames, which aborts the process ("exception not rethrown"):
    seen in one of six runs.
    """
    end_process(code if check_output() else code or 1)
