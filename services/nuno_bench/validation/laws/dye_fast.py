"""Laws of diffusion that falls with dye, D = D0 P phi0 / u where that is below its cap: fast diffusion.

    u_t = k (ln u)_xx,  k = D0 P phi0

Barenblatt's solution, a source that spreads and keeps its dye, is of Cauchy's form here: 2 k t / (x^2 + (c k t)^2).
Sources a period 2 pi / l apart add up, though the equation is not linear (Rosenau 1995, with cosh for cos):

    u = m sinh(theta) / (cosh(theta) - cos(l x)),  theta = l^2 k t / m,

for with C = cosh(theta) - cos(l x) both u_t and k (ln u)_xx are l^2 k (1 - cosh(theta) cos(l x)) / C^2. m is the mean.
By symmetry nothing passes x = 0 and x = pi / l, so that it is also what a source at the wall becomes between walls. It
is nowhere below m tanh(theta / 2): with phi0 / cap less than that, the cap does not act.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nuno_bench.validation.laws.base import Found, Laws, fit_order, relative
from nuno_bench.validation.laws.dye import D0, GROUP, RATE, DyeRun, make_cells
from nuno_bench.validation.laws.dye_spread import make_wave
from nuno_schemas.dye import Dye
from nuno_schemas.dyeing import WeiszZollinger
from nuno_schemas.fabric import Float

laws = Laws(GROUP)
KERNEL = "m sinh(theta) / (cosh(theta) - cos(l x)), theta = l^2 D0 P phi0 t / m"
MEAN, PHI0, CAP = 0.1, 0.02, 2.0
"""m, phi0 and cap: the cap acts below 0.1 of m."""
BEGIN, END = 0.3, 1.2
"""theta; the source's peak falls from 6.7 m to 1.9 m at the wall, and rises from 0.15 m to 0.54 m opposite to it."""


def average_sources(n: int, theta: float) -> Float:
    """(n,) means of the closed form over n cells between the walls: of 2 m / l atan(tan(l x / 2) / tanh(theta / 2))."""
    half = 0.5 * math.pi * np.arange(n + 1) / n
    whole = 2.0 * MEAN * n / math.pi * np.arctan2(np.sin(half), np.cos(half) * math.tanh(0.5 * theta))
    means: Float = np.diff(whole)
    return means


def _spread_sources(plugin: Any, n: int, steps: int, down: bool) -> tuple[float, float]:
    """Peak over the exact one, and the largest distance to it as a share of it, along the weft or across it."""
    start, exact = (average_sources(n, theta) for theta in (BEGIN, END))
    dye = Dye("dye", D0, weisz_zollinger=WeiszZollinger(phi0=PHI0, cap=CAP))
    shape = (2, n, 2) if down else (2, 2, n)
    cells = make_cells(*shape[1:], porosity=1.0)
    duration = (END - BEGIN) * MEAN / PHI0 * (n / math.pi) ** 2 / (2.0 * RATE)
    phi = np.broadcast_to(start[:, None] if down else start, shape)
    run = DyeRun(plugin, cells, phi, dye).go(duration, duration / steps)
    found = run.phi[0, :, 0] if down else run.phi[0, 0]
    return float(found.max() / exact.max()), float(np.abs(found - exact).max() / exact.max())


@laws({"fast diffusion, along": {"down": False}, "fast diffusion, across": {"down": True}}, KERNEL)
def measure_sources(plugin: Any, down: bool) -> Found:
    """With D = D0 phi0 / phi sources spread as Barenblatt's do, along the weft and across it, on 32 cells."""
    measured, error = _spread_sources(plugin, 32, 100, down)
    return Found(measured, 1.0, error, 3e-3)


@laws("fast diffusion, order", KERNEL)
def measure_cells(plugin: Any) -> Found:
    """The distance of sources to their closed form falls with the square of the cells' size, in steps that fall too."""
    numbers = np.array([12, 16, 24, 32])
    errors = [_spread_sources(plugin, int(n), int(4 * n), False)[1] for n in numbers]
    return fit_order(1.0 / numbers, np.array(errors), 2.0)


@laws(
    {"fast diffusion, wave": {"phi0": 0.1, "cap": 10.0}, "fast diffusion, cap": {"phi0": 5.0, "cap": 4.0}},
    "linearised u_t = div(grad u / u)",
)
def measure_wave(plugin: Any, phi0: float, cap: float) -> Found:
    """A small wave on even dye u decays with D0 phi0 / u, and with D0 cap where that is above the cap."""
    n, mean = 16, 0.25
    factor = min(cap, phi0 / mean)
    start, decay = make_wave(n, mean, 1e-4, 2)
    duration = 1.0 / factor / (8.0 * math.sin(math.pi / n) ** 2 * RATE)
    dye = Dye("dye", D0, weisz_zollinger=WeiszZollinger(phi0=phi0, cap=cap))
    run = DyeRun(plugin, make_cells(n, n), start, dye).go(duration, duration / 200.0)
    return relative(float(np.ptp(run.phi[0]) / np.ptp(start[0])), decay(duration * factor), 5e-3)
