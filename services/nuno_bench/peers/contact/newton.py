"""Newton, on the processor: the pile by its two solvers of cloth that meets cloth.

https://newton-physics.github.io/newton, examples cloth_twist, cloth_poker_cards and cloth_style3d.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np

from nuno_bench.peers.contact.problem import (
    BEND,
    CENTRE,
    DENSITY,
    FRICTION,
    RADIUS,
    RATE,
    RUB,
    SHEAR,
    STRETCH,
    THICKNESS,
    Pile,
)
from nuno_schemas.fabric import Float

PUSH, DAMP = 1e3, 0.1
"""Stiffness [N/m] and damping [N s/m] of contacts, as in the example cloth_twist."""
GAP, PAIRS_OF_VERTEX, PAIRS_OF_EDGE = 1.5e-3, 64, 128
"""How far beyond the thickness pairs are looked for [m], and how many are kept, as there; its thickness is ours."""
DIAGONAL = 0.5
"""Of the stiffness of folds along rows, so that triangles whose diagonals alternate bend alike in all directions."""


class _Newton:
    def __init__(self, pile: Pile, substeps: int, iterations: int) -> None:
        import newton
        import warp

        warp.config.quiet = True
        warp.set_device("cpu")
        self.newton, self.warp, self.remark = newton, warp, ""
        self.substeps, self.iterations = substeps, iterations
        builder = newton.ModelBuilder(up_axis=newton.Axis.Y, gravity=warp.vec3(*pile.gravity))
        still = warp.vec3(0.0, 0.0, 0.0)
        mesh = {
            "pos": still, "rot": warp.quat_identity(), "vel": still, "scale": 1.0, "density": DENSITY,
            "vertices": pile.x.tolist(), "indices": pile.faces.ravel().tolist(), "particle_radius": THICKNESS,
        }  # fmt: skip
        self._build(builder, pile, mesh)
        builder.particle_mass[:] = pile.mass.tolist()
        builder.edge_bending_properties[:] = [(k, 0.0) for k in self._folds(*folds(builder)).tolist()]
        # Of two coefficients of friction it takes the root of the product.
        rough = newton.ModelBuilder.ShapeConfig(mu=RUB**2 / FRICTION, ke=PUSH, kd=DAMP)
        place = warp.transform(warp.vec3(*CENTRE), warp.quat_identity())
        builder.add_shape_sphere(-1, xform=place, radius=RADIUS, cfg=rough)
        self.model = builder.finalize()
        self.model.soft_contact_ke, self.model.soft_contact_kd, self.model.soft_contact_mu = PUSH, DAMP, FRICTION
        self.reset()

    @abstractmethod
    def _build(self, builder: Any, pile: Pile, mesh: dict[str, Any]) -> None:
        """Cloth of a mesh, as Newton's functions take it."""

    @abstractmethod
    def _folds(self, length: Float, area: Float, share: Float) -> Float:
        """What the solver has for the stiffness of folds: see `folds`."""

    @abstractmethod
    def _solver(self) -> Any: ...

    def reset(self) -> None:
        self.now, self.next, self.control = self.model.state(), self.model.state(), self.model.control()
        self.pipeline = self.newton.CollisionPipeline(self.model)
        self.contacts, self.solver = self.pipeline.contacts(), self._solver()

    def _step_frame(self) -> None:
        self.solver.rebuild_bvh(self.now)
        for _ in range(self.substeps):
            self.now.clear_forces()
            self.pipeline.collide(self.now, self.contacts)
            self.solver.step(self.now, self.next, self.control, self.contacts, 1.0 / RATE / self.substeps)
            self.now, self.next = self.next, self.now

    def advance(self, seconds: float) -> Float:
        frames = []
        for _ in range(max(1, round(seconds * RATE))):
            self._step_frame()
            frames.append(self.now.particle_q.numpy().astype(np.float64))
        return np.array(frames)


class VBD(_Newton):
    """Triangles by vertex block descent, with self-contact.

    A frame is a graph of kernels, as in the examples; its steps are even in number, so that it ends where it began.
    """

    def _build(self, builder: Any, pile: Pile, mesh: dict[str, Any]) -> None:
        builder.add_cloth_mesh(**mesh, tri_ke=SHEAR, tri_ka=SHEAR, tri_kd=0.0)
        builder.color(include_bending=True)

    def _folds(self, length: Float, area: Float, share: Float) -> Float:
        return share * BEND * length / area  # times the length is the stiffness

    def _solver(self) -> Any:
        return self.newton.solvers.SolverVBD(
            self.model, iterations=self.iterations, particle_enable_self_contact=True,
            particle_self_contact_margin=THICKNESS, particle_self_contact_gap=GAP,
            particle_vertex_contact_buffer_size=PAIRS_OF_VERTEX, particle_edge_contact_buffer_size=PAIRS_OF_EDGE,
        )  # fmt: skip

    def reset(self) -> None:
        super().reset()
        with self.warp.ScopedCapture() as capture:
            super()._step_frame()
        self.graph = capture.graph

    def _step_frame(self) -> None:
        self.warp.capture_launch(self.graph)


class Style3D(_Newton):
    """Triangles by projective dynamics, with its own self-contact, which reaches as far as ours or as it is built."""

    def __init__(self, pile: Pile, substeps: int, iterations: int, own_reach: bool = False) -> None:
        self.own_reach = own_reach
        super().__init__(pile, substeps, iterations)

    def _build(self, builder: Any, pile: Pile, mesh: dict[str, Any]) -> None:
        from newton.solvers import style3d

        self.newton.solvers.SolverStyle3D.register_custom_attributes(builder)
        stretch = self.warp.vec3(STRETCH, STRETCH, SHEAR)
        style3d.add_cloth_mesh(builder, **mesh, panel_verts=pile.x[:, [2, 0]].tolist(), tri_aniso_ke=stretch)

    def _folds(self, length: Float, area: Float, share: Float) -> Float:
        return share * BEND / 3.0  # times 3 length^2 / area is the stiffness

    def _solver(self) -> Any:
        config = self.newton.solvers.SolverStyle3D.Config(iterations=self.iterations)
        solver = self.newton.solvers.SolverStyle3D(self.model, config=config)
        if not self.own_reach:
            solver.collision.radius = THICKNESS / 2.0
        return solver


def folds(builder: Any) -> tuple[Float, Float, Float]:
    """Of each edge its length [m], the area of its two triangles [m^2], and its part in bending, none at a border.

    The stiffness of a fold is that part of BEND length^2 / area, as nuno_cloth.fabrics.constants has it for triangles.
    """
    x, quads = np.asarray(builder.particle_q, np.float64), np.asarray(builder.edge_indices)
    first, second, i, j = x[quads].transpose(1, 0, 2)
    along = j - i
    area = 0.5 * sum(np.linalg.norm(np.cross(along, corner - i), axis=1) for corner in (first, second))
    straight = np.abs(along).max(axis=1) > 0.99 * np.linalg.norm(along, axis=1)
    share = np.where((quads[:, :2] >= 0).all(axis=1), np.where(straight, 1.0, DIAGONAL), 0.0)
    return np.linalg.norm(along, axis=1), area, share
