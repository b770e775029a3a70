"""Compiled functions that plugins share: the forces of cloth as terms, the acceleration, lanes, and their compilation.

Kernels use one C-contiguous (3, n) float64 array per quantity. Numba's cache goes stale when only a callee in another
module changes, so its folder carries a hash of the sources of the solvers' packages, the compile flags and the
versions; it is set here, before any function is decorated. Kernels of other packages are keyed by all that they reach,
see `nuno_kernels.compilation.internals`.
"""

from __future__ import annotations

import functools
import hashlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import llvmlite
import numba
import numpy as np
from numba.extending import register_jitable

from nuno_kernels.compilation.internals import SOLVERS, Borrowing, ByAddress, call_from_kernels, dependencies_of, keep
from nuno_kernels.compilation.workers import compile_side_by_side

F = TypeVar("F", bound=Callable[..., Any])

FLAGS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""No fastmath: NaN must stay visible, and sums must not be reordered. No wrapper for callers in C: there are none,
and to unpack the arrays of a scene in it takes a seventh of the compilation."""


def _cache_folder() -> Path:
    here = Path(__file__).parent
    digest = hashlib.sha256(
        repr(
            (numba.__version__, llvmlite.__version__, np.__version__, sys.version_info[:3], sorted(FLAGS.items()))
        ).encode()
    )
    for package in SOLVERS:
        for source in sorted((here.parent / package).rglob("*.py")):
            digest.update(source.name.encode() + b"\0" + source.read_bytes())
    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return root / "nuno" / "kernels" / digest.hexdigest()[:16]


CACHE = _cache_folder()
numba.config.CACHE_DIR = str(CACHE)


def kernel(function: F) -> F:
    """Compile `function` with the flags that all kernels share. It becomes a part of kernels that call it; steps call
    terms' kernels by address (nuno_kernels.terms).
    """
    return cast(F, _versions(function))


def block_kernel(function: F) -> F:
    """Compile a function that works on a block of vertices or on a mesh as `kernel` does, once, and call it by address.

    Not for those called per vertex, which a call may cost ten times what they do.
    """
    return cast(F, _versions(function, apart=True))


def _versions(function: Any, apart: bool = False, **flags: Any) -> Any:
    """Return a compiled function for Python, with the version that kernels call in its place."""

    @functools.cache
    def part() -> Any:
        return _kept(function, "part", no_cpython_wrapper=True, **flags)

    @functools.cache
    def by_address() -> Any:
        alone = keep(numba.njit(no_cpython_wrapper=True, pipeline_class=Borrowing, **FLAGS)(function), CACHE, "apart")
        called = ByAddress(alone, lambda types: CACHE.name + dependencies_of(function, types))
        return compile_side_by_side(alone, called.declare if called.result else None)

    outer = _kept(function, **flags)
    outer.by_address = by_address
    return call_from_kernels(outer, by_address if apart else part)


def _kept(function: Any, version: str = "Python", **flags: Any) -> Any:
    return compile_side_by_side(keep(numba.njit(**flags, **FLAGS)(function), CACHE, version))


def inlined(function: F) -> F:
    """Compile a small function whose source goes into every kernel that calls it.

    Compiling a kernel optimises all that it calls once more, so a call costs a user's first run
    about as much as the function itself. For functions without optional arguments: numba prunes
    the branches of a None before it inlines.
    """
    return cast(F, _kept(function, inline="always"))


def forced_inline(function: F) -> F:
    """Compile a function called per vertex as `kernel` does: LLVM inlines it, since a call would pass every array's
    shape and strides.
    """
    return cast(F, _versions(function, forceinline=True))


def parallel_kernel(function: F) -> F:
    """Compile `function` so that its `prange` loops run on several threads."""
    return cast(F, _kept(function, parallel=True))


def shared_source(function: F) -> F:
    """Mark a function that compiled code compiles and Python interprets."""
    return cast(F, register_jitable(function))


SPINS = 3000


@functools.cache
def threads_available() -> tuple[int, str]:
    """Return how many threads a kernel may use, and a description.

    Only OpenMP and TBB will do: numba's own workqueue aborts the process when two threads of a
    program run parallel kernels at once. OpenMP's threads wait for each other awake for SPINS turns, some
    tens of microseconds, which is longer than the way from one step to the next, and sleep then; unless
    the user's OMP_WAIT_POLICY or GOMP_SPINCOUNT says otherwise. Sleeping at once makes a 64 x 64 sheet
    three times slower on two cores than on one; never to sleep takes a core from everybody else.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    os.environ.setdefault("GOMP_SPINCOUNT", str(SPINS))
    for layer, module in (("omp", "omppool"), ("tbb", "tbbpool")):
        try:
            __import__(f"numba.np.ufunc.{module}")
        except ImportError:
            continue
        numba.config.THREADING_LAYER = layer
        return int(numba.config.NUMBA_NUM_THREADS), f"threading layer {layer}"
    return 1, "one thread: neither OpenMP nor TBB is available to numba"
