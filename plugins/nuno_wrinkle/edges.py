"""Edges of triangles as sorted numbers, and their opposite vertices."""

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
        """Return the place of each key, and whether it exists."""
        at = np.minimum(np.searchsorted(self.key, keys), max(len(self.key) - 1, 0))
        return at, self.key[at] == keys if len(self.key) else np.zeros(len(keys), np.bool_)


def keys_of(pairs: NDArray[np.integer]) -> Keys:
    """Return one number (p,) for each unordered pair of vertices (p, 2)."""
    low, high = np.minimum(pairs[:, 0], pairs[:, 1]).astype(np.int64), np.maximum(pairs[:, 0], pairs[:, 1])
    return np.asarray(low << 32 | high, np.int64)


def any_of(mask: Bool, indices: Int) -> Bool:
    """Return whether (m,) `mask` is true of any vertex in each row of indices (m, w); by columns, for speed."""
    result = mask[indices[:, 0]]
    for column in range(1, indices.shape[1]):
        result |= mask[indices[:, column]]
    return result


def pairs_of(keys: Keys) -> Int:
    """Return the vertices (p, 2) of keys, the smaller first."""
    return np.stack([keys >> 32, keys & 0xFFFFFFFF], axis=1).astype(np.int32)


def edges_of(faces: Int) -> Edges:
    """Return the edges of triangles (f, 3)."""
    pairs = np.stack([faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)], axis=1)
    key, place = np.unique(keys_of(pairs), return_inverse=True)
    return Edges(key, place.reshape(-1, 3))


def quads_of(faces: Int, across: Int, chosen: Int) -> Int:
    """Return start, end, left and right (h, 4) of each edge between two triangles, one of which is chosen."""
    corners = faces[chosen]
    start, end, left = (
        corners.reshape(-1),
        np.roll(corners, -1, axis=1).reshape(-1),
        np.roll(corners, -2, axis=1).reshape(-1),
    )
    beyond = across[chosen].reshape(-1)
    inner = beyond >= 0
    start, end, left = start[inner], end[inner], left[inner]
    right = faces[beyond[inner]].sum(axis=1) - start - end
    reversed_pairs = start > end
    quads = np.stack([start, end, left, right], axis=1)
    quads[reversed_pairs] = quads[reversed_pairs][:, [1, 0, 3, 2]]
    first = np.unique(keys_of(quads[:, :2]), return_index=True)[1]
    return np.ascontiguousarray(quads[first], np.int32)


def heron(side: Float) -> Float:
    """Return areas (f,) of triangles by their sides (f, 3), in W. Kahan's form, which loses no digits on slivers."""
    a, b, c = np.sort(side, axis=1).T[::-1]
    square = (a + (b + c)) * (c - (a - b)) * (c + (a - b)) * (a + (b - c))
    return np.asarray(0.25 * np.sqrt(np.maximum(square, 0.0)))


def area_of(x: Float, faces: Int) -> float:
    """Return the total area of triangles.

    It is computed by |u x v|^2 = |u|^2 |v|^2 - (u . v)^2, in a quarter of the time of np.cross: this loses digits only
    of slivers, whose areas hardly count.
    """
    a = x.take(faces[:, 0], axis=0)
    u, v = x.take(faces[:, 1], axis=0) - a, x.take(faces[:, 2], axis=0) - a
    uu, vv, uv = (np.einsum("fk,fk->f", one, other) for one, other in ((u, u), (v, v), (u, v)))
    return 0.5 * float(np.sqrt(np.maximum(uu * vv - uv * uv, 0.0)).sum())


def fold_angles(x: Float, quads: Int) -> Float:
    """Return angles (h,) of folds [rad], 0 if flat, positive if the triangles fold towards their normals."""
    x0, x1, x2, x3 = (x[quads[:, i]] for i in range(4))
    e = x1 - x0
    left, right = np.cross(e, x2 - x0), np.cross(x3 - x0, e)
    size = np.linalg.norm(e, axis=1)
    # The common factor |left| |right| cancels in arctan2.
    return np.asarray(np.arctan2(np.einsum("hk,hk->h", left, x3 - x0) * size, np.einsum("hk,hk->h", left, right)))
