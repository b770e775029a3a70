"""Processes of a test: started in groups of their own, their memory watched, none left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

import psutil

LOOK_SECONDS = 0.2


@contextmanager
def started(arguments: Sequence[str], **options: Any) -> Iterator[subprocess.Popen[str]]:
    """`python -m ARGUMENTS`, killed with all that it has started when the block ends."""
    child = subprocess.Popen([sys.executable, "-m", *arguments], text=True, start_new_session=True, **options)
    try:
        yield child
    finally:
        for number in (signal.SIGCONT, signal.SIGKILL):
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(child.pid, number)
        child.wait()
        for stream in (child.stdin, child.stdout):
            if stream is not None:
                stream.close()


@dataclass
class Memory:
    """Resident bytes of a process, looked at again and again while the block lasts."""

    pid: int
    samples: list[int] = field(default_factory=list)
    _over: threading.Event = field(default_factory=threading.Event)

    def __enter__(self) -> Memory:
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._over.set()
        self._thread.join()

    def _watch(self) -> None:
        with suppress(psutil.Error):
            process = psutil.Process(self.pid)
            while not self._over.wait(LOOK_SECONDS):
                self.samples.append(process.memory_info().rss)

    def largest(self) -> tuple[int, int]:
        """In the first quarter of the time, and in the other three [bytes]."""
        quarter = max(1, len(self.samples) // 4)
        return max(self.samples[:quarter]), max(self.samples[quarter:] or self.samples)


def ended(child: subprocess.Popen[str], patience: float) -> str:
    """What a process printed until it ended well. Raises TimeoutError, RuntimeError."""
    begin = time.monotonic()
    try:
        said, _ = child.communicate(timeout=patience)
    except subprocess.TimeoutExpired:
        raise TimeoutError(f"not over after {time.monotonic() - begin:.0f} s: {child.args!r:.200}") from None
    if child.returncode != 0:
        raise RuntimeError(f"exit code {child.returncode}: {child.args!r:.200}")
    return said
