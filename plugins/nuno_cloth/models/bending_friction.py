"""Friction of bent cloth, on any mesh, in the middle of a patch round each vertex.

A patch is a vertex with the AROUND nearest vertices among its neighbours and their neighbours: enough for all
curvatures on borders, and where diagonals alternate and every other vertex has four neighbours. Its derivatives are
those of the quadratic function that fits best (nuno_cloth.models.bending): exact where curvature is the same
everywhere.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno_cloth.fabrics.material import FabricChoice, Materials, resolve
from nuno_cloth.fabrics.presets import Material
from nuno_cloth.models.bending import AT_ONCE, Clamp, find_clamp, fit, plate
from nuno_cloth.models.patches import Patches, find_patches, find_sides
from nuno_schemas.fabric import BendingFriction, Bool, Float, Int
from nuno_schemas.vectors import face_areas

AROUND = 8
BYTES_PER_VERTEX = 1500
"""The most memory that friction adds to a run: 1,030 were measured, between meshes of 90,000 and 250,000 vertices."""
SLIP = 1.0
"""Change of curvature that friction holds before it slips [1/m]. It has not been measured: KES, which bends to 250 1/m,
reads its hysteresis at 50 to 150. A smaller one would be stiffer, and would shorten explicit steps."""


def bytes_of_friction(fabric: FabricChoice) -> int:
    """Return the most memory that friction adds to a run, per vertex [bytes]; 0 for a fabric without friction."""
    material = resolve(fabric)
    rubs = isinstance(material, Material) and material.hysteresis_warp + material.hysteresis_weft > 0.0
    return BYTES_PER_VERTEX if rubs else 0


def build_friction(
    material: Material | Materials, corners: Float, faces: Int, warp: Float, weft: Float, held: Bool
) -> BendingFriction | None:
    """Build the friction of triangles with corners (f, 3, 3) [m], flat once unfolded, yarn directions (f, 3) and
    vertices faces (f, 3); `held` (n,) marks held vertices. None for a fabric without friction.
    """
    cloth = Materials.spread(material, len(faces))
    widths = np.stack([cloth.by_triangle("hysteresis_warp"), cloth.by_triangle("hysteresis_weft")])
    if not widths.any() or len(held) < 4:
        return None
    clamp, area = find_clamp(faces, held), face_areas(corners)
    loose = np.flatnonzero(~clamp.faces).astype(np.int32)
    if not len(loose):
        return None
    centres, place = np.unique(faces[loose], return_index=True)
    face, corner = loose[place // 3], place % 3
    area = np.bincount(faces[loose].reshape(-1), np.repeat(area[loose] / 3.0, 3), len(held))[centres].astype(np.float64)
    limit, slip = 0.5 * np.take(widths, face, axis=1), np.full(len(centres), SLIP)
    rigidity = np.array([plate(one) for one in cloth.fabrics])[cloth.fabric_index[face]]
    sides, parts = find_sides(corners, faces), []
    for at in range(0, len(centres), AT_ONCE):
        part = slice(at, at + AT_ONCE)
        patches = find_patches(sides, face[part], warp[face[part]], weft[face[part]])
        derived = _derive(patches, corner[part], area[part], clamp, rigidity[part])
        parts.append(BendingFriction(*derived, area[part], limit[:, part], slip[part]))
    return BendingFriction.join(parts)


def _derive(patches: Patches, corner: Any, area: Float, clamp: Clamp, rigidity: Float) -> tuple[Int, Float]:
    """Return vertices (f, k) near a corner of each triangle, the corner first, and the derivatives (f, 5, k) at the
    corner per height of each vertex.
    """
    flat = patches.flat - patches.flat[np.arange(len(corner)), corner][:, None]
    far = np.where(patches.there, np.linalg.norm(flat, axis=2), np.inf)
    near = np.argsort(far, axis=1, kind="stable")[:, : AROUND + 1]
    vertices = np.take_along_axis(patches.vertices, near, axis=1)
    there = np.take_along_axis(patches.there, near, axis=1)
    flat = np.take_along_axis(flat, near[..., None], axis=1)
    fitted = fit(flat, clamp.base(vertices, flat, there), there, np.sqrt(2.0 / np.sqrt(3.0) * area), rigidity)
    shares = np.where(there[:, None], np.concatenate([fitted.first, fitted.second], axis=1), 0.0)
    return np.where(there, vertices, vertices[:, :1]).astype(np.int32), shares
