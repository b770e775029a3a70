"""How large a texture is on cloth: so large is what is printed, or dyed in its own measures, on it."""

from __future__ import annotations

import numpy as np

from nuno_schemas.fabric import Fabric


def texture_size(fabric: Fabric) -> tuple[float, float]:
    """Width and height [m] of the whole texture, [0, 1] x [0, 1], on cloth at its start: means over its triangles, by
    area, of |dx/du| and |dx/dv|. Raises ValueError for cloth without texture coordinates.
    """
    if fabric.corners is not None:
        points, faces = fabric.corners.points[fabric.corners.faces], fabric.corners.vertex[fabric.corners.faces]
    elif fabric.uv is not None:
        points, faces = fabric.uv[fabric.faces], fabric.faces
    else:
        raise ValueError("cloth without texture coordinates")
    # x = x0 + (dx/du) u + (dx/dv) v on each triangle, so that its two sides have [e1 e2] = [dx/du dx/dv] [t1 t2].
    sides = np.diff(fabric.position[faces], axis=1)
    t = np.diff(points.astype(np.float64), axis=1)
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    det = t[:, 0, 0] * t[:, 1, 1] - t[:, 0, 1] * t[:, 1, 0]
    flat = det != 0.0
    along_u = (sides[flat, 0] * t[flat, 1, 1:] - sides[flat, 1] * t[flat, 0, 1:]) / det[flat, None]
    along_v = (sides[flat, 1] * t[flat, 0, :1] - sides[flat, 0] * t[flat, 1, :1]) / det[flat, None]
    width, height = (float(np.average(np.linalg.norm(one, axis=1), weights=area[flat])) for one in (along_u, along_v))
    return width, height
