"""The same explicit step written with NumPy slices: what a careful user would write without kernels."""

from __future__ import annotations

import numpy as np

from nuno_schemas.fabric import Float

# (rows, columns) from a spring's first to its second end, and the class of its constants.
OFFSETS = ((0, 1, 0), (1, 0, 0), (1, 1, 1), (1, -1, 1), (0, 2, 2), (2, 0, 2))


def spring_forces(x: Float, stiffness: tuple[float, float, float], edge: float) -> Float:
    """(3, rows, columns) forces [N] of a square grid's 12 springs a vertex; edge is its spacing [m]."""
    force = np.zeros_like(x)
    for down, right, kind in OFFSETS:
        near = (slice(None), slice(0, -down or None), slice(max(0, -right), -right if right > 0 else None))
        far = (slice(None), slice(down, None), slice(max(0, right), right if right < 0 else None))
        d = x[far] - x[near]
        length = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        d *= stiffness[kind] * (1.0 - edge * np.hypot(down, right) / length)
        force[near] += d
        force[far] -= d
    return force


def advance(
    x: Float, v: Float, inverse_mass: Float, stiffness: tuple[float, float, float], edge: float, steps: int, dt: float
) -> None:
    """`steps` of symplectic Euler on x, v (3, rows, columns); inverse_mass (rows, columns), 0 where pinned."""
    for _ in range(steps):
        a = spring_forces(x, stiffness, edge)
        a *= inverse_mass
        a[1] -= 9.81 * (inverse_mass > 0)
        v += dt * a
        x += dt * v
