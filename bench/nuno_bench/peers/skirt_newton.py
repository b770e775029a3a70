"""Newton, on the processor: the skirt by its three solvers that hold cloth and bodies that move.

https://newton-physics.github.io/newton, examples cloth_twist, cloth_franka and cloth_style3d.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno.collision.crossings import mesh_of
from nuno_bench.peers.newton import Cloth, colour
from nuno_bench.peers.problem import RATE
from nuno_bench.peers.skirt import Skirt
from nuno_schemas.fabric import Float


class _Skirt(Cloth):
    """Bodies are kinematic, and they and the waist are put in place in every step."""

    rebuilds = True
    """Whether the solver has a tree of its cloth that is built anew every frame."""

    @property
    def friction(self) -> float:
        return float(self.posed.friction)

    def _pose(self, builder: Any, skirt: Skirt) -> None:
        self._cloth(builder, skirt)
        builder.particle_mass[:] = (skirt.mass * skirt.free).tolist()  # 0 holds a particle
        builder.particle_radius[:] = [skirt.thickness / 2.0] * len(skirt.mass)
        warp, shape, rough = self.warp, skirt.geometry, self.rough(skirt.rub, skirt.friction)
        rough.density = 0.0
        start = self._transforms(*skirt.places(0, 0.0))
        for place in start.tolist():
            builder.add_body(xform=warp.transform(place[:3], place[3:]), is_kinematic=True)
        for i, frame in enumerate(shape.frame.tolist()):
            along = shape.b[i] - shape.a[i]
            half = float(np.linalg.norm(along)) / 2.0
            turn = _from_z(along / (2.0 * half)) if half > 0.0 else np.array([0.0, 0.0, 0.0, 1.0])
            at = warp.transform((0.5 * (shape.a[i] + shape.b[i])).tolist(), turn.tolist())
            builder.add_shape_capsule(frame, xform=at, radius=float(shape.radius[i]), half_height=half, cfg=rough)

    def _cloth(self, builder: Any, skirt: Skirt) -> None:
        """Add the skirt's springs and hinges; triangles and edges of no stiffness carry contact."""
        builder.add_cloth_mesh(
            **self.mesh(skirt.flat, skirt.faces, 1.0, 0.0), tri_ke=0.0, tri_ka=0.0, tri_kd=0.0, edge_ke=0.0, edge_kd=0.0
        )
        for i, j, k, c in zip(*skirt.pairs.T.tolist(), skirt.k.tolist(), skirt.c.tolist(), strict=True):
            builder.add_spring(i, j, k, c, 0.0)
        builder.spring_rest_length[:] = skirt.rest.tolist()
        own = {tuple(sorted(quad)) for quad in skirt.quads[:, :2].tolist()}
        bare = [quad for quad in np.asarray(builder.edge_indices).tolist() if tuple(sorted(quad[2:])) not in own]
        builder.particle_q[:] = [self.warp.vec3(*place) for place in skirt.flat.tolist()]
        for name in ("edge_indices", "edge_rest_angle", "edge_rest_length", "edge_bending_properties"):
            getattr(builder, name).clear()
        bends = skirt.quads[:, [2, 3, 0, 1]].tolist()
        for quad, stiffness in [*zip(bends, self._folds(skirt).tolist(), strict=True), *((quad, 0.0) for quad in bare)]:
            builder.add_edge(*quad, rest=0.0, edge_ke=stiffness, edge_kd=0.0)

    def _folds(self, skirt: Skirt) -> Float:
        """Return the solver's coefficients for the stiffness (h,) of hinges."""
        return skirt.bend

    def _transforms(self, turned: Float, moved: Float) -> Float:
        """(f, 7) as Newton has them: place, then the quaternion with its real part last."""
        return np.column_stack([moved, turned[:, 1:], turned[:, :1]])

    def reset(self) -> None:
        super().reset()
        self.frame = 0
        for state in (self.now, self.next):
            state.particle_q.numpy()[:], state.particle_qd.numpy()[:] = self.posed.x, self.posed.v

    def _step_frame(self) -> None:
        if self.rebuilds:
            self.solver.rebuild_bvh(self.now)
        dt = 1.0 / RATE / self.substeps
        # On the processor Warp's arrays are NumPy's.
        for step in range(self.substeps):
            before, after = (self.posed.places(self.frame, (step + k) / self.substeps) for k in (0, 1))
            old, new = (self._transforms(*places) for places in (before, after))
            self.now.body_q.numpy()[:], self.next.body_q.numpy()[:] = old, new
            self.now.particle_q.numpy()[self.posed.pinned] = self.posed.waist(*after)
            self.now.clear_forces()
            self.drag()
            self.step(dt)
        self.frame += 1


class XPBD(_Skirt):
    """Springs and hinges as compliant constraints, corrected all at once; cloth meets cloth as balls at vertices."""

    rebuilds = False

    def _solver(self) -> Any:
        return self.newton.solvers.SolverXPBD(self.model, iterations=self.iterations)


