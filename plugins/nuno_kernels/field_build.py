"""A sampled distance field of a triangle mesh, adaptive and within a tolerance (the wrinkle paper's distance function).

Cells are cut into eight until the trilinear interpolation of the distance between their corners is near enough to
the exact distance (S. F. Frisken, R. N. Perry, A. P. Rockwood, T. R. Jones: Adaptively sampled distance fields,
SIGGRAPH 2000). With d the distance of a point the error that is allowed there is

    tolerance max(1, d / band),

and a cell is left whole if the largest error in its lattice (nuno_kernels.field_cells) is at most half of that which
is allowed at its nearest, and its gradient at the surface does not turn away, as that of a cell does which reaches
across a plate; or if its size alone keeps the error there: distance changes by no more than one goes, so that no
point of a cell of edge h is off by more than sqrt(3)/2 h.

Corners of a small cell on the face of a larger one take the larger one's interpolated values, from large to
small (`join_leaves`): the field is continuous, and so is its gradient. That shifts small cells by up to their larger
neighbour's error. Where a cell is then off by more than SHARE_AFTER of what is allowed, in its lattice or at a vertex
of the mesh, it is cut again, or the larger one if that is to blame, until none is.

Not chosen: bricks of 8^3 cells of one size, which a crease that passes through fills with cells that it does not need;
a polynomial in each cell (D. Koschier et al. 2016), which a crease takes most of the use of.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from nuno_kernels import threads_available
from nuno_kernels.field_cells import LATTICE, measure_errors, measure_points
from nuno_kernels.field_join import check_places, join_leaves
from nuno_kernels.field_winding import make_dipoles
from nuno_kernels.surface_tree import Tree, build_tree
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.field import DistanceField

Long = NDArray[np.int64]
Single = NDArray[np.float32]

SHARE = 0.5
"""Of what is allowed, the error in a cell's lattice up to which it is left whole ..."""
SHARE_AFTER = 0.75
"""... and that which it may have beside larger cells."""
WHOLE = 16
"""Whole cells along the longest side of the box, about."""
PROBE, EACH = 4096, 15
"""As soon as there are so many cells to cut, every so many of them are, to foresee how large the field will be."""
ALONG = 0.3
"""Least cosine between interpolated and exact gradient at the surface."""
ROUNDS = 12
"""Times that cells are cut again beside larger ones."""
DEEPEST = 15
"""Halvings of a whole cell at most: places in a lattice then have 21 bits."""
TORN = 2.0
"""Cells across which the distance jumps, in the hole of a mesh, are no smaller than half of so many tolerances."""
PIECE = 1 << 15
"""Cells examined together."""
BYTES_PER_LEAF = 128 + 5
"""A leaf, and its part of the cells above it."""

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


class Exact:
    """A mesh's exact signed distance, for the build and to check a field by."""

    def __init__(self, tree: Tree, closed: bool) -> None:
        """Signs of a mesh that is not `closed` are the winding number's."""
        self.tree, self.closed = tree, closed
        dipoles: tuple[Any, Any] = (None, None) if closed else make_dipoles(tree)
        self.arrays = (
            tree.boxes, tree.child, tree.corners, tree.face, tree.faces, tree.edges, tree.vertex_normals,
            tree.edge_normals, *dipoles,
        )  # fmt: skip

    def measure(self, points: Float, near: Long | None = None) -> Float:
        """(n, 4) distance [m] and gradient at points (n, 3)."""
        points = np.ascontiguousarray(points, np.float64)
        out = np.empty((len(points), 4))
        measure_points(points, np.zeros(len(points), np.int64) if near is None else near, *self.arrays, out)
        return out


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
    """What is kept of leaves until the field is done: see Cells; tests (l, 27) exact distances in their lattices."""

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
    """A field in the making."""

    exact: Exact
    low: Float
    size: float
    shape: Int
    tolerance: float
    band: float
    most: int
    """Leaves at most."""
    child: list[Long] = field(default_factory=list)
    cells: int = 0
    """Cells so far, of any level: the length of `child` when it is done."""
    leaves: int = 0

    def allowed(self, distance: Any) -> Any:
        """Error allowed at a distance [m]."""
        return self.tolerance * np.maximum(1.0, distance / self.band)

    def examine(self, cells: Cells) -> tuple[Single, Float]:
        """Lattices (m, 27, 4), and what `measure_errors` finds (m, 3). Points that cells share are measured once."""
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
        found = np.empty((len(cells.at), 3))
        measure_errors(lattice, self.size / 2**cells.level, self.tolerance, found)
        return lattice, found

    def refine(self, cells: Cells) -> list[Leaves]:
        """Cut cells and their parts until all are leaves, level by level."""
        done: list[Leaves] = []
        while len(cells.at):
            found, cells = self.step(cells)
            done += found
        return done

    def step(self, cells: Cells) -> tuple[list[Leaves], Cells]:
        """Cells of a level that are leaves, and the parts of the others."""
        done, parts = [], []
        size = self.size / 2**cells.level
        for first in range(0, len(cells.at), PIECE):
            piece = cells.pick(slice(first, first + PIECE))
            lattice, found = self.examine(piece)
            # Every point of a cell is within sqrt(3)/4 of its edge from a point of the lattice.
            allowed = self.allowed(np.maximum(0.0, found[:, 1] - 0.433013 * size))
            whole = (found[:, 0] <= SHARE * allowed) & (found[:, 2] >= ALONG)
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
        """The eight parts of the chosen cells."""
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
        """The field of these leaves, corners joined."""
        child = np.zeros(self.cells, np.int64)
        for links in self.child:
            child[links[:, 0]] = links[:, 1]
        child[leaves.slot] = -1 - np.arange(len(leaves.slot))
        corners = leaves.corners.reshape(-1, 32).copy()
        made = DistanceField(
            self.low, self.size, self.shape, self.tolerance, self.band, child.astype(np.int32), corners
        )
        join_leaves(leaves.at, leaves.level, int(leaves.level.max()), self.shape, made.child, corners)
        return made


