"""The exact signed distance of a mesh, closed or not."""

from __future__ import annotations

import numpy as np

from nuno_contact.fields.cells import measure_points
from nuno_contact.fields.winding import make_dipoles
from nuno_geometry.tree import Tree
from nuno_kernels.step.blocks import Long
from nuno_schemas.fabric import Float


class Exact:
    """A mesh's exact signed distance, for the build and to check a field by."""

    def __init__(self, tree: Tree, closed: bool) -> None:
        """Compute signs of a mesh that is not `closed` by the winding number."""
        self.tree, self.closed = tree, closed
        self.dipoles = None if closed else make_dipoles(tree)

    def measure(self, points: Float, near: Long | None = None) -> Float:
        """Return the distance [m] and gradient (n, 4) at points (n, 3)."""
        points = np.ascontiguousarray(points, np.float64)
        out = np.empty((len(points), 4))
        near = np.zeros(len(points), np.int64) if near is None else near
        measure_points(points, near, self.tree, self.dipoles, out)
        return out
