"""The pairs of each block of cloth's vertices: blocks add forces to their own vertices, on any thread."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nuno_contact.offset.contact_state import IN_TURN, PARTS, WORTH, ContactState
from nuno_kernels import block_kernel, forced_inline
from nuno_kernels.step.blocks import BLOCK
from nuno_kernels.terms import over_blocks
from nuno_schemas.fabric import Int


@forced_inline
def block_of(pair: Int, p: int, corner: int, cloth: int) -> int:
    """Return the block of a pair's corner, -1 if an earlier corner has the same, and for bodies, after the cloth."""
    block = pair[p, corner] // BLOCK if pair[p, corner] < cloth else -1
    for other in range(corner):
        if pair[p, other] < cloth and pair[p, other] // BLOCK == block:
            return -1
    return int(block)


@block_kernel
def count_part(part: int, pair: Int, chosen: Int, number: int, cloth: int, at: NDArray[np.int64]) -> None:
    """Count how many of a part of the chosen pairs each block has, at[part]."""
    for q in range(part * number // PARTS, (part + 1) * number // PARTS):
        for corner in range(4):
            block = block_of(pair, chosen[q], corner, cloth)
            if block >= 0:
                at[part, block] += 1


@block_kernel
def fill_part(part: int, pair: Int, chosen: Int, number: int, cloth: int, at: NDArray[np.int64], shared: Int) -> None:
    """Write a part of the chosen pairs to the places from at[part] on, for each block."""
    for q in range(part * number // PARTS, (part + 1) * number // PARTS):
        for corner in range(4):
            block = block_of(pair, chosen[q], corner, cloth)
            if block >= 0:
                shared[at[part, block]] = chosen[q]
                at[part, block] += 1


count_parts = over_blocks(count_part, "pair, chosen, number, cloth, at", WORTH, IN_TURN)
fill_parts = over_blocks(fill_part, "pair, chosen, number, cloth, at, shared", WORTH, IN_TURN)


@block_kernel
def share_out(m: ContactState, chosen: Int, number: int, start: Int, shared: Int, threads: int | None) -> None:
    """Assign `number` chosen pairs to the blocks of cloth of their vertices, in order: bounds of each block's, and the
    pairs.
    """
    pair, cloth, blocks = m.pair, m.mass.shape[0] - m.local.shape[0], start.shape[0] - 1
    at = np.zeros((PARTS, blocks), np.int64)
    count_parts(pair, chosen, number, cloth, at, PARTS, number, threads)
    total = 0
    for block in range(blocks):
        start[block] = total
        for part in range(PARTS):
            count = at[part, block]
            at[part, block] = total
            total += count
    start[blocks] = total
    fill_parts(pair, chosen, number, cloth, at, shared, PARTS, number, threads)
