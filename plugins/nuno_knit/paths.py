"""Yarns as rows of points, from one end to the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Fabric, Float, Int


@dataclass(frozen=True)
class Paths:
    """Points along yarns.

    vertex (p,)     int32 points of the fabric, yarn by yarn; a ring ends with its first point
    ptr    (y + 1,) int64 yarn y is vertex[ptr[y]:ptr[y + 1]]
    kind   (y,)     int32 index into `names`
    thickness (y,)  as a ratio of the mean yarn's
    """

    vertex: Int
    ptr: NDArray[np.int64]
    kind: Int
    names: tuple[str, ...]
    thickness: Float

    @property
    def number(self) -> int:
        return len(self.kind)

    @property
    def steps(self) -> NDArray[np.int64]:
        """Places (s,) in `vertex` from which a link leads to the next."""
        last = np.zeros(len(self.vertex), bool)
        last[self.ptr[1:] - 1] = True
        return np.flatnonzero(~last)

    @property
    def pairs(self) -> Int:
        """Points (s, 2) of every link, in the direction of its yarn."""
        return np.stack([self.vertex[self.steps], self.vertex[self.steps + 1]], axis=1)

    @property
    def order(self) -> NDArray[np.int64]:
        """Number (s,) of each link in its yarn, from 0."""
        return self.steps - np.repeat(self.ptr[:-1], np.diff(self.ptr) - 1)

    @property
    def rings(self) -> Bool:
        """Whether yarns (y,) close on themselves."""
        return np.asarray(
            (np.diff(self.ptr) > 2) & (self.vertex[self.ptr[:-1]] == self.vertex[self.ptr[1:] - 1]), np.bool_
        )


def find_paths(fabric: Fabric) -> Paths:
    """Return the points along a fabric's yarns, in order. Raises BadInput for a fabric without yarns."""
    springs, yarns = fabric.springs, fabric.yarns
    if springs is None or yarns is None or not yarns.number:
        raise BadInput("the cloth has no yarns", value=fabric.name, remedy="yarns are what the model knit makes")
    size = np.diff(yarns.ptr).astype(np.int64)
    first, last = yarns.ptr[:-1].astype(np.int64), yarns.ptr[1:].astype(np.int64) - 1
    ring = (size > 1) & (yarns.links[first] == yarns.links[last])
    counted = np.ones(len(yarns.links), bool)
    counted[last[ring]] = False
    links = springs.pairs()[yarns.links]
    # A link's end is the point that the next link shares; a yarn's last link starts where the previous one ends, and a
    # single link at its first point.
    following, previous = np.roll(links, -1, axis=0), np.roll(links, 1, axis=0)
    backward = (links[:, :1] == following).any(axis=1) & ~(links[:, 1:] == following).any(axis=1)
    backward[last] = (links[last, 1:] == previous[last]).any(axis=1) & (size > 1)
    directed = np.where(backward[:, None], links[:, ::-1], links)[counted]
    count = size - ring
    ptr = np.concatenate([[0], np.cumsum(count + 1)]).astype(np.int64)
    vertex = np.empty(ptr[-1], np.int32)
    ends = ptr[1:] - 1
    inner = np.ones(len(vertex), bool)
    inner[ends] = False
    vertex[inner] = directed[:, 0]
    vertex[ends] = directed[np.cumsum(count) - 1, 1]
    return Paths(vertex, ptr, yarns.kind.astype(np.int32), yarns.names, yarns.thickness())


def mean_length(paths: Paths, x: Float) -> float:
    """Return the mean length of all links [m] between points x (n, 3) [m]; 0 without links."""
    pairs = paths.pairs
    return float(np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1).mean()) if len(pairs) else 0.0
