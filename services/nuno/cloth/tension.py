"""Tension of links of yarns, for those who show them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.cloth.yarns import beside_sides
from nuno_schemas.fabric import Fabric, Float

SPAN = 1000.0
"""Of the colours, which are logarithmic: as many times as the weakest tension is the strongest."""


def tension_arrays(fabric: Fabric) -> dict[str, NDArray[Any]]:
    """What tension of its springs, and none of the sides of a membrane's triangles, (e,) takes beside where they are;
    nothing for a fabric without yarns, nor for one of whose springs some are not shown.

    edge_k, edge_mu (e,) float32 [N/m, 1]; edge_beside (e, 2) int32 the links before and after on the same yarn, -1
    for none; of yarns that lock edge_lock, edge_k_lock (e,) float32 [1, N/m] as well.
    """
    springs, yarns = fabric.springs, fabric.yarns
    if springs is None or yarns is None:
        return {}
    shown = springs.of_kind(0)
    if shown.any() and not shown.all():
        return {}
    pairs, _ = yarns.neighbours()
    beside = np.full((springs.number, 2), -1, np.int32)
    beside[pairs[:, 0], 1], beside[pairs[:, 1], 0] = pairs[:, 1], pairs[:, 0]
    mu = np.zeros(springs.number, np.float32)
    mu[yarns.links] = np.repeat(yarns.mu, np.diff(yarns.ptr))
    found: dict[str, NDArray[Any]] = {"edge_mu": mu, "edge_beside": beside}
    for name, values in (("edge_k", springs.k), ("edge_lock", springs.lock), ("edge_k_lock", springs.k_lock)):
        if values is not None:
            found[name] = springs.per_spring(values).astype(np.float32)
    return {name: beside_sides(fabric, values, -1 if name == "edge_beside" else 0.0) for name, values in found.items()}


@dataclass(frozen=True)
class Tensions:
    """The knit paper's tension of links, T'_n = T_n + mu (T_(n-1) + T_(n+1)), from how far they are stretched.

    Arrays as `tension_arrays` has them, and rest (e,) float32 [m]; most [N] is the end of the colours.
    """

    rest: NDArray[np.float32]
    k: NDArray[np.float32]
    mu: NDArray[np.float32]
    beside: NDArray[np.int32]
    lock: NDArray[np.float32] | None
    k_lock: NDArray[np.float32] | None
    most: float

    @staticmethod
    def read(arrays: Mapping[str, NDArray[Any]], mine: NDArray[np.bool_]) -> Tensions | None:
        """Of those links of a fabric message that are `mine` (e,); None where it says nothing of them, or they are
        sides of a membrane's triangles.

        `most` is that of the stiffest link of all, as long again as at rest, so that it does not change with time.
        Raises ValueError where arrays do not fit.
        """
        if "edge_k" not in arrays:
            return None
        number, beside = len(mine), arrays["edge_beside"]
        given = {name: arrays.get(f"edge_{name}") for name in ("rest", "k", "mu", "lock", "k_lock")}
        if any(values is not None and len(values) != number for values in given.values()):
            raise ValueError("the arrays of yarns' tension differ in length")
        if beside.shape != (number, 2) or (beside.size and not (beside.min() >= -1 and beside.max() < number)):
            raise ValueError("a link beside another that is not there")
        if not arrays["edge_k"][mine].any():
            return None
        stiffest = arrays.get("edge_k_lock", arrays["edge_k"])
        most = float((stiffest * arrays["edge_rest"]).max(initial=0.0)) or 1.0
        # The last number stands for the link that is not there: -1.
        numbers = np.append(np.where(mine, np.cumsum(mine) - 1, -1), -1).astype(np.int32)
        own: Any = {name: None if values is None else values[mine] for name, values in given.items()}
        return Tensions(**own, beside=numbers[beside[mine]], most=most)

    def __call__(self, stretch: NDArray[np.floating]) -> Float:
        """(e,) [N] at elongations (e,), |d| / rest - 1."""
        own = np.zeros(len(self.rest) + 1)  # the last is the neighbour that is not there
        own[:-1] = self.k * self.rest * stretch
        if self.lock is not None and self.k_lock is not None:
            own[:-1] += (self.k_lock - self.k) * self.rest * np.maximum(stretch - self.lock, 0.0)
        return np.asarray(own[:-1] + self.mu * (own[self.beside[:, 0]] + own[self.beside[:, 1]]))
