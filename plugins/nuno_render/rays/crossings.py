"""Yarns along a ray: each crossing counts once, however many of a yarn's capsules it passes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nuno_kernels import kernel
from nuno_render.rays.hits import Buffers, meet_capsules, meet_triangle
from nuno_render.rays.worn import Skin, Threads
from nuno_schemas.fabric import Float


@kernel
def join_crossings(count: int, items: NDArray[np.int64], enters: Float, leaves: Float, yarn: NDArray[np.int64]) -> int:
    """Merge hits of capsules of one yarn that overlap along the ray. Return the number left, nearest first."""
    kept = 0
    for i in range(count):
        whole = True
        for j in range(kept):
            if yarn[items[j]] == yarn[items[i]] and leaves[j] >= enters[i]:
                leaves[j] = max(leaves[j], leaves[i])
                whole = False
                break
        if whole:
            items[kept], enters[kept], leaves[kept] = items[i], enters[i], leaves[i]
            kept += 1
    return kept


@kernel
def cross_yarns(p: Float, d: Float, most: float, threads: Threads, keep: int, buffers: Buffers) -> int:
    """Write crossings of yarns from p (3,) along d (3,) up to a distance into the buffers. Return their number."""
    count = meet_capsules(p, d, most, threads.tree, keep, buffers)
    if count < 2:
        return count
    return join_crossings(count, buffers.items, buffers.enters, buffers.leaves, threads.yarn)


@kernel
def free_way(p: Float, d: Float, skin: Skin, threads: Threads, share: float, keep: int, buffers: Buffers) -> float:
    """Return the share of light that reaches p (3,) from direction d (3,): 0 through bodies, `share` through a yarn."""
    face, _ = meet_triangle(p, d, skin.tree, buffers)
    if face >= 0:
        return 0.0
    if share == 1.0:
        return 1.0
    through: float = share ** cross_yarns(p, d, np.inf, threads, keep, buffers)
    return through
