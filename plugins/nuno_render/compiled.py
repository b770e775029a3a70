"""How the renderer's functions are compiled: as all kernels are, but their types are not written out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import nuno_kernels


def kernel(function: Callable[..., Any]) -> Any:
    """Compile `function`: one thread, no fastmath, division by zero as in IEEE 754."""
    return nuno_kernels.kernel(function)


def inlined(function: Callable[..., Any]) -> Any:
    """A small function whose source goes into every kernel that calls it."""
    return nuno_kernels.inlined(function)
