"""The vertices by which wrinkles are measured: on their lines, and at their feet on both sides."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nuno_kernels import kernel
from nuno_schemas.fabric import Float, Int

# A wrinkle is measured across each vertex of its line, between its feet on either side: vertices that it leaves in
# place, or where none lies between, the next line that goes the other way, as of a valley between ridges.


@kernel
def _nearest(x: Float, feet: Int, turn: Float, vertices: Int, own: Float, across: Float, nearest: Int) -> None:
    """Find the feet (f,) nearest to each of `vertices` (m,) on the side that across (m, 3) points to, and on the other,
    within 45 degrees of it. x (n, 3); turn (f,) and own (m,) are above 0 on ridges, below in valleys, and 0 elsewhere;
    nearest (m, 2) is the result, -1 without a foot on that side.
    """
    for i in range(len(vertices)):
        best_left, best_right = np.inf, np.inf
        nearest[i, 0], nearest[i, 1] = -1, -1
        size = 0.0
        for k in range(3):
            size += across[i, k] * across[i, k]
        for j in range(len(feet)):
            side, distance = 0.0, 0.0
            for k in range(3):
                component = x[feet[j], k] - x[vertices[i], k]
                side += component * across[i, k]
                distance += component * component
            if turn[j] * own[i] > 0.0 or 2.0 * side * side < size * distance:
                continue
            if side > 0.0 and distance < best_left:
                best_left, nearest[i, 0] = distance, feet[j]
            if side < 0.0 and distance < best_right:
                best_right, nearest[i, 1] = distance, feet[j]


def find_crests(x: Float, normal: Float, chains: Sequence[Int], turn: Float, feet: Int) -> Int:
    """Return vertices (5, c): those along lines, the nearest of feet (f,) to the left and to the right of their line,
    and those before and after them. x (n, 3) [m] and normal (n, 3) are of the cloth before it is raised; turn (n,) is
    above 0 on ridges, below in valleys.

    Ends of lines, and vertices with feet on one side only, are left out.
    """
    none = np.zeros(0, np.int32)
    before, inner, after = (
        np.concatenate([none, *(chain[part] for chain in chains)]) for part in (np.s_[:-2], np.s_[1:-1], np.s_[2:])
    )
    pair = np.empty((len(inner), 2), np.int32)
    across = np.cross(normal[inner], x[after] - x[before])
    _nearest(x, feet, turn[feet], inner, turn[inner], across, pair)
    crests = np.stack([inner, *pair.T, before, after])
    return np.ascontiguousarray(crests[:, (pair >= 0).all(axis=1)], np.int32)