def too_large(leaves: int, most: int, tolerance: float) -> BadInput:
    """The error of a field that takes too much memory."""
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


def build_field(
    x: Float, faces: Int, tolerance: float, band: float | None = None, closed: bool = True,
    most_bytes: int = 1 << 30, threads: int | None = None,
) -> DistanceField:  # fmt: skip
    """The field of a mesh of vertices (n, 3) [m] and triangles (f, 3), counter-clockwise seen from outside.

    `tolerance` [m] holds within `band` [m], five times as much unless given. A mesh that is not `closed` gets its signs
    from the winding number. `threads` are all that there are unless given; the same bits with any.
    Raises BadInput for a field of more than `most_bytes`, once a part of it tells how large it will be.
    """
    available = threads_available()[0]
    numba.set_num_threads(max(1, min(threads or available, available)))
    exact = Exact(build_tree(x, faces), closed)
    builder = start_builder(exact, x, tolerance, band or 5.0 * tolerance, most_bytes // BYTES_PER_LEAF)
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
    """Raises BadInput where the cells, of which every few are cut to their leaves, would be too many."""
    left = builder.most - builder.leaves
    probe = replace(builder, child=[], leaves=0, most=left // EACH)
    try:
        probe.refine(cells.pick(slice(None, None, EACH)))
    except BadInput:
        raise too_large(builder.leaves + EACH * probe.leaves, builder.most, builder.tolerance) from None


def start_builder(exact: Exact, x: Float, tolerance: float, band: float, most: int) -> Builder:
    """A box of whole cells round the mesh and the band about it."""
    low, high = x.min(axis=0) - band, x.max(axis=0) + band
    size = float((high - low).max()) / WHOLE
    shape = np.maximum(1, np.ceil((high - low) / size - 1e-9)).astype(np.int32)
    low = 0.5 * (low + high) - 0.5 * size * shape
    return Builder(exact, low, size, shape, tolerance, band, most)


def whole_cells(builder: Builder) -> Cells:
    """The cells that a field begins with."""
    nx, ny, nz = builder.shape.tolist()
    number = np.arange(nx * ny * nz, dtype=np.int64)
    at = np.stack([number // (ny * nz), number // nz % ny, number % nz], axis=1)
    points = builder.low + builder.size * (at[:, None] + CODES).reshape(-1, 3)
    corners = builder.exact.measure(points).astype(np.float32).reshape(-1, 8, 4)
    builder.cells = len(number)
    return Cells(0, at, number, np.zeros(len(number), np.int64), corners)


def are_torn(lattice: Single, size: Any) -> NDArray[np.bool_]:
    """(m,) whether distances in lattices (m, 27) of cells of edge `size` [m] differ by more than their places do: they
    do where a hole is between them, on both sides of which the surface is as far away.
    """
    values = lattice.reshape(-1, 3, 3, 3)
    steps = [np.abs(np.diff(values, axis=axis)).reshape(len(values), -1).max(axis=1) for axis in (1, 2, 3)]
    return np.asarray(np.max(steps, axis=0) > 1.05 * 0.5 * size)


def find_bad(builder: Builder, leaves: Leaves, made: DistanceField, x: Float) -> NDArray[np.bool_]:
    """(l,) leaves to cut, because they or smaller ones beside them are off by more than SHARE_AFTER of what is
    allowed, in their lattices or at the mesh's vertices, where the distance is 0.
    """
    size = builder.size / 2.0**leaves.level
    least = np.abs(leaves.tests).min(axis=1)
    allowed = SHARE_AFTER * builder.allowed(np.maximum(0.0, least - 0.433013 * size))
    bad = np.zeros(len(allowed), np.bool_)
    head = np.array([[*made.low, 1.0 / made.size, *made.shape, 0.0]])
    check_places(
        leaves.tests, allowed, x, SHARE_AFTER * builder.tolerance, leaves.at, leaves.level, int(leaves.level.max()),
        made.shape, head, made.child, made.corners, bad,
    )  # fmt: skip
    if not builder.exact.closed:
        bad &= ~are_torn(leaves.tests, size)
    return bad & (leaves.level < DEEPEST) & (0.866026 * size > 0.5 * SHARE * builder.tolerance)
