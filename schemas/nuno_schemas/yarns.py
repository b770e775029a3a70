"""Yarns of a fabric: springs that are links of yarns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.layout import Bounds

if TYPE_CHECKING:  # a fabric has yarns, so that at run time it is fabric that imports this
    from nuno_schemas.fabric import Float, Int, Springs


@dataclass(frozen=True)
class Yarns:
    """Springs that are links of yarns, along which tension passes: T'_n = T_n + mu (T_(n-1) + T_(n+1)).

    links (l,)    int32    springs yarn by yarn, each sharing a vertex with the one before it.
                           A yarn that ends with its first link is a ring; apart from that a
                           spring occurs at most once
    ptr   (y + 1,) int32   yarn y is links[ptr[y]:ptr[y + 1]]
    mu    (y,)    float64  share of tension passed on, 0 <= mu < 1/2
    kind  (y,)    int8     index into `names`, for reports and pictures
    names                  e.g. ("nylon", "support")
    density (y,)  float64  linear density [kg/m], for the thickness in pictures; None if unknown

    The force T' acts along the link, equal and opposite on its ends. A spring without a yarn, or the only
    link of its yarn, keeps its tension.
    """

    links: Annotated[NDArray[np.int32], "l", Bounds(0)]
    ptr: Annotated[NDArray[np.int32], "p", Bounds(0)]
    mu: Annotated[NDArray[np.float64], "y", Bounds(0.0, np.nextafter(0.5, 0.0))]
    kind: Annotated[NDArray[np.int8], "y", Bounds(0)]
    names: tuple[str, ...] = ("yarn",)
    density: Annotated[NDArray[np.float64], "y", Bounds(above=0.0)] | None = None

    @property
    def number(self) -> int:
        return int(self.mu.shape[0])

    def thickness(self) -> Float:
        """Return the thickness of every yarn over that of a yarn of mean linear density, shape (y,); 1 if unknown.

        It is the root of the ratio of linear densities: with one bulk density, cross sections are proportional to them.
        """
        return np.ones(self.number) if self.density is None else np.sqrt(self.density / self.density.mean())

    def neighbours(self) -> tuple[Int, Int]:
        """Return the pairs (p, 2) of consecutive links of a yarn, and the yarn (p,) of each pair."""
        yarn = np.repeat(np.arange(self.number, dtype=np.int32), np.diff(self.ptr))
        same = yarn[1:] == yarn[:-1]
        return np.stack([self.links[:-1], self.links[1:]], axis=1)[same], yarn[1:][same]

    def lengths(self, springs: Springs, each: Float | None = None) -> Float:
        """Return the rest length of every yarn, shape (y,) [m], or the sum of `each`, lengths of all springs (s,) [m];
        a ring counts each link once.
        """
        rest = (springs.per_spring(springs.rest) if each is None else each)[self.links]
        total = np.add.reduceat(rest, self.ptr[:-1]) if self.number else np.zeros(0)
        first, last = self.ptr[:-1], self.ptr[1:] - 1
        ring = (last > first) & (self.links[first] == self.links[last])
        return np.asarray(total - np.where(ring, rest[last], 0.0))

    @staticmethod
    def join(parts: list[tuple[Yarns, int]]) -> Yarns:
        """Join several sets (at least one), each with the offset of its spring indices."""
        names = tuple(dict.fromkeys(name for yarns, _ in parts for name in yarns.names))
        sizes = np.concatenate([np.diff(yarns.ptr) for yarns, _ in parts])
        densities = [yarns.density for yarns, _ in parts if yarns.density is not None]
        return Yarns(
            np.concatenate([(yarns.links + offset).astype(np.int32) for yarns, offset in parts]),
            np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32),
            np.concatenate([yarns.mu for yarns, _ in parts]),
            np.concatenate([[names.index(yarns.names[k]) for k in yarns.kind] for yarns, _ in parts]).astype(np.int8),
            names,
            np.concatenate(densities) if len(densities) == len(parts) else None,
        )
