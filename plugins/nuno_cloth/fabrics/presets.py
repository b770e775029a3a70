"""Fabrics in measured units (after KES: tensile, shear, bending, weight), each with its source.

The numbers come from the samples of Wang, O'Brien and Ramamoorthi, "Data-driven elastic models
for cloth" (2011), as distributed with ARCSim's material files, first strain and first curvature
bin. They are converted as ARCSim's code reads them:

tensile   The file's C11 and C22 are doubled when read. With Green strain the energy per area is
          (C11 exx^2 + C22 eyy^2 + 2 C12 exx eyy) / 2, so they are force per width and strain
          with the width held. The file's first axis is taken as the warp; it does not say.
shear     The file's C33 is doubled, halved in the stress and multiplies the tensor strain
          exy = gamma / 2: energy C33 gamma^2 / 4 per area, hence G = C33 / 2.
bending   Its hinge has the energy K e^2 theta^2 / (8 (A1 + A2)) (Bridson's coefficient). A plate
          of rigidity B has B e^2 theta^2 / (2 (A1 + A2)), hence B = K / 4. The first row of the
          table is the fold along the first axis, which bends the weft; the third bends the warp.

The woven cotton, wool and polyester of Penava (2014) are left out: only their tensile stiffness
was measured. No source gives damping: the ratio is ours, chosen to let a sheet settle in seconds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

DAMPING_RATIO = 0.05
MEASURES = ("density", "warp", "weft", "shear", "bend_warp", "bend_weft")
"""What every fabric is described by."""
OTHERWISE = {
    "bend_bias": "derived: from the other rigidities",
    "bend_twist": "derived: from the other rigidities",
    "bend_poisson": "assumed: 0, not measured",
    "hysteresis_warp": "assumed: 0, not measured",
    "hysteresis_weft": "assumed: 0, not measured",
    "damping_ratio": f"assumed: {DAMPING_RATIO:g}, no source gives any",
}
"""How the rest of a fabric's measures is had where its source does not give them."""


def complete(how: Mapping[str, str]) -> dict[str, str]:
    """Of every measure whether it was `measured`, `derived` or `assumed`, and by what: `how` says it of what a source
    gives.
    """
    return OTHERWISE | dict(how)


@dataclass(frozen=True)
class Material:
    """A fabric whatever its mesh.

    density               areal density [kg/m^2]
    warp, weft            tensile stiffness, width held [N/m]
    shear                 shear stiffness, force per width and shear angle [N/m per rad]
    bend_warp, bend_weft  bending rigidity per width, of the warp and of the weft yarns [N m]
    bend_bias             the same of a strip cut at 45 degrees to both, or None where it was not measured
    bend_poisson          how far a bent strip curls up across, nu of B_1 = nu sqrt(B_w B_f)
    hysteresis_warp, hysteresis_weft  2HB [N]: width of the loop of moment per width over curvature
    damping_ratio         damping of each spring as a part of its critical damping
    source                where the numbers come from
    given                 the fields that it gives; for the rest see OTHERWISE
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
    given: tuple[str, ...] = MEASURES

    @property
    def bend_twist(self) -> float:
        """B_t [N m], of the energy 2 B_t t^2 per area and twist t.

        A strip along the bias is as stiff as 4 / B_45 = S_w + S_f + 2 S_wf + 1 / B_t says, S being the inverse of the
        rigidities. Where that was not measured, 2 B_t = (1 - nu) sqrt(B_w B_f).
        """
        both = math.sqrt(self.bend_warp * self.bend_weft)
        if self.bend_bias is None:
            return 0.5 * (1.0 - self.bend_poisson) * both
        return 1.0 / (4.0 / self.bend_bias - self.straight)

    @property
    def straight(self) -> float:
        """S_w + S_f + 2 S_wf [1/(N m)]: what warp and weft give to a strip along the bias."""
        nu, both = self.bend_poisson, math.sqrt(self.bend_warp * self.bend_weft)
        return (1.0 / self.bend_warp + 1.0 / self.bend_weft - 2.0 * nu / both) / (1.0 - nu * nu)


def _sample(
    name: str, what: str, density: float, c11: float, c22: float, c33: float, k_weft: float, k_warp: float
) -> Material:
    """A material from the numbers of a sample's file; the bending coefficients are in uN m."""
    return Material(
        density=density,
        warp=2 * c11,
        weft=2 * c22,
        shear=c33 / 2,
        bend_warp=k_warp * 1e-6 / 4,
        bend_weft=k_weft * 1e-6 / 4,
        source=f"Wang et al. 2011, sample {name} ({what}), ARCSim material file, first bins",
    )


PRESETS: dict[str, Material] = {
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
