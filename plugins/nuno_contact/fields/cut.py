"""Cells of an unfinished distance field (nuno_contact.fields.build), cut into eight until they are accurate."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_contact.fields.cells import LATTICE, measure_errors
from nuno_contact.fields.exact import Exact
from nuno_contact.fields.join import Grid, join_leaves
from nuno_kernels.step.blocks import Long
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.field import DistanceField

Single = NDArray[np.float32]

SHARE = 0.5
"""share of the allowed error in a cell's lattice up to which it is not cut"""
ALONG = 0.3
"""least cosine between interpolated and exact gradient at the surface"""
DEEPEST = 15
"""most halvings of a whole cell: places in a lattice then have 21 bits"""
TORN = 2.0
"""Cells across which the distance jumps, in a hole of the mesh, are no smaller than half of so many tolerances."""
PIECE = 1 << 15
"""cells examined together"""
BYTES_PER_LEAF = 128 + 5
"""a leaf, and its part of the cells above it"""

CORNER = np.array([18 * a + 6 * b + 2 * c for a in (0, 1) for b in (0, 1) for c in (0, 1)])
"""The corners of a cell in its lattice."""
PART = np.array([[9 * a + 3 * b + c for a in (0, 1) for b in (0, 1) for c in (0, 1)]])
CHILDREN = np.array([9 * a + 3 * b + c for a in (0, 1) for b in (0, 1) for c in (0, 1)])[:, None] + PART
"""(8, 8) the corners of a cell's eight parts in its lattice."""
BETWEEN = np.setdiff1d(np.arange(27), CORNER)
"""The lattice's other points, and the number of the middle among them."""
MIDDLE = int(np.flatnonzero(BETWEEN == 13)[0])
BETWEEN_AT = np.stack([BETWEEN // 9, BETWEEN // 3 % 3, BETWEEN % 3], axis=1)
CODES = np.array([[a, b, c] for a in (0, 1) for b in (0, 1) for c in (0, 1)], np.int64)


@dataclass
class Cells:
    """m cells of one level: at (m, 3) in units of their size, slot (m,) in `child`, near (m,) the place of a triangle,
    corners (m, 8, 4) distance and gradient.
    """

    level: int
    at: Long
    slot: Long
    near: Long
    corners: Single

    def pick(self, chosen: Any) -> Cells:
        return Cells(self.level, self.at[chosen], self.slot[chosen], self.near[chosen], self.corners[chosen])


@dataclass
class Leaves:
    """Leaves of an unfinished field: see Cells; tests (l, 27) exact distances in their lattices."""

    level: Long
    at: Long
    slot: Long
    near: Long
    corners: Single
    tests: Single

    @staticmethod
    def of(parts: list[Leaves]) -> Leaves:
        return Leaves(*(np.concatenate([getattr(part, name) for part in parts]) for name in Leaves.__annotations__))

    def pick(self, chosen: Any) -> Leaves:
        return Leaves(*(getattr(self, name)[chosen] for name in Leaves.__annotations__))


@dataclass
class Builder:
    """An unfinished field."""

    exact: Exact
    low: Float
    size: float
    shape: Int
    tolerance: float
    band: float
    most: int
    """most leaves"""
    child: list[Long] = field(default_factory=list)
    cells: int = 0
    """number of cells so far, of any level: the final length of `child`"""
    leaves: int = 0

    def allowed(self, distance: Any) -> Any:
        """Return the error allowed at a distance [m]."""
        return self.tolerance * np.maximum(1.0, distance / self.band)

    def examine(self, cells: Cells) -> tuple[Single, Float]:
        """Return lattices (m, 27, 4), and their `measure_errors` (m, 3). Shared points are measured once."""
        lattice = np.empty((len(cells.at), LATTICE, 4), np.float32)
        lattice[:, CORNER] = cells.corners
        places = (2 * cells.at[:, None] + BETWEEN_AT).reshape(-1, 3)
        _, first, number = np.unique(
            (places[:, 0] << 42) | (places[:, 1] << 21) | places[:, 2], return_index=True, return_inverse=True
        )
        near = cells.near[first // len(BETWEEN)]
        points = self.low + 0.5 * self.size / 2**cells.level * places[first]
        lattice[:, BETWEEN] = self.exact.measure(points, near)[number.reshape(-1)].reshape(len(cells.at), -1, 4)
        cells.near[:] = near[number.reshape(len(cells.at), -1)[:, MIDDLE]]
        errors = np.empty((len(cells.at), 3))
        measure_errors(lattice, self.size / 2**cells.level, self.tolerance, errors)
        return lattice, errors

    def refine(self, cells: Cells) -> list[Leaves]:
        """Cut cells and their parts until all are leaves, level by level; return the leaves."""
        done: list[Leaves] = []
        while len(cells.at):
            leaves_of_level, cells = self.step(cells)
            done += leaves_of_level
        return done

    def step(self, cells: Cells) -> tuple[list[Leaves], Cells]:
        """Return the leaves among the cells of a level, and the parts of the others."""
        done, parts = [], []
        size = self.size / 2**cells.level
        for first in range(0, len(cells.at), PIECE):
            piece = cells.pick(slice(first, first + PIECE))
            lattice, errors = self.examine(piece)
            # Every point of a cell is within sqrt(3)/4 of its edge from a point of the lattice.
            allowed = self.allowed(np.maximum(0.0, errors[:, 1] - 0.433013 * size))
            whole = (errors[:, 0] <= SHARE * allowed) & (errors[:, 2] >= ALONG)
            whole |= 0.866026 * size <= SHARE * allowed
            whole |= cells.level >= DEEPEST
            if not self.exact.closed:
                whole |= are_torn(lattice[:, :, 0], size) & (size <= TORN * self.tolerance)
            done.append(_leaves(piece, lattice, whole))
            parts.append(self.cut(piece, lattice, ~whole))
            self.leaves += int(whole.sum())
            if self.leaves > self.most:
                raise too_large(self.leaves, self.most, self.tolerance)
        return done, _join(parts)

    def cut(self, cells: Cells, lattice: Single, chosen: Any) -> Cells:
        """Return the eight parts of the chosen cells."""
        at, slot, near = cells.at[chosen], cells.slot[chosen], cells.near[chosen]
        first = self.cells + 8 * np.arange(len(at), dtype=np.int64)
        self.cells += 8 * len(at)
        self.child.append(np.stack([slot, first], axis=1))
        return Cells(
            cells.level + 1,
            (2 * at[:, None] + CODES).reshape(-1, 3),
            (first[:, None] + np.arange(8)).reshape(-1),
            np.repeat(near, 8),
            lattice[chosen][:, CHILDREN].reshape(-1, 8, 4),
        )

    def lay_out(self, leaves: Leaves) -> DistanceField:
        """Return the field of these leaves, corners joined."""
        child = np.zeros(self.cells, np.int64)
        for links in self.child:
            child[links[:, 0]] = links[:, 1]
        child[leaves.slot] = -1 - np.arange(len(leaves.slot))
        corners = leaves.corners.reshape(-1, 32).copy()
        made = DistanceField(
            self.low, self.size, self.shape, self.tolerance, self.band, child.astype(np.int32), corners
        )
        join_leaves(grid_of(leaves, made))
        return made


def grid_of(leaves: Leaves, made: DistanceField) -> Grid:
    """Return the leaves among the cells of the field that they were made into."""
    return Grid(leaves.at, leaves.level, int(leaves.level.max()), made.shape, made.child, made.corners)


def too_large(leaves: int, most: int, tolerance: float) -> BadInput:
    """Return the error for a field that takes too much memory."""
    return BadInput(
        "the distance field is too large", field="tolerance", value=f"{tolerance:g} m, which takes at least "
        f"{leaves * BYTES_PER_LEAF / 2**20:,.0f} MiB", limit=f"{most * BYTES_PER_LEAF / 2**20:,.0f} MiB",
        remedy="raise the tolerance",
    )  # fmt: skip


def _leaves(cells: Cells, lattice: Single, chosen: Any) -> Leaves:
    return Leaves(
        np.full(int(chosen.sum()), cells.level, np.int64), cells.at[chosen], cells.slot[chosen], cells.near[chosen],
        cells.corners[chosen], lattice[chosen, :, 0],
    )  # fmt: skip


def _join(parts: list[Cells]) -> Cells:
    names = ("at", "slot", "near", "corners")
    return Cells(parts[0].level, *(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def are_torn(lattice: Single, size: Any) -> NDArray[np.bool_]:
    """Return whether distances in lattices (m, 27) of cells of edge `size` [m] differ by more than their points'
    distances do: across a hole whose two sides are equally near.
    """
    values = lattice.reshape(-1, 3, 3, 3)
    steps = [np.abs(np.diff(values, axis=axis)).reshape(len(values), -1).max(axis=1) for axis in (1, 2, 3)]
    return np.asarray(np.max(steps, axis=0) > 1.05 * 0.5 * size)
