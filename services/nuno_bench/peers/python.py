"""Peers in Python: our own solvers, a step by NumPy slices, SciPy's methods with the same slices."""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno.choose.cloth import decide
from nuno.scene import scene_file
from nuno.simulation.run import Simulation
from nuno_bench.machine import cores
from nuno_bench.peers.problem import Sheet
from nuno_bench.speed.steps.sliced import SlicedCloth
from nuno_bench.speed.steps.stiff import SCENE
from nuno_schemas.fabric import Fabric, Float, Springs


class Nuno:
    """Our kernels and solvers, without services: `solver` as a scene has it, and `accuracy` where it is auto.

    What `auto` tries before it decides is part of the start.
    """

    def __init__(self, sheet: Sheet, solver: str, accuracy: str = "") -> None:
        overrides = [f"solver={{{solver}}}"] + [f"accuracy={accuracy}"] * bool(accuracy)
        self.loaded = decide(scene_file.read(scene_file.find(SCENE), overrides))
        self.remark = "" if not accuracy else f"took {self.loaded.integrator.plugin.name}"
        self.reset()

    def reset(self) -> None:
        self.simulation = Simulation(self.loaded, None, None, cores())
        self.simulation.measure(None)

    def advance(self, seconds: float) -> Float:
        simulation = self.simulation
        while simulation.t < seconds - 1e-9:
            report = simulation.advance(None, None).report
            if report.status != "ok":
                raise RuntimeError(f"{report.status}: {report.message}")
        return simulation.state.x


class _Sliced:
    def __init__(self, sheet: Sheet) -> None:
        self.remark, self.sheet = "", sheet
        self.cloth = SlicedCloth(_fabric(sheet), sheet.gravity, float(sheet.drag))
        self.reset()

    def reset(self) -> None:
        self.x = np.ascontiguousarray(self.sheet.x.T)
        self.v = np.zeros_like(self.x)


class NumPy(_Sliced):
    """Symplectic Euler of a fixed step `dt` [s]."""

    def __init__(self, sheet: Sheet, dt: float) -> None:
        super().__init__(sheet)
        self.dt = dt

    def advance(self, seconds: float) -> Float:
        self.cloth.advance(self.x, self.v, max(1, round(seconds / self.dt)), self.dt)
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
            self.cloth.accelerate(now[0], now[1], out[1])
            return out.reshape(-1)

        start, how = np.concatenate([self.x.ravel(), self.v.ravel()]), {"rtol": self.rtol, "atol": self.rtol}
        done: Any = solve_ivp(slopes, (0.0, seconds), start, method=self.method, t_eval=[seconds], **how)
        if not done.success:
            raise RuntimeError(done.message)
        return np.asarray(done.y[: 3 * n, -1].reshape(3, n).T)


def _fabric(sheet: Sheet) -> Fabric:
    """The sheet as our own data, a run of one spring each."""
    one, kind = np.ones(len(sheet.pairs), np.int32), np.zeros(len(sheet.pairs), np.int8)
    springs = Springs(sheet.pairs.astype(np.int32), one, one, sheet.k, sheet.rest, sheet.c, kind)
    none = np.zeros((0, 3), np.int32)
    return Fabric("sheet", sheet.x, np.zeros_like(sheet.x), sheet.mass, sheet.pinned, none, springs)
