"""Set-up and end of a `nuno` process, and its temporary folders."""

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
"""Time within which the creator of a file or folder locks it [s]."""

end_process = os._exit
"""End the process at once; other code cannot once `os._exit` is refused."""

T = TypeVar("T")
LOOKS = 0.2
"""Interval of the checks for signals [s]."""
_refused = threading.local()
_command: int | None = None
"""The process of the `nuno` command."""


def working_folder() -> str:
    """Return the working folder of this process; empty if it has been removed."""
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

    By default glibc raises the first limit to the largest array ever freed, and then keeps memory that a run needed
    only in its preparation: a third of that of a large sheet. And it returns free memory at the end of its heap from
    128 KB on: a check of a frame's crossings took two thirds of its time for clearing the same memory again.
    """
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, LARGE)
            ctypes.CDLL(None).mallopt(M_TRIM_THRESHOLD, KEPT)


class _Stream(io.TextIOWrapper):
    """Standard output or standard error, whose write errors do not fail a run."""

    fault = ""
    """Why something could not be written."""

    def write(self, text: str) -> int:
        """Write a text; an error on standard error is ignored."""
        return self._note(lambda: super(_Stream, self).write(text)) or len(text)

    def flush(self) -> None:
        """Flush the buffer; an error on standard error is ignored."""
        self._note(super().flush)

    def close(self) -> None:
        """Only flush: plugins may not close the command's streams."""
        self.flush()

    def _note(self, do: Callable[[], T]) -> T | None:
        try:
            return do()
        except OSError as error:
            if self.fileno() == 1:
                if not isinstance(error, BrokenPipeError):  # the reader has ended
                    self.fault = str(error.strerror)
                raise
        return None


def open_streams() -> None:
    """Open closed standard streams on the null device: otherwise the next files and sockets would have their numbers,
    and the system's libraries would write to these. Characters outside a stream's encoding are escaped.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the lowest number that is free
    sys.stdin = sys.stdin or open(0, closefd=False)  # noqa: SIM115
    encoding = getattr(sys.stdout or sys.stderr, "encoding", "utf-8")
    for number, name in (1, "stdout"), (2, "stderr"):
        raw = open(number, "wb", closefd=False)  # noqa: SIM115
        stream = _Stream(raw, encoding, "backslashreplace", line_buffering=number == 2 or raw.isatty())
        setattr(sys, name, stream)


def check_output() -> bool:
    """Flush standard output; return whether all of it could be written, and print the error if not."""
    with contextlib.suppress(OSError, ValueError):
        sys.stdout.flush()
    fault = getattr(sys.stdout, "fault", "")
    if fault:
        print(f"failed: standard output cannot be written: {fault}", file=sys.stderr)
    return not fault


def import_no_own_files() -> None:
    """Keep child Python processes from importing files of the working folder, as a `queue.py` there."""
    os.environ["PYTHONSAFEPATH"] = "1"


def check_compiler() -> None:
    """Raise BadInput for environment variables that disable the compilation, or the threads, of kernels."""
    without, threads = os.environ.get("NUMBA_DISABLE_JIT", ""), os.environ.get("NUMBA_NUM_THREADS", "1")
    if without not in ("", "0"):
        problem = "numba is set to compile nothing, and nuno's kernels cannot do without"
        raise BadInput(problem, field="NUMBA_DISABLE_JIT", value=without, remedy="unset NUMBA_DISABLE_JIT")
    if not (threads.isdecimal() and int(threads) > 0):
        remedy = "unset NUMBA_NUM_THREADS; nuno run --threads N limits them for a run"
        problem = "numba needs a whole number of threads, at least 1"
        raise BadInput(problem, field="NUMBA_NUM_THREADS", value=threads, remedy=remedy)


class Terminated(KeyboardInterrupt):
    """The process received SIGTERM or SIGHUP, and ends as on Ctrl-C."""


SIGNALS = {"interrupted": "SIGINT (Ctrl-C)", "terminated": "SIGTERM or SIGHUP"}
"""Signals that end a run, by its state."""
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def state_of(ended: KeyboardInterrupt) -> str:
    """Return the state in SIGNALS."""
    return "terminated" if isinstance(ended, Terminated) else "interrupted"


def end_when_terminated() -> None:
    """Handle SIGTERM of service managers, and SIGHUP unless nohup ignores it, like Ctrl-C: an end in order."""

    def terminate(number: int, frame: FrameType | None) -> NoReturn:
        raise Terminated

    for number in ENDING[1:]:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, terminate)


@contextlib.contextmanager
def ending_at_once() -> Iterator[None]:
    """End the process at the second of the signals ENDING, in any state.

    Python runs handlers only in the main thread, which may be compiling or waiting in foreign code; so a
    thread counts the signals.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    source, sink = os.pipe()
    os.set_blocking(sink, False)
    counter = threading.Thread(target=_count_signals, args=(source,), name="signals", daemon=True)
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
    """Return or raise the result of `work` in a separate thread, so that a signal ends the wait at once: Python runs
    handlers only in the main thread, which may be compiling or in compiled code. `leave` is then called; the thread
    ends with the process at the latest.
    """
    if threading.current_thread() is not threading.main_thread():
        return work()
    done: Future[T] = Future()

    def run() -> None:
        try:
            done.set_result(work())
        except BaseException as error:  # any error is raised in the waiting thread
            done.set_exception(error)

    try:
        threading.Thread(target=run, name="attended", daemon=True).start()
        while not wait([done], LOOKS).done:  # otherwise a signal just before would be handled at the end
            pass
        return done.result()
    finally:
        if not done.done():
            leave()


def _count_signals(source: int) -> None:
    seen = 0
    while numbers := os.read(source, 64):
        seen += sum(number in ENDING for number in numbers)
        if seen >= 2:
            os.write(2, b"ended at once\n")
            end_process(1)


def _fail() -> None:
    os.write(2, b"failed: compiled code has ended the process (exit, or STOP in Fortran)\n")
    end_process(1)


_FAIL = ctypes.CFUNCTYPE(None)(_fail)


def fail_on_exit() -> None:
    """Make C's exit(), which a plugin's compiled code may call with code 0 during a run, end with code 1.

    The `nuno` command itself ends by `leave`, without it.
    """
    with contextlib.suppress(OSError, AttributeError):
        getattr(ctypes.CDLL(None), "__cxa_atexit")(_FAIL, None, None)


def refuse_exit() -> None:
    """Make `os._exit` raise SystemExit in all of the command's process, also in threads of plugins."""
    global _command
    _command = os.getpid()
    os._exit = _refuse_exit


@contextlib.contextmanager
def refusing_exit() -> Iterator[None]:
    """Make `os._exit` raise SystemExit in this thread, but not in others, nor in forked processes."""
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
    """Lock an open file or folder until it is closed, or this process ends. Rejected: the process's number, which may
    be another's in a folder that two hosts or containers share.
    """
    with contextlib.suppress(OSError):  # a file system without locks
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def sweep(folder: Path, pattern: str) -> None:
    """Remove this user's matching files and folders that no process has locked."""
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
    """Make a temporary folder, the system's or hidden in `beside`, and remove it afterwards. Raises OSError."""
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

    zenoh's threads outlive their session. One that calls the interpreter during its shutdown is
    ended by pthread_exit under Rust frames, which aborts the process ("exception not rethrown"),
    as in one of six runs.
    """
    end_process(code if check_output() else code or 1)
