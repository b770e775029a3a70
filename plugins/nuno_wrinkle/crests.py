"""Where to measure a wrinkle: across each new vertex, between the unsmoothed vertices on either side of its line."""

from __future__ import annotations

import numpy as np

from nuno_schemas.fabric import Int
from nuno_wrinkle.lines import Crossed
from nuno_wrinkle.raised import Raised


def find_crests(n: int, crossed: Crossed, raised: Raised) -> Int:
    """(5, c) vertices: new ones, the nearest unsmoothed ones to the left and to the right of their line, and the
    new ones before and after them.

    Ends of lines, and new vertices with unsmoothed ones on one side only, are left out.
    """
    still = np.ones(len(raised.x), np.bool_)
    still[raised.smoothed] = still[n:] = False
    feet = np.unique(raised.faces[raised.local])
    feet = feet[still[feet]]
    rows = []
    for chain in crossed.chains if len(feet) else ():
        inner = np.asarray(chain[1:-1], np.int64)
        along = raised.flat[n + np.asarray(chain[2:], np.int64)] - raised.flat[n + np.asarray(chain[:-2], np.int64)]
        across = np.cross(raised.normal[inner], along)
        for before, own, after, left in zip(chain[:-2], chain[1:-1], chain[2:], across, strict=True):
            way = raised.flat[feet] - raised.flat[n + own]
            side = way @ left
            distance = np.square(way).sum(axis=1)
            if (side > 0.0).any() and (side < 0.0).any():
                pair = (feet[np.argmin(np.where(one, distance, np.inf))] for one in (side > 0.0, side < 0.0))
                rows.append((n + own, *pair, n + before, n + after))
    return np.array(rows, np.int32).reshape(-1, 5).T.copy()
