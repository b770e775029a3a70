"""Laws of specimens: the weight under which a strip on its side tips over, and what a disc's drape depends on."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nuno_bench.instruments import buckling
from nuno_bench.validation.laws.base import ACCURATE, DOWN, Found, G, Laws, Run, relative
from nuno_bench.validation.laws.statics import settle, swatch
from nuno_schemas.system import System

laws = Laws()
POISSON = {"0": 0.0, "0.3": 0.3, "-1/3": -1.0 / 3.0}


@laws({f"lateral buckling {name}": {"poisson": value} for name, value in POISSON.items()}, "zero of Bessel's J -1/6")
def measure_buckling(plugin: Any, poisson: float, layout: str = "irregular") -> Found:
    """A narrow strip on its side loses all stiffness against tipping over at w L^3 / B = 12.85 sqrt(2 / (1 + nu)).

    By the forces that the solver reports. The strip is 120 edges long and 2 wide.
    """
    density, rigidity = 0.2, 1e-5
    fabric = {"density": density, "warp": 4e3, "weft": 4e3, "shear": 4e2, "bend_poisson": poisson}
    fabric |= {"bend_warp": rigidity, "bend_weft": rigidity}
    narrow = rigidity * (1.0 - poisson**2)
    found = buckling.tips_over(fabric, narrow, density, 0.2, 120, 2, solver=plugin.name, layout=layout)
    return relative(found, buckling.critical(poisson), 3e-2)


def sunk(plugin: Any, size: float, weight: float) -> float:
    """Mean depth of a draped disc's ring over its radius a, with w a^3 / B = 300 and C = 1500 w a.

    It starts in four folds; a and the mass per area are so many times 15 cm and 0.2 kg/m^2.
    """
    radius, density = 0.15 * size, 0.2 * weight
    fabric = dict.fromkeys(("warp", "weft"), 1500.0 * density * G * radius)
    fabric |= dict.fromkeys(("bend_warp", "bend_weft"), density * G * radius**3 / 300.0)
    fabric |= {"density": density, "shear": 0.1 * fabric["warp"], "damping_ratio": 0.0}
    cloth = swatch(radius=radius, hold=0.6 * radius, edge=0.2 * radius, fabric=fabric)
    free, x = ~cloth.pinned, cloth.position
    out = (np.hypot(x[:, 0], x[:, 2]) / radius - 0.6) / 0.4
    x[free, 1] = (0.06 * radius * out * np.cos(4.0 * np.arctan2(x[:, 2], x[:, 0])))[free]
    swing = math.sqrt(G / radius)
    run = Run(plugin, System(cloth, DOWN, 2.0 * swing), ACCURATE)
    return settle(run, 60.0 / swing, 0.1 / swing, lambda x: float(-x[free, 1].mean()) / radius, 1e-5)


@laws("drape", "dimensions")
def measure_drape(plugin: Any) -> Found:
    """A disc of twice the size and three times the weight with the same w a^3 / B drapes alike, from a start alike."""
    return relative(sunk(plugin, 2.0, 3.0), sunk(plugin, 1.0, 1.0), 1e-3)
