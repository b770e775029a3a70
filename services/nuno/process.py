"""What a `nuno` process sets up at its start, and how it ends."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import sys
from typing import NoReturn

M_MMAP_THRESHOLD = -3
LARGE = 1 << 20


def return_large_arrays() -> None:
    """Give arrays of a megabyte and more back to the system when they are freed (glibc).

    By default glibc raises this limit to the largest array ever freed, and then keeps what a
    run needed only while it was prepared: a third of the memory of a large sheet.
    """
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, LARGE)


def collect_rarely() -> None:
    """Look for cycles of garbage a seventieth as often as Python would.

    Compiling a kernel makes millions of objects that stay, and to walk through them again and again
    is a tenth of the first run of a scene.
    """
    gc.set_threshold(50_000, 20, 20)


def leave(code: int) -> NoReturn:
    """End the process without Python's own shutdown.

    zenoh's threads outlive their session. One that meets the interpreter while it shuts down is
    ended by pthread_exit under Rust frames, which aborts the process ("exception not rethrown"):
    seen in one of six runs.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)
