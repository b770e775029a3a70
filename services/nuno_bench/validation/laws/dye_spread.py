"""Laws of dye that spreads: a point source, a wave's decay, two layers, a bath."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from nuno_bench.validation.laws.base import Case, Found, fit_order, order_slack
from nuno_bench.validation.laws.dye import GROUP, POROSITY, RATE, DyeRun, make_cells
from nuno_schemas.fabric import Float

SPREAD = 50.0
"""D t / size^2 of the point source at its end along x: a standard deviation of ten cells."""


def _drop(plugin: Any, ratio: float) -> tuple[DyeRun, Float, Float]:
    """A full cell of the weft layer spread for a while, D being `ratio` times smaller across the yarns than along
    them; and 2 D t along x and y [cells^2].
    """
    nx, ny = 121, 2 * math.ceil(6.0 * math.sqrt(2.0 * SPREAD / ratio)) + 1
    cells, phi = make_cells(ny, nx, beside=1.0 / ratio), np.zeros((2, ny, nx))
    phi[0, ny // 2, nx // 2] = POROSITY
    run, duration = DyeRun(plugin, cells, phi), SPREAD / RATE
    run.go(duration, duration / 500.0)
    return run, 2.0 * SPREAD * np.ones(1), 2.0 * SPREAD / ratio * np.ones(1)


def measure_source(plugin: Any, ratio: float) -> Found:
    """Largest distance to M / (4 pi t sqrt(Dx Dy)) exp(-x^2 / 4 Dx t - y^2 / 4 Dy t), as a share of its peak.

    Cells of size d leave d^2 / (8 D t) of the peak along either axis, 1 % of it at 2 D t = 25 d^2.
    """
    run, wide, high = _drop(plugin, ratio)
    ny, nx = run.phi.shape[1:]
    x, y = np.arange(nx) - nx // 2, (np.arange(ny) - ny // 2)[:, None]
    peak = POROSITY / (2.0 * math.pi * math.sqrt(float(wide[0] * high[0])))
    exact = peak * np.exp(-(x**2) / (2.0 * wide) - y**2 / (2.0 * high))
    error = float(np.abs(run.phi[0] - exact).max()) / peak
    return Found(float(run.phi[0].max()) / peak, 1.0, error, 1e-2)


def measure_variance(plugin: Any, ratio: float) -> Found:
    """The second moment of a drop grows by 2 D t along either axis, on cells and for any step alike:
    one step of weights w to the next cells adds 2 w to it.
    """
    run, wide, high = _drop(plugin, ratio)
    ny, nx = run.phi.shape[1:]
    x, y = np.arange(nx) - nx // 2, (np.arange(ny) - ny // 2)[:, None]
    total = float(run.phi[0].sum())
    along, across = (float((run.phi[0] * places**2).sum()) / total for places in (x, y))
    error = max(abs(along / float(wide[0]) - 1.0), abs(across / float(high[0]) - 1.0))
    return Found(along / across, ratio, error, 1e-4)


def make_wave(n: int, mean: float, height: float, times: int) -> tuple[Float, Callable[[float], float]]:
    """cos of half waves across n cells, twice in each direction, and its decay: exp(-4 sin^2 D t / d^2) each.

    Cosines at the middles of cells are eigenvectors of differences without flux at the ends.
    """
    wave = np.cos(math.pi * times * (np.arange(n) + 0.5) / n)
    speed = 8.0 * math.sin(0.5 * math.pi * times / n) ** 2 * RATE
    amounts = np.broadcast_to(mean + height * np.outer(wave, wave), (2, n, n)).copy()
    return amounts, lambda t: math.exp(-speed * t)


def measure_order(plugin: Any) -> Found:
    """The error against the wave's decay over five steps, halved, and the slope fitted to it.

    A solver may state its `order`; of one that does not at least 1 is expected.
    """
    n, height = 16, 0.1
    start, decay = make_wave(n, 0.25, height, 2)
    cells, stated = make_cells(n, n), getattr(plugin, "order", None)
    limit = DyeRun(plugin, cells, start).limit
    duration = 1.0 / (8.0 * math.sin(math.pi / n) ** 2 * RATE)
    coarse = max(8, math.ceil(duration / limit * (1.0 - 1e-12)))
    steps, errors = coarse * 2 ** np.arange(5), []
    exact = 0.25 + (start - 0.25) * decay(duration)
    # As even steps as a solver will take: those of a fine start would make coarse runs better than their order.
    settings = {"tolerance": 1e-12, "residual": 1e-13, "start": 1}
    for count in steps:
        run = DyeRun(plugin, cells, start, settings=settings)
        run.step(int(count), duration / count)
        errors.append(float(np.abs(run.phi - exact).max()))
    dt, found = duration / steps, np.array(errors)
    seen = fit_order(dt, found)
    short = abs(seen - stated) if stated is not None else max(0.0, 1.0 - seen)
    series = {"dt": tuple(map(float, dt)), "error": tuple(errors)}
    return Found(seen, float(stated or 1), short, order_slack(int(stated or 1)), series)


def measure_exchange(plugin: Any) -> Found:
    """Two layers, one dyed: their difference decays as exp(-2 w t), w = D0 P T / d^2."""
    layers = 0.5
    phi = np.zeros((2, 4, 4))
    phi[0] = 0.4
    run, duration = DyeRun(plugin, make_cells(4, 4, layers=layers), phi), 1.0 / (2.0 * layers * RATE)
    run.go(duration, duration / 2000.0)
    measured = float((run.phi[0] - run.phi[1]).mean()) / 0.4
    return Found(measured, math.exp(-1.0), abs(measured - math.exp(-1.0)), 1e-3)


def measure_bath(plugin: Any) -> Found:
    """M_t / M_inf of a sheet in a fixed bath, 1 - sum of 8 / ((2 n + 1)^2 pi^2) exp(-D (2 n + 1)^2 pi^2 t / 4 l^2).

    The bath keeps the first column full. From its middle to the wall, where nothing passes, is half of the
    sheet, l; its own half cell counts as full.
    """
    n, share, bath = 64, 0.2, 0.4
    phi = np.zeros((2, 4, n))
    phi[:, :, 0] = bath
    run, length = DyeRun(plugin, make_cells(4, n), phi, supply=phi), n - 0.5
    duration = share * length**2 / RATE
    run.go(duration, duration / 4000.0)
    odd = 2.0 * np.arange(200) + 1.0
    expected = 1.0 - float((8.0 / (odd * math.pi) ** 2 * np.exp(-((odd * math.pi) ** 2) * share / 4.0)).sum())
    measured = float(run.phi[0, 0, 1:].sum() + 0.5 * bath) / (bath * length)
    return Found(measured, expected, abs(measured / expected - 1.0), 3e-3)


SOURCE = "M / (4 pi t sqrt(Dx Dy)) exp(-x^2 / 4 Dx t - y^2 / 4 Dy t)"
CASES = (
    *(
        Case(f"{name}, {what}", law, SOURCE, partial(measure, ratio=ratio), GROUP)
        for what, ratio in (("isotropic", 1.0), ("anisotropic", 4.0))
        for name, law, measure in (
            ("point source", "dye from one cell spreads as a Gaussian", measure_source),
            ("variance", "the second moment of a drop grows by 2 D t along either axis", measure_variance),
        )
    ),
    Case("order, dye", "the error of a wave's decay falls with the order, at least 1", "eigenvectors of differences",
         measure_order, GROUP),
    Case("two layers", "the difference of two layers decays as exp(-2 w t)", "closed form", measure_exchange, GROUP),
    Case("bath", "a sheet in a fixed bath takes up M_t / M_inf", "Crank 1975, equation 4.18", measure_bath, GROUP),
)  # fmt: skip
