"""Texture coordinates of cloth: their check, and the size of the texture, which a print or a dyed pattern has."""

from __future__ import annotations

import numpy as np

from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric

UV_ROUNDING = 1e-6
"""Texture coordinates are float32, and files round them."""


def texture_size(fabric: Fabric) -> tuple[float, float]:
    """Return width and height [m] of the whole texture, [0, 1] x [0, 1], on cloth at its start: means of |dx/du| and
    |dx/dv| over its triangles, by area. Raises ValueError for cloth without texture coordinates.
    """
    corners = fabric.laid_out
    if corners is None:
        raise ValueError("cloth without texture coordinates")
    points, faces = corners.points[corners.faces], fabric.faces
    # x = x0 + (dx/du) u + (dx/dv) v on each triangle, so that its two sides have [e1 e2] = [dx/du dx/dv] [t1 t2].
    sides = np.diff(fabric.position[faces], axis=1)
    t = np.diff(points.astype(np.float64), axis=1)
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    det = t[:, 0, 0] * t[:, 1, 1] - t[:, 0, 1] * t[:, 1, 0]
    flat = det != 0.0
    along_u = (sides[flat, 0] * t[flat, 1, 1:] - sides[flat, 1] * t[flat, 0, 1:]) / det[flat, None]
    along_v = (sides[flat, 1] * t[flat, 0, :1] - sides[flat, 0] * t[flat, 1, :1]) / det[flat, None]
    width, height = (float(np.average(np.linalg.norm(per, axis=1), weights=area[flat])) for per in (along_u, along_v))
    return width, height


def check_texture(fabric: Fabric, name: str) -> None:
    """Raise BadInput for a fabric without texture coordinates in [0, 1] x [0, 1], which dye cells need."""
    corners = fabric.laid_out
    if corners is None:
        remedy = "dye a sheet or a skirt, or give the mesh texture coordinates"
        raise BadInput("what is dyed needs texture coordinates, and this has none", value=name, remedy=remedy)
    low, high = float(corners.points.min(initial=0.0)), float(corners.points.max(initial=1.0))
    if not (low >= -UV_ROUNDING and high <= 1.0 + UV_ROUNDING):
        problem = "texture coordinates leave the cloth that is dyed"
        remedy = "lay the mesh's texture out without repeating it"
        raise BadInput(problem, value=f"{low:g} to {high:g}", limit="0 to 1", remedy=remedy)
