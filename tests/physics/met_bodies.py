"""Bodies of triangles that cloth meets as it meets cloth, moved by hand; and ipctk as the judge of all together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from sheets import Pile

from nuno_bench.piles import Oracle
from nuno_contact.motions.rotations import from_axis_angle
from nuno_schemas.bodies import MESH, Geometry, Poses, rotation_matrices
from nuno_schemas.fabric import Fabric, Float, Int
from nuno_schemas.system import StepReport

Shape = tuple[Float, Int]
Motion = Callable[[float], tuple[float, Float]]
"""Angle about the z axis [rad] and place [m] at a time [s]."""


def still(t: float) -> tuple[float, Float]:
    """No motion."""
    return 0.0, np.zeros(3)


def geometry_of(shapes: Sequence[Shape], friction: float) -> Geometry:
    """Meshes, each a body on a frame of its own."""
    count = len(shapes)
    starts = np.cumsum([0, *(len(x) for x, _ in shapes)])
    numbers = np.arange(count, dtype=np.int32)
    return Geometry(
        tuple(f"body {i}" for i in range(count)), tuple(f"body {i}/world" for i in range(count)),
        np.full(count, MESH, np.int8), numbers, numbers, np.stack([x.min(axis=0) for x, _ in shapes]),
        np.stack([x.max(axis=0) for x, _ in shapes]), np.zeros(count), np.full(count, np.nan), np.full(count, 0.5),
        np.full(count, friction), np.concatenate([x for x, _ in shapes]),
        np.concatenate([faces + np.int32(at) for (_, faces), at in zip(shapes, starts, strict=False)]),
        np.repeat(numbers, [len(faces) for _, faces in shapes]),
    )  # fmt: skip


class Met(Pile):
    """Pieces and bodies under cloth contact and a solver."""

    def __init__(
        self, *pieces: Fabric, shapes: Sequence[Shape], motions: Sequence[Motion] = (), rough: float = 0.3,
        **settings: Any,
    ) -> None:  # fmt: skip
        self.motions = list(motions) or [still] * len(shapes)
        self.geometry = geometry_of(shapes, rough)
        super().__init__(*pieces, bodies=(self.geometry, self.poses(0.0)), **settings)
        faces = np.concatenate([self.fabric.faces, self.geometry.faces + np.int32(self.fabric.number)])
        self.oracle = Oracle(np.concatenate([self.fabric.position, self.places(0.0)]), faces)

    def poses(self, t: float) -> Poses:
        """Where the bodies are."""
        angles, places = zip(*(motion(t) for motion in self.motions), strict=True)
        turns = [from_axis_angle(np.array([0.0, 0.0, 1.0]), angle) for angle in angles]
        return Poses(t, np.stack(turns), np.stack(places))

    def places(self, t: float) -> Float:
        """(v, 3) all bodies' vertices [m]."""
        poses, of = self.poses(t), np.repeat(self.geometry.owner, 3)
        frame = np.zeros(len(self.geometry.vertices), np.int64)
        frame[self.geometry.faces.ravel()] = of
        turned = np.einsum("nij,nj->ni", rotation_matrices(poses.rotation)[frame], self.geometry.vertices)
        return np.asarray(turned + poses.translation[frame])

    def go(self, steps: int) -> StepReport:
        """An interval of so many steps."""
        ends = self.poses(self.state.t), self.poses(self.state.t + steps * self.dt)
        report: StepReport = self.solver.advance(self.system, self.state, self.memory, ends, steps, self.dt)
        assert report.status == "ok", report.message
        return report

    @property
    def crossed(self) -> bool:
        """Whether an edge of cloth goes through a triangle of cloth or of a body, or one of a body through cloth."""
        return self.oracle.crossed(np.concatenate([self.state.x, self.places(self.state.t)]))

    @property
    def behind(self) -> int:
        """Vertices of bodies that are behind them."""
        return int(self.meeting.bodies.behind.sum())
