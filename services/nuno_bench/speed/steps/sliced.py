"""A grid's springs written with NumPy slices: what a careful user would write without kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno_schemas.fabric import Fabric, Float


class Offset(NamedTuple):
    """Springs from every vertex i to i + step; of no stiffness where the fabric has none.

    k, tension, c   (n - step,) stiffness [N/m], that times the rest length [N], damping [N s/m] or None
    d, u            (3, n - step) buffers
    w, p            (n - step,) buffers
    """

    step: int
    k: Float
    tension: Float
    c: Float | None
    d: Float
    u: Float
    w: Float
    p: Float


class SlicedSprings:
    """The springs of a fabric whose vertices are a grid, by the six distances that their indices have.

    Slices of whole rows of the arrays. `np.add.at` over pairs of indices takes twice as long on 32 x 32
    vertices; slices of the grid in two dimensions, which need no springs of no stiffness where its rows end,
    take a third longer on 64 x 64 and more.
    """

    def __init__(self, fabric: Fabric) -> None:
        assert fabric.springs is not None
        pairs = np.sort(fabric.springs.pairs(), axis=1).astype(np.int64)
        apart = pairs[:, 1] - pairs[:, 0]
        named = [fabric.springs.per_spring(a) for a in (fabric.springs.k, fabric.springs.rest, fabric.springs.c)]
        self.offsets = []
        for step in np.unique(apart).tolist():
            own, number = np.flatnonzero(apart == step), fabric.number - step
            full = np.zeros((3, number))
            full[:, pairs[own, 0]] = [values[own] for values in named]
            k, rest, c = full
            buffers = (np.empty((3, number)), np.empty((3, number)), np.empty(number), np.empty(number))
            self.offsets.append(Offset(step, k.copy(), k * rest, c.copy() if c.any() else None, *buffers))

    def add(self, x: Float, v: Float, force: Float) -> None:
        """Add the forces [N] at positions x [m] and velocities v [m/s]; all (3, n).

        (k (|d| - L) / |d| + c (u.d) / d^2) d, with d and u what a spring's ends differ by in x and v.
        """
        for step, k, tension, c, d, u, w, p in self.offsets:
            np.subtract(x[:, step:], x[:, :-step], out=d)
            np.einsum("ai,ai->i", d, d, out=w)
            if c is not None:
                np.subtract(v[:, step:], v[:, :-step], out=u)
                np.einsum("ai,ai->i", u, d, out=p)
                p *= c
                p /= w
            np.sqrt(w, out=w)
            np.divide(tension, w, out=w)
            np.subtract(k, w, out=w)
            if c is not None:
                w += p
            d *= w
            force[:, :-step] += d
            force[:, step:] -= d


class SlicedCloth:
    """A grid's accelerations: springs, gravity, air drag, pins."""

    def __init__(self, fabric: Fabric, gravity: Float, damping: float = 0.0) -> None:
        """Gravity (3,) [m/s^2]; damping [1/s], a deceleration in proportion to velocity."""
        self.springs = SlicedSprings(fabric)
        free = ~fabric.pinned
        self.inverse_mass = free / fabric.mass
        self.gravity = gravity[:, None] * free
        self.damping = damping * free if damping else None

    def accelerate(self, x: Float, v: Float, out: Float) -> None:
        """Accelerations [m/s^2] into out; all (3, n)."""
        out[...] = 0.0
        self.springs.add(x, v, out)
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
