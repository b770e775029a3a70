"""Repair of amounts below 0 or above capacity after a step, from or to the nearest cells that can; no dye is lost.

Excess flows over faces, through full cells, towards those with room: from every cell to the neighbours that are a face
nearer to room, by the faces' weights, and at the end by the available room. The nearest cells that have dye fill a
deficit likewise. Rejected: sharing excess with the neighbours until all are within bounds, which took hundreds of
sweeps where many full cells are together, and then ended no better than rounding.
"""

from __future__ import annotations

import numpy as np

from nuno_dye.solvers.diffusion import LEFT, Rows, Weights
from nuno_kernels import block_kernel, kernel
from nuno_schemas.fabric import Float, Int

ROUNDS = 100
"""The most rounds in which excess moves, each with twice the reach of the last: nearly all of it finds room at once,
and overfilled cells pass their excess on in the next round."""

ROUNDING = 1.0 + 2.0**-49
"""A cell above its capacity by no more than rounding is set to it: among full cells no other could take so little."""
ROOM = 2.0**-20
"""Least free share of its capacity for which a cell is a target, unless there is none."""


@kernel
def face(weights: Weights, r: int, row: int, c: int, side: int) -> tuple[float, int, int]:
    """Return the weight of a cell's face, and the row, (2 r, w), and column of the cell behind it."""
    if side == 0:
        return weights.along[row, c], row, c + 1
    if side == 1:
        return weights.along[row, c - 1], row, c - 1
    if side == 2:
        return weights.down[row, c], row + 1, c
    if side == 3:
        return weights.down[row - 1, c], row - 1, c
    layer = row // r
    return weights.across[row - layer * r, c], row + r - 2 * layer * r, c


@kernel
def room_of(phi: Float, most: Float, row: int, c: int, lacking: bool) -> float:
    """Return the amount that a cell can take, or, if others are `lacking`, give."""
    there: float = phi[row, c]
    return there if lacking else most[row, c] - there


@kernel
def find_outside(
    phi: Float, most: Float, floor: Float, first: int, last: int, nx: int, lacking: bool, queue: Rows
) -> int:
    """Write cells above capacity, or below 0, into `queue` as row w + c. Return their number."""
    r, w, count = phi.shape[0] // 2, phi.shape[1], 0
    for layer in range(2):
        for row in range(first + layer * r, last + 1 + layer * r):
            for c in range(LEFT, LEFT + nx):
                present, limit = phi[row, c], most[row, c]
                if lacking:
                    outside = present < 0.0 and floor[row, c] == 0.0
                else:
                    outside = present > limit
                    if outside and present <= limit * ROUNDING:
                        phi[row, c] = limit
                        outside = False
                if outside:
                    queue[count] = row * w + c
                    count += 1
    return count


@kernel
def find_ends(
    phi: Float, most: Float, weights: Weights, lacking: bool, queue: Rows, count: int, far: Int, ends: Rows, reach: int
) -> int:
    """Write cells with room within `reach` faces of the `count` first of `queue` into `ends`. Return their number.
    `far` is then 0 in cells with room, -1 in visited ones, and -2 in others.
    """
    r, w, end_count, at = weights.across.shape[0], phi.shape[1], 0, 0
    worth = 0.0 if reach >= phi.size else ROOM
    for n in range(count):
        far[queue[n] // w, queue[n] % w] = -1
    for _ in range(reach):
        layer = count
        for n in range(at, layer):
            row, c = queue[n] // w, queue[n] % w
            for side in range(5):
                weight, i, k = face(weights, r, row, c, side)
                if weight > 0.0 and far[i, k] == -2:
                    if room_of(phi, most, i, k, lacking) > worth * most[i, k]:
                        far[i, k] = 0
                        ends[end_count] = i * w + k
                        end_count += 1
                    else:
                        far[i, k] = -1
                        queue[count] = i * w + k
                        count += 1
        if count == layer:
            break
        at = layer
    return end_count


@kernel
def measure_distances(weights: Weights, w: int, far: Int, ends: Rows, count: int) -> int:
    """Write visited cells into `ends`, nearest to room first, and their distance in faces into `far`. Return their
    number.
    """
    r, at = weights.across.shape[0], 0
    while at < count:
        row, c = ends[at] // w, ends[at] % w
        at += 1
        for side in range(5):
            weight, i, k = face(weights, r, row, c, side)
            if weight > 0.0 and far[i, k] == -1:
                far[i, k] = far[row, c] + 1
                ends[count] = i * w + k
                count += 1
    return count


@kernel
def move_excess(
    phi: Float, most: Float, weights: Weights, floor: Float, lacking: bool, far: Int, row: int, c: int
) -> None:
    """Bring one cell within its bounds; its excess moves a face nearer to room."""
    r, near = weights.across.shape[0], far[row, c] - 1
    if lacking and floor[row, c] > 0.0:
        return
    amount = -phi[row, c] if lacking else phi[row, c] - most[row, c]
    if amount <= 0.0:
        return
    total = 0.0
    for side in range(5):
        weight, i, k = face(weights, r, row, c, side)
        if weight > 0.0 and far[i, k] == near:
            total += max(room_of(phi, most, i, k, lacking), 0.0) if near == 0 else weight
    if total == 0.0:  # others have used all room: this cell waits for the next round
        return
    for side in range(5):
        weight, i, k = face(weights, r, row, c, side)
        if weight > 0.0 and far[i, k] == near:
            share = max(room_of(phi, most, i, k, lacking), 0.0) if near == 0 else weight
            phi[i, k] += (-amount if lacking else amount) * share / total
    phi[row, c] = 0.0 if lacking else most[row, c]


@block_kernel
def repair_side(
    phi: Float, most: Float, floor: Float, weights: Weights, first: int, last: int, nx: int, lacking: bool
) -> int:
    """Bring amounts below capacity, or above 0. Return the number of cells still outside."""
    w = phi.shape[1]
    queue = np.empty(phi.size, np.int64)
    outside = find_outside(phi, most, floor, first, last, nx, lacking, queue)
    if outside == 0:
        return 0
    ends, far = np.empty(phi.size, np.int64), np.empty(phi.shape, np.int32)
    reach = 1
    for _ in range(ROUNDS):
        far[:] = -2
        count = find_ends(phi, most, weights, lacking, queue, outside, far, ends, reach)
        if count == 0 and reach >= phi.size:
            break
        for n in range(measure_distances(weights, w, far, ends, count) - 1, count - 1, -1):
            move_excess(phi, most, weights, floor, lacking, far, ends[n] // w, ends[n] % w)
        outside = find_outside(phi, most, floor, first, last, nx, lacking, queue)
        if outside == 0:
            break
        reach = min(2 * reach, phi.size)
    return outside


@kernel
def repair(phi: Float, most: Float, floor: Float, weights: Weights, first: int, last: int, nx: int) -> int:
    """Bring amounts (2 r, w) into 0 .. `most`. Return the number of cells still outside. NaN stays. A cell with a
    `floor` above 0 may be below 0, since its supply fills it.
    """
    outside = repair_side(phi, most, floor, weights, first, last, nx, False)
    return outside + repair_side(phi, most, floor, weights, first, last, nx, True)
