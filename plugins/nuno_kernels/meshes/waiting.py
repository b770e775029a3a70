"""Nodes of a tree that wait to be looked at, the nearest of each node's children first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nuno_kernels import forced_inline
from nuno_kernels.lanes.choose import first_lane, lane
from nuno_kernels.lanes.simd import Lanes
from nuno_schemas.fabric import Float


@forced_inline
def push_children(away: Lanes, bits: int, first: int, waiting: NDArray[np.int64], bound: Float, top: int) -> int:
    """Let those of a node's eight children wait whose `bits` are set, the nearest last; how many wait then, `top`
    before.

    `away` is how far each is, which `bound` notes; `first` is the first child, and counts down where it is negative, as
    numbers of leaves do.
    """
    base = top
    while bits != 0:
        j = first_lane(bits)
        bits &= bits - 1
        value, k = lane(away, j), top
        while k > base and bound[k - 1] < value:
            waiting[k], bound[k] = waiting[k - 1], bound[k - 1]
            k -= 1
        waiting[k], bound[k] = first + j if first >= 0 else first - j, value
        top += 1
    return top
