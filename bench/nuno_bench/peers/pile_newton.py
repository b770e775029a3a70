"""Newton, on the processor: the pile by its two solvers of cloth that meets cloth.

https://newton-physics.github.io/newton, examples cloth_twist, cloth_poker_cards and cloth_style3d.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np

from nuno_bench.peers import pile as problem
from nuno_bench.peers.newton import Cloth
from nuno_bench.peers.pile import Pile
from nuno_bench.peers.problem import RATE
from nuno_schemas.fabric import Float

DIAGONAL = 0.5
"""Stiffness of folds along diagonals over that of folds along rows: alternating diagonals then bend isotropically."""


class _Pile(Cloth):
    def _pose(self, builder: Any, pile: Pile) -> None:
        mesh = self.mesh(pile.x, pile.faces, problem.DENSITY, problem.THICKNESS)
        self._build(builder, pile, mesh)
        builder.particle_mass[:] = pile.mass.tolist()
        builder.edge_bending_properties[:] = [(k, 0.0) for k in self._folds(*folds(builder)).tolist()]
        place = self.warp.transform(self.warp.vec3(*problem.CENTRE), self.warp.quat_identity())
        builder.add_shape_sphere(-1, xform=place, radius=problem.RADIUS, cfg=self.rough(problem.RUB, problem.FRICTION))

    @abstractmethod
    def _build(self, builder: Any, pile: Pile, mesh: dict[str, Any]) -> None:
        """Cloth of a mesh, as Newton's functions take it."""

    @abstractmethod
    def _folds(self, length: Float, area: Float, share: Float) -> Float:
        """Return the solver's coefficients for the stiffness of folds, from the values of `folds`."""

    @property
    def friction(self) -> float:
        return problem.FRICTION

    def _step_frame(self) -> None:
        self.solver.rebuild_bvh(self.now)
        for _ in range(self.substeps):
            self.now.clear_forces()
            self.step(1.0 / RATE / self.substeps)


class VBD(_Pile):
    """Triangles by vertex block descent, with self-contact.

    A frame is a graph of kernels, as in the examples; its steps are even in number, so that it ends where it began.
    """

    def _build(self, builder: Any, pile: Pile, mesh: dict[str, Any]) -> None:
        builder.add_cloth_mesh(**mesh, tri_ke=problem.SHEAR, tri_ka=problem.SHEAR, tri_kd=0.0)
        builder.color(include_bending=True)

    def _folds(self, length: Float, area: Float, share: Float) -> Float:
        return share * problem.BEND * length / area  # times the length is the stiffness

    def _solver(self) -> Any:
        return self.vbd(problem.THICKNESS)

    def reset(self) -> None:
        super().reset()
        with self.warp.ScopedCapture() as capture:
            super()._step_frame()
        self.graph = capture.graph

    def _step_frame(self) -> None:
        self.warp.capture_launch(self.graph)


class Style3D(_Pile):
    """Triangles by projective dynamics, with its own self-contact, which reaches as far as ours or as it is built."""

    def __init__(self, pile: Pile, substeps: int, iterations: int, own_reach: bool = False) -> None:
        self.own_reach = own_reach
        super().__init__(pile, substeps, iterations)

    def _build(self, builder: Any, pile: Pile, mesh: dict[str, Any]) -> None:
        from newton.solvers import style3d

        self.newton.solvers.SolverStyle3D.register_custom_attributes(builder)
        stretch = self.warp.vec3(problem.STRETCH, problem.STRETCH, problem.SHEAR)
        style3d.add_cloth_mesh(builder, **mesh, panel_verts=pile.x[:, [2, 0]].tolist(), tri_aniso_ke=stretch)

    def _folds(self, length: Float, area: Float, share: Float) -> Float:
        return share * problem.BEND / 3.0  # times 3 length^2 / area is the stiffness

    def _solver(self) -> Any:
        return self.style3d(None if self.own_reach else problem.THICKNESS)


def folds(builder: Any) -> tuple[Float, Float, Float]:
    """Return each edge's length [m], the area of its two triangles [m^2], and its share in bending, 0 at a border.

    The stiffness of a fold is that part of BEND length^2 / area, as nuno_cloth.fabrics.constants has it for triangles.
    """
    x, quads = np.asarray(builder.particle_q, np.float64), np.asarray(builder.edge_indices)
    first, second, i, j = x[quads].transpose(1, 0, 2)
    along = j - i
    area = 0.5 * sum(np.linalg.norm(np.cross(along, corner - i), axis=1) for corner in (first, second))
    straight = np.abs(along).max(axis=1) > 0.99 * np.linalg.norm(along, axis=1)
    share = np.where((quads[:, :2] >= 0).all(axis=1), np.where(straight, 1.0, DIAGONAL), 0.0)
    return np.linalg.norm(along, axis=1), area, share
