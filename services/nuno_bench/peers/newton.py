"""Newton, on the processor: the sheet's springs by three of its solvers.

https://newton-physics.github.io/newton, example cloth_hanging.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_bench.peers.problem import Sheet
from nuno_schemas.fabric import Float

RADIUS = 1e-4
"""Of a particle [m]; nothing touches anything."""


class _Newton:
    solver_name: str

    def __init__(self, sheet: Sheet, dt: float, **options: int) -> None:
        import newton
        import warp

        warp.config.quiet = True
        warp.set_device("cpu")
        self.newton, self.warp, self.sheet, self.dt, self.remark = newton, warp, sheet, dt, ""
        self.options = options
        builder = newton.ModelBuilder(up_axis=newton.Axis.Y, gravity=warp.vec3(*sheet.gravity))
        self._build(builder)
        self.model = builder.finalize()
        self.drag = (-sheet.drag * sheet.mass * sheet.free)[:, None].astype(np.float32)
        self.reset()

    def _build(self, builder: Any) -> None:
        sheet, vec3 = self.sheet, self.warp.vec3
        places, still = [vec3(*place) for place in sheet.x], [vec3(0.0, 0.0, 0.0)] * len(sheet.x)
        masses = (sheet.mass * sheet.free).tolist()  # 0 holds a particle
        builder.add_particles(places, still, masses, radius=[RADIUS] * len(sheet.x))
        for (i, j), k, c in zip(sheet.pairs.tolist(), sheet.k.tolist(), sheet.c.tolist(), strict=True):
            builder.add_spring(i, j, k, c, 0.0)

    def reset(self) -> None:
        self.now, self.next = self.model.state(), self.model.state()
        self.control = self.model.control()
        self.solver = getattr(self.newton.solvers, self.solver_name)(self.model, **self.options)

    def advance(self, seconds: float) -> Float:
        for _ in range(max(1, round(seconds / self.dt))):
            # On the processor Warp's arrays are NumPy's: this is the drag's force.
            np.multiply(self.now.particle_qd.numpy(), self.drag, out=self.now.particle_f.numpy())
            self.solver.step(self.now, self.next, self.control, None, self.dt)
            self.now, self.next = self.next, self.now
        x = np.asarray(self.now.particle_q.numpy(), np.float64)
        if not np.isfinite(x).all():
            raise RuntimeError("positions are no longer finite")
        return x


class SemiImplicit(_Newton):
    """Springs, explicit: symplectic Euler."""

    solver_name = "SolverSemiImplicit"


class XPBD(_Newton):
    """Springs as compliant constraints, corrected all at once."""

    solver_name = "SolverXPBD"


class VBD(_Newton):
    """Springs by vertex block descent, in colours of vertices that no spring joins."""

    solver_name = "SolverVBD"

    def _build(self, builder: Any) -> None:
        super()._build(builder)
        builder.set_coloring(colour(len(self.sheet.mass), self.sheet.pairs))


def colour(number: int, pairs: NDArray[np.int64]) -> list[NDArray[np.int32]]:
    """Groups of so many vertices that no pair (s, 2) joins, first come first served."""
    near: list[list[int]] = [[] for _ in range(number)]
    for i, j in pairs.tolist():
        near[i].append(j)
        near[j].append(i)
    colours = np.full(len(near), -1)
    for vertex, others in enumerate(near):
        taken = set(colours[others].tolist())
        colours[vertex] = next(c for c in range(len(others) + 1) if c not in taken)
    return [np.flatnonzero(colours == c).astype(np.int32) for c in range(colours.max() + 1)]
