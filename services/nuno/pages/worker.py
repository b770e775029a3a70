"""What a page waits for that may take long, done in a process of its own: so it can be ended, and the page answers."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection, Pipe
from types import FrameType
from typing import Any, TypeVar

import psutil

from nuno_schemas.errors import BadInput

LOOK = 0.02
"""How often the process is looked at while it works [s]."""
GRACE = 1.0
"""How long it may go on after it was interrupted [s], until it is killed: a kernel that has begun ends first."""
Made = TypeVar("Made")


class Workshop:
    """Makes one thing at a time, in a process that is kept for the next, with all that it has cached.

    What a page asks for takes the place of what the same page asked for before. `what` is made within `seconds` and,
    where `most` is given, with at most so many bytes of memory; the `remedy` is for what takes more.
    """

    def __init__(self, what: str, seconds: float, remedy: str, most: int | None = None) -> None:
        self.what, self.seconds, self.remedy, self.most = what, seconds, remedy, most
        self._asked: dict[str, object] = {}
        self._turn, self._closed = threading.Lock(), False
        self._process: subprocess.Popen[bytes] | None = None

    def make(self, page: str, call: Callable[..., Made], *args: object) -> Made:
        """What a function of a module returns, and raises. Raises BadInput where it takes too much, and where the page
        has asked for something else meanwhile.
        """
        request = self._asked[page] = object()
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
        """End what a page has asked for."""
        self._asked.pop(page, None)

    def close(self) -> None:
        """End the process, and whatever it makes."""
        self._closed = True
        with self._turn:
            self._kill()

    def _require(self, page: str, request: object) -> None:
        if self._closed or self._asked.get(page) is not request:
            raise BadInput("another one has been asked for meanwhile")

    def _begin(self) -> None:
        self._line, theirs = Pipe()
        # -P: a module of the user's folder must not stand in for one of ours. A session of its own: Ctrl-C is ours.
        command = [sys.executable, "-P", "-m", "nuno.pages.worker", str(theirs.fileno())]
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
            good, found = self._line.recv()
        except BadInput:
            if self._process is not None:
                self._interrupt(self._process)
            raise
        except (OSError, EOFError, psutil.Error):  # it was killed, for want of memory or by a person
            self._kill()
            raise BadInput(f"{self.what} has ended on its way", remedy="the terminal may say why") from None
        if not good:
            raise found
        return found

    def _interrupt(self, process: subprocess.Popen[bytes]) -> None:
        """End what is being made: the process goes on where that can be done at once, since it knows much by then."""
        process.terminate()
        try:
            if not self._line.poll(GRACE):
                raise EOFError
            self._line.recv_bytes()
        except (OSError, EOFError):
            self._kill()

    def _kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._line.close()
            self._process = None


def serve(line: Connection) -> None:
    """Make one thing after the other, until whoever asks for them is gone."""

    def watch() -> None:
        psutil.Process(os.getppid()).wait()
        os._exit(0)

    def interrupt(_: int, frame: FrameType | None) -> None:
        while frame is not None:
            if frame.f_code.co_filename.startswith("<frozen importlib"):
                return  # half a module would stay with this process: it is killed unless the whole is there soon
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
