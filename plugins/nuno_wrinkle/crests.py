"""Where to measure a wrinkle: across each new vertex, between the unsmoothed vertices on either side of its line."""

from __future__ import annotations

import numpy as np

from nuno_kernels import kernel
from nuno_schemas.fabric import Float, Int
from nuno_wrinkle.lines import Crossed
from nuno_wrinkle.raised import Raised


@kernel
def _nearest(x: Float, feet: Int, own: Int, across: Float, found: Int) -> None:
    """Of feet (f,), those nearest to each of own (m,) on the side that across (m, 3) points to, and on the other.

    x (n, 3); found (m, 2) out: -1 where there is none on that side.
    """
    for i in range(len(own)):
        best_left, best_right = np.inf, np.inf
        found[i, 0], found[i, 1] = -1, -1
        for foot in feet:
            side, distance = 0.0, 0.0
            for k in range(3):
                way = x[foot, k] - x[own[i], k]
                side += way * across[i, k]
                distance += way * way
            if side > 0.0 and distance < best_left:
                best_left, found[i, 0] = distance, foot
            if side < 0.0 and distance < best_right:
                best_right, found[i, 1] = distance, foot


def find_crests(n: int, crossed: Crossed, raised: Raised) -> Int:
    """(5, c) vertices: new ones, the nearest unsmoothed ones to the left and to the right of their line, and the
    new ones before and after them.

    Ends of lines, and new vertices with unsmoothed ones on one side only, are left out.
    """
    still = np.ones(len(raised.x), np.bool_)
    still[raised.smoothed] = still[n:] = False
    corners = np.zeros(len(raised.x), np.bool_)
    corners[raised.faces[raised.local]] = True
    feet = np.flatnonzero(corners & still).astype(np.int32)
    chains = [np.asarray(chain, np.int32) for chain in crossed.chains]
    before, inner, after = (
        np.concatenate([chain[part] for chain in chains]) for part in (np.s_[:-2], np.s_[1:-1], np.s_[2:])
    )
    along = raised.flat[n + after] - raised.flat[n + before]
    pair = np.empty((len(inner), 2), np.int32)
    _nearest(raised.flat, feet, n + inner, np.cross(raised.normal[inner], along), pair)
    crests = np.stack([n + inner, *pair.T, n + before, n + after])
    return np.ascontiguousarray(crests[:, (pair >= 0).all(axis=1)], np.int32)
