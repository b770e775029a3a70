"""How far every vertex of a cloth is from rest, as a share of the forces of its springs or triangles."""

from __future__ import annotations

import math

import numpy as np

from nuno_kernels.forces.yarn_tension import lengths, own_tensions
from nuno_schemas.fabric import Fabric, Float, Membrane

TINY = 1e-300
"""stands for the length of a yarn of length 0 [1], which then exerts no force"""
NO_STRAIN = 1e-11
"""Springs strained by less than this share of the cloth's largest coordinate count with that strain: their own length
is known no better, so that cloth without load, whose forces are rounding, is at rest."""


def typical_tension(fabric: Fabric, x: Float) -> float:
    """Return the mean size of the forces [N] at x (n, 3) [m] of springs and of triangles at their corners; 0 without
    either.

    Summed exactly: NumPy's order differs between machines, and this decides which frame is the last.
    """
    pulls, stiffness = list[float](), list[float]()
    if fabric.springs is not None:
        _, length = lengths(fabric.springs, x)
        pulls += np.abs(own_tensions(fabric.springs, length)).tolist()
        stiffness += fabric.springs.per_spring(fabric.springs.k).tolist()
    if fabric.membrane is not None:
        pulls += pulls_of_membrane(fabric.membrane, x).reshape(-1).tolist()
        stiffness += fabric.membrane.stiffness().reshape(-1).tolist()
    if not pulls:
        return 0.0
    try:
        pull = math.fsum(pulls)
    except OverflowError:  # cloth that flies apart
        pull = math.inf
    return max(pull, NO_STRAIN * float(np.abs(x).max()) * math.fsum(stiffness)) / len(pulls)


def pulls_of_membrane(membrane: Membrane, x: Float) -> Float:
    """Return the size of the force [N] that each triangle has on each corner at x (n, 3) [m], shape (t, 3)."""
    shares, corners = membrane.shares(), x[membrane.faces]
    warp, weft = (sum(share[:, k, None] * corners[:, k] for k in range(3)) for share in shares)
    long, wide = size(warp), size(weft)
    c_w, c_f, both, g = membrane.area * membrane.moduli
    along, across = c_w * (long - 1.0) + both * (wide - 1.0), c_f * (wide - 1.0) + both * (long - 1.0)
    shear = g * (warp[:, 0] * weft[:, 0] + warp[:, 1] * weft[:, 1] + warp[:, 2] * weft[:, 2])
    on_warp = (along / np.maximum(long, TINY))[:, None] * warp + shear[:, None] * weft
    on_weft = (across / np.maximum(wide, TINY))[:, None] * weft + shear[:, None] * warp
    forces = [shares[0, :, k, None] * on_warp + shares[1, :, k, None] * on_weft for k in range(3)]
    return np.stack([size(force) for force in forces], axis=1)


def size(a: Float) -> Float:
    """Return the lengths (n,) of vectors (n, 3), by sums in one order on every machine."""
    return np.asarray(np.sqrt(a[:, 0] * a[:, 0] + a[:, 1] * a[:, 1] + a[:, 2] * a[:, 2]))


def unbalance(fabric: Fabric, x: Float, v: Float, left: Float) -> Float:
    """Return the distance from rest (n,): the force `left` (n, 3) [N] on each vertex and what its velocity v (n, 3)
    [m/s] will turn into, over the typical tension; 0 for held vertices, inf for all others in cloth without tension.

    Force alone is no measure of rest: a mass that swings feels none in the middle of its way. With K the stiffness of
    all springs and triangles of a vertex, F^2 + m K v^2 is the same all along its swing, the square of the force at
    its ends.
    """
    far = np.zeros(fabric.number)
    scale = typical_tension(fabric, x)
    if scale == 0.0:
        return np.where(fabric.pinned, 0.0, np.inf)
    stiffness = np.zeros(fabric.number)
    if fabric.springs is not None:
        k = fabric.springs.per_spring(fabric.springs.k)
        stiffness += sum(np.bincount(end, k, fabric.number) for end in fabric.springs.pairs().T)
    if fabric.membrane is not None:
        corners, k = fabric.membrane.faces, fabric.membrane.stiffness()
        stiffness += np.bincount(corners.reshape(-1), k.reshape(-1), fabric.number)
    for axis in range(3):
        far += left[:, axis] ** 2 + fabric.mass * stiffness * v[:, axis] ** 2
    return np.where(fabric.pinned, 0.0, np.sqrt(far) / scale)
