"""Updates y + h k of positions and velocities, and sums of a Runge-Kutta method's slopes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from nuno_kernels import block_kernel, kernel
from nuno_kernels.lanes import WIDTH, read, splat, store, write
from nuno_kernels.step.blocks import BLOCK
from nuno_kernels.terms import over_blocks
from nuno_schemas.fabric import Float

# Sums of a Runge-Kutta method's slopes, and the size of its error estimate.
#
# The method is taken in Nystrom's form: with x' = v, v' = a(x, v) the slopes of x are velocities,
# which are sums of the slopes of v themselves. With k_j = a(y_j, u_j), a stage of the method A is
#
#     y_i = x + c_i h v + h^2 sum_j (A A)_ij k_j,    u_i = v + h sum_j A_ij k_j,
#
# the same numbers as the usual form gives (Hairer, Norsett & Wanner 1993, section II.14), from half
# the memory.


class Buffers(NamedTuple):
    """Start (x, v) of the pending step, its end (y, u), and slopes k (s, 3, n), twice the same memory."""

    x: Float
    v: Float
    y: Float
    u: Float
    k: Float
    flat: Float
    """(3 s, n)"""
    sums: Float
    wait: Float


class Stage(NamedTuple):
    """y = x + ch v + h^2 sum position_j k_j and u = v + h sum velocity_j k_j, over the first `slopes` of them."""

    ch: float
    h: float
    position: Float
    velocity: Float
    slopes: int


@block_kernel
def combine_block(block: int, b: Buffers, stage: Stage, y: Float, u: Float) -> None:
    """Compute a stage (y, u) on a block's vertices."""
    x, v, k, position, velocity = b.x, b.v, b.flat, stage.position, stage.velocity
    ch, h, count = stage.ch, stage.h, stage.slopes
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


combine_blocks = over_blocks(combine_block, "b, stage, y, u")


@kernel
def combine(b: Buffers, stage: Stage, y: Float, u: Float, threads: int | None) -> None:
    """Compute a stage (y, u) (3, n) from the state and the slopes in b."""
    combine_blocks(b, stage, y, u, (y.shape[1] + BLOCK - 1) // BLOCK, threads)


@block_kernel
def add_squares(block: int, k: Float, weights: Float, sums: Float, wait: Float) -> None:
    """Sum (sum_j weights_j k_j)^2 over a block, into sums; `wait` (blocks, 1, 8) is scratch."""
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
    lanes = wait[block]
    store(lanes, 0, 0, total)
    result = 0.0
    for lane in range(WIDTH):
        result += lanes[0, lane]
    sums[block] = result


square_blocks = over_blocks(add_squares, "k, weights, sums, wait")


@block_kernel
def square(k: Float, weights: Float, sums: Float, wait: Float, threads: int | None) -> float:
    """Return the sum over all vertices of |sum_j weights_j k_j|^2, in an order independent of threads.

    sums (blocks,) and wait (blocks, 1, 8) are scratch; a pinned vertex has slopes 0.
    """
    square_blocks(k, weights, sums, wait, sums.shape[0], threads)
    total = 0.0
    for block in range(sums.shape[0]):
        total += sums[block]
    return total


# Updates y + h k of positions and velocities, two in one pass over the blocks; and velocities split into their mean
# and the rest, and recombined.
#
# A parallel region costs its threads a barrier; two updates that follow each other share one.


@kernel
def add_block(block: int, out: Float, y: Float, h: float, k: Float) -> None:
    """Compute out = y + h k on a block's vertices."""
    low, high = block * BLOCK, min((block + 1) * BLOCK, out.shape[1])
    for p in range(low, high, WIDTH):
        m = min(WIDTH, high - p)
        for row in range(3):
            write(out, row, p, m, read(y, row, p, m) + h * read(k, row, p, m))


@kernel
def add_block_twice(
    block: int, first: Float, y: Float, h: float, k: Float, second: Float, z: Float, g: float, m: Float
) -> None:
    """Compute first = y + h k, then second = z + g m on a block's vertices."""
    add_block(block, first, y, h, k)
    add_block(block, second, z, g, m)


add_blocks = over_blocks(add_block, "out, y, h, k")
add_blocks_twice = over_blocks(add_block_twice, "first, y, h, k, second, z, g, m")


@kernel
def add(out: Float, y: Float, h: float, k: Float, threads: int | None) -> None:
    """Compute out = y + h k, all (3, n)."""
    add_blocks(out, y, h, k, (out.shape[1] + BLOCK - 1) // BLOCK, threads)


@kernel
def add_twice(
    first: Float, y: Float, h: float, k: Float, second: Float, z: Float, g: float, m: Float, threads: int | None
) -> None:
    """Compute first = y + h k, then second = z + g m, all (3, n); the second may use the first."""
    add_blocks_twice(first, y, h, k, second, z, g, m, (first.shape[1] + BLOCK - 1) // BLOCK, threads)


@kernel
def average_block(block: int, u: Float, v: Float, x: Float, last: Float, rate: float) -> None:
    """Compute mean velocities u = (x - last) rate of a block's vertices, and subtract them from v."""
    low, high = block * BLOCK, min((block + 1) * BLOCK, x.shape[1])
    for row in range(3):
        for i in range(np.uint64(low), np.uint64(high)):
            u[row, i] = (x[row, i] - last[row, i]) * rate
            v[row, i] -= u[row, i]


average_blocks = over_blocks(average_block, "u, v, x, last, rate")


@kernel
def average(u: Float, v: Float, x: Float, last: Float, rate: float, threads: int | None) -> None:
    """Compute u = (x - last) rate, and v -= u, all (3, n)."""
    average_blocks(u, v, x, last, rate, (x.shape[1] + BLOCK - 1) // BLOCK, threads)


@kernel
def rejoin_block(block: int, v: Float, u: Float, x: Float, meant: Float, last: Float, change: Float) -> None:
    """Compute v = u + s v on a block, s the share of their way from `last` to `meant` that vertices have gone, up to 1;
    and its change from u + v.

    One that is held where it is swings no farther, either: it would set out anew from there after each kick.
    """
    low, high = block * BLOCK, min((block + 1) * BLOCK, x.shape[1])
    for i in range(np.uint64(low), np.uint64(high)):
        gone, whole = 0.0, 0.0
        for row in range(3):
            gone += (x[row, i] - last[row, i]) ** 2
            whole += (meant[row, i] - last[row, i]) ** 2
        share = 1.0 if gone >= whole else math.sqrt(gone / whole)
        for row in range(3):
            change[row, i] = (share - 1.0) * v[row, i]
            v[row, i] = u[row, i] + share * v[row, i]


rejoin_blocks = over_blocks(rejoin_block, "v, u, x, meant, last, change")


@kernel
def rejoin(v: Float, u: Float, x: Float, meant: Float, last: Float, change: Float, threads: int | None) -> None:
    """Do so for all vertices, each array (3, n)."""
    rejoin_blocks(v, u, x, meant, last, change, (x.shape[1] + BLOCK - 1) // BLOCK, threads)
