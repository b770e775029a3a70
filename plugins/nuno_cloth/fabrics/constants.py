"""Spring and hinge constants of a grid, from a material in measured units or set by hand.

Springs. A cell is a wide (weft) and b high (warp). Under the strains ef (weft), ew (warp) and
the shear angle g a diagonal of length l = sqrt(a^2 + b^2) has the strain
(a^2 ef + b^2 ew +- a b g) / l^2, so the two diagonals of stiffness kd in a cell store

    kd / l^2 ((a^2 ef + b^2 ew)^2 + a^2 b^2 g^2).

Shear: this must be G g^2 / 2 per area a b, hence kd = G l^2 / (2 a b). Tension: the diagonals then add G (a/b)^2 to the
weft's stiffness, G (b/a)^2 to the warp's, and the coupling C12 = G. The first two are subtracted from the structural
springs, whose k is (modulus) x (width per spring) / (length), with half the width on a border. So tension with the
width held, and shear, are exact for homogeneous strain at any resolution. What remains is the coupling: with free sides
the sheet narrows by G / Cf of its warp strain and the warp's modulus is Cw - G^2 / Cf. (The denim was measured to
couple by 20 N/m, with G = 27 N/m; other samples differ, one even in sign.) Cells too elongated for positive structural
constants are refused.

On a cone the cells are trapezoids: a is the mean width, b the height, and a weft spring takes
half of each row of cells at it.

Hinges. A hinge needs an edge and two opposite vertices, which need not be triangles of the drawn mesh. Three families,
on w = (kx x^2 + 2 t x y + ky y^2) / 2:
warp lines   edge (r, c)-(r, c+1), opposite (r-1, c) and (r+1, c): angle b ky, k = Bw a / b;
weft lines   edge (r, c)-(r+1, c), opposite (r, c+1) and (r, c-1): angle a kx, k = Bf b / a;
twist        diagonal of a cell, its other corners opposite: angle l t, k = 2 D a b / l^2.
Each family sees one component only, so the energy per area is exactly

    (Bf kx^2 + Bw ky^2 + 2 D t^2) / 2,

the orthotropic plate without Poisson coupling; with D = sqrt(Bf Bw) (twist was not measured) and Bf = Bw it is the
isotropic one, which bends alike in every direction. Lines on a border have half the width. A strip bent along its
length has its last hinge one cell before its end: the half cells beyond carry no moment, as a free edge should.

Rejected: hinges on the edges of the drawn triangles, with B e^2 / (A1 + A2) on straight edges and
half of that on alternating diagonals. It gives the same energy for a smooth w, but the vertices
with even r + c can move against the odd ones, which relieves all straight edges at once: after
relaxation 3/4 of B is left on square cells, with a Poisson ratio of -1/3. Here that motion bends
neighbouring lines in opposite senses and relieves nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nuno_cloth.fabrics.material import HandSet
from nuno_cloth.fabrics.presets import Material
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float


@dataclass(frozen=True)
class Lattice:
    """Rest measures of a grid: width (rows,) of a cell along each row and length (rows - 1,) of warp edges [m]."""

    width: Float
    length: Float

    def mean_width(self) -> Float:
        return 0.5 * (self.width[1:] + self.width[:-1])

    def height(self) -> Float:
        """Return heights (rows - 1,) of the trapezoids [m]."""
        return np.sqrt(self.length**2 - 0.25 * (self.width[1:] - self.width[:-1]) ** 2)

    def diagonal(self) -> Float:
        """Return diagonals (rows - 1,) of the trapezoids [m]: Ptolemy's d^2 = b^2 + a1 a2."""
        return np.sqrt(self.length**2 + self.width[1:] * self.width[:-1])

    def row_area(self) -> Float:
        """Return areas (rows,) of inner vertices [m^2]: a quarter of each adjacent cell."""
        area = self.mean_width() * self.height()
        return 0.5 * (np.append(area, 0.0) + np.insert(area, 0, 0.0))


@dataclass(frozen=True)
class Constants:
    """Constants per row of vertices (weft_*, hinge_warp, hinge_weft: rows) or of cells (the others: rows - 1).

    k [N/m], rest [m], c [N s/m]; hinges [N m]; bend_* are the papers' springs two apart; border is the ratio of a warp
    line's constants on a free side to an inner line's.
    """

    warp_k: Float
    warp_rest: Float
    warp_c: Float
    weft_k: Float
    weft_rest: Float
    weft_c: Float
    shear_k: Float
    shear_rest: Float
    shear_c: Float
    hinge_warp: Float
    hinge_weft: Float
    hinge_twist: Float
    bend_warp_k: float
    bend_weft_k: float
    bend_warp_c: Float
    bend_weft_c: Float
    border: float


