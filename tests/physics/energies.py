"""Energies of membranes and of bending and their gradients in plain NumPy, against which kernels are checked."""

from __future__ import annotations

import numpy as np

from nuno_schemas.fabric import Fabric, Float


def membrane_energy(fabric: Fabric, x: Float) -> tuple[float, Float]:
    """Return the energy of triangles of constant strain [J] and its gradient (n, 3) [N]; x (n, 3) [m].

    nuno_schemas.fabric.Membrane defines it. A yarn of length 0 has no direction and gives no gradient.
    """
    gradient, membrane = np.zeros_like(x), fabric.membrane
    if membrane is None:
        return 0.0, gradient
    shares, corners = membrane.shares(), x[membrane.faces]
    warp, weft = np.einsum("ytk,tkd->ytd", shares, corners)
    long, wide = (np.linalg.norm(yarn, axis=1) for yarn in (warp, weft))
    e, f, g = long - 1.0, wide - 1.0, np.einsum("td,td->t", warp, weft)
    c_w, c_f, both, shear = membrane.area * membrane.moduli
    pull_w, pull_f, turn = c_w * e + both * f, c_f * f + both * e, shear * g
    along, across = (np.where(size > 0, pull, 0) / np.where(size > 0, size, 1)
                     for pull, size in ((pull_w, long), (pull_f, wide)))  # fmt: skip
    on_warp = along[:, None] * warp + turn[:, None] * weft
    on_weft = across[:, None] * weft + turn[:, None] * warp
    np.add.at(gradient, membrane.faces, np.einsum("ytk,ytd->tkd", shares, np.stack([on_warp, on_weft])))
    return float(0.5 * (pull_w * e + pull_f * f + turn * g).sum()), gradient


def bending_energy(fabric: Fabric, x: Float) -> tuple[float, Float]:
    """Return the energy of bending, a quadratic form [J], and its gradient (n, 3) [N]; x (n, 3) [m]."""
    gradient = np.zeros_like(x)
    if fabric.bending is None:
        return 0.0, gradient
    (first, second), weight = fabric.bending.pairs.T, fabric.bending.weight
    d = x[second] - x[first]
    pull = weight[:, None] * d
    np.add.at(gradient, second, pull)
    np.add.at(gradient, first, -pull)
    return float(0.5 * (pull * d).sum()), gradient
