"""The membrane of a triangle mesh: a measured fabric's tension and shear, whatever the mesh.

A triangle of constant strain stores the measured energy whatever its shape and the direction of the yarns across it, as
springs on its edges cannot (nuno_cloth.models.triangles). Warp and weft couple as those of a grid of springs do, C_wf =
G (nuno_cloth.fabrics.constants), so that the same fabric hangs the same on both. If a fabric is so stiff in shear that
its energy would not be positive, C_wf = sqrt(C_w C_f).

Damping. Strained alone, a triangle of area A whose yarn F = a (x1 - x0) + b (x2 - x0) has the modulus C swings with

    w^2 = A C S,  S = (a + b)^2 / m0 + a^2 / m1 + b^2 / m2,

so that a share zeta of its critical damping is D = 2 zeta C / w = 2 zeta sqrt(C / (A S)): as a spring's, by the masses
at its ends. Shear moves both yarns, and has the sum of their S.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from nuno_cloth.fabrics.material import HandSet, Materials
from nuno_cloth.fabrics.presets import Material
from nuno_cloth.models.bending import build_bending
from nuno_cloth.models.bending_friction import build_friction, bytes_of_friction
from nuno_cloth.models.placement import STILL
from nuno_cloth.models.triangles import Edges, hinge_stiffness, spring_stiffness, yarn_axes
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import (
    BENDING,
    STRUCTURAL,
    Bending,
    BendingFriction,
    Bool,
    Fabric,
    Float,
    Hinges,
    Int,
    Membrane,
    Springs,
)
from nuno_schemas.plugin import Files
from nuno_schemas.vectors import face_areas

# Elements of cloth of triangles: a measured fabric's membrane and bending, or springs with hinges.

Tension = Literal["auto", "membrane", "springs"]
TENSION = (
    "what bears tension and shear: membrane, triangles of constant strain along warp and weft, which have a measured "
    "fabric's stiffness on any mesh; springs on the edges, which lines of wrinkles without a width need; auto: a "
    "membrane of measured fabrics, springs of constants set by hand"
)
BYTES_PER_VERTEX, SPRUNG = 4500, 2000
"""The most memory that a run takes, with a membrane and with springs: 4,188 and 1,896 were measured, between meshes of
90,000 and 250,000 and of 262,144 and 640,000 vertices, and the file's text and triangles while it is read."""


class Elements(NamedTuple):
    """Fields of a fabric: masses, triangles, and the elements that bear tension and bending."""

    mass: Float
    faces: Int
    springs: Springs | None = None
    hinges: Hinges | None = None
    membrane: Membrane | None = None
    bending: Bending | None = None
    friction: BendingFriction | None = None

    def fabric(self, name: str, x: Float, held: Bool, velocity: Sequence[float] = STILL, **more: Any) -> Fabric:
        """Return a fabric of these elements at x (n, 3) [m] with one velocity [m/s], and `more` of its fields."""
        speed = np.tile(np.asarray(velocity, np.float64), (len(x), 1))
        return Fabric(name=name, position=x, velocity=speed, pinned=held, **more, **self._asdict())


class OfTriangles:
    """A model of triangles, with a membrane or springs."""

    def memory(self, config: Any, files: Files, vertices: int) -> int:
        """Return the most memory that a run takes [bytes]."""
        return vertices * (BYTES_PER_VERTEX + bytes_of_friction(config.fabric))


