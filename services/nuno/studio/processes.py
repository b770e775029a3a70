"""Slow work and commands of the page in other processes, so that it can be cancelled and the page stays responsive."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection, Pipe
from types import FrameType
from typing import Any, TypeVar

import psutil

from nuno_schemas.errors import BadInput

LOOK = 0.02
"""Interval of checks while the process works [s]."""
GRACE = 1.0
"""Time after an interrupt until the process is killed [s]: a running kernel ends first."""
Made = TypeVar("Made")


class Workshop:
    """Runs one task at a time, in a process that is kept with its caches for the next.

    A page's request cancels its previous one. A task, named `what` in errors, may take `seconds` [s] and, if given,
    `most` bytes of memory; errors about these limits have the `remedy`.
    """

    def __init__(self, what: str, seconds: float, remedy: str, most: int | None = None) -> None:
        self.what, self.seconds, self.remedy, self.most = what, seconds, remedy, most
        self._requests: dict[str, object] = {}
        self._turn, self._closed = threading.Lock(), False
        self._process: subprocess.Popen[bytes] | None = None

    def make(self, page: str, call: Callable[..., Made], *args: object) -> Made:
        """Return the result of a module's function, or raise its error. Raises BadInput if it exceeds a limit, or the
        page has requested something else meanwhile.
        """
        request = self._requests[page] = object()
        while not self._turn.acquire(timeout=LOOK):
            self._require(page, request)
        try:
            self._require(page, request)
            if self._process is None:
                self._begin()
            made: Made = self._wait(page, request, (os.getcwd(), call, args))
            return made
        finally:
            self._turn.release()

    def forget(self, page: str) -> None:
        """Cancel the request of a page."""
        self._requests.pop(page, None)

    def close(self) -> None:
        """End the process and its task."""
        self._closed = True
        with self._turn:
            self._kill()

    def _require(self, page: str, request: object) -> None:
        if self._closed or self._requests.get(page) is not request:
            raise BadInput("another one has been asked for meanwhile")

    def _begin(self) -> None:
        self._line, theirs = Pipe()
        # -P: a module of the user's folder must not replace one of ours. A new session: Ctrl-C must not reach it.
        command = [sys.executable, "-P", "-m", "nuno.studio.processes", str(theirs.fileno())]
        self._process = subprocess.Popen(command, pass_fds=[theirs.fileno()], start_new_session=True)
        theirs.close()

    def _wait(self, page: str, request: object, task: tuple[Any, ...]) -> Any:
        end = time.monotonic() + self.seconds
        assert self._process is not None
        try:
            self._line.send(task)
            while not self._line.poll(LOOK):
                self._require(page, request)
                if time.monotonic() > end:
                    raise BadInput(f"{self.what} takes too long", limit=f"{self.seconds:g} s", remedy=self.remedy)
                if self.most is not None and psutil.Process(self._process.pid).memory_info().rss > self.most:
                    self._kill()
                    limit = f"{self.most / 2**30:.3g} GiB"
                    raise BadInput(f"{self.what} takes too much memory", limit=limit, remedy=self.remedy)
            good, result = self._line.recv()
        except BadInput:
            if self._process is not None:
                self._process.terminate()
                try:
                    if not self._line.poll(GRACE):
                        raise EOFError
                    self._line.recv_bytes()
                except (OSError, EOFError):
                    self._kill()
            raise
        except (OSError, EOFError, psutil.Error):  # it was killed, for lack of memory or by a user
            self._kill()
            raise BadInput(f"{self.what} has ended on its way", remedy="the terminal may say why") from None
        if not good:
            raise result
        return result

    def _kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._line.close()
            self._process = None


def serve(line: Connection) -> None:
    """Run one task after the other, until the parent process ends."""

    def watch() -> None:
        psutil.Process(os.getppid()).wait()
        os._exit(0)

    def interrupt(_: int, frame: FrameType | None) -> None:
        while frame is not None:
            if frame.f_code.co_filename.startswith("<frozen importlib"):
                return  # an interrupted import would leave half a module: the process is killed if it takes long
            frame = frame.f_back
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    threading.Thread(target=watch, daemon=True).start()
    while True:
        folder, call, args = line.recv()
        try:
            signal.signal(signal.SIGTERM, interrupt)
            try:
                os.chdir(folder)
                answer = True, call(*args)
            finally:
                signal.signal(signal.SIGTERM, signal.SIG_IGN)
        except (Exception, KeyboardInterrupt) as error:
            error.add_note(traceback.format_exc())
            answer = False, error
        line.send(answer)


if __name__ == "__main__":
    with contextlib.suppress(EOFError):
        serve(Connection(int(sys.argv[1])))


# A `nuno` command in another process, so that the page stays responsive.

MOST_SAID = 20_000
"""Length of a command's output that is kept [bytes]."""
END_PATIENCE = 20.0
"""Longest time that a command may take to end [s] before it is killed."""


class Child:
    """A command in a process that starts with this object."""

    def __init__(self, arguments: Sequence[str]) -> None:
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - open while the command runs
        self._said: str | None = None
        self._reading = threading.Lock()
        # -P: a module of the user's folder must not stand in for one of ours.
        command = [sys.executable, "-P", "-m", "nuno", *arguments]
        self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=self._log, stderr=subprocess.STDOUT)

    @property
    def code(self) -> int | None:
        """Exit code; None while the command runs."""
        return self._process.poll()

    @property
    def said(self) -> str:
        """The end of the output so far; after the command's end the file is closed."""
        with self._reading:
            if self._said is not None:
                return self._said
            code = self.code
            # Read without moving the file's position, at which the command writes.
            size = os.fstat(self._log.fileno()).st_size
            output = os.pread(self._log.fileno(), MOST_SAID, max(0, size - MOST_SAID)).decode(errors="replace").strip()
            if code is not None:
                self._said = output
                self._log.close()
            return output

    def end(self, terminate: bool = True) -> None:
        """Wait for the command's end, after a signal if `terminate` and it still runs; kill it if it takes too long."""
        if terminate:
            self._process.terminate()
        try:
            self._process.wait(END_PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
