"""A dressed body: what the next garment is drawn together round."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nuno_kernels.meshes.closest_point import closest_points
from nuno_kernels.meshes.isosurface import net_of
from nuno_kernels.meshes.tree import build_tree
from nuno_schemas.fabric import Fabric, Float, Int

CELLS, FINEST = 2.0, 8e-3
"""Cells of the grid to the clearance, and how small they are at least [m]."""


def enclose(x: Float, faces: Int, worn: Sequence[Fabric], clearance: float) -> tuple[Float, Int]:
    """Vertices (v, 3) [m] and triangles (f, 3) of a closed surface about `clearance` [m] off a body, with vertices x
    (n, 3) and triangles faces (m, 3), and off the cloth that it wears.

    Room between body and cloth that is less than twice the clearance wide, or that nothing leads into, belongs to what
    is enclosed: a garment that is drawn round that does not get beneath a hem.
    """
    from scipy.ndimage import binary_fill_holes

    spacing = max(clearance / CELLS, FINEST)
    points = np.concatenate([x, *(one.position for one in worn)])
    low = points.min(axis=0) - clearance - 2.0 * spacing
    counts = np.ceil((points.max(axis=0) + clearance + 2.0 * spacing - low) / spacing).astype(int) + 1
    nodes = low + spacing * np.indices(tuple(counts)).reshape(3, -1).T
    away = np.asarray(closest_points(build_tree(x, faces), nodes).distance)
    for one in worn:
        # Cloth has two sides, and no inside.
        away = np.minimum(away, np.abs(closest_points(build_tree(one.position, one.faces), nodes).distance))
    value = away.reshape(tuple(counts)) - clearance
    value[binary_fill_holes(value < 0.0) & (value >= 0.0)] = -clearance
    return net_of(value, low, spacing)
