"""Energies and their gradients in plain NumPy, for virtual tests and checks: nuno_kernels has the fast ones."""

from __future__ import annotations

import numpy as np

from nuno_schemas.fabric import Fabric, Float


def spring_energy(fabric: Fabric, x: Float) -> tuple[float, Float]:
    """Return the sum of k (|d| - rest)^2 / 2 [J] and its gradient (n, 3) [N]; x (n, 3) [m].

    A spring of length 0 has no direction and gives no gradient.
    """
    gradient = np.zeros_like(x)
    springs = fabric.springs
    if springs is None:
        return 0.0, gradient
    pairs = springs.pairs()
    k, rest = springs.per_spring(springs.k), springs.per_spring(springs.rest)
    d = x[pairs[:, 1]] - x[pairs[:, 0]]
    length = np.linalg.norm(d, axis=1)
    pull = k * (length - rest)
    along = d * (pull / np.where(length > 0, length, np.inf))[:, None]
    np.add.at(gradient, pairs[:, 1], along)
    np.add.at(gradient, pairs[:, 0], -along)
    return float(0.5 * (pull * (length - rest)).sum()), gradient


def hinge_energy(fabric: Fabric, x: Float) -> tuple[float, Float]:
    """Return the sum of k (1 - cos(angle - rest)) [J] and its gradient (n, 3) [N]; x (n, 3) [m].

    The angle is 0 if flat, positive if the triangles fold towards their normals. Its gradient is n1 |e| / |n1|^2 and n2
    |e| / |n2|^2 at the opposite vertices, and the reaction is shared by the ends of the edge like that of a lever
    (Tamstorf and Grinspun 2013).
    """
    gradient = np.zeros_like(x)
    hinges = fabric.hinges
    if hinges is None:
        return 0.0, gradient
    quads = hinges.quads()
    k, rest = hinges.per_hinge(hinges.k), hinges.per_hinge(hinges.rest)
    x0, x1, x2, x3 = (x[quads[:, i]] for i in range(4))
    e = x1 - x0
    n1, n2 = np.cross(e, x2 - x0), np.cross(x3 - x0, e)
    ee, q1, q2 = (np.einsum("ij,ij->i", a, a) for a in (e, n1, n2))
    size = np.sqrt(q1 * q2)
    angle = np.arctan2(np.einsum("ij,ij->i", n1, x3 - x0) * np.sqrt(ee) / size, np.einsum("ij,ij->i", n1, n2) / size)
    moment = (k * np.sin(angle - rest))[:, None]
    g2, g3 = n1 * (np.sqrt(ee) / q1)[:, None], n2 * (np.sqrt(ee) / q2)[:, None]
    t2, t3 = (np.einsum("ij,ij->i", y - x0, e) / ee for y in (x2, x3))
    g1 = -(t2[:, None] * g2 + t3[:, None] * g3)
    for corner, g in enumerate((-(g1 + g2 + g3), g1, g2, g3)):
        np.add.at(gradient, quads[:, corner], moment * g)
    return float((k * (1 - np.cos(angle - rest))).sum()), gradient


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


def elastic_energy(fabric: Fabric, x: Float) -> tuple[float, Float]:
    """Return the energy of springs, hinges, membrane and bending [J] and its gradient (n, 3) [N]."""
    parts = [energy(fabric, x) for energy in (spring_energy, hinge_energy, membrane_energy, bending_energy)]
    return sum(part[0] for part in parts), np.sum([part[1] for part in parts], axis=0)
