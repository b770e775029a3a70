"""From packed springs and hinges to batches of constraints that may be solved side by side.

A batch holds the elements whose vertices lie in one block, or in one and the same set of blocks; batches
without a common block get one colour. A sheet of rows has two kinds of batches, blocks and the seams
between neighbours, and three colours. What a batch holds in lists is coloured once more, so that eight
elements side by side never meet at a vertex. All of it depends on the fabric alone.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from nuno_integrators.xpbd.constraints import ListBatches, RunBatches
from nuno_kernels import kernel
from nuno_kernels.forces.hinges import HingeLists, HingeRuns
from nuno_kernels.forces.springs import SpringLists, SpringRuns
from nuno_kernels.lanes.simd import WIDTH
from nuno_kernels.step.acceleration import Packed
from nuno_kernels.step.blocks import BLOCK, Long
from nuno_kernels.step.packing import of_type
from nuno_schemas.fabric import Float

MOST_BATCHES = 4096
"""Sets of blocks that are told apart: beyond, vertices are in no order, and what crosses blocks is one batch."""

COLOURS = 62
"""Colours of elements within a batch that a vertex's mask holds; what finds none free goes alone."""


class Constraints(NamedTuple):
    """A fabric's constraints; absent kinds are None. colour (colours + 1,) bounds over the batches."""

    colour: Long
    runs: RunBatches | None
    lists: ListBatches | None
    hinges: ListBatches | None


