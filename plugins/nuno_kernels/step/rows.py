"""Whole arrays (rows, n) by loops: numba compiles each expression over arrays anew where it stands, for a second."""

from __future__ import annotations

import math

import numpy as np

from nuno_kernels import block_kernel
from nuno_schemas.fabric import Float


@block_kernel
def copy_rows(x: Float, to: Float) -> None:
    """Copy x; numba's own assignment goes through a third array, in case the two overlap."""
    for row in range(x.shape[0]):
        for i in range(x.shape[1]):
            to[row, i] = x[row, i]


@block_kernel
def same_rows(a: Float, b: Float) -> bool:
    """Whether two arrays hold the same numbers; NaN equals none."""
    for row in range(a.shape[0]):
        for i in range(a.shape[1]):
            if a[row, i] != b[row, i]:
                return False
    return True


@block_kernel
def all_finite(x: Float) -> bool:
    """Whether all entries are finite."""
    for row in range(x.shape[0]):
        for i in range(x.shape[1]):
            if not math.isfinite(x[row, i]):
                return False
    return True


@block_kernel
def sum_rows(a: Float, share: float, b: Float) -> Float:
    """Return a + share b."""
    out = np.empty(a.shape)
    for row in range(a.shape[0]):
        for i in range(a.shape[1]):
            out[row, i] = a[row, i] + share * b[row, i]
    return out
