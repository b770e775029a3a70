"""A harmonic field on a triangle mesh: as smooth as the given values on some vertices allow.

With linear elements the field solves sum_j w_ij (u_i - u_j) = 0 on every other vertex, w_ij = (cot a + cot b) / 2 of
the two angles opposite to the edge (U. Pinkall, K. Polthier, Computing discrete minimal surfaces and their conjugates,
Experimental Mathematics 2(1), 1993). It has no extreme but on vertices that are given, so that on a tube between two
given ends its levels are loops that go round it once and never cross: what planes across an axis do at a bend.
Weights of obtuse pairs, which may be negative, are raised to a small share of the largest; that keeps this.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from nuno_geometry.normals import edge_numbers
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int

LEAST = 1e-3
"""least weight of an edge; equilateral triangles have 0.58"""
ACCURACY = 1e-8
"""residual of the solution, as a share of that at the start"""
ROUNDS = 20_000


def edge_weights(x: Float, faces: Int) -> tuple[Int, Float]:
    """Return edges (e, 2) of a mesh and their weights (e,), `LEAST` at least."""
    numbers, pairs = edge_numbers(faces)
    corner = x[faces]
    weight = np.zeros(len(pairs))
    for k in range(3):
        # The edge from corner k to the next is opposite to the one after that.
        a, b = corner[:, k] - corner[:, k - 1], corner[:, (k + 1) % 3] - corner[:, k - 1]
        sine = np.linalg.norm(np.cross(a, b), axis=1)
        cosine = (a * b).sum(axis=1)
        weight += np.bincount(numbers[:, k], 0.5 * cosine / np.maximum(sine, LEAST * np.abs(cosine)), len(pairs))
    return pairs, np.maximum(weight, LEAST)


def solve_harmonic(x: Float, faces: Int, fixed: Bool, value: Float) -> Float:
    """Return the field (n,) that is `value` on the vertices `fixed` (n,) and harmonic elsewhere.

    Vertices that no edges join to a given one stay 0. Raises BadInput for a mesh on which it is not found.
    """
    pairs, weight = edge_weights(x, faces)
    used = ~(fixed[pairs[:, 0]] & fixed[pairs[:, 1]])
    (i, j), w, n = pairs[used].T, weight[used], len(x)
    diagonal = np.maximum(np.bincount(i, w, n) + np.bincount(j, w, n), LEAST)

    def apply(u: Float) -> Float:
        return np.asarray(diagonal * u - np.bincount(i, w * u[j], n) - np.bincount(j, w * u[i], n))

    u = np.where(fixed, value, 0.0)
    residual = np.where(fixed, 0.0, -apply(u))
    what = "smooth field was found on the mesh, from which a limb's rows follow"
    return solve_gradients(lambda p: np.where(fixed, 0.0, apply(p)), diagonal, residual, u, ACCURACY, ROUNDS, what)


def solve_gradients(
    apply: Callable[[Float], Float], diagonal: Float, residual: Float, u: Float, accuracy: float, rounds: int, what: str
) -> Float:
    """Solve by conjugate gradients, preconditioned with the diagonal, from u (n,) or (n, k) on, for each column;
    `apply` multiplies by a symmetric positive definite matrix.

    Ends when each residual is no more than so small a share of its first; raises BadInput, for a mesh that has no
    `what`, after so many rounds. Not a factorisation, whose bits differ between processors.
    """
    z = residual / diagonal
    direction, power = z, (residual * z).sum(axis=0)
    least = accuracy**2 * np.maximum(power, np.finfo(float).tiny / accuracy**2)
    for _ in range(rounds):
        if (power <= least).all():
            return u
        image = apply(direction)
        bent = (direction * image).sum(axis=0)
        step = np.where(power > least, power / np.where(bent > 0.0, bent, 1.0), 0.0)
        u = u + step * direction
        residual = residual - step * image
        z = residual / diagonal
        before, power = power, (residual * z).sum(axis=0)
        direction = z + power / np.where(before > 0.0, before, 1.0) * direction
    raise BadInput(
        f"no {what}", limit=f"{accuracy:g}",
        value=f"a residual of {np.sqrt((power / least).max()) * accuracy:.2g} of the first after {rounds:,} rounds",
        remedy="mend or remesh it: its triangles differ too much in size, or are no more than lines",
    )  # fmt: skip
