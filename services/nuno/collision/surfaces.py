"""Surfaces of a scene's bodies, wherever its frames are: for all that draws them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nuno_schemas.bodies import Poses, rotation_matrices
from nuno_schemas.fabric import Float, Int


@dataclass(frozen=True)
class Surfaces:
    """Triangles of all bodies in their frames, as `nuno_schemas.surface` gives them: vertices (n, 3) [m], faces (f, 3),
    and the frame (n,) that each vertex is in.
    """

    vertices: Float
    faces: Int
    frame: Int

    def at(self, poses: Poses) -> Float:
        """(n, 3) vertices in the world [m]. Raises IndexError for poses of fewer frames."""
        turned = np.einsum("nij,nj->ni", rotation_matrices(poses.rotation)[self.frame], self.vertices)
        return np.asarray(turned + poses.translation[self.frame])


NO_SURFACES = Surfaces(np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros(0, np.int32))
