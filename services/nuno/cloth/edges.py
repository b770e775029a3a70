"""What of a fabric's springs is shown."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.fabric import Fabric, Float


def edge_yarns(fabric: Fabric) -> NDArray[np.int8] | None:
    """(e,) which of its yarns' names each of `structural_edges` is, -1 where it is in none; None without yarns."""
    springs, yarns = fabric.springs, fabric.yarns
    if springs is None or yarns is None:
        return None
    kind = np.full(springs.number, -1, np.int8)
    kind[yarns.links] = np.repeat(yarns.kind, np.diff(yarns.ptr))
    structural = np.repeat(springs.kind == 0, springs.count)
    return kind[structural] if structural.any() else kind


def structural_edges(fabric: Fabric) -> tuple[np.ndarray, Float]:
    """Pairs and rest lengths of the structural springs (all springs if none is), for display."""
    springs = fabric.springs
    if springs is None:
        return np.zeros((0, 2), np.int32), np.zeros(0)
    if (springs.kind == 0).any() and not (springs.kind == 0).all():
        springs = springs.of_kind(0)
    single = springs.first.shape[0] == springs.number
    return springs.first if single else springs.pairs(), springs.per_spring(springs.rest)
