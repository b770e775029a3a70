"""Yarns between a point and what it looks at: each crossing counts once, however many of a yarn's capsules it takes."""

from __future__ import annotations

import numpy as np

from nuno_render.compiled import kernel
from nuno_render.rays.hits import meet_capsules, meet_triangle

# mypy: disable-error-code="no-untyped-def"


@kernel
def join_crossings(count, items, enters, leaves, yarn):
    """Make one hit of capsules of one yarn that overlap along the ray; returns how many are left, nearest first."""
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
def cross_yarns(p, d, most, threads, keep, hits):
    """Crossings of yarns from p (3,) along d (3,) up to a distance: their number, and hits filled with them."""
    items, enters, leaves, waiting, bound = hits
    count = meet_capsules(
        p[0], p[1], p[2], d[0], d[1], d[2], most, threads.tree, keep, items, enters, leaves, waiting, bound
    )
    return count if count < 2 else join_crossings(count, items, enters, leaves, threads.yarn)


@kernel
def free_way(p, d, skin, threads, share, keep, hits):
    """Share of the light that comes to p (3,) from direction d (3,): none through bodies, `share` through a yarn."""
    face, _ = meet_triangle(p[0], p[1], p[2], d[0], d[1], d[2], 0.0, np.inf, skin.tree, hits[3], hits[4])
    if face >= 0:
        return 0.0
    if share == 1.0:
        return 1.0
    return share ** cross_yarns(p, d, np.inf, threads, keep, hits)
