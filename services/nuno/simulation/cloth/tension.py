"""Tension of links of yarns, for display."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.simulation.cloth.yarns import append_sides
from nuno_schemas.fabric import Fabric, Float

SPAN = 1000.0
"""Ratio of the strongest to the weakest tension on the logarithmic colour scale."""


def tension_arrays(fabric: Fabric) -> dict[str, NDArray[Any]]:
    """Return the arrays that the tension of the shown edges (e,) needs besides positions; empty for a fabric without
    yarns, or with springs that are not shown. Sides of a membrane's triangles have no tension.

    edge_k, edge_mu (e,) float32 [N/m, 1]; edge_beside (e, 2) int32 the links before and after on the same yarn, -1
    for none; yarns that lock also have edge_lock, edge_k_lock (e,) float32 [1, N/m].
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
    out: dict[str, NDArray[Any]] = {"edge_mu": mu, "edge_beside": beside}
    for name, values in (("edge_k", springs.k), ("edge_lock", springs.lock), ("edge_k_lock", springs.k_lock)):
        if values is not None:
            out[name] = springs.per_spring(values).astype(np.float32)
    return {name: append_sides(fabric, values, -1 if name == "edge_beside" else 0.0) for name, values in out.items()}


@dataclass(frozen=True)
class Tensions:
    """The knit paper's tension of links, T'_n = T_n + mu (T_(n-1) + T_(n+1)), from their stretch.

    Arrays are those of `tension_arrays`, and rest (e,) float32 [m]; most [N] is the end of the colour scale.
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
        """Read the links `mine` (e,) of a fabric message; None if it has no tension of them, as for sides of a
        membrane's triangles.

        `most` is the tension of the stiffest link at twice its rest length, so that it does not change with time.
        Raises ValueError where arrays do not fit.
        """
        if "edge_k" not in arrays:
            return None
        number, around = len(mine), arrays["edge_beside"]
        values_by_name = {name: arrays.get(f"edge_{name}") for name in ("rest", "k", "mu", "lock", "k_lock")}
        if any(values is not None and len(values) != number for values in values_by_name.values()):
            raise ValueError("the arrays of yarns' tension differ in length")
        if around.shape != (number, 2) or (around.size and not (around.min() >= -1 and around.max() < number)):
            raise ValueError("a link beside another that is not there")
        if not arrays["edge_k"][mine].any():
            return None
        stiffest = arrays.get("edge_k_lock", arrays["edge_k"])
        most = float((stiffest * arrays["edge_rest"]).max(initial=0.0)) or 1.0
        # The last number is that of a missing neighbour, -1.
        numbers = np.append(np.where(mine, np.cumsum(mine) - 1, -1), -1).astype(np.int32)
        selected: Any = {name: None if values is None else values[mine] for name, values in values_by_name.items()}
        return Tensions(**selected, beside=numbers[around[mine]], most=most)

    def __call__(self, stretch: NDArray[np.floating]) -> Float:
        """Return tensions (e,) [N] at elongations (e,), |d| / rest - 1."""
        tension = np.zeros(len(self.rest) + 1)  # the last is a missing neighbour
        tension[:-1] = self.k * self.rest * stretch
        if self.lock is not None and self.k_lock is not None:
            tension[:-1] += (self.k_lock - self.k) * self.rest * np.maximum(stretch - self.lock, 0.0)
        return np.asarray(tension[:-1] + self.mu * (tension[self.beside[:, 0]] + tension[self.beside[:, 1]]))
