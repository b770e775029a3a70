"""What a step leaves below nothing or above capacity goes to or comes from the neighbours; no dye is lost.

A cell's excess, or its lack, is shared among the cells that it has faces with, by what they have room for, or have.
A cell that held more than its capacity before the step may go on to. One whose neighbours cannot take it all gives
them the rest by their weights, and they pass it on in the next sweep.
"""

from __future__ import annotations

from typing import Any

from nuno_dye.diffusion import LEFT
from nuno_kernels import kernel

SWEEPS = 300
"""Over all cells. What is to be moved are errors of a step, and nearly always gone after one or two."""

ROUNDING = 1.0 + 2.0**-51
"""A cell above its capacity by no more than rounding is set to it: among full cells nobody could take so little."""


@kernel
def face(weights: Any, r: int, layer: int, row: int, c: int, side: int) -> tuple[float, int, int]:
    """Weight of a cell's face, and the row and column of the cell behind it."""
    at = row + layer * r
    if side == 0:
        return weights.along[at, c], at, c + 1
    if side == 1:
        return weights.along[at, c - 1], at, c - 1
    if side == 2:
        return weights.down[at, c], at + 1, c
    if side == 3:
        return weights.down[at - 1, c], at - 1, c
    return weights.across[row, c], row + r - layer * r, c


@kernel
def share_out(phi: Any, most: Any, weights: Any, layer: int, row: int, c: int, excess: float) -> None:
    """Bring one cell back by `excess`, negative for a lack."""
    r = weights.across.shape[0]
    total, ways = 0.0, 0.0
    for side in range(5):
        weight, i, k = face(weights, r, layer, row, c, side)
        if weight > 0.0:
            total += max(most[i, k] - phi[i, k], 0.0) if excess > 0.0 else max(phi[i, k], 0.0)
            ways += weight
    if ways == 0.0:
        return
    amount = abs(excess)
    part = min(1.0, amount / total) if total > 0.0 else 0.0
    rest = max(amount - total, 0.0)
    sign = 1.0 if excess > 0.0 else -1.0
    for side in range(5):
        weight, i, k = face(weights, r, layer, row, c, side)
        if weight > 0.0:
            room = max(most[i, k] - phi[i, k], 0.0) if excess > 0.0 else max(phi[i, k], 0.0)
            phi[i, k] += sign * (part * room + rest * weight / ways)
    phi[row + layer * r, c] = most[row + layer * r, c] if excess > 0.0 else 0.0


@kernel
def repair(phi: Any, most: Any, floor: Any, weights: Any, first: int, last: int, nx: int) -> int:
    """Bring amounts (2 r, w) into 0 .. `most`; how many cells still lie outside. Not a number stays.

    A cell with a `floor` may lack what it will be given, and so takes others' excess.
    """
    r = weights.across.shape[0]
    outside = 0
    for _ in range(SWEEPS):
        outside = 0
        for layer in range(2):
            for row in range(first, last + 1):
                for c in range(LEFT, LEFT + nx):
                    there, limit = phi[row + layer * r, c], most[row + layer * r, c]
                    if there > limit * ROUNDING:
                        outside += 1
                        share_out(phi, most, weights, layer, row, c, there - limit)
                    elif there > limit:
                        phi[row + layer * r, c] = limit
                    elif there < 0.0 and (floor is None or floor[row + layer * r, c] == 0.0):
                        outside += 1
                        share_out(phi, most, weights, layer, row, c, there)
        if outside == 0:
            break
    return outside
