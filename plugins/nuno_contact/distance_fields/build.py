"""A sampled distance field of a triangle mesh, adaptive and within a tolerance (the wrinkle paper's distance function).

Cells are cut into eight until the trilinear interpolation of the distance between their corners is near enough to
the exact distance (S. F. Frisken, R. N. Perry, A. P. Rockwood, T. R. Jones: Adaptively sampled distance fields,
SIGGRAPH 2000). With d the distance of a point the error that is allowed there is

    tolerance max(1, d / band),

and a cell is left whole if the largest error in its lattice (nuno_contact.distance_fields.cells) is at most half of
that which is allowed at its nearest, and its gradient at the surface does not turn away, as that of a cell does which
reaches across a plate; or if its size alone keeps the error there: distance changes by no more than one goes, so that
no point of a cell of edge h is off by more than sqrt(3)/2 h.

Corners of a small cell on the face of a larger one take the larger one's interpolated values, from large to
small (`join_leaves`): the field is continuous, and so is its gradient. That shifts small cells by up to their larger
neighbour's error. Where a cell is then off by more than SHARE_AFTER of what is allowed, in its lattice or at a vertex
of the mesh, it is cut again, or the larger one if that is to blame, until none is.

Not chosen: bricks of 8^3 cells of one size, which a crease that passes through fills with cells that it does not need;
a polynomial in each cell (D. Koschier et al. 2016), which a crease takes most of the use of.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numba
import numpy as np
from numba import prange
from numpy.typing import NDArray

from nuno_contact.distance_fields.cells import LATTICE, Exact, measure_errors
from nuno_contact.distance_fields.sample import Fields, blend, find_leaf, join_fields
from nuno_geometry.tree import build_tree
from nuno_kernels import kernel, parallel_kernel, threads_available
from nuno_kernels.step.blocks import Long
from nuno_schemas.bodies import DistanceField
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int

# Leaves of a distance field beside larger ones: continuity across their common faces, and its error.

BLOCK = 256


class Grid(NamedTuple):
    """The l leaves of one field among its cells."""

    at: Long
    """(l, 3) place of each, in units of its size"""
    level: Long
    """(l,) how often a whole cell was halved"""
    deepest: int
    """The greatest level."""
    shape: Int
    """(3,) whole cells along x, y, z"""
    child: Int
    corners: NDArray[np.float32]
    """`child` and `corners` are as in DistanceField."""


@kernel
def leaf_at(i: int, j: int, k: int, grid: Grid) -> tuple[int, int]:
    """Return (leaf, its level) of the cell i, j, k of the deepest level; -1 outside of the box."""
    shape, child, deepest = grid.shape, grid.child, grid.deepest
    if min(i, j, k) < 0 or i >> deepest >= shape[0] or j >> deepest >= shape[1] or k >> deepest >= shape[2]:
        return -1, 0
    at = child[((i >> deepest) * shape[1] + (j >> deepest)) * shape[2] + (k >> deepest)]
    level = 0
    while at >= 0:
        level += 1
        down = deepest - level
        at = child[at + 4 * (i >> down & 1) + 2 * (j >> down & 1) + (k >> down & 1)]
    return -1 - at, level


@kernel
def corner_at(leaf: int | np.int64, c: int, grid: Grid) -> tuple[int, int, int]:
    """Return corner c of a leaf, in cells of the deepest level."""
    at, down = grid.at[leaf], grid.deepest - grid.level[leaf]
    return (at[0] + c // 4) << down, (at[1] + c // 2 % 2) << down, (at[2] + c % 2) << down


@kernel
def largest_round(corner: tuple[int, int, int], own: int, grid: Grid) -> tuple[int, int]:
    """Return (leaf, its level) of the largest leaf whose face or edge a corner of a leaf of level `level` lies on,
    without being its corner; -1 if there is none.
    """
    x, y, z = corner
    found, least = -1, own
    for turn in range(8):
        leaf, level = leaf_at(x - turn // 4, y - turn // 2 % 2, z - turn % 2, grid)
        if leaf >= 0 and level < least and (x | y | z) & ((1 << (grid.deepest - level)) - 1):
            found, least = leaf, level
    return found, least


@kernel
def join_leaf(leaf: int, grid: Grid) -> None:
    """Set a leaf's corners that lie on larger leaves to those leaves' values."""
    for c in range(8):
        corner = corner_at(leaf, c, grid)
        larger, level = largest_round(corner, grid.level[leaf], grid)
        if larger < 0:
            continue
        edge, at = 1 << (grid.deepest - level), grid.at[larger]
        u, v, w = corner[0] / edge - at[0], corner[1] / edge - at[1], corner[2] / edge - at[2]
        for part in range(4):
            grid.corners[leaf, 4 * c + part] = blend(grid.corners, np.uint64(larger), np.uint64(part), u, v, w)


@parallel_kernel
def join_leaves(grid: Grid) -> None:
    """Join all leaves, from large to small: a leaf's source is done before it."""
    for own in range(1, grid.deepest + 1):
        for block in prange((grid.at.shape[0] + BLOCK - 1) // BLOCK):
            for leaf in range(block * BLOCK, min((block + 1) * BLOCK, grid.at.shape[0])):
                if grid.level[leaf] == own:
                    join_leaf(leaf, grid)


@kernel
def to_blame(leaf: int | np.int64, tests: NDArray[np.float32], allowed: float, grid: Grid) -> int:
    """Return the leaf to cut if `leaf` is inaccurate: the largest neighbour at the corner with the largest error above
    `allowed`, or `leaf` itself if there is none.
    """
    worst, which = allowed, int(leaf)
    for c in range(8):
        off = abs(grid.corners[leaf, 4 * c] - tests[leaf, 18 * (c // 4) + 6 * (c // 2 % 2) + 2 * (c % 2)])
        if off > worst:
            worst, which = off, largest_round(corner_at(leaf, c, grid), grid.level[leaf], grid)[0]
    return which


@kernel
def check_places(
    tests: NDArray[np.float32], allowed: Float, x: Float, at_vertices: float, grid: Grid, field: Fields, bad: Bool
) -> None:
    """Mark in bad (l,) the leaves to cut because some are off by more than allowed (l,) from tests (l, 27) in their
    lattices, or by more than `at_vertices` from 0 at places x (n, 3).
    """
    corners = grid.corners
    for leaf in range(tests.shape[0]):
        off = 0.0
        for p in range(27):
            value = blend(corners, np.uint64(leaf), np.uint64(0), 0.5 * (p // 9), 0.5 * (p // 3 % 3), 0.5 * (p % 3))
            off = max(off, abs(value - tests[leaf, p]))
        if off > allowed[leaf]:
            bad[to_blame(leaf, tests, 0.667 * allowed[leaf], grid)] = True
    for i in range(x.shape[0]):
        place, u, v, w, _ = find_leaf(x[i, 0], x[i, 1], x[i, 2], 0, field)
        if abs(blend(corners, place, np.uint64(0), u, v, w)) > at_vertices:
            bad[to_blame(np.int64(place), tests, 0.667 * at_vertices, grid)] = True


# Cells of an unfinished distance field, cut into eight until they are accurate.

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
            level = np.full(int(whole.sum()), piece.level, np.int64)
            own = piece.at[whole], piece.slot[whole], piece.near[whole], piece.corners[whole]
            done.append(Leaves(level, *own, lattice[whole, :, 0]))
            parts.append(self.cut(piece, lattice, ~whole))
            self.leaves += int(whole.sum())
            if self.leaves > self.most:
                raise too_large(self.leaves, self.most, self.tolerance)
        names = ("at", "slot", "near", "corners")
        joined = (np.concatenate([getattr(part, name) for part in parts]) for name in names)
        return done, Cells(cells.level + 1, *joined)

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


def are_torn(lattice: Single, size: Any) -> NDArray[np.bool_]:
    """Return whether distances in lattices (m, 27) of cells of edge `size` [m] differ by more than their points'
    distances do: across a hole whose two sides are equally near.
    """
    values = lattice.reshape(-1, 3, 3, 3)
    steps = [np.abs(np.diff(values, axis=axis)).reshape(len(values), -1).max(axis=1) for axis in (1, 2, 3)]
    return np.asarray(np.max(steps, axis=0) > 1.05 * 0.5 * size)


SHARE_AFTER = 0.75
"""share of the allowed error that a cell may have beside larger ones"""
WHOLE = 16
"""whole cells along the longest side of the box, about"""
PROBE, EACH = 4096, 15
"""from so many cells to cut, each so-manieth is cut first, to predict the field's size"""
ROUNDS = 12
"""times that cells are cut again beside larger ones"""


def build_field(
    x: Float, faces: Int, tolerance: float, band: float | None = None, closed: bool = True,
    most_bytes: int = 1 << 30, threads: int | None = None,
) -> DistanceField:  # fmt: skip
    """Build the field of a mesh of vertices (n, 3) [m] and triangles (f, 3), counter-clockwise seen from outside.

    `tolerance` [m] holds within `band` [m], five times as much unless given. A mesh that is not `closed` gets its signs
    from the winding number. `threads` are all that there are unless given; the same bits with any. Raises BadInput for
    a field of more than `most_bytes`, predicted from a part of it.
    """
    available = threads_available()[0]
    numba.set_num_threads(max(1, min(threads or available, available)))
    band = band or 5.0 * tolerance
    low, high = x.min(axis=0) - band, x.max(axis=0) + band
    size = float((high - low).max()) / WHOLE
    shape = np.maximum(1, np.ceil((high - low) / size - 1e-9)).astype(np.int32)
    low = 0.5 * (low + high) - 0.5 * size * shape
    exact = Exact(build_tree(x, faces), closed)
    builder = Builder(exact, low, size, shape, tolerance, band, most_bytes // BYTES_PER_LEAF)
    done: list[Leaves] = []
    cells = whole_cells(builder)
    while 0 < len(cells.at) < PROBE:
        found, cells = builder.step(cells)
        done += found
    foresee(builder, cells)
    leaves = Leaves.of(done + builder.refine(cells))
    for _ in range(ROUNDS):
        made = builder.lay_out(leaves)
        bad = find_bad(builder, leaves, made, x)
        if not bad.any():
            break
        builder.leaves -= int(bad.sum())
        parts = [leaves.pick(~bad)]
        for level in np.unique(leaves.level[bad]).tolist():
            own = leaves.pick(bad & (leaves.level == level))
            cells = Cells(level, own.at, own.slot, own.near, own.corners)
            lattice, _ = builder.examine(cells)
            parts += builder.refine(builder.cut(cells, lattice, np.ones(len(own.at), np.bool_)))
        leaves = Leaves.of(parts)
    return made


def foresee(builder: Builder, cells: Cells) -> None:
    """Raise BadInput if the cells would be too many, as a sample cut to its leaves predicts."""
    left = builder.most - builder.leaves
    probe = replace(builder, child=[], leaves=0, most=left // EACH)
    try:
        probe.refine(cells.pick(slice(None, None, EACH)))
    except BadInput:
        raise too_large(builder.leaves + EACH * probe.leaves, builder.most, builder.tolerance) from None


def whole_cells(builder: Builder) -> Cells:
    """Return the cells that a field begins with."""
    nx, ny, nz = builder.shape.tolist()
    number = np.arange(nx * ny * nz, dtype=np.int64)
    at = np.stack([number // (ny * nz), number // nz % ny, number % nz], axis=1)
    points = builder.low + builder.size * (at[:, None] + CODES).reshape(-1, 3)
    corners = builder.exact.measure(points).astype(np.float32).reshape(-1, 8, 4)
    builder.cells = len(number)
    return Cells(0, at, number, np.zeros(len(number), np.int64), corners)


def find_bad(builder: Builder, leaves: Leaves, made: DistanceField, x: Float) -> NDArray[np.bool_]:
    """Return the leaves (l,) to cut, because they or smaller ones beside them are off by more than SHARE_AFTER of what
    is allowed, in their lattices or at the mesh's vertices, where the distance is 0.
    """
    size = builder.size / 2.0**leaves.level
    least = np.abs(leaves.tests).min(axis=1)
    allowed = SHARE_AFTER * builder.allowed(np.maximum(0.0, least - 0.433013 * size))
    bad = np.zeros(len(allowed), np.bool_)
    check_places(
        leaves.tests, allowed, x, SHARE_AFTER * builder.tolerance, grid_of(leaves, made), join_fields([made]), bad
    )
    if not builder.exact.closed:
        bad &= ~are_torn(leaves.tests, size)
    return bad & (leaves.level < DEEPEST) & (0.866026 * size > 0.5 * SHARE * builder.tolerance)
