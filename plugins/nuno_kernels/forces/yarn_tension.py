"""Tension of springs and yarns at rest, and the forces on their points, in plain NumPy: not for steps."""

from __future__ import annotations

import numpy as np

from nuno_schemas.fabric import Fabric, Float, Springs


def lengths(springs: Springs, x: Float) -> tuple[Float, Float]:
    """Return vectors (s, 3) from each spring's first end to its second at x (n, 3) [m], and their lengths (s,)."""
    pairs = springs.pairs()
    d = x[pairs[:, 1]] - x[pairs[:, 0]]
    return d, np.sqrt(d[:, 0] * d[:, 0] + d[:, 1] * d[:, 1] + d[:, 2] * d[:, 2])


def own_tensions(springs: Springs, length: Float) -> Float:
    """Return the tension (s,) [N] of springs of these lengths (s,) [m]: k (|d| - L), and beyond a lock as in
    nuno_kernels.forces.springs.

    Without damping. One of no length has none.
    """
    k, rest = springs.per_spring(springs.k), springs.per_spring(springs.rest)
    own = k * (length - rest)
    if springs.lock is not None and springs.k_lock is not None:
        beyond = np.maximum(length - (1.0 + springs.per_spring(springs.lock)) * rest, 0.0)
        own += (springs.per_spring(springs.k_lock) - k) * beyond
    own[length == 0.0] = 0.0
    return np.asarray(own)


def link_tensions(fabric: Fabric, x: Float) -> Float:
    """Return the tension (s,) [N] of every spring at x (n, 3) [m]: its own, and that passed along its yarn.

    T'_n = T_n + mu (T_(n-1) + T_(n+1)). As in nuno_kernels.forces.yarns a link of no length takes no part.
    """
    if fabric.springs is None:
        return np.zeros(0)
    _, length = lengths(fabric.springs, x)
    tension = own_tensions(fabric.springs, length)
    if fabric.yarns is None:
        return tension
    neighbours, yarn = fabric.yarns.neighbours()
    both = (length[neighbours] > 0.0).all(axis=1)
    share = np.where(both, fabric.yarns.mu[yarn], 0.0)
    whole = tension.copy()
    for here, there in ((0, 1), (1, 0)):
        whole += np.bincount(neighbours[:, here], share * tension[neighbours[:, there]], len(tension))
    return np.asarray(whole)


def point_forces(fabric: Fabric, x: Float) -> Float:
    """Return the force (n, 3) [N] of all links on every point at x (n, 3) [m]."""
    if fabric.springs is None:
        return np.zeros_like(x)
    pairs, (d, length) = fabric.springs.pairs(), lengths(fabric.springs, x)
    pull = np.divide(link_tensions(fabric, x), length, out=np.zeros_like(length), where=length > 0.0)
    force = np.empty_like(x)
    for axis in range(3):
        along = pull * d[:, axis]
        force[:, axis] = np.bincount(pairs[:, 0], along, len(x)) - np.bincount(pairs[:, 1], along, len(x))
    return force