class VBD(_Skirt):
    """Springs and hinges by vertex block descent, with self-contact."""

    def _cloth(self, builder: Any, skirt: Skirt) -> None:
        super()._cloth(builder, skirt)
        joined: list[Any] = [skirt.pairs, mesh_of(skirt.faces).edges]
        joined += [skirt.quads[:, [i, j]] for i in range(4) for j in range(i)]
        builder.set_coloring(colour(len(skirt.mass), np.unique(np.sort(np.concatenate(joined), axis=1), axis=0)))

    def _folds(self, skirt: Skirt) -> Float:
        start, end = skirt.flat[skirt.quads[:, 0]], skirt.flat[skirt.quads[:, 1]]
        return np.asarray(skirt.bend / np.linalg.norm(end - start, axis=1))  # times the length is the stiffness

    def _solver(self) -> Any:
        return self.vbd(self.posed.thickness, integrate_with_external_rigid_solver=True)


class Style3D(_Skirt):
    """Triangles by projective dynamics, flat as their springs are long, with its own self-contact."""

    def _cloth(self, builder: Any, skirt: Skirt) -> None:
        from newton.solvers import style3d

        self.newton.solvers.SolverStyle3D.register_custom_attributes(builder)
        panels, (warp, weft, shear) = lay_flat(skirt), skirt.fabric
        style3d.add_cloth_mesh(
            builder, **self.mesh(skirt.flat, skirt.faces, 1.0, 0.0), panel_verts=panels.reshape(-1, 2).tolist(),
            panel_indices=list(range(3 * len(panels))), tri_aniso_ke=self.warp.vec3(weft, warp, shear),
        )  # fmt: skip
        builder.edge_bending_properties[:] = [(k, 0.0) for k in _of_edges(skirt, builder, panels).tolist()]

    def _solver(self) -> Any:
        return self.style3d(self.posed.thickness)


def lay_flat(skirt: Skirt) -> Float:
    """(f, 3, 2) [m] corners of every triangle by itself, its sides as long as its springs at rest, weft along the first
    axis: the ring has no flat form as a whole that closes.
    """
    length = {tuple(sorted(pair)): rest for pair, rest in zip(skirt.pairs.tolist(), skirt.rest.tolist(), strict=True)}
    found = np.zeros((len(skirt.faces), 3, 2))
    for corners, face in zip(found, skirt.faces.tolist(), strict=True):
        # a and b are the two in one row, c the third.
        a = next(i for i in range(3) if face[i] // skirt.columns == face[i - 2] // skirt.columns)
        b, c = (a + 1) % 3, (a + 2) % 3
        ab, bc, ca = (length[tuple(sorted((face[i], face[j])))] for i, j in ((a, b), (b, c), (c, a)))
        along = (ab * ab + ca * ca - bc * bc) / (2.0 * ab)
        corners[b], corners[c] = (ab, 0.0), (along, np.sqrt(ca * ca - along * along))
    return found


def _of_edges(skirt: Skirt, builder: Any, panels: Float) -> Float:
    """Style3D's bending (e,) of the mesh's edges: times 3 length^2 over the area of both triangles it is a stiffness.

    A hinge along the diagonal that a cell's triangles do not have is put on the one that they have.
    """
    stiffness: dict[tuple[int, ...], float] = {}
    for quad, k in zip(skirt.quads[:, :2].tolist(), skirt.bend.tolist(), strict=True):
        stiffness[tuple(sorted(quad))] = stiffness.get(tuple(sorted(quad)), 0.0) + k
    one, two = panels[:, 1] - panels[:, 0], panels[:, 2] - panels[:, 0]
    of_edge: dict[tuple[int, ...], float] = {}
    areas = 0.5 * np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])
    for face, size in zip(skirt.faces.tolist(), areas.tolist(), strict=True):
        for i in range(3):
            side = tuple(sorted((face[i], face[i - 1])))
            of_edge[side] = of_edge.get(side, 0.0) + size
    found = []
    for *opposite, i, j in np.asarray(builder.edge_indices).tolist():
        k = stiffness.get(tuple(sorted((i, j))), stiffness.get(tuple(sorted(opposite)), 0.0))
        square = float(((skirt.flat[i] - skirt.flat[j]) ** 2).sum())
        found.append(k * of_edge[tuple(sorted((i, j)))] / (3.0 * square) if min(opposite) >= 0 else 0.0)
    return np.array(found)


def _from_z(direction: Float) -> Float:
    """(4,) quaternion, real part last, of the shortest turn of z to a unit vector."""
    x, y, z = direction.tolist()
    if z < -1.0 + 1e-12:
        return np.array([1.0, 0.0, 0.0, 0.0])
    found = np.array([-y, x, 0.0, 1.0 + z])
    return np.asarray(found / np.linalg.norm(found))
