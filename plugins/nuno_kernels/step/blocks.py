"""Blocks of vertices: the unit of work of every kernel, whatever the number of threads.

A block owns BLOCK consecutive vertices and is the only one that writes their forces. A spring
inside a block is computed once; one that crosses is computed by both blocks, and each adds its
own side. Blocks and the order of sums inside them depend on the fabric alone, so the result is
the same to the last bit for any number of threads.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from nuno_kernels import block_kernel
from nuno_kernels.lanes import WIDTH
from nuno_schemas.fabric import Bool, Float, Int

# Whole arrays (rows, n) by loops: numba compiles each expression over arrays anew where it stands, for a second.


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


Long = NDArray[np.int64]

BLOCK = 2048
"""Vertices of a block. Its forces (49 kB) stay in a core's second-level cache. Smaller blocks share
out better, larger ones compute fewer springs twice: of a grid 256 wide 10 %, against 5 % at 4,096."""

PADDING = 8
"""columns after a block's forces that take those of other blocks' vertices"""

SHORTEST = 6
"""runs with fewer elements than this go through lists of indices, unless they are FEW"""

FEW = 1 / 16
"""Short runs with no more than this share of all elements are computed as runs too, and the kernel for lists is not
even compiled. A grid's borders are such."""

SMALL = 1024
"""With fewer elements all go through lists, which take any constants: a step could gain microseconds by runs, and each
combination of features takes seconds to compile."""


def is_small(elements: int) -> bool:
    """Whether so many springs or hinges are not worth a specialised kernel."""
    return elements < SMALL


def block_count(vertices: int) -> int:
    """Return the number of blocks of so many vertices."""
    return -(-vertices // BLOCK)


def owned_copies(indices: Long | Int, blocks: int) -> tuple[Long, Long]:
    """Return the elements that each block has to compute, for (w, m) vertices of m elements.

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


def pad_lists(element: Long, bounds: Long) -> tuple[Long, Long]:
    """Pad every block's list to whole vectors; the added places hold -1."""
    length = np.diff(bounds)
    padded = -(-length // WIDTH) * WIDTH
    start = np.concatenate([[0], np.cumsum(padded)]).astype(np.int64)
    out = np.full(int(start[-1]), -1, np.int64)
    block = np.repeat(np.arange(length.shape[0]), length)
    out[np.arange(element.shape[0]) - bounds[:-1][block] + start[:-1][block]] = element
    return out, start


def local_targets(indices: Long | Int, start: Long, vertices: int) -> Int:
    """Return columns (w, p) in the block's own forces; others' vertices, and -1, go to the padding."""
    origin = BLOCK * np.repeat(np.arange(start.shape[0] - 1), np.diff(start))
    width = np.minimum(BLOCK, vertices - origin)
    local = indices - origin
    inside = (indices >= 0) & (local >= 0) & (local < width)
    return np.ascontiguousarray(np.where(inside, local, width), np.int32)


def list_copies(indices: Long | Int, vertices: int) -> tuple[Long, Long, Int]:
    """Return lists per block of elements with vertices (w, m): the element (p,) in each place, -1 for padding; bounds
    (blocks + 1,); and (2 w, p) int32 the vertices, then their columns in the block's own forces.
    """
    element, start = pad_lists(*owned_copies(indices, block_count(vertices)))
    filled = element >= 0
    target = local_targets(np.where(filled, indices[:, element], -1), start, vertices)
    return element, start, np.concatenate([np.where(filled, indices[:, element], 0).astype(np.int32), target])


def cut_runs(runs: Long, longest: int) -> Long:
    """Cut runs so that each corner of a piece stays in one block.

    runs (m, w + 2): first vertex at each of w corners, elements, column of the constants. Returns
    (p, w + 3): the same and the run each piece comes from, in the order of the runs.
    """
    corners = runs.shape[1] - 2
    rest = np.column_stack([runs, np.arange(runs.shape[0])]).astype(np.int64)
    pieces = [np.zeros((0, corners + 3), np.int64)]
    while rest.shape[0]:
        room = (BLOCK - rest[:, :corners] % BLOCK).min(axis=1)
        take = np.minimum(np.minimum(room, rest[:, corners]), longest)
        piece = rest.copy()
        piece[:, corners] = take
        pieces.append(piece)
        rest[:, :corners] += take[:, None]
        rest[:, corners] -= take
        rest[:, corners + 1] += take
        rest = rest[rest[:, corners] > 0]
    cut = np.concatenate(pieces)
    return cut[np.lexsort((cut[:, corners + 1], cut[:, corners + 2]))]


def assign_runs(cut: Long, blocks: int) -> tuple[Long, Long]:
    """Return tasks from pieces (p, w + 2) of runs: one for every block that owns a corner.

    Returns (t, w + 3), the piece and a mark of the corners to add to (bit c for corner c), and
    (blocks + 1,) bounds. A block's tasks go by vertex, so that all work on a row finds it in the
    nearest cache.
    """
    corners = cut.shape[1] - 2
    home = cut[:, :corners] // BLOCK
    tasks, owners = [], []
    for c in range(corners):
        mark = ((home == home[:, c : c + 1]) << np.arange(corners)).sum(axis=1)
        first = (home[:, :c] != home[:, c : c + 1]).all(axis=1)
        tasks.append(np.column_stack([cut, mark])[first])
        owners.append(home[first, c])
    task, block = np.concatenate(tasks), np.concatenate(owners)
    order = np.lexsort((*task[:, :corners].T[::-1], block))
    start = np.searchsorted(block[order], np.arange(blocks + 1))
    return np.ascontiguousarray(task[order], np.int64), start.astype(np.int64)


def choose_runs(count: Int, stride: Int) -> Bool:
    """Return which of the runs (m,) with (m,) counts and strides are taken unchanged."""
    if is_small(int(count.sum())):
        return np.zeros(count.shape, bool)
    straight: Bool = stride == 1
    long: Bool = straight & (count >= SHORTEST)
    few = int(count[straight & ~long].sum()) <= FEW * int(count.sum())
    return straight if few else long
