"""Blocks of vertices: the unit of work of every kernel, whatever the number of threads.

A block owns BLOCK consecutive vertices and is the only one that writes their forces. A spring
inside a block is computed once; one that crosses is computed by both blocks, and each adds its
own side. Blocks and the order of sums inside them depend on the fabric alone, so the result is
the same to the last bit for any number of threads.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.fabric import Int

Long = NDArray[np.int64]

BLOCK = 4096
"""Vertices of a block. Forces of a block (98 kB) stay in a core's second-level cache."""

PADDING = 8
"""Columns after a block's forces that take what belongs to other blocks' vertices."""


def block_count(vertices: int) -> int:
    """Blocks that `vertices` make."""
    return -(-vertices // BLOCK)


def owned_copies(indices: Long, blocks: int) -> tuple[Long, Long]:
    """Elements each block has to compute, for (w, m) vertices of m elements.

    Returns (p,) element numbers, grouped by block, and (blocks + 1,) bounds: an element appears
    once in each block that owns one of its vertices.
    """
    home = indices // BLOCK
    fresh = np.ones(home.shape, bool)
    for row in range(1, home.shape[0]):
        fresh[row] = (home[:row] != home[row]).all(axis=0)
    which, element = np.nonzero(fresh)
    block = home[which, element]
    order = np.lexsort((element, block))
    bounds = np.searchsorted(block[order], np.arange(blocks + 1))
    return element[order].astype(np.int64), bounds.astype(np.int64)


def pad_lists(element: Long, bounds: Long, width: int) -> tuple[Long, Long]:
    """Make every block's list a whole number of vectors; the added places hold -1."""
    length = np.diff(bounds)
    padded = -(-length // width) * width
    start = np.concatenate([[0], np.cumsum(padded)]).astype(np.int64)
    out = np.full(int(start[-1]), -1, np.int64)
    block = np.repeat(np.arange(length.shape[0]), length)
    out[np.arange(element.shape[0]) - bounds[:-1][block] + start[:-1][block]] = element
    return out, start


def local_targets(indices: Long, start: Long, vertices: int) -> Int:
    """(w, p) columns in the block's own forces; others' vertices, and -1, go to the padding."""
    origin = BLOCK * np.repeat(np.arange(start.shape[0] - 1), np.diff(start))
    width = np.minimum(BLOCK, vertices - origin)
    local = indices - origin
    own = (indices >= 0) & (local >= 0) & (local < width)
    return np.ascontiguousarray(np.where(own, local, width), np.int32)


def cut_runs(runs: Long, longest: int) -> Long:
    """Cut runs so that each end of a piece lies in one block.

    runs (m, 4): first vertex of either end, springs, column of the constants. Returns (p, 5):
    the same and the run each piece comes from, in the order of the runs.
    """
    rest = np.column_stack([runs, np.arange(runs.shape[0])]).astype(np.int64)
    pieces = [np.zeros((0, 5), np.int64)]
    while rest.shape[0]:
        room = np.minimum(BLOCK - rest[:, 0] % BLOCK, BLOCK - rest[:, 1] % BLOCK)
        take = np.minimum(np.minimum(room, rest[:, 2]), longest)
        piece = rest.copy()
        piece[:, 2] = take
        pieces.append(piece)
        rest[:, :2] += take[:, None]
        rest[:, 2] -= take
        rest[:, 3] += take
        rest = rest[rest[:, 2] > 0]
    cut = np.concatenate(pieces)
    return cut[np.lexsort((cut[:, 3], cut[:, 4]))]
