"""A `nuno` command in a process of its own, so that a page answers meanwhile."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path

MOST_SAID = 20_000
"""Of what a command has printed, how much is told [bytes]."""
END_PATIENCE = 20.0
"""How long a command may take to end [s] when it is told to."""


class Child:
    """A command that goes on from when this is made."""

    def __init__(self, arguments: Sequence[str], folder: Path | None = None) -> None:
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - the command's own, for as long as it goes on
        self._said: str | None = None
        self._reading = threading.Lock()
        # -P: a module of the user's folder must not stand in for one of ours.
        command = [sys.executable, "-P", "-m", "nuno", *arguments]
        self._process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=self._log, stderr=subprocess.STDOUT, cwd=folder
        )

    @property
    def code(self) -> int | None:
        """Its exit code; None while it goes on."""
        return self._process.poll()

    @property
    def said(self) -> str:
        """The last that it has printed so far; once it has ended, the file is closed."""
        with self._reading:
            if self._said is not None:
                return self._said
            code = self.code
            # Read without moving the place in the file, at which the command writes.
            size = os.fstat(self._log.fileno()).st_size
            said = os.pread(self._log.fileno(), MOST_SAID, max(0, size - MOST_SAID)).decode(errors="replace").strip()
            if code is not None:
                self._said = said
                self._log.close()
            return said

    def end(self, terminate: bool = True) -> None:
        """Wait until it has ended, told to by a signal or otherwise; kill it where that takes too long."""
        if terminate:
            self._process.terminate()
        try:
            self._process.wait(END_PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
