"""Linearised springs and hinges, added to the entries of a factorisation: a term's role `assemble`."""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno_kernels import kernel
from nuno_kernels.forces.linear_layout import Linear
from nuno_schemas.fabric import Float


@kernel
def assemble_springs(linear: Linear, places: Any, diagonal: Float, values: Float) -> None:
    """Add springs, alpha I + w w^T each."""
    rows, vertices = linear.rows, places.vertices
    block = np.empty(6)
    for p in range(places.column.shape[0]):
        c = places.column[p]
        alpha, x, y, z = rows[0, c], rows[1, c], rows[2, c], rows[3, c]
        block[0], block[1], block[2] = alpha + x * x, alpha + y * y, alpha + z * z
        block[3], block[4], block[5] = x * y, x * z, y * z
        for end in range(2):
            for row in range(6):
                diagonal[row, vertices[end, p]] += block[row]
        at, width = places.at[0, p], abs(places.width[0, p])
        if at >= 0:
            values[0, at] -= block[0]
            values[0, at + 1] -= block[3]
            values[0, at + 2] -= block[4]
            values[0, at + width] -= block[3]
            values[0, at + width + 1] -= block[1]
            values[0, at + width + 2] -= block[5]
            values[0, at + 2 * width] -= block[4]
            values[0, at + 2 * width + 1] -= block[5]
            values[0, at + 2 * width + 2] -= block[2]


@kernel
def assemble_hinges(linear: Linear, places: Any, diagonal: Float, values: Float) -> None:
    """Add hinges, g g^T each; the rows hold g at corner 1, -g at 2 and at 3, and corner 0 balances them."""
    rows, vertices = linear.rows, places.vertices
    g = np.empty((4, 3))
    for p in range(places.column.shape[0]):
        c = places.column[p]
        for axis in range(3):
            g[1, axis], g[2, axis], g[3, axis] = rows[axis, c], -rows[3 + axis, c], -rows[6 + axis, c]
            g[0, axis] = -(g[1, axis] + g[2, axis] + g[3, axis])
        for corner in range(4):
            x, y, z, v = g[corner, 0], g[corner, 1], g[corner, 2], vertices[corner, p]
            diagonal[0, v] += x * x
            diagonal[1, v] += y * y
            diagonal[2, v] += z * z
            diagonal[3, v] += x * y
            diagonal[4, v] += x * z
            diagonal[5, v] += y * z
        pair = 0
        for i in range(4):
            for j in range(i + 1, 4):
                at, width = places.at[pair, p], places.width[pair, p]
                first, second = (i, j) if width > 0 else (j, i)
                if at >= 0:
                    for row in range(3):
                        for column in range(3):
                            values[0, at + row * abs(width) + column] += g[first, row] * g[second, column]
                pair += 1
