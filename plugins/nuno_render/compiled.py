"""How the renderer's functions are compiled and kept.

Numba's cache goes stale when only a callee in another module changes, so its folder carries a
hash of this plugin's sources, of the shared ones that it compiles, and the versions. It is apart
from the solvers' folder: a change to a colour must not recompile the solvers.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import llvmlite
import numba

import nuno_kernels
from nuno_kernels.kept import keep

SHARED = ("simd.py", "simd_choose.py")
"""What is compiled of nuno_kernels."""


def _cache_folder() -> Path:
    digest = hashlib.sha256(repr((numba.__version__, llvmlite.__version__, sys.version_info[:3])).encode())
    shared = [Path(nuno_kernels.__file__).with_name(name) for name in SHARED]
    for source in [*sorted(Path(__file__).parent.glob("*.py")), *shared]:
        digest.update(source.name.encode() + b"\0" + source.read_bytes())
    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return root / "nuno" / "render" / digest.hexdigest()[:16]


CACHE = _cache_folder()


def kernel(function: Callable[..., Any]) -> Any:
    """Compile `function`: one thread, no fastmath, division by zero as in IEEE 754."""
    return _compile(function)


def inlined(function: Callable[..., Any]) -> Any:
    """A small function whose source goes into every kernel that calls it."""
    return _compile(function, inline="always")


def _compile(function: Callable[..., Any], **flags: str) -> Any:
    # Numba reads the folder when it decorates; other plugins' setting is put back.
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(CACHE)
    try:
        compiled = numba.njit(nogil=True, error_model="numpy", no_cfunc_wrapper=True, **flags)(function)
        return keep(compiled, CACHE)
    finally:
        numba.config.CACHE_DIR = before
