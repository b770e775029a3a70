"""Edges of triangles as sorted numbers, and what lies across them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.fabric import Bool, Float, Int

Keys = NDArray[np.int64]


@dataclass(frozen=True)
class Edges:
    """Edges of some triangles: key (e,) ascending, of_face (f, 3) the edge that leaves each corner."""

    key: Keys
    of_face: NDArray[np.int64]

    def rows(self, keys: Keys) -> tuple[NDArray[np.int64], Bool]:
        """Where each key stands, and whether it does."""
        at = np.minimum(np.searchsorted(self.key, keys), max(len(self.key) - 1, 0))
        return at, self.key[at] == keys if len(self.key) else np.zeros(len(keys), np.bool_)


def keys_of(pairs: NDArray[np.integer]) -> Keys:
    """(p,) one number for each pair of vertices (p, 2), whichever comes first."""
    low, high = np.minimum(pairs[:, 0], pairs[:, 1]).astype(np.int64), np.maximum(pairs[:, 0], pairs[:, 1])
    return np.asarray(low << 32 | high, np.int64)


def any_of(mask: Bool, indices: Int) -> Bool:
    """(m,) whether `mask` holds of any vertex in each row of indices (m, w); column by column, which is much faster."""
    found = mask[indices[:, 0]]
    for column in range(1, indices.shape[1]):
        found |= mask[indices[:, column]]
    return found


def pairs_of(keys: Keys) -> Int:
    """(p, 2) the vertices of keys, the smaller first."""
    return np.stack([keys >> 32, keys & 0xFFFFFFFF], axis=1).astype(np.int32)


def edges_of(faces: Int) -> Edges:
    """Edges of triangles (f, 3)."""
    pairs = np.stack([faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)], axis=1)
    key, place = np.unique(keys_of(pairs), return_inverse=True)
    return Edges(key, place.reshape(-1, 3))


def quads_of(faces: Int, across: Int, chosen: Int) -> Int:
    """(h, 4) start, end, left and right of each edge between two triangles one of which is chosen."""
    own = faces[chosen]
    start, end, left = own.reshape(-1), np.roll(own, -1, axis=1).reshape(-1), np.roll(own, -2, axis=1).reshape(-1)
    beyond = across[chosen].reshape(-1)
    inner = beyond >= 0
    start, end, left = start[inner], end[inner], left[inner]
    right = faces[beyond[inner]].sum(axis=1) - start - end
    turned = start > end
    quads = np.stack([start, end, left, right], axis=1)
    quads[turned] = quads[turned][:, [1, 0, 3, 2]]
    first = np.unique(keys_of(quads[:, :2]), return_index=True)[1]
    return np.ascontiguousarray(quads[first], np.int32)


def heron(side: Float) -> Float:
    """(f,) areas of triangles by their sides (f, 3); W. Kahan's form, which loses no digits on slivers."""
    a, b, c = np.sort(side, axis=1).T[::-1]
    square = (a + (b + c)) * (c - (a - b)) * (c + (a - b)) * (a + (b - c))
    return np.asarray(0.25 * np.sqrt(np.maximum(square, 0.0)))


def area_of(x: Float, faces: Int) -> float:
    """Area of triangles together.

    By |u x v|^2 = |u|^2 |v|^2 - (u . v)^2, which takes a quarter of the time of np.cross: the digits that it loses are
    of slivers, whose areas hardly count.
    """
    a = x.take(faces[:, 0], axis=0)
    u, v = x.take(faces[:, 1], axis=0) - a, x.take(faces[:, 2], axis=0) - a
    uu, vv, uv = (np.einsum("fk,fk->f", one, other) for one, other in ((u, u), (v, v), (u, v)))
    return 0.5 * float(np.sqrt(np.maximum(uu * vv - uv * uv, 0.0)).sum())


def fold_angles(x: Float, quads: Int) -> Float:
    """(h,) angles of folds [rad], 0 where flat, positive where the triangles fold towards their normals."""
    x0, x1, x2, x3 = (x[quads[:, i]] for i in range(4))
    e = x1 - x0
    left, right = np.cross(e, x2 - x0), np.cross(x3 - x0, e)
    size = np.linalg.norm(e, axis=1)
    # arctan2 takes both up to the same factor, |left| |right|.
    return np.asarray(np.arctan2(np.einsum("hk,hk->h", left, x3 - x0) * size, np.einsum("hk,hk->h", left, right)))
