"""Folders and files that a process has only while it works: of one that was killed, the next one takes them away."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PREFIX, HIDDEN = "nuno-scratch-", ".nuno-scratch-"
YOUNG = 1.0
"""Seconds in which whoever makes something comes to hold it."""


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


@contextmanager
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