def grid_constants(material: Material | HandSet, lattice: Lattice) -> Constants:
    """Return constants of a grid. Raises BadInput if cells are too elongated for the material."""
    if isinstance(material, HandSet):
        return _by_hand(material, lattice)
    a, b, g = lattice.mean_width(), lattice.height(), material.shear
    warp_modulus = material.warp - g * (b / a) ** 2
    weft_modulus = material.weft - g * (a / b) ** 2
    warp_k = warp_modulus * a / lattice.length
    weft_k = _half_sum(weft_modulus * b) / lattice.width
    _require_positive(material, lattice, warp_k, weft_k)
    shear_k = g * (a * a + b * b) / (2 * a * b)
    mass = material.density * lattice.row_area()
    warp_mass = mass[1:] * mass[:-1] / (mass[1:] + mass[:-1])
    ratio = 2 * material.damping_ratio
    return Constants(
        warp_k=warp_k,
        warp_rest=lattice.length,
        warp_c=ratio * np.sqrt(warp_k * warp_mass),
        weft_k=weft_k,
        weft_rest=lattice.width,
        weft_c=ratio * np.sqrt(weft_k * mass / 2),
        shear_k=shear_k,
        shear_rest=lattice.diagonal(),
        shear_c=ratio * np.sqrt(shear_k * warp_mass),
        hinge_warp=material.bend_warp * lattice.width / _half_sum(b),
        hinge_weft=material.bend_weft * _half_sum(b) / lattice.width,
        hinge_twist=4 * material.bend_twist * a * b / (a * a + b * b),
        bend_warp_k=0.0,
        bend_weft_k=0.0,
        bend_warp_c=np.zeros(max(0, mass.shape[0] - 2)),
        bend_weft_c=np.zeros_like(mass),
        border=0.5,
    )


def _half_sum(cells: Float) -> Float:
    """Return sums (rows,) of half of each of the two rows of cells at a row of vertices."""
    return 0.5 * (np.append(cells, 0.0) + np.insert(cells, 0, 0.0))


def _require_positive(material: Material, lattice: Lattice, warp_k: Float, weft_k: Float) -> None:
    if warp_k.min() > 0 and weft_k.min() > 0:
        return
    a, b = lattice.mean_width(), lattice.height()
    shape = a / b
    worst = shape[np.argmax(np.abs(np.log(shape)))]
    low, high = np.sqrt(material.shear / material.warp), np.sqrt(material.weft / material.shear)
    raise BadInput(
        "the cells are too elongated for this fabric: its shear springs alone would be stiffer in tension than it is",
        field="resolution",
        value=f"a cell {worst:.3g} times as wide as high",
        limit=f"between {low:.3g} and {high:.3g} times as wide as high",
        remedy="change the numbers of rows and columns until the cells are nearly square",
    )


def _by_hand(material: HandSet, lattice: Lattice) -> Constants:
    rows = lattice.width.shape[0]
    cells, vertices = np.ones(rows - 1), np.ones(rows)
    mass = material.density * lattice.row_area()
    ratio, reduced_mass = 2 * material.damping_ratio, mass[1:] * mass[:-1] / (mass[1:] + mass[:-1])

    def damping(k: float, reduced: Float) -> Float:
        return np.asarray(material.damping + ratio * np.sqrt(k * reduced))

    return Constants(
        warp_k=cells * material.structural[0],
        warp_rest=lattice.length,
        warp_c=damping(material.structural[0], reduced_mass),
        weft_k=vertices * material.structural[1],
        weft_rest=lattice.width,
        weft_c=damping(material.structural[1], mass / 2),
        shear_k=cells * material.shear,
        shear_rest=lattice.diagonal(),
        shear_c=damping(material.shear, reduced_mass),
        hinge_warp=vertices * material.hinge,
        hinge_weft=vertices * material.hinge,
        hinge_twist=cells * material.hinge,
        bend_warp_k=material.bending[0],
        bend_weft_k=material.bending[1],
        bend_warp_c=damping(material.bending[0], mass[2:] * mass[:-2] / (mass[2:] + mass[:-2])),
        bend_weft_c=damping(material.bending[1], mass / 2),
        border=1.0,
    )
