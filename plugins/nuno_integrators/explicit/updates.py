"""Updates y + h k of positions and velocities, two in one pass over the blocks.

A parallel region costs its threads a meeting; two updates that follow each other share one.
"""

from __future__ import annotations

from nuno_kernels import kernel
from nuno_kernels.lanes.simd import WIDTH, read, write
from nuno_kernels.step.blocks import BLOCK
from nuno_kernels.terms import over_blocks
from nuno_schemas.fabric import Float


@kernel
def add_block(block: int, out: Float, y: Float, h: float, k: Float) -> None:
    """out = y + h k on a block's vertices."""
    low, high = block * BLOCK, min((block + 1) * BLOCK, out.shape[1])
    for p in range(low, high, WIDTH):
        m = min(WIDTH, high - p)
        for row in range(3):
            write(out, row, p, m, read(y, row, p, m) + h * read(k, row, p, m))


@kernel
def add_block_twice(
    block: int, first: Float, y: Float, h: float, k: Float, second: Float, z: Float, g: float, m: Float
) -> None:
    """first = y + h k, then second = z + g m on a block's vertices."""
    add_block(block, first, y, h, k)
    add_block(block, second, z, g, m)


add_blocks = over_blocks(add_block, "out, y, h, k")
add_blocks_twice = over_blocks(add_block_twice, "first, y, h, k, second, z, g, m")


@kernel
def add(out: Float, y: Float, h: float, k: Float, threads: int | None) -> None:
    """out = y + h k, all (3, n)."""
    add_blocks(out, y, h, k, (out.shape[1] + BLOCK - 1) // BLOCK, threads)


@kernel
def add_twice(
    first: Float, y: Float, h: float, k: Float, second: Float, z: Float, g: float, m: Float, threads: int | None
) -> None:
    """first = y + h k, then second = z + g m, all (3, n); the second may use the first."""
    add_blocks_twice(first, y, h, k, second, z, g, m, (first.shape[1] + BLOCK - 1) // BLOCK, threads)
