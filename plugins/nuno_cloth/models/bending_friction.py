"""Friction of cloth that is bent, for any mesh: in the middle of patches round each vertex.

A patch is a vertex with the AROUND nearest of those that it or its neighbours touch: enough for all curvatures where
diagonals alternate and every other vertex has four neighbours, and on borders. Its derivatives are those of the
quadratic function that fits best (nuno_cloth.models.bending): exact where curvature is the same everywhere.
"""

from __future__ import annotations

import numpy as np

from nuno_cloth.fabrics.presets import Material
from nuno_cloth.models.bending import find_clamp, fit
from nuno_cloth.models.patches import find_patches
from nuno_schemas.fabric import BendingFriction, Bool, Float, Int

AROUND = 8
SLIP = 1.0
"""Change of curvature that friction holds before it slips [1/m]. No instrument tells: KES, which bends to 250 1/m,
reads its hysteresis at 50 to 150. Less would be stiffer, and would shorten explicit steps."""


def build_friction(
    material: Material, x: Float, faces: Int, warp: Float, weft: Float, held: Bool
) -> BendingFriction | None:
    """Of triangles faces (f, 3), flat as x (n, 3) [m] is laid open, with yarn directions (f, 3), between vertices of
    which some are held (n,); None of a fabric that has none.
    """
    widths = np.array([material.hysteresis_warp, material.hysteresis_weft])
    if not widths.any() or len(x) < 4:
        return None
    clamp, patches = find_clamp(faces, held), find_patches(x, faces, warp, weft)
    loose = np.flatnonzero(~clamp.faces)
    of, place = np.unique(faces[loose], return_index=True)
    face, corner = loose[place // 3], place % 3
    area = np.bincount(faces[loose].reshape(-1), np.repeat(patches.area[loose] / 3.0, 3), len(x))[of].astype(np.float64)
    found = patches.of(face)
    flat = found.flat - found.flat[np.arange(len(of)), corner][:, None]
    far = np.where(found.there, np.linalg.norm(flat, axis=2), np.inf)
    near = np.argsort(far, axis=1, kind="stable")[:, : AROUND + 1]
    vertices = np.take_along_axis(found.vertices, near, axis=1)
    there = np.take_along_axis(found.there, near, axis=1)
    flat = np.take_along_axis(flat, near[..., None], axis=1)
    base = clamp.base(vertices, flat, there)
    derived = fit(flat, base, there, np.sqrt(2.0 / np.sqrt(3.0) * area))
    shares = np.where(there[:, None], np.concatenate([derived.first, derived.second], axis=1), 0.0)
    limit = 0.5 * np.repeat(widths[:, None], len(of), axis=1)
    vertices = np.where(there, vertices, vertices[:, :1]).astype(np.int32)
    return BendingFriction(vertices, shares, area, limit, np.full(len(of), SLIP))
