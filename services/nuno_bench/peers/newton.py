"""Newton, on the processor: the sheet's springs by three of its solvers, its fabric by Style3D.

https://newton-physics.github.io/newton, examples cloth_hanging and cloth_style3d.
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
    def __init__(self, sheet: Sheet, dt: float) -> None:
        import newton
        import warp

        warp.config.quiet = True
        warp.set_device("cpu")
        self.newton, self.warp, self.sheet, self.dt, self.remark = newton, warp, sheet, dt, ""
        self.contacts: Any = None
        builder = newton.ModelBuilder(up_axis=newton.Axis.Y, gravity=warp.vec3(*sheet.gravity))
        self._build(builder)
        self.model = builder.finalize()
        self.drag = (-float(sheet.drag) * sheet.mass * sheet.free)[:, None].astype(np.float32)
        self.reset()

    def _build(self, builder: Any) -> None:
        sheet, vec3 = self.sheet, self.warp.vec3
        places, still = [vec3(*place) for place in sheet.x], [vec3(0.0, 0.0, 0.0)] * len(sheet.x)
        builder.add_particles(places, still, self._masses(), radius=[RADIUS] * len(sheet.x))
        for (i, j), k, c in zip(sheet.pairs.tolist(), sheet.k.tolist(), sheet.c.tolist(), strict=True):
            builder.add_spring(i, j, k, c, 0.0)

    def _masses(self) -> list[float]:
        """0 holds a particle."""
        masses: list[float] = (self.sheet.mass * self.sheet.free).tolist()
        return masses

    def _solver(self) -> Any:
        raise NotImplementedError

    def reset(self) -> None:
        self.now, self.next = self.model.state(), self.model.state()
        self.control, self.solver = self.model.control(), self._solver()

    def advance(self, seconds: float) -> Float:
        for _ in range(max(1, round(seconds / self.dt))):
            # On the processor Warp's arrays are NumPy's: this is the drag's force.
            np.multiply(self.now.particle_qd.numpy(), self.drag, out=self.now.particle_f.numpy())
            self.solver.step(self.now, self.next, self.control, self.contacts, self.dt)
            self.now, self.next = self.next, self.now
        x = np.asarray(self.now.particle_q.numpy(), np.float64)
        if not np.isfinite(x).all():
            raise RuntimeError("positions are no longer finite")
        return x


class SemiImplicit(_Newton):
    """Springs, explicit: symplectic Euler."""

    def _solver(self) -> Any:
        return self.newton.solvers.SolverSemiImplicit(self.model)


class XPBD(_Newton):
    """Springs as compliant constraints, corrected all at once."""

    def __init__(self, sheet: Sheet, dt: float, iterations: int) -> None:
        self.iterations = iterations
        super().__init__(sheet, dt)

    def _solver(self) -> Any:
        return self.newton.solvers.SolverXPBD(self.model, iterations=self.iterations)


class VBD(_Newton):
    """Springs by vertex block descent, in colours of vertices that no spring joins."""

    def __init__(self, sheet: Sheet, dt: float, iterations: int) -> None:
        self.iterations = iterations
        super().__init__(sheet, dt)

    def _build(self, builder: Any) -> None:
        super()._build(builder)
        builder.set_coloring(colour(self.sheet))

    def _solver(self) -> Any:
        return self.newton.solvers.SolverVBD(self.model, iterations=self.iterations)


class Style3D(_Newton):
    """Triangles of a woven fabric, by projective dynamics with conjugate gradients."""

    def __init__(self, sheet: Sheet, dt: float, iterations: int, linear_iterations: int) -> None:
        self.config = {"iterations": iterations, "linear_iterations": linear_iterations}
        super().__init__(sheet, dt)

    def _build(self, builder: Any) -> None:
        from newton.solvers import style3d

        sheet, vec3 = self.sheet, self.warp.vec3
        self.newton.solvers.SolverStyle3D.register_custom_attributes(builder)
        k, s, b = sorted(np.unique(sheet.k).tolist(), reverse=True)
        area = 0.5 * np.abs(np.linalg.det(sheet.flat[sheet.faces[:, 1:]] - sheet.flat[sheet.faces[:, :1]])).sum()
        style3d.add_cloth_mesh(
            builder,
            pos=vec3(0.0, 0.0, 0.0),
            rot=self.warp.quat_identity(),
            vel=vec3(0.0, 0.0, 0.0),
            vertices=[vec3(*place) for place in sheet.x],
            indices=sheet.faces.reshape(-1).tolist(),
            density=float(sheet.mass.sum() / area),
            panel_verts=[self.warp.vec2(*place) for place in sheet.flat],
            tri_aniso_ke=vec3(k + s + 4.0 * b, k + s + 4.0 * b, s),
            edge_aniso_ke=vec3(0.0, 0.0, 0.0),
            particle_radius=RADIUS,
        )
        builder.particle_mass[:] = self._masses()

    def _solver(self) -> Any:
        solvers = self.newton.solvers
        flags = self.model.particle_flags.numpy()
        flags[self.sheet.pinned] &= ~int(self.newton.ParticleFlags.ACTIVE)
        self.model.particle_flags.assign(flags)
        solver = solvers.SolverStyle3D(self.model, config=solvers.SolverStyle3D.Config(**self.config))
        solver.collision = None
        return solver


def colour(sheet: Sheet) -> list[NDArray[np.int32]]:
    """Groups of vertices that no spring joins, first come first served."""
    near: list[list[int]] = [[] for _ in sheet.mass]
    for i, j in sheet.pairs.tolist():
        near[i].append(j)
        near[j].append(i)
    colours = np.full(len(near), -1)
    for vertex, others in enumerate(near):
        taken = set(colours[others].tolist())
        colours[vertex] = next(c for c in range(len(others) + 1) if c not in taken)
    return [np.flatnonzero(colours == c).astype(np.int32) for c in range(colours.max() + 1)]
