"""Sums of a Runge-Kutta method's slopes, and the size of its error estimate.

The method is taken in Nystrom's form: with x' = v, v' = a(x, v) the slopes of x are velocities,
which are sums of the slopes of v themselves. With k_j = a(y_j, u_j), a stage of the method A is

    y_i = x + c_i h v + h^2 sum_j (A A)_ij k_j,    u_i = v + h sum_j A_ij k_j,

the same numbers as the usual form gives (Hairer, Norsett & Wanner 1993, section II.14), from half
the memory.
"""

from __future__ import annotations

from typing import Any

from numba import prange

from nuno_kernels import kernel, parallel_kernel
from nuno_kernels.lanes.simd import WIDTH, read, splat, store, write
from nuno_kernels.step.blocks import BLOCK


@kernel
def combine_block(
    block: int, x: Any, v: Any, k: Any, ch: float, h: float, position: Any, velocity: Any, count: int, y: Any, u: Any
) -> None:
    """y = x + ch v + h^2 sum position_j k_j and u = v + h sum velocity_j k_j on a block's vertices.

    k is (stages * 3, n); the first `count` of the weights are read.
    """
    low, high = block * BLOCK, min((block + 1) * BLOCK, x.shape[1])
    for row in range(3):
        for p in range(low, high, WIDTH):
            m = min(WIDTH, high - p)
            moved, sped = splat(0.0), splat(0.0)
            for j in range(count):
                if position[j] != 0.0 or velocity[j] != 0.0:
                    slope = read(k, 3 * j + row, p, m)
                    moved = moved + position[j] * slope
                    sped = sped + velocity[j] * slope
            speed = read(v, row, p, m)
            write(y, row, p, m, read(x, row, p, m) + (ch * speed + h * h * moved))
            write(u, row, p, m, speed + h * sped)


@parallel_kernel
def combine_parallel(
    x: Any, v: Any, k: Any, ch: float, h: float, position: Any, velocity: Any, count: int, y: Any, u: Any
) -> None:
    """All blocks on several threads."""
    for block in prange((x.shape[1] + BLOCK - 1) // BLOCK):
        combine_block(block, x, v, k, ch, h, position, velocity, count, y, u)


@kernel
def combine(
    x: Any, v: Any, k: Any, ch: float, h: float, position: Any, velocity: Any, count: int, y: Any, u: Any, threads: Any
) -> None:
    """A stage (y, u) from the state (x, v), all (3, n), and the slopes k (stages * 3, n)."""
    if threads is None:
        for block in range((x.shape[1] + BLOCK - 1) // BLOCK):
            combine_block(block, x, v, k, ch, h, position, velocity, count, y, u)
    else:
        combine_parallel(x, v, k, ch, h, position, velocity, count, y, u)


@kernel
def add_squares(block: int, k: Any, weights: Any, wait: Any) -> float:
    """Sum over a block of (sum_j weights_j k_j)^2; `wait` (1, 8) is scratch."""
    low, high = block * BLOCK, min((block + 1) * BLOCK, k.shape[1])
    total = splat(0.0)
    for row in range(3):
        for p in range(low, high, WIDTH):
            m = min(WIDTH, high - p)
            e = splat(0.0)
            for j in range(weights.shape[0]):
                if weights[j] != 0.0:
                    e = e + weights[j] * read(k, 3 * j + row, p, m)
            total = total + e * e
    store(wait, 0, 0, total)
    result = 0.0
    for lane in range(WIDTH):
        result += wait[0, lane]
    return result


@parallel_kernel
def square_parallel(k: Any, weights: Any, sums: Any, wait: Any) -> None:
    """The sums of all blocks on several threads."""
    for block in prange(sums.shape[0]):
        sums[block] = add_squares(block, k, weights, wait[block])


@kernel
def square(k: Any, weights: Any, sums: Any, wait: Any, threads: Any) -> float:
    """Sum over all vertices of |sum_j weights_j k_j|^2, in an order that no thread changes.

    sums (blocks,) and wait (blocks, 1, 8) are scratch; a pinned vertex has slopes 0.
    """
    if threads is None:
        for block in range(sums.shape[0]):
            sums[block] = add_squares(block, k, weights, wait[block])
    else:
        square_parallel(k, weights, sums, wait)
    total = 0.0
    for block in range(sums.shape[0]):
        total += sums[block]
    return total
