"""Stiffness of the folds of a kept wrinkle, which bear the cloth that hangs from it.

A fold of rigidity B whose rest shape is a wave of height h and length w, under a line tension T along it, has the
height

    y / h = B q^2 / (B q^2 + T) = 1 / (1 + T w^2 / (4 pi^2 B)),    q = 2 pi / w,

the balance of B (y'''' - h'''') and T y''. T is the weight of hung cloth below, rho g L at most. So B must grow with
the load and the width of the fold: no multiple of the cloth's rigidity suits all weights of cloth and all sizes of
meshes.
"""

from __future__ import annotations

import numpy as np

from nuno_schemas.fabric import Bool, Float, Int, Springs

GRAVITY = 9.81
"""Acceleration that kept wrinkles bear [m/s^2], also in a scene without gravity."""
HOLD = 0.03
"""B / (rho g L w^2). A wave under the whole weight would need 0.1 to keep four fifths of its height, but most of the
cloth bears less, and flat cloth at the ends of a line bears part of it: on cloth hung at its corners 0.03 keeps that
share of ridges of several heights, directions and weights, and 0.02 loses a quarter of low ones."""


def kept_rigidity(density: float, x: Float, crests: Int) -> float:
    """Return the rigidity [N m] of folds that hold on cloth of `density` [kg/m^2] at x (n, 3) [m]; crests (5, c) are
    those of `find_crests`. 0 if the width is unknown, as of a line of two triangles.
    """
    if not crests.size:
        return 0.0
    width = float(np.linalg.norm(x[crests[1]] - x[crests[2]], axis=1).mean())
    return HOLD * density * GRAVITY * float(np.ptp(x, axis=0).max()) * width**2


def most_stiffness(x: Float, quads: Int, mass: Float, pinned: Bool, springs: Springs) -> Float:
    """Return the stiffness (h,) [N m] at which a hinge alone moves its vertices as fast as the net's springs may.

    A hinge of stiffness k moves along its gradients g with omega^2 = k sum |g_c|^2 / m_c, and springs with at most 2
    max sum_j k_j / m_i (Gershgorin). Slivers as stiff as the rest would halve the step without raising the wrinkle.
    """
    free = ~pinned
    pairs, stiffness = springs.pairs(), springs.per_spring(springs.k)
    row = np.bincount(pairs[:, 0], stiffness, len(mass)) + np.bincount(pairs[:, 1], stiffness, len(mass))
    edge = x[quads[:, 1]] - x[quads[:, 0]]
    square = np.einsum("hk,hk->h", edge, edge)
    slope, lever = np.zeros(len(quads)), np.zeros((2, len(quads)))
    for corner in (2, 3):
        side = x[quads[:, corner]] - x[quads[:, 0]]
        share = np.einsum("hk,hk->h", side, edge) / square
        tilt = np.sqrt(square / np.square(np.cross(edge, side)).sum(axis=1))
        slope += tilt**2 / mass[quads[:, corner]]
        lever += tilt * np.stack([1.0 - share, share])
    slope += (lever**2 / mass[quads[:, :2].T]).sum(axis=0)
    return np.asarray(2.0 * (row[free] / mass[free]).max(initial=0.0) / slope)
