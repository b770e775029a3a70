"""Whether cloth passes through cloth, as ipc-toolkit sees it: by none of our own code."""

from __future__ import annotations

from nuno.collision.pairs import mesh_of
from nuno_schemas.fabric import Float, Int


class Oracle:
    """Of a mesh x (n, 3) [m] of triangles (f, 3); the last `body` vertices are a body's, which may
    pass through itself.
    """

    def __init__(self, x: Float, faces: Int, body: int = 0) -> None:
        import ipctk

        self._ipctk, self._mesh = ipctk, ipctk.CollisionMesh(x, mesh_of(faces).edges, faces)
        if body:
            self._mesh.can_collide = ipctk.make_static_obstacle_filter(len(x) - body)

    def crossed(self, x: Float) -> bool:
        """Whether an edge goes through a triangle that it shares no vertex with, of vertices at x (n, 3) [m]."""
        return bool(self._ipctk.has_intersections(self._mesh, x))
