"""The stack of a tree search, the nearest of each node's children on top."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nuno_kernels import forced_inline
from nuno_kernels.lanes.choose import first_lane, lane
from nuno_kernels.lanes.simd import Lanes
from nuno_schemas.fabric import Float


@forced_inline
def push_children(away: Lanes, bits: int, first: int, waiting: NDArray[np.int64], bound: Float, top: int) -> int:
    """Push those of a node's eight children whose `bits` are set, the nearest last; return the new height, `top`
    before.

    `away` are their distances, written to `bound`; `first` is the first child, and counts down where it is negative, as
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
