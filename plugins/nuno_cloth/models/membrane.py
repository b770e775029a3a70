"""The membrane of a triangle mesh: a measured fabric's tension and shear, whatever the mesh.

A triangle of constant strain stores what the measures say for any shape of its own and any direction of the yarns
across it, as springs on its edges cannot (nuno_cloth.models.triangles). Warp and weft couple as those of a grid of
springs do, C_wf = G (nuno_cloth.fabrics.constants), so that the same fabric hangs the same on both; of a fabric so
stiff in shear that this would be no elastic body, as far as one can be.

Damping. Strained alone, a triangle of area A whose yarn F = a (x1 - x0) + b (x2 - x0) has the modulus C swings with

    w^2 = A C S,  S = (a + b)^2 / m0 + a^2 / m1 + b^2 / m2,

so that a share zeta of its critical damping is D = 2 zeta C / w = 2 zeta sqrt(C / (A S)): as a spring's, by the masses
at its ends. Shear moves both yarns, and has the sum of their S.
"""

from __future__ import annotations

import numpy as np

from nuno_cloth.fabrics.material import Materials
from nuno_cloth.fabrics.presets import Material
from nuno_cloth.models.triangles import face_areas
from nuno_schemas.fabric import Float, Int
from nuno_schemas.triangles import Membrane


def build_membrane(
    material: Material | Materials, corners: Float, faces: Int, mass: Float, warp: Float, weft: Float
) -> Membrane:
    """Of triangles with corners (f, 3, 3) at rest [m], between vertices faces (f, 3) of mass (n,) [kg], with the yarn
    directions (f, 3) of each.
    """
    sides = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    flat = np.einsum("fyi,fis->fys", np.stack([warp, weft], axis=1), sides)
    inverse = np.linalg.inv(flat)
    along, across = (np.ascontiguousarray(inverse[:, :, yarn]) for yarn in (0, 1))
    area = face_areas(corners)
    cloth = Materials.spread(material, len(faces))
    along_warp, along_weft, shear = (cloth.by_triangle(name) for name in ("warp", "weft", "shear"))
    moduli = np.stack([along_warp, along_weft, np.minimum(shear, np.sqrt(along_warp * along_weft)), shear])
    mobile = np.stack([_mobility(along, mass[faces]), _mobility(across, mass[faces])])
    mobile = np.concatenate([mobile, mobile.sum(axis=0, keepdims=True)])
    damping = 2.0 * cloth.by_triangle("damping_ratio") * np.sqrt(moduli[[0, 1, 3]] / (area * mobile))
    return Membrane(faces, along, across, area, moduli, damping)


def _mobility(yarn: Float, mass: Float) -> Float:
    """(f,) S [1 / (kg m^2)] of yarns (f, 2) between vertices of mass (f, 3)."""
    shares = np.column_stack([yarn.sum(axis=1), yarn])
    return np.asarray((np.square(shares) / mass).sum(axis=1))
