"""Fabrics in measured units (after KES: tensile, shear, bending, weight), each with its source.

The numbers come from the samples of Wang, O'Brien and Ramamoorthi, "Data-driven elastic models
for cloth" (2011), as distributed with ARCSim's material files, first strain and first curvature
bin. They are converted as ARCSim's code reads them:

tensile   The file's C11 and C22 are doubled when read. With Green strain the energy per area is (C11 exx^2 + C22 eyy^2
          + 2 C12 exx eyy) / 2, so they are force per width and strain with the width held. The file's first axis is
          assumed to be the warp; it does not say.
shear     The file's C33 is doubled, halved in the stress and multiplies the tensor strain
          exy = gamma / 2: energy C33 gamma^2 / 4 per area, hence G = C33 / 2.
bending   Its hinge has the energy K e^2 theta^2 / (8 (A1 + A2)) (Bridson's coefficient). A plate
          of rigidity B has B e^2 theta^2 / (2 (A1 + A2)), hence B = K / 4. The first row of the
          table is the fold along the first axis, which bends the weft; the third bends the warp.

Silk, chiffon, wool, linen, canvas and leather are not among those samples, and no open source has all six measures of
one such cloth. `how` gives the origin of each of their measures:

bending   From the fibre: straight fibres that slide freely in their yarns bend independently. A mass m per area of
          bending yarns has n = 4 m / (pi rho d^2) fibres of diameter d and density rho per width, each of rigidity E pi
          d^4 / 64, hence B = m E d^2 / (16 rho). Cloth whose fibres hold each other is stiffer: fabrics of Feng et al.
          within a tenth of chiffon's weight have 1.5 to 2.1 times as much, those of silk's, of any fibre, 0.5 to 6
          times.
tension   That of the preset with the most similar yarns and weave: cloth first gives by crimp, not by its fibre.

No source gives damping: the ratio is chosen to let a sheet settle in seconds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

DAMPING_RATIO = 0.05
MEASURES = ("density", "warp", "weft", "shear", "bend_warp", "bend_weft")
"""Measures that every fabric has."""
OTHERWISE = {
    "bend_bias": "derived: from the other rigidities",
    "bend_twist": "derived: from the other rigidities",
    "bend_poisson": "assumed: 0, not measured",
    "hysteresis_warp": "assumed: 0, not measured",
    "hysteresis_weft": "assumed: 0, not measured",
    "damping_ratio": f"assumed: {DAMPING_RATIO:g}, no source gives any",
}
"""Origin of the other measures of a fabric whose source does not give them."""


def complete(how: Mapping[str, str]) -> dict[str, str]:
    """Return for every measure `measured`, `derived` or `assumed`, and the reason; `how` holds those that a source
    gives.
    """
    return OTHERWISE | dict(how)


@dataclass(frozen=True)
class Material:
    """A fabric, independent of any mesh.

    density               areal density [kg/m^2]
    warp, weft            tensile stiffness, width held [N/m]
    shear                 shear stiffness, force per width and shear angle [N/m per rad]
    bend_warp, bend_weft  bending rigidity per width, of the warp and of the weft yarns [N m]
    bend_bias             the same of a strip cut at 45 degrees to both, or None where it was not measured
    bend_poisson          how far a bent strip curls up across, nu of B_1 = nu sqrt(B_w B_f)
    hysteresis_warp, hysteresis_weft  2HB [N]: width of the loop of moment per width over curvature
    damping_ratio         damping of each spring as a part of its critical damping
    source                where the numbers come from
    how                   for each measure `measured`, by the source, or `derived` or `assumed`, a colon and the reason;
                          by default as in OTHERWISE
    """

    density: float
    warp: float
    weft: float
    shear: float
    bend_warp: float
    bend_weft: float
    damping_ratio: float = DAMPING_RATIO
    source: str = "the scene"
    bend_bias: float | None = None
    bend_poisson: float = 0.0
    hysteresis_warp: float = 0.0
    hysteresis_weft: float = 0.0
    how: Mapping[str, str] = field(default_factory=lambda: dict.fromkeys(MEASURES, "measured"))

    @property
    def bend_twist(self) -> float:
        """B_t [N m], of the energy 2 B_t t^2 per area and twist t.

        The rigidity of a strip along the bias is 4 / B_45 = S_w + S_f + 2 S_wf + 1 / B_t, S being the inverse of the
        rigidities. If it was not measured, 2 B_t = (1 - nu) sqrt(B_w B_f).
        """
        both = math.sqrt(self.bend_warp * self.bend_weft)
        if self.bend_bias is None:
            return 0.5 * (1.0 - self.bend_poisson) * both
        return 1.0 / (4.0 / self.bend_bias - self.bias_compliance)

    @property
    def bias_compliance(self) -> float:
        """S_w + S_f + 2 S_wf [1/(N m)]: the compliance of a strip along the bias by warp and weft."""
        nu, both = self.bend_poisson, math.sqrt(self.bend_warp * self.bend_weft)
        return (1.0 / self.bend_warp + 1.0 / self.bend_weft - 2.0 * nu / both) / (1.0 - nu * nu)


def _sample(
    name: str, what: str, density: float, c11: float, c22: float, c33: float, k_weft: float, k_warp: float
) -> Material:
    """Return a material from the numbers of a sample's file; the bending coefficients are in uN m."""
    return Material(
        density=density,
        warp=2 * c11,
        weft=2 * c22,
        shear=c33 / 2,
        bend_warp=k_warp * 1e-6 / 4,
        bend_weft=k_weft * 1e-6 / 4,
        source=f"Wang et al. 2011, sample {name} ({what}), ARCSim material file, first bins",
    )