def pack_constraints(packed: Packed, remember: bool) -> Constraints:
    """Batches of a packed system; with room for forces where sweeps are repeated."""
    task, pairs, constants = _spring_elements(packed)
    quads, bends = _hinge_elements(packed)
    homes = [elements // BLOCK for elements in (task[:, :2], pairs, quads)]
    (of_task, of_pair, of_quad), colour = find_batches(homes)
    batches = int(colour[-1])
    runs = None
    if task.shape[0]:
        (from_runs,) = of_type(packed, SpringRuns)
        order = np.argsort(of_task, kind="stable")
        padded = -(-task[order, 2] // WIDTH) * WIDTH
        column = np.cumsum(padded) - padded
        start = np.searchsorted(of_task[order], np.arange(batches + 1))
        table = np.column_stack([task[order], column]).astype(np.int64)
        kept = np.zeros((3, int(padded.sum()))) if remember else None
        runs = RunBatches(start.astype(np.int64), table, from_runs.constants, from_runs.each, kept)
    vertices = packed.inverse_mass.shape[0]
    lists = _pack_lists(pairs, constants, of_pair, batches, vertices, remember)
    hinges = _pack_lists(quads, bends, of_quad, batches, vertices, remember)
    return Constraints(colour, runs, lists, hinges)


def _places(count: Long) -> Long:
    """0, 1, .. for each of (m,) counts, one after another."""
    return np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)


def _spring_elements(packed: Packed) -> tuple[Long, Long, Float]:
    """Every spring once: tasks (m, 4) of long runs, and pairs (s, 2) with constants (3, s) of all others."""
    task, pairs, constants = np.zeros((0, 4), np.int64), [np.zeros((0, 2), np.int64)], [np.zeros((3, 0))]
    for runs in of_type(packed, SpringRuns):
        own = runs.task[(runs.task[:, 4] & 1) == 1]
        far = own[:, 1] - own[:, 0] >= WIDTH
        task, near = own[far, :4], own[~far]
        place = _places(near[:, 2])
        pairs.append(np.repeat(near[:, :2], near[:, 2], axis=0) + place[:, None])
        column = np.repeat(near[:, 3], near[:, 2]) + (place if runs.each else 0)
        constants.append(runs.constants[:, column])
    for lists in of_type(packed, SpringLists):
        at = _at_home(lists.start, lists.ends[2], packed.inverse_mass.shape[0])
        pairs.append(lists.ends[:2, at].T.astype(np.int64))
        constants.append(lists.constants[:, at])
    return task, np.concatenate(pairs), np.concatenate(constants, axis=1)


def _hinge_elements(packed: Packed) -> tuple[Long, Float]:
    """Every hinge once: corners (h, 4) and k cos(rest), k sin(rest), k (3, h)."""
    quads, constants = [np.zeros((0, 4), np.int64)], [np.zeros((2, 0))]
    for runs in of_type(packed, HingeRuns):
        own = runs.task[(runs.task[:, 6] & 1) == 1]
        place = _places(own[:, 4])
        quads.append(np.repeat(own[:, :4], own[:, 4], axis=0) + place[:, None])
        constants.append(runs.constants[:, np.repeat(own[:, 5], own[:, 4])])
    for lists in of_type(packed, HingeLists):
        at = _at_home(lists.start, lists.corners[4], packed.inverse_mass.shape[0])
        quads.append(lists.corners[:4, at].T.astype(np.int64))
        constants.append(lists.constants[:, at])
    both = np.concatenate(constants, axis=1)
    return np.concatenate(quads), np.concatenate([both, np.hypot(both[:1], both[1:])])


def _at_home(start: Long, target: Any, vertices: int) -> Long:
    """Columns of a block's copies whose first vertex the block owns: every element once, no padding."""
    block = np.repeat(np.arange(start.shape[0] - 1), np.diff(start))
    return np.flatnonzero(target < np.minimum(BLOCK, vertices - block * BLOCK))


def find_batches(homes: list[Long]) -> tuple[list[Long], Long]:
    """The batch of each element, for kinds of elements in blocks (m, w); bounds of the colours over the batches."""
    sets = np.concatenate([_distinct(home) for home in homes])
    if sets.shape[0] == 0:
        return [np.zeros(0, np.int64) for _ in homes], np.zeros(1, np.int64)
    found, group = np.unique(sets, axis=0, return_inverse=True)
    group = group.reshape(-1)
    colours = np.zeros(found.shape[0], np.int64)
    if found.shape[0] <= MOST_BATCHES:
        taken: dict[int, int] = {}
        for place, row in enumerate(found.tolist()):
            blocks = [block for block in row if block >= 0]
            used = 0
            for block in blocks:
                used |= taken.get(block, 0)
            free = ~used & (used + 1)
            colours[place] = free.bit_length() - 1
            for block in blocks:
                taken[block] = taken.get(block, 0) | free
    else:
        crossing = found[:, -2] >= 0
        first = int(np.flatnonzero(crossing)[0])
        colours[crossing] = 1
        group = np.where(crossing[group], first, group)
        colours = colours[: first + 1]
    order = np.argsort(colours, kind="stable")
    number = np.argsort(order)
    bounds = np.searchsorted(colours[order], np.arange(int(colours.max()) + 2)).astype(np.int64)
    sizes = np.cumsum([home.shape[0] for home in homes])[:-1]
    return np.split(number[group], sizes), bounds


def _distinct(home: Long) -> Long:
    """Rows of up to four distinct blocks, ascending, filled up with -1 in front."""
    rows = np.sort(home, axis=1)
    rows[:, 1:][rows[:, 1:] == rows[:, :-1]] = -1
    full = np.full((home.shape[0], 4), -1, np.int64)
    full[:, 4 - home.shape[1] :] = rows
    return np.sort(full, axis=1)


def _pack_lists(
    elements: Long, constants: Float, batch: Long, batches: int, vertices: int, remember: bool
) -> ListBatches | None:
    """Elements (s, w) in whole vectors of one colour each; those added are the vector's first vertex, w times."""
    if elements.shape[0] == 0:
        return None
    order = np.lexsort((elements.min(axis=1), batch))
    elements, constants, batch = np.ascontiguousarray(elements[order]), constants[:, order], batch[order]
    colour = np.empty(elements.shape[0], np.int64)
    colour_elements(elements, batch, np.zeros(vertices, np.int64), np.full(vertices, -1, np.int64), colour)
    order = np.lexsort((colour, batch))
    batch, colour = batch[order], colour[order]
    first = np.flatnonzero(np.concatenate([[True], (np.diff(batch) != 0) | (np.diff(colour) != 0)]))
    length = np.diff(np.concatenate([first, [order.shape[0]]]))
    padded = -(-length // WIDTH) * WIDTH
    begin = np.cumsum(padded) - padded
    source = np.full(int(padded.sum()), -1, np.int64)
    source[np.arange(order.shape[0]) - np.repeat(first, length) + np.repeat(begin, length)] = order
    filled = source >= 0
    anchor = np.repeat(elements[order[first], 0], padded)
    ends = np.where(filled, elements[source].T, anchor).astype(np.int32)
    values = np.where(filled, constants[:, source], 0.0)
    bounds = np.concatenate([begin, [source.shape[0]]])
    start = bounds[np.searchsorted(batch[first], np.arange(batches + 1))]
    kept = np.zeros((3 * (elements.shape[1] - 1), source.shape[0])) if remember else None
    return ListBatches(start.astype(np.int64), np.ascontiguousarray(ends), np.ascontiguousarray(values), kept)


@kernel
def colour_elements(elements: Any, batch: Any, taken: Any, seen: Any, colour: Any) -> None:
    """The least colour that no element before it in its batch has at any of its vertices, into colour (s,).

    taken and seen (n,) are scratch: colours at a vertex as bits, and the batch that these are of.
    """
    alone = COLOURS
    for e in range(elements.shape[0]):
        used = np.int64(0)
        for c in range(elements.shape[1]):
            v = elements[e, c]
            if seen[v] != batch[e]:
                seen[v], taken[v] = batch[e], 0
            used |= taken[v]
        own = 0
        while own < COLOURS and (used >> own) & 1:
            own += 1
        if own == COLOURS:
            colour[e] = alone
            alone += 1
            continue
        colour[e] = own
        for c in range(elements.shape[1]):
            taken[elements[e, c]] |= np.int64(1) << own
