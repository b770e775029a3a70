"""Peers in Python: our own solvers, a step by NumPy slices, SciPy's methods with the same slices."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from nuno.scene import scene_file, shipped
from nuno.simulation.run import Simulation
from nuno.simulation.solver_selection.cloth import decide
from nuno_bench.machine import cores
from nuno_bench.peers.problem import SCENE, Sheet
from nuno_schemas.fabric import Float


def stiff_sheet(*overrides: str) -> Sheet:
    """The shipped scene's sheet as plain arrays."""
    return plain_sheet(Simulation(scene_file.read(shipped.find(SCENE), overrides), None, None, 1))


def plain_sheet(simulation: Simulation) -> Sheet:
    """The cloth of a simulation at rest."""
    fabric, system = simulation.fabric, simulation.system
    springs = fabric.springs
    assert springs is not None
    k, rest, c = (springs.per_spring(values) for values in (springs.k, springs.rest, springs.c))
    pairs, gravity = springs.pairs().astype(np.int64), np.asarray(system.gravity, np.float64)
    return Sheet(fabric.position.copy(), fabric.mass, fabric.pinned, pairs, k, rest, c, gravity, float(system.damping))


class Nuno:
    """Our kernels and solvers, without services: `solver` as a scene has it, and `accuracy` where it is auto.

    What `auto` tries before it decides is part of the start. What is posed is the scene's own, with `overrides`.
    """

    scene = SCENE

    def __init__(self, posed: object, solver: str, accuracy: str = "", overrides: Sequence[str] = ()) -> None:
        chosen = [f"solver={{{solver}}}", *[f"accuracy={accuracy}"] * bool(accuracy), *overrides]
        self.loaded = decide(scene_file.read(shipped.find(self.scene), chosen))
        self.remark = "" if not accuracy else f"took {self.loaded.integrator.plugin.name}"
        self.reset()

    def reset(self) -> None:
        self.simulation = Simulation.with_bodies(self.loaded, cores())
        self.simulation.present()

    def advance(self, seconds: float) -> Float:
        for _ in self.frames(seconds):
            pass
        return self.simulation.state.x

    def frames(self, seconds: float) -> Iterator[Float]:
        """Yield the positions (n, 3) [m] after each frame of this time; the next frame overwrites them."""
        simulation = self.simulation
        end = simulation.t + seconds
        while simulation.t < end - 1e-9:
            report = simulation.step().report
            if report.status != "ok":
                raise RuntimeError(f"{report.status}: {report.message}")
            yield simulation.state.x


class _Sliced:
    """A grid's springs written with NumPy slices: what a careful user would write without kernels.

    Springs are taken by the six distances that their ends' numbers have, from every vertex i to i + step, of no
    stiffness where the sheet has none. `np.add.at` over pairs of indices takes twice as long on 32 x 32 vertices;
    slices of the grid in two dimensions, which need no springs of no stiffness where its rows end, a third longer on
    64 x 64 and more; and buffers that are kept save nothing but a sixth of undamped steps of 32 x 32.
    """

    def __init__(self, sheet: Sheet) -> None:
        self.remark, self.sheet = "", sheet
        pairs = np.sort(sheet.pairs, axis=1)
        apart, named = pairs[:, 1] - pairs[:, 0], np.stack([sheet.k, sheet.k * sheet.rest, sheet.c])
        self.springs: list[tuple[int, Float]] = []
        """The distance; (3, n - step) stiffness [N/m], that times rest length [N], and damping [N s/m]."""
        for step in np.unique(apart).tolist():
            own, full = np.flatnonzero(apart == step), np.zeros((3, len(sheet.mass) - step))
            full[:, pairs[own, 0]] = named[:, own]
            self.springs.append((step, full))
        self.inverse_mass, self.gravity = sheet.free / sheet.mass, sheet.gravity[:, None] * sheet.free
        self.reset()

    def reset(self) -> None:
        self.x = np.ascontiguousarray(self.sheet.x.T)
        self.v = np.zeros_like(self.x)

    def accelerate(self, x: Float, v: Float, out: Float) -> None:
        """Accelerations [m/s^2] at positions x [m] and velocities v [m/s] into out; all (3, n).

        A spring's force is (k (|d| - L) / |d| + c (u.d) / d^2) d, with d and u what its ends differ by in x and v.
        """
        out[...] = 0.0
        for step, (k, tension, c) in self.springs:
            d = x[:, step:] - x[:, :-step]
            square = np.einsum("ai,ai->i", d, d)
            pull = k - tension / np.sqrt(square) + c * np.einsum("ai,ai->i", v[:, step:] - v[:, :-step], d) / square
            d *= pull
            out[:, :-step] += d
            out[:, step:] -= d
        out *= self.inverse_mass
        out += self.gravity
        out -= (self.sheet.drag * self.sheet.free) * v


class NumPy(_Sliced):
    """Symplectic Euler of a fixed step `dt` [s]."""

    def __init__(self, sheet: Sheet, dt: float) -> None:
        super().__init__(sheet)
        self.dt = dt

    def advance(self, seconds: float) -> Float:
        a = np.empty_like(self.x)
        for _ in range(max(1, round(seconds / self.dt))):
            self.accelerate(self.x, self.v, a)
            self.v += a * self.dt
            self.x += self.v * self.dt
        return self.x.T


class SciPy(_Sliced):
    """`solve_ivp` with relative and absolute tolerance `rtol`."""

    def __init__(self, sheet: Sheet, method: str, rtol: float) -> None:
        super().__init__(sheet)
        self.method, self.rtol = method, rtol

    def advance(self, seconds: float) -> Float:
        from scipy.integrate import solve_ivp

        n = self.sheet.mass.size

        def slopes(t: float, y: Float) -> Float:
            now, out = y.reshape(2, 3, n), np.empty((2, 3, n))
            out[0] = now[1]
            self.accelerate(now[0], now[1], out[1])
            return out.reshape(-1)

        start, how = np.concatenate([self.x.ravel(), self.v.ravel()]), {"rtol": self.rtol, "atol": self.rtol}
        done: Any = solve_ivp(slopes, (0.0, seconds), start, method=self.method, t_eval=[seconds], **how)
        if not done.success:
            raise RuntimeError(done.message)
        return np.asarray(done.y[: 3 * n, -1].reshape(3, n).T)
