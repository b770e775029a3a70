"""Friction of cloth that is bent, for any mesh: in the middle of patches round each vertex.

A patch is a vertex with the AROUND nearest of those that it or its neighbours touch: enough for all curvatures where
diagonals alternate and every other vertex has four neighbours, and on borders. Its derivatives are those of the
quadratic function that fits best (nuno_cloth.models.bending): exact where curvature is the same everywhere.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno_cloth.fabrics.material import FabricChoice, Materials, resolve
from nuno_cloth.fabrics.presets import Material
from nuno_cloth.models.bending import AT_ONCE, Clamp, find_clamp, fit, plate
from nuno_cloth.models.patches import Patches, find_patches, find_sides
from nuno_cloth.models.triangles import face_areas
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.triangles import BendingFriction

AROUND = 8
BYTES_PER_VERTEX = 1500
"""What a run takes at most for it beside the cloth: 1,030 were measured, of meshes of 90,000 and 250,000 vertices."""
SLIP = 1.0
"""Change of curvature that friction holds before it slips [1/m]. No instrument tells: KES, which bends to 250 1/m,
reads its hysteresis at 50 to 150. Less would be stiffer, and would shorten explicit steps."""


def bytes_of_friction(fabric: FabricChoice) -> int:
    """What a run takes at most for friction, per vertex; 0 of a fabric without."""
    material = resolve(fabric)
    rubs = isinstance(material, Material) and material.hysteresis_warp + material.hysteresis_weft > 0.0
    return BYTES_PER_VERTEX if rubs else 0


def build_friction(
    material: Material | Materials, corners: Float, faces: Int, warp: Float, weft: Float, held: Bool
) -> BendingFriction | None:
    """Of triangles with corners (f, 3, 3) [m], flat as they are laid open, and yarn directions (f, 3), between vertices
    faces (f, 3) of which some are held (n,); None of a fabric that has none.
    """
    cloth = Materials.spread(material, len(faces))
    widths = np.stack([cloth.by_triangle("hysteresis_warp"), cloth.by_triangle("hysteresis_weft")])
    if not widths.any() or len(held) < 4:
        return None
    clamp, area = find_clamp(faces, held), face_areas(corners)
    loose = np.flatnonzero(~clamp.faces).astype(np.int32)
    if not len(loose):
        return None
    of, place = np.unique(faces[loose], return_index=True)
    face, corner = loose[place // 3], place % 3
    area = np.bincount(faces[loose].reshape(-1), np.repeat(area[loose] / 3.0, 3), len(held))[of].astype(np.float64)
    limit, slip = 0.5 * np.take(widths, face, axis=1), np.full(len(of), SLIP)
    rigidity = np.array([plate(one) for one in cloth.each])[cloth.of[face]]
    sides, parts = find_sides(corners, faces), []
    for at in range(0, len(of), AT_ONCE):
        part = slice(at, at + AT_ONCE)
        patches = find_patches(sides, face[part], warp[face[part]], weft[face[part]])
        derived = _derive(patches, corner[part], area[part], clamp, rigidity[part])
        parts.append(BendingFriction(*derived, area[part], limit[:, part], slip[part]))
    return BendingFriction.join(parts)


def _derive(patches: Patches, corner: Any, area: Float, clamp: Clamp, rigidity: Float) -> tuple[Int, Float]:
    """(f, k) vertices near a corner of each triangle, that first, and (f, 5, k) by how much derivatives there move with
    them.
    """
    flat = patches.flat - patches.flat[np.arange(len(corner)), corner][:, None]
    far = np.where(patches.there, np.linalg.norm(flat, axis=2), np.inf)
    near = np.argsort(far, axis=1, kind="stable")[:, : AROUND + 1]
    vertices, there = (
        np.take_along_axis(patches.vertices, near, axis=1),
        np.take_along_axis(patches.there, near, axis=1),
    )
    flat = np.take_along_axis(flat, near[..., None], axis=1)
    derived = fit(flat, clamp.base(vertices, flat, there), there, np.sqrt(2.0 / np.sqrt(3.0) * area), rigidity)
    shares = np.where(there[:, None], np.concatenate([derived.first, derived.second], axis=1), 0.0)
    return np.where(there, vertices, vertices[:, :1]).astype(np.int32), shares
