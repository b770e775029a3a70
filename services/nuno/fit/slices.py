"""Slices of a mesh by level planes, for girths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError

from nuno_schemas.fabric import Bool, Float, Int


@dataclass(frozen=True)
class Slice:
    """The cut of a mesh by a level plane: m segments, one for each cut triangle, counter-clockwise around the inside
    seen from above.

    face    (m,) triangle of each segment
    shares  (m, 2, 3) weights of the triangle's corners in each end
    ends    (m, 2, 2) z and x of both ends [m]
    piece   (m,) connected curve of each segment
    """

    face: Int
    shares: Float
    ends: Float
    piece: Int

    def curves(self) -> list[Slice]:
        """Return each connected curve as a slice."""
        return [self._of(self.piece == i) for i in range(int(self.piece.max(initial=-1)) + 1)]

    def _of(self, which: Bool) -> Slice:
        return Slice(self.face[which], self.shares[which], self.ends[which], self.piece[which])

    def length(self) -> float:
        """Return the length of all segments [m]."""
        return float(np.linalg.norm(self.ends[:, 1] - self.ends[:, 0], axis=1).sum())

    def turns(self, centre: Float) -> float:
        """Return the winding number of the curve around a point (z, x), counter-clockwise seen from above."""
        return turns(*(self.ends - centre).transpose(1, 0, 2))

    def hull(self) -> tuple[float, float, Float]:
        """Return the girth of the convex hull, as by a tape over hollows [m], its area [m^2] and centre (z, x)."""
        try:
            hull = ConvexHull(self.ends.reshape(-1, 2))
        except (QhullError, ValueError):
            return 0.0, 0.0, self.ends.reshape(-1, 2).mean(axis=0)
        # For plane figures, Qhull's `area` is the perimeter, and `volume` the area.
        return float(hull.area), float(hull.volume), hull.points[hull.vertices].mean(axis=0)


def turns(start: Float, end: Float) -> float:
    """Return the winding number of segments from `start` (m, 2) to `end` (m, 2) around the origin."""
    angle = np.arctan2(start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0], (start * end).sum(axis=1))
    return float(angle.sum() / (2.0 * np.pi))


def cut(x: Float, faces: Int, height: float) -> Slice:
    """Cut a mesh x (n, 3) [m], faces (f, 3), with y up, at a height [m]; a vertex at that height counts as above."""
    above = x[:, 1] >= height
    over = above[faces]
    crossed = np.flatnonzero((over.sum(axis=1) % 3) != 0)
    over = over[crossed]
    # The single corner on one side of the plane, and the triangle's sides from it.
    lone = np.argmax(over == (over.sum(axis=1) == 1)[:, None], axis=1)
    rows = np.arange(len(crossed))
    shares, keys = np.zeros((len(crossed), 2, 3)), np.zeros((len(crossed), 2), np.int64)
    for end in range(2):
        other = (lone + 1 + end) % 3
        p, q = faces[crossed, lone], faces[crossed, other]
        part = (height - x[p, 1]) / (x[q, 1] - x[p, 1])
        shares[rows, end, lone], shares[rows, end, other] = 1.0 - part, part
        keys[:, end] = np.minimum(p, q).astype(np.int64) * len(x) + np.maximum(p, q)
    # A triangle with its lone corner above has its outside on the right of the segment to the second side.
    flipped = ~over[rows, lone]
    shares[flipped], keys[flipped] = shares[flipped][:, ::-1], keys[flipped][:, ::-1]
    ends = np.einsum("mec,mcd->med", shares, x[faces[crossed]])[:, :, [2, 0]]
    _, number = np.unique(keys, return_inverse=True)
    number = number.reshape(-1, 2)
    total = int(number.max(initial=-1)) + 1
    graph = coo_matrix((np.ones(len(number)), (number[:, 0], number[:, 1])), shape=(total, total))
    piece = connected_components(graph, directed=False)[1] if total else np.zeros(0, np.int32)
    of = piece[number[:, 0]] if len(number) else np.zeros(0, np.int32)
    return Slice(crossed.astype(np.int32), shares, ends, of.astype(np.int32))
