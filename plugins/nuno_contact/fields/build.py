"""A sampled distance field of a triangle mesh, adaptive and within a tolerance (the wrinkle paper's distance function).

Cells are cut into eight until the trilinear interpolation of the distance between their corners is near enough to
the exact distance (S. F. Frisken, R. N. Perry, A. P. Rockwood, T. R. Jones: Adaptively sampled distance fields,
SIGGRAPH 2000). With d the distance of a point the error that is allowed there is

    tolerance max(1, d / band),

and a cell is left whole if the largest error in its lattice (nuno_contact.fields.cells) is at most half of that which
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

from dataclasses import replace

import numba
import numpy as np
from numpy.typing import NDArray

from nuno_contact.fields.cut import (
    BYTES_PER_LEAF,
    CODES,
    DEEPEST,
    SHARE,
    Builder,
    Cells,
    Leaves,
    are_torn,
    grid_of,
    too_large,
)  # fmt: skip
from nuno_contact.fields.exact import Exact
from nuno_contact.fields.join import check_places
from nuno_contact.fields.sample import join_fields
from nuno_geometry.tree import build_tree
from nuno_kernels import threads_available
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.field import DistanceField

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
    """Raise BadInput if the cells would be too many, as a sample cut to its leaves predicts."""
    left = builder.most - builder.leaves
    probe = replace(builder, child=[], leaves=0, most=left // EACH)
    try:
        probe.refine(cells.pick(slice(None, None, EACH)))
    except BadInput:
        raise too_large(builder.leaves + EACH * probe.leaves, builder.most, builder.tolerance) from None


def start_builder(exact: Exact, x: Float, tolerance: float, band: float, most: int) -> Builder:
    """Return a box of whole cells round the mesh and the band about it."""
    low, high = x.min(axis=0) - band, x.max(axis=0) + band
    size = float((high - low).max()) / WHOLE
    shape = np.maximum(1, np.ceil((high - low) / size - 1e-9)).astype(np.int32)
    low = 0.5 * (low + high) - 0.5 * size * shape
    return Builder(exact, low, size, shape, tolerance, band, most)


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