def build_elements(
    material: Material | HandSet, x: Float, faces: Int, edges: Edges, warp: Float, folded: bool = False,
    tension: Tension = "springs", held: Bool | None = None,
) -> Elements:  # fmt: skip
    """Build a membrane and bending by a matrix, or springs on edges with hinges or bending springs across inner edges.
    Raises BadInput for a membrane of constants per spring, and for measures of bending that hinges cannot have.

    Cloth between vertices that are all `held` (n,) does not bend. Bending springs are at rest in the shape x, or, if
    pieces lie `folded` on each other along their seams, with x laid open.
    """
    if tension == "membrane" and isinstance(material, HandSet):
        remedy = "give a preset or measured values, or take tension: springs"
        raise BadInput("constants per spring make no membrane", field="tension", value=tension, remedy=remedy)
    held = np.zeros(len(x), np.bool_) if held is None else held
    if tension != "springs" and isinstance(material, Material):
        return build_triangles(material, x[faces], faces, warp, held)
    pairs, area = edges.pairs, face_areas(x[faces])
    mass = _masses(material.density, area, faces, len(x))
    rest = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1)
    flat = np.zeros(len(edges.inner))
    reduced = _reduced(mass, pairs)
    if isinstance(material, Material):
        axes = yarn_axes(x[faces], warp)
        friction = build_friction(material, x[faces], faces, *axes, held)
        if material.bend_bias is not None or material.bend_poisson != 0.0:
            problem, remedy = "hinges bend alike along the bias whatever was measured", "take tension: membrane"
            raise BadInput(problem, field="tension", value=tension, remedy=remedy)
        hinges = _hinges(edges, hinge_stiffness(material, x, edges, area, *axes), flat)
        k = spring_stiffness(material, x, faces, edges, *axes)
        c = 2 * material.damping_ratio * np.sqrt(k * reduced)
        springs = Springs.from_pairs(pairs, k, rest, c, STRUCTURAL)
        return Elements(mass, faces, springs, hinges, friction=friction)
    k, ratio = np.full(len(pairs), material.structural[0]), 2 * material.damping_ratio
    c = material.damping + ratio * np.sqrt(k * reduced)
    springs = Springs.from_pairs(pairs, k, rest, c, STRUCTURAL)
    if material.bending[0] > 0:
        ends = np.ascontiguousarray(edges.quads[:, 2:])
        span = open_spans(x, edges.quads) if folded else np.linalg.norm(x[ends[:, 1]] - x[ends[:, 0]], axis=1)
        c = material.damping + ratio * np.sqrt(material.bending[0] * _reduced(mass, ends))
        across = Springs.from_pairs(ends, flat + material.bending[0], span, c, BENDING)
        springs = Springs.join([springs, across])
    return Elements(mass, faces, springs, _hinges(edges, flat + material.hinge, flat))


def build_triangles(material: Material | Materials, corners: Float, faces: Int, warp: Float, held: Bool) -> Elements:
    """Build a membrane, and bending by a matrix, of triangles with vertices faces (f, 3) and corners (f, 3, 3) at rest
    [m], with the warp (3,) or (f, 3) laid onto each. Neighbours along a seam each have their own corners.
    """
    density = Materials.spread(material, len(faces)).by_triangle("density")
    mass, axes = _masses(density, face_areas(corners), faces, len(held)), yarn_axes(corners, warp)
    friction = build_friction(material, corners, faces, *axes, held)
    membrane = build_membrane(material, corners, faces, mass, *axes)
    bending = build_bending(material, corners, faces, *axes, held)
    return Elements(mass, faces, membrane=membrane, bending=bending, friction=friction)


def open_spans(x: Float, quads: Int) -> Float:
    """Return distances (h,) [m] between the last two vertices of hinges (h, 4) that are unfolded into a plane."""
    start, end, left, right = (x[quads[:, i]] for i in range(4))
    along = end - start
    along /= np.linalg.norm(along, axis=1)[:, None]
    (one, high), (other, low) = (
        (np.einsum("hk,hk->h", side - start, along), np.linalg.norm(np.cross(side - start, along), axis=1))
        for side in (left, right)
    )
    return np.asarray(np.hypot(one - other, high + low))


def _masses(density: Float | float, area: Float, faces: Int, n: int) -> Float:
    """Return masses (n,) of vertices [kg]: a third of each triangle's mass for each of its corners."""
    return np.bincount(faces.reshape(-1), np.repeat(area * density / 3, 3), n).astype(np.float64)


def _reduced(mass: Float, pairs: Int) -> Float:
    """Return reduced masses (s,) of springs (s, 2) [kg]."""
    one, other = mass[pairs[:, 0]], mass[pairs[:, 1]]
    return np.asarray(one * other / (one + other))


def _hinges(edges: Edges, k: Float, rest: Float) -> Hinges | None:
    if not k.any():
        return None
    one = np.ones(len(k), np.int32)
    return Hinges(edges.quads, one, one, k, rest)


def build_membrane(
    material: Material | Materials, corners: Float, faces: Int, mass: Float, warp: Float, weft: Float
) -> Membrane:
    """Build the membrane of triangles with corners (f, 3, 3) at rest [m], vertices faces (f, 3) of mass (n,) [kg] and
    yarn directions (f, 3).
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
    """Return S (f,) [1 / (kg m^2)] of yarns (f, 2) between vertices of mass (f, 3)."""
    shares = np.column_stack([yarn.sum(axis=1), yarn])
    return np.asarray((np.square(shares) / mass).sum(axis=1))
