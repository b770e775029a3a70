"""Updates y + h k of positions and velocities, two in one pass over the blocks; and velocities split into their mean
and the rest, and recombined.

A parallel region costs its threads a barrier; two updates that follow each other share one.
"""

from __future__ import annotations

import numpy as np

from nuno_kernels import kernel
from nuno_kernels.lanes import WIDTH, dot, minus, read, read_triple, root, splat, where_not_negative, write
from nuno_kernels.step.blocks import BLOCK
from nuno_kernels.terms import over_blocks
from nuno_schemas.fabric import Float


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
    for p in range(low, high, WIDTH):
        m = min(WIDTH, high - p)
        start = read_triple(last, 0, p, m)
        way, goal = minus(read_triple(x, 0, p, m), start), minus(read_triple(meant, 0, p, m), start)
        gone, whole = dot(way, way), dot(goal, goal)
        share = where_not_negative(gone - whole, splat(1.0), root(gone / whole))
        for row in range(3):
            swing = read(v, row, p, m)
            write(change, row, p, m, (share - 1.0) * swing)
            write(v, row, p, m, read(u, row, p, m) + share * swing)


rejoin_blocks = over_blocks(rejoin_block, "v, u, x, meant, last, change")


@kernel
def rejoin(v: Float, u: Float, x: Float, meant: Float, last: Float, change: Float, threads: int | None) -> None:
    """Do so for all vertices, each array (3, n)."""
    rejoin_blocks(v, u, x, meant, last, change, (x.shape[1] + BLOCK - 1) // BLOCK, threads)
