"""A grid's springs written with NumPy slices: what a careful user would write without kernels."""

from __future__ import annotations

import numpy as np

from nuno_schemas.fabric import Fabric, Float


class SlicedCloth:
    """A grid's accelerations: springs, gravity, air drag, pins.

    Springs are taken by the six distances that their ends' numbers have, from every vertex i to i + step, of no
    stiffness where the fabric has none. `np.add.at` over pairs of indices takes twice as long on 32 x 32 vertices;
    slices of the grid in two dimensions, which need no springs of no stiffness where its rows end, a third longer on
    64 x 64 and more; and buffers that are kept save nothing but a sixth of undamped steps of 32 x 32.
    """

    def __init__(self, fabric: Fabric, gravity: Float, damping: float = 0.0) -> None:
        """Gravity (3,) [m/s^2]; damping [1/s], a deceleration in proportion to velocity."""
        assert fabric.springs is not None
        pairs = np.sort(fabric.springs.pairs(), axis=1).astype(np.int64)
        apart = pairs[:, 1] - pairs[:, 0]
        named = [fabric.springs.per_spring(a) for a in (fabric.springs.k, fabric.springs.rest, fabric.springs.c)]
        self.springs: list[tuple[int, Float, Float, Float | None]] = []
        """The distance; (n - step,) stiffness [N/m], that times rest length [N], damping [N s/m] where there is any."""
        for step in np.unique(apart).tolist():
            own, full = np.flatnonzero(apart == step), np.zeros((3, fabric.number - step))
            full[:, pairs[own, 0]] = [values[own] for values in named]
            k, rest, c = full
            self.springs.append((step, k, k * rest, c if c.any() else None))
        free = ~fabric.pinned
        self.inverse_mass, self.gravity = free / fabric.mass, gravity[:, None] * free
        self.damping = damping * free if damping else None

    def accelerate(self, x: Float, v: Float, out: Float) -> None:
        """Accelerations [m/s^2] at positions x [m] and velocities v [m/s] into out; all (3, n).

        A spring's force is (k (|d| - L) / |d| + c (u.d) / d^2) d, with d and u what its ends differ by in x and v.
        """
        out[...] = 0.0
        for step, k, tension, c in self.springs:
            d = x[:, step:] - x[:, :-step]
            square = np.einsum("ai,ai->i", d, d)
            pull = k - tension / np.sqrt(square)
            if c is not None:
                pull += c * np.einsum("ai,ai->i", v[:, step:] - v[:, :-step], d) / square
            d *= pull
            out[:, :-step] += d
            out[:, step:] -= d
        out *= self.inverse_mass
        out += self.gravity
        if self.damping is not None:
            out -= self.damping * v

    def advance(self, x: Float, v: Float, steps: int, dt: float) -> None:
        """`steps` of symplectic Euler of dt [s] on x and v (3, n), in place."""
        a = np.empty_like(x)
        for _ in range(steps):
            self.accelerate(x, v, a)
            a *= dt
            v += a
            x += v * dt
