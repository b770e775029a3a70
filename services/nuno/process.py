"""What a `nuno` process sets up at its start, and how it ends."""

from __future__ import annotations

import contextlib
import ctypes
import io
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import NoReturn, TypeVar

from nuno_schemas.errors import BadInput

T = TypeVar("T")
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
LARGE, KEPT = 1 << 22, 1 << 25

end_process = os._exit
"""End the process at once, as nobody else may once `os._exit` is refused."""

_refused = threading.local()
_command: int | None = None
"""The process of the `nuno` command."""


def working_folder() -> str:
    """The folder that this process works in; empty where that has been removed."""
    with contextlib.suppress(OSError):
        return os.getcwd()
    return ""


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


def leave(code: int) -> NoReturn:
    """End the process without Python's own shutdown.

    zenoh's threads outlive their session. One that meets the interpreter while it shuts down is
    ended by pthread_exit under Rust frames, which aborts the process ("exception not rethrown"):
    seen in one of six runs.
    """
    end_process(code if check_output() else code or 1)
