"""A `nuno` command in another process, so that the page stays responsive."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path

MOST_SAID = 20_000
"""Length of a command's output that is kept [bytes]."""
END_PATIENCE = 20.0
"""Longest time that a command may take to end [s] before it is killed."""


class Child:
    """A command in a process that starts with this object."""

    def __init__(self, arguments: Sequence[str], folder: Path | None = None) -> None:
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - open while the command runs
        self._said: str | None = None
        self._reading = threading.Lock()
        # -P: a module of the user's folder must not stand in for one of ours.
        command = [sys.executable, "-P", "-m", "nuno", *arguments]
        self._process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=self._log, stderr=subprocess.STDOUT, cwd=folder
        )

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
        """Wait for the command's end, after a signal if `terminate`; kill it if it takes too long."""
        if terminate:
            self._process.terminate()
        try:
            self._process.wait(END_PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
