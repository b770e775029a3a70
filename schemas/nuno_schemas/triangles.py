"""Elasticity of triangle meshes of a measured fabric, independent of the mesh: membrane, bending, bending friction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.layout import Bounds

if TYPE_CHECKING:  # parts of a fabric, so that at run time it is fabric that imports this
    from nuno_schemas.fabric import Float, Int


@dataclass(frozen=True)
class Membrane:
    """Triangles of constant strain: energy A (C_w e_w^2 + C_f e_f^2 + 2 C_wf e_w e_f + G g^2) / 2 each.

    The cloth's unit vectors along warp and weft become F_w = a (x1 - x0) + b (x2 - x0) and F_f; the strains are
    e_w = |F_w| - 1, e_f = |F_f| - 1 and g = F_w.F_f, the angle of shear where they are small.

    faces    (t, 3) int32  vertices x0, x1, x2
    along    (t, 2)        a, b of F_w [1/m]
    across   (t, 2)        a, b of F_f [1/m]
    area     (t,)          A, at rest [m^2]
    moduli   (4, t)        C_w, C_f, C_wf and G [N/m]; C_wf^2 <= C_w C_f
    damping  (3, t)        damping of e_w, e_f and g [N s/m]
    """

    faces: Annotated[NDArray[np.int32], "t", 3, Bounds(0, below="n")]
    along: Annotated[NDArray[np.float64], "t", 2]
    across: Annotated[NDArray[np.float64], "t", 2]
    area: Annotated[NDArray[np.float64], "t", Bounds(above=0.0)]
    moduli: Annotated[NDArray[np.float64], 4, "t"]
    damping: Annotated[NDArray[np.float64], 3, "t", Bounds(0.0)]

    @property
    def number(self) -> int:
        return int(self.faces.shape[0])

    def shares(self) -> Float:
        """Return the derivatives of F_w and F_f by each corner, shape (2, t, 3) [1/m]."""
        yarns = np.stack([self.along, self.across])
        return np.concatenate([-yarns.sum(axis=2, keepdims=True), yarns], axis=2)

    def stiffness(self) -> Float:
        """Return the largest stiffness of each corner within its triangle alone, shape (t, 3) [N/m]."""
        (warp, weft), (c_w, c_f, _, g) = np.square(self.shares()), self.moduli[..., None]
        return np.asarray(self.area[:, None] * ((c_w + g) * warp + (c_f + g) * weft))

    def sides(self) -> Float:
        """Return the rest lengths of x0 x1, x1 x2 and x2 x0, shape (t, 3) [m]."""
        first, second = np.linalg.inv(np.stack([self.along, self.across], axis=2)).transpose(2, 0, 1)
        return np.asarray(np.linalg.norm(np.stack([first, second - first, second], axis=1), axis=2))

    def edges(self) -> tuple[Int, Float]:
        """Return the vertices (e, 2) of every edge, each once, and its rest length (e,) [m]."""
        ends = np.sort(np.stack([self.faces, np.roll(self.faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
        pairs, first = np.unique(ends, axis=0, return_index=True)
        return pairs, self.sides().reshape(-1)[first]


@dataclass(frozen=True)
class Bending:
    """Bending as a quadratic form of the positions: energy sum of weight |x_j - x_i|^2 / 2 over pairs.

    pairs    (p, 2) int32  vertices i < j, each pair once
    weight   (p,)          [N/m], of either sign; the form is never negative, and 0 for every affine motion
    """

    pairs: Annotated[NDArray[np.int32], "p", 2, Bounds(0, below="n")]
    weight: Annotated[NDArray[np.float64], "p"]

    @property
    def number(self) -> int:
        return int(self.pairs.shape[0])


@dataclass(frozen=True)
class BendingFriction:
    """Internal friction against bending, in patches of vertices; nuno_kernels.forces.bending_friction computes it.

    vertices (b, k) int32  patches, each padded with its first vertex
    shares   (b, 5, k)     derivatives of the tangents along warp and weft [1/m], and of the second derivatives along
                           warp, weft and between them [1/m^2], by each vertex; rows sum to 0
    area     (b,)          area of the patch [m^2]
    limit    (2, b)        moment per width at which friction slips, of warp and weft [N]
    slip     (b,)          change of curvature at which friction slips [1/m]
    """

    vertices: Annotated[NDArray[np.int32], "b", "k", Bounds(0, below="n")]
    shares: Annotated[NDArray[np.float64], "b", 5, "k"]
    area: Annotated[NDArray[np.float64], "b", Bounds(above=0.0)]
    limit: Annotated[NDArray[np.float64], 2, "b", Bounds(0.0)]
    slip: Annotated[NDArray[np.float64], "b", Bounds(above=0.0)]

    @property
    def number(self) -> int:
        return int(self.vertices.shape[0])

    @staticmethod
    def join(parts: list[BendingFriction]) -> BendingFriction:
        """Join several (at least one) into one, with patches padded to the largest."""
        most = max(part.vertices.shape[1] for part in parts)
        vertices = [
            np.concatenate([p.vertices, np.repeat(p.vertices[:, :1], most - p.vertices.shape[1], axis=1)], axis=1)
            for p in parts
        ]
        shares = [np.pad(p.shares, ((0, 0), (0, 0), (0, most - p.shares.shape[2]))) for p in parts]
        limit = np.concatenate([p.limit for p in parts], axis=1)
        area, slip = (np.concatenate([getattr(p, name) for p in parts]) for name in ("area", "slip"))
        return BendingFriction(np.concatenate(vertices), np.concatenate(shares), area, limit, slip)