def _sliding(mass: float, modulus: float, density: float, diameter: float) -> float:
    """Return rigidity per width [N m] of sliding fibres: mass per area [kg/m^2], modulus [Pa], density [kg/m^3], m."""
    return mass * modulus * diameter**2 / (16.0 * density)


def _as_of(name: str, why: str, *measures: str) -> dict[str, str]:
    return dict.fromkeys(measures, f"assumed: as of {name}, {why}")


def _by_fibre(words: str) -> dict[str, str]:
    """Return the origin of both rigidities that are derived from the fibre, with half of the mass each way."""
    return dict.fromkeys(("bend_warp", "bend_weft"), f"derived: of {words}, that slide freely, half of them each way")


SAMPLES: dict[str, Material] = {
    "denim": _sample(
        "11oz-black-denim", "jeans, 99% cotton", 0.324, 205.352005, 1013.88629, 53.387184, 64.196457, 96.951576
    ),
    "interlock": _sample(
        "gray-interlock",
        "t-shirt, 60% cotton 40% polyester",
        0.187,
        16.593832,
        34.477123,
        36.860302,
        23.191698,
        14.267624,
    ),
    "rib-knit": _sample(
        "ivory-rib-knit",
        "underwear, 95% cotton 5% spandex",
        0.276,
        42.871021,
        65.166023,
        83.175644,
        46.237591,
        32.243889,
    ),
    "polyester": _sample(
        "white-dots-on-blk", "tablecloth, polyester", 0.128, 2002.08618, 2027.48559, 19.189022, 51.713814, 31.282822
    ),
    "jacket": _sample(
        "tango-red-jet-set", "jacket, polyester", 0.113, 43.067627, 171.424835, 14.3147, 14.293814, 20.345654
    ),
    "trousers": _sample(
        "royal-target",
        "pants, 65% cotton 35% polyester",
        0.220,
        2016.55456,
        2034.97644,
        104.759674,
        125.409805,
        125.409805,
    ),
    "swimwear": _sample(
        "white-swim-solid",
        "swimsuit, 87% nylon 13% spandex",
        0.204,
        47.971176,
        104.615456,
        60.773663,
        60.237942,
        51.018833,
    ),
}

OUNCE, MOMME = 0.0339057, 0.00434
"""An ounce on a square yard, and a momme, the weight of silk [kg/m^2]."""
HANDBOOK = "Bunsell (ed.), Handbook of Properties of Textile and Technical Fibres, 2018, table 1.1"
SILK = "silk fibres of 10 um, 7 GPa and 1.34 g/cm^3"
SILKS = "7 GPa of silk: Materials Science in Additive Manufacturing 4(2), 2025, doi 10.36922/MSAM025130020, table 1"
PENAVA = "Penava, Simic Penava, Knezic, Fibres & Textiles in Eastern Europe 22(2), 2014"
FENG = "Feng et al., Learning-Based Bending Stiffness Parameter Estimation by a Drape Tester, 2022, data of 618 fabrics"
MEMON = "Memon et al., Materials 14(16), 2021, 4553: sheep garment leather of 0.64 to 0.96 mm drapes at 47 to 70 %"

