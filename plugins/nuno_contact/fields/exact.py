"""The exact signed distance of a mesh, closed or not."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno_contact.fields.cells import measure_points
from nuno_contact.fields.winding import make_dipoles
from nuno_kernels.meshes.tree import Tree
from nuno_schemas.fabric import Float

Long = NDArray[np.int64]


class Exact:
    """A mesh's exact signed distance, for the build and to check a field by."""

    def __init__(self, tree: Tree, closed: bool) -> None:
        """Signs of a mesh that is not `closed` are the winding number's."""
        self.tree, self.closed = tree, closed
        dipoles: tuple[Any, Any] = (None, None) if closed else make_dipoles(tree)
        self.arrays = (
            tree.boxes, tree.child, tree.corners, tree.face, tree.faces, tree.edges, tree.vertex_normals,
            tree.edge_normals, *dipoles,
        )  # fmt: skip

    def measure(self, points: Float, near: Long | None = None) -> Float:
        """(n, 4) distance [m] and gradient at points (n, 3)."""
        points = np.ascontiguousarray(points, np.float64)
        out = np.empty((len(points), 4))
        measure_points(points, np.zeros(len(points), np.int64) if near is None else near, *self.arrays, out)
        return out
