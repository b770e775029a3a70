"""A `nuno` command in a process of its own, so that a page answers meanwhile."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

END_PATIENCE = 20.0
"""How long a command may take to end [s] when it is told to."""


class Child:
    """A command that goes on from when this is made; `said` is all that it has printed so far."""

    def __init__(self, arguments: Sequence[str], folder: Path | None = None) -> None:
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - the command's own, for as long as it goes on
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
        # Read without moving the place in the file, at which the command writes.
        size = os.fstat(self._log.fileno()).st_size
        return os.pread(self._log.fileno(), size, 0).decode(errors="replace").strip()

    def end(self, terminate: bool = True) -> None:
        """Wait until it has ended, told to by a signal or otherwise; kill it where that takes too long."""
        if terminate:
            self._process.terminate()
        try:
            self._process.wait(END_PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
