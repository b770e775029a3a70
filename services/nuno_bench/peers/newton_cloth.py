"""Newton, on the processor, with cloth that meets cloth and bodies: what the pile and the skirt are stepped by.

https://newton-physics.github.io/newton, examples cloth_twist, cloth_poker_cards and cloth_style3d.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np

from nuno_bench.peers.problem import RATE
from nuno_schemas.fabric import Float, Int

PUSH, DAMP = 1e3, 0.1
"""Stiffness [N/m] and damping [N s/m] of contacts, as in the example cloth_twist."""
GAP, PAIRS_OF_VERTEX, PAIRS_OF_EDGE = 1.5e-3, 64, 128
"""How far beyond the thickness pairs are looked for [m], and how many are kept, as there; its thickness is ours."""


class Newton:
    """A model of what is posed, stepped so many times a frame."""

    def __init__(self, posed: Any, substeps: int, iterations: int) -> None:
        import newton
        import warp

        warp.config.quiet = True
        warp.set_device("cpu")
        self.newton, self.warp, self.remark, self.posed = newton, warp, "", posed
        self.substeps, self.iterations = substeps, iterations
        builder = newton.ModelBuilder(up_axis=newton.Axis.Y, gravity=warp.vec3(*posed.gravity))
        self._pose(builder, posed)
        self.model = builder.finalize()
        self.model.soft_contact_ke, self.model.soft_contact_kd = PUSH, DAMP
        self.model.soft_contact_mu = self.friction
        self.reset()

    @abstractmethod
    def _pose(self, builder: Any, posed: Any) -> None:
        """Put cloth and bodies into the model."""

    @property
    @abstractmethod
    def friction(self) -> float:
        """Coulomb's coefficient of cloth on cloth."""

    @abstractmethod
    def _solver(self) -> Any: ...

    @abstractmethod
    def _step_frame(self) -> None: ...

    def mesh(self, x: Float, faces: Int, density: float, radius: float) -> dict[str, Any]:
        """What Newton's functions take of a mesh at x (n, 3) [m], of particles of a radius [m]."""
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
        """Projective dynamics with self-contact that reaches as far as told, or as it is built."""
        config = self.newton.solvers.SolverStyle3D.Config(iterations=self.iterations)
        solver = self.newton.solvers.SolverStyle3D(self.model, config=config)
        if thickness is not None:
            solver.collision.radius = thickness / 2.0
        return solver

    def reset(self) -> None:
        self.now, self.next, self.control = self.model.state(), self.model.state(), self.model.control()
        self.pipeline = self.newton.CollisionPipeline(self.model)
        self.contacts, self.solver = self.pipeline.contacts(), self._solver()

    def step(self, dt: float) -> None:
        """One step, from forces that are cleared."""
        self.now.clear_forces()
        self.collide_and_solve(dt)

    def collide_and_solve(self, dt: float) -> None:
        self.pipeline.collide(self.now, self.contacts)
        self.solver.step(self.now, self.next, self.control, self.contacts, dt)
        self.now, self.next = self.next, self.now

    def advance(self, seconds: float) -> Float:
        frames = []
        for _ in range(max(1, round(seconds * RATE))):
            self._step_frame()
            frames.append(self.now.particle_q.numpy().astype(np.float64))
        return np.array(frames)