_POLYESTER, _JACKET, _TROUSERS, _DENIM = (SAMPLES[name] for name in ("polyester", "jacket", "trousers", "denim"))
_IN_PLANE = ("warp", "weft", "shear")

PRESETS: dict[str, Material] = SAMPLES | {
    "silk": Material(
        density=16 * MOMME, warp=_POLYESTER.warp, weft=_POLYESTER.weft, shear=_POLYESTER.shear,
        bend_warp=_sliding(8 * MOMME, 7e9, 1340.0, 10e-6), bend_weft=_sliding(8 * MOMME, 7e9, 1340.0, 10e-6),
        source=f"habotai of 16 momme, not a sample; {SILKS}",
        how={"density": "assumed: 16 momme", **_by_fibre(SILK),
             **_as_of("polyester", "a plain weave of filaments, too", *_IN_PLANE)},
    ),
    "chiffon": Material(
        density=8 * MOMME, warp=_JACKET.warp, weft=_JACKET.weft, shear=_JACKET.shear,
        bend_warp=_sliding(4 * MOMME, 7e9, 1340.0, 10e-6), bend_weft=_sliding(4 * MOMME, 7e9, 1340.0, 10e-6),
        source=f"silk chiffon of 8 momme, not a sample; {SILKS}",
        how={"density": "assumed: 8 momme", **_by_fibre(SILK),
             **_as_of("jacket", "the light woven cloth that gives most", *_IN_PLANE)},
    ),
    "wool": Material(
        density=0.2348, warp=0.170e6 * 0.568e-3, weft=0.170e6 * 0.568e-3, shear=_DENIM.shear,
        bend_warp=_sliding(0.1174, 2e9, 1300.0, 20e-6), bend_weft=_sliding(0.1174, 2e9, 1300.0, 20e-6),
        source=f"{PENAVA}, plain woven wool; {HANDBOOK}",
        how={"density": "measured",
             **dict.fromkeys(("warp", "weft"), "derived: 0.170 MPa times 0.568 mm, the mean of both ways, sides free"),
             **_as_of("denim", "a woven cloth of spun yarns, too", "shear"),
             **_by_fibre("wool fibres of 20 um, 2 GPa and 1.3 g/cm^3")},
    ),
    "linen": Material(
        density=0.185, warp=_TROUSERS.warp, weft=_TROUSERS.weft, shear=_TROUSERS.shear,
        bend_warp=_sliding(0.0925, 65e9, 1530.0, 14e-6), bend_weft=_sliding(0.0925, 65e9, 1530.0, 14e-6),
        source=f"linen for dresses and suits, not a sample; {HANDBOOK}",
        how={"density": "assumed: of linen for dresses and suits",
             **_by_fibre("flax fibres of 14 um, 65 GPa and 1.53 g/cm^3"),
             **_as_of("trousers", "a woven cloth of spun yarns, too", *_IN_PLANE)},
    ),
    "canvas": Material(
        density=10 * OUNCE, warp=_TROUSERS.warp, weft=_TROUSERS.weft, shear=_TROUSERS.shear,
        bend_warp=188.9957e-6, bend_weft=37.2213e-6,
        source=f"cotton duck of 10 oz/yd^2, not a sample; {FENG}",
        how={"density": "assumed: 10 oz/yd^2",
             **dict.fromkeys(("bend_warp", "bend_weft"),
                             "assumed: as of the stiffest of 618 fabrics within a tenth of its weight, of any fibre"),
             **_as_of("trousers", "a woven cloth of spun yarns, too", *_IN_PLANE)},
    ),
    "leather": Material(
        density=0.8e-3 * 650.0, warp=1000.0, weft=1000.0, shear=1000.0 / 3.0, bend_warp=20.9e-6, bend_weft=20.9e-6,
        source=f"sheep leather for garments, not a sample; {MEMON}",
        how={"density": "assumed: 0.8 mm of 0.65 g/cm^3",
             **dict.fromkeys(("warp", "weft"), "assumed: 0.8 mm of 1.25 MPa"),
             "shear": "derived: a third of tension, at which a sheet is alike in all directions",
             **dict.fromkeys(("bend_warp", "bend_weft"),
                             "derived: a bending length of 16 mm, which drapes here at 55 to 67 %")},
    ),
}  # fmt: skip
"""The measured samples, and common fabrics that are not among them."""
