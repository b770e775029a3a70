"""Newton, on the processor: the sheet's springs by three of its solvers, and what the pile and the skirt share.

https://newton-physics.github.io/newton, examples cloth_hanging, cloth_twist, cloth_poker_cards and cloth_style3d.
"""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_bench.peers.problem import RATE, Sheet
from nuno_schemas.fabric import Float, Int

RADIUS = 1e-4
"""Of a particle of the sheet [m]; nothing touches anything."""
PUSH, DAMP = 1e3, 0.1
"""Stiffness [N/m] and damping [N s/m] of contacts, as in the example cloth_twist."""
GAP, PAIRS_OF_VERTEX, PAIRS_OF_EDGE = 1.5e-3, 64, 128
"""Reach of the search for pairs beyond the thickness [m], and sizes of their buffers, as in cloth_twist."""


class Newton:
    """A model of what is posed."""

    def __init__(self, posed: Any) -> None:
        import newton
        import warp

        warp.config.quiet = True
        warp.set_device("cpu")
        self.newton, self.warp, self.posed, self.remark = newton, warp, posed, ""
        builder = newton.ModelBuilder(up_axis=newton.Axis.Y, gravity=warp.vec3(*posed.gravity))
        self._pose(builder, posed)
        self.model = builder.finalize()
        self.reset()

    @abstractmethod
    def _pose(self, builder: Any, posed: Any) -> None:
        """Put cloth and bodies into the model."""

    @abstractmethod
    def _solver(self) -> Any: ...

    def reset(self) -> None:
        self.now, self.next, self.control = self.model.state(), self.model.state(), self.model.control()
        self.solver = self._solver()

    @cached_property
    def _drag(self) -> Float:
        """(n, 1) its force over velocity [N s/m]."""
        sheet: Sheet = self.posed
        return np.asarray((-sheet.drag * sheet.mass * sheet.free)[:, None].astype(np.float32))

    def drag(self) -> None:
        """Put the drag into the forces: on the processor Warp's arrays are NumPy's."""
        np.multiply(self.now.particle_qd.numpy(), self._drag, out=self.now.particle_f.numpy())

    def solve(self, contacts: Any, dt: float) -> None:
        self.solver.step(self.now, self.next, self.control, contacts, dt)
        self.now, self.next = self.next, self.now


class _Springs(Newton):
    solver_name: str

    def __init__(self, sheet: Sheet, dt: float, **options: int) -> None:
        self.dt, self.options = dt, options
        super().__init__(sheet)

    def _pose(self, builder: Any, sheet: Sheet) -> None:
        vec3 = self.warp.vec3
        places, still = [vec3(*place) for place in sheet.x], [vec3(0.0, 0.0, 0.0)] * len(sheet.x)
        masses = (sheet.mass * sheet.free).tolist()  # 0 holds a particle
        builder.add_particles(places, still, masses, radius=[RADIUS] * len(sheet.x))
        for (i, j), k, c in zip(sheet.pairs.tolist(), sheet.k.tolist(), sheet.c.tolist(), strict=True):
            builder.add_spring(i, j, k, c, 0.0)

    def _solver(self) -> Any:
        return getattr(self.newton.solvers, self.solver_name)(self.model, **self.options)

    def advance(self, seconds: float) -> Float:
        for _ in range(max(1, round(seconds / self.dt))):
            self.drag()
            self.solve(None, self.dt)
        x = np.asarray(self.now.particle_q.numpy(), np.float64)
        if not np.isfinite(x).all():
            raise RuntimeError("positions are no longer finite")
        return x


class SemiImplicit(_Springs):
    """Springs, explicit: symplectic Euler."""

    solver_name = "SolverSemiImplicit"


class XPBD(_Springs):
    """Springs as compliant constraints, corrected all at once."""

    solver_name = "SolverXPBD"


class VBD(_Springs):
    """Springs by vertex block descent, in colours of vertices that no spring joins."""

    solver_name = "SolverVBD"

    def _pose(self, builder: Any, sheet: Sheet) -> None:
        super()._pose(builder, sheet)
        builder.set_coloring(colour(len(sheet.mass), sheet.pairs))


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


class Cloth(Newton):
    """Cloth that meets cloth and bodies, stepped so many times a frame."""

    def __init__(self, posed: Any, substeps: int, iterations: int) -> None:
        self.substeps, self.iterations = substeps, iterations
        super().__init__(posed)

    @property
    @abstractmethod
    def friction(self) -> float:
        """Coulomb's coefficient of cloth on cloth."""

    @abstractmethod
    def _step_frame(self) -> None: ...

    def mesh(self, x: Float, faces: Int, density: float, radius: float) -> dict[str, Any]:
        """Return the arguments of Newton's functions for a mesh at x (n, 3) [m] of particles of a radius [m]."""
        still = self.warp.vec3(0.0, 0.0, 0.0)
        return {
            "pos": still, "rot": self.warp.quat_identity(), "vel": still, "scale": 1.0, "density": density,
            "vertices": x.tolist(), "indices": faces.ravel().tolist(), "particle_radius": radius,
        }  # fmt: skip

    def rough(self, rub: float, friction: float) -> Any:
        """A body's surface: of two coefficients of friction Newton takes the root of the product."""
        return self.newton.ModelBuilder.ShapeConfig(mu=rub**2 / friction, ke=PUSH, kd=DAMP)

    def vbd(self, thickness: float, **more: Any) -> Any:
        """Vertex block descent with self-contact."""
        return self.newton.solvers.SolverVBD(
            self.model, iterations=self.iterations, particle_enable_self_contact=True,
            particle_self_contact_margin=thickness, particle_self_contact_gap=GAP,
            particle_vertex_contact_buffer_size=PAIRS_OF_VERTEX, particle_edge_contact_buffer_size=PAIRS_OF_EDGE,
            **more,
        )  # fmt: skip

    def style3d(self, thickness: float | None) -> Any:
        """Projective dynamics with self-contact that reaches as far as a thickness, or as it is built."""
        config = self.newton.solvers.SolverStyle3D.Config(iterations=self.iterations)
        solver = self.newton.solvers.SolverStyle3D(self.model, config=config)
        if thickness is not None:
            solver.collision.radius = thickness / 2.0
        return solver

    def reset(self) -> None:
        self.model.soft_contact_ke, self.model.soft_contact_kd = PUSH, DAMP
        self.model.soft_contact_mu = self.friction
        self.pipeline = self.newton.CollisionPipeline(self.model)
        self.contacts = self.pipeline.contacts()
        super().reset()

    def step(self, dt: float) -> None:
        self.pipeline.collide(self.now, self.contacts)
        self.solve(self.contacts, dt)

    def advance(self, seconds: float) -> Float:
        frames = []
        for _ in range(max(1, round(seconds * RATE))):
            self._step_frame()
            frames.append(self.now.particle_q.numpy().astype(np.float64))
        return np.array(frames)
