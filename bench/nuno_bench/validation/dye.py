"""Laws of dye: its spread, its balance and bounds, and adsorption to the isotherm; and runs of solvers for them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Literal

import numpy as np
from pydantic import ValidationError

from nuno_bench.validation.law import (
    ACCURATE,
    BrokenRun,
    Laws,
    Measurement,
    Unsupported,
    bisect,
    fit_order,
    relative,
    whole_steps,
)
from nuno_schemas.dye import Cells, Dye, DyeReport, DyeState, DyeSystem, Isotherm, Tortuosity
from nuno_schemas.dyeing import WeiszZollinger
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

GROUP = "nuno.dye_solvers"
SIZE, D0, POROSITY = 5e-5, 5e-10, 0.5
"""Side of a cell [m], diffusion in water [m^2/s] and P of all cases, about those of the dye paper."""
RATE = D0 * POROSITY / SIZE**2
"""D0 P / size^2 [1/s]: what passes a face of tortuosity 1 in a second, as a share of the difference."""
SHARE = 0.9
"""Largest share of the stable step that is taken."""
laws = Laws(GROUP)
TAKEN = 0.02
"""D_ab / D0 of what adsorbs."""
ADSORB = TAKEN * D0 / SIZE**2
"""D_ab / size^2 [1/s]: rate at which fibre takes up adjacent dye."""
ADSORBED = Dye("dye", D0, TAKEN, Isotherm("langmuir", 2.0))
LONG = 1000.0
"""Explicit steps in one of a solver for which every step is stable."""
AMOUNT = 0.4
LAWS: dict[str, tuple[Isotherm, Callable[[float], float]]] = {
    "partition": (Isotherm("partition", 0.5), lambda phi: 0.5 * phi),
    "freundlich": (Isotherm("freundlich", 0.2, 0.5), lambda phi: 0.2 * math.sqrt(phi)),
    "langmuir": (Isotherm("langmuir", 1.0), lambda phi: (1.0 - POROSITY) * phi / (1.0 + phi)),
}
"""A_d of phi."""


def make_cells(
    ny: int,
    nx: int,
    *,
    yarn: float = 1.0,
    beside: float = 1.0,
    layers: float = 0.0,
    porosity: Float | float = POROSITY,
    resist: Float | float = 0.0,
) -> Cells:
    """Two layers, all fibre; what passes along yarns, across them and between the layers; weft lies along x."""
    one = np.ones((2, ny, nx))
    up = np.zeros((2, ny, nx), bool)
    up[1] = True
    tortuosity = Tortuosity(layers=layers, beside=beside, rim=1.0, gap=1.0, yarn=yarn, weave=1.0)
    return Cells(one > 0.0, up, porosity * one, one, resist * one, SIZE, tortuosity)


class DyeRun:
    """A solver on one cloth with one dye, from amounts phi (2, ny, nx) and nothing fixed.

    `phi` (2, ny, nx) is the mobile dye, `fixed` what fibre has taken; `report` is the last one; `supplied` is all
    that was given so far, `steps` how many were taken.
    """

    def __init__(
        self,
        plugin: Any,
        cells: Cells,
        phi: Float,
        dye: Dye | None = None,
        supply: Float | None = None,
        settings: Mapping[str, Any] = ACCURATE,
    ) -> None:
        """Raises Unsupported where the solver refuses it, or its configuration cannot be guessed."""
        self.plugin = plugin
        kept = None if supply is None else np.ascontiguousarray(supply, np.float64)[None]
        self.system = DyeSystem(cells, (dye or Dye("dye", D0),), 1, kept)
        known = {name: value for name, value in settings.items() if name in plugin.Config.model_fields}
        try:
            self.config = plugin.Config(**known)
        except ValidationError as error:
            missing = ", ".join(str(one["loc"][0]) for one in error.errors() if one["loc"])
            raise Unsupported(f"its configuration has no defaults ({missing})") from None
        start = np.ascontiguousarray(phi, np.float64)[None]
        self.state = DyeState(start.copy(), np.zeros_like(start))
        self.phi: Float = self.state.phi[0]
        self.fixed: Float = self.state.fixed[0]
        try:
            self.memory = plugin.prepare(self.config, self.system, self.state)
        except BadInput as refused:
            # A solver may know no isotherm, or no diffusion that falls with dye; what else it refuses all must pose.
            (one,) = self.system.dyes
            if one.isotherm is None and one.weisz_zollinger is None:
                raise BrokenRun(
                    f"refuses a system of neither isotherm nor law of diffusion: {refused.problem}"
                ) from None
            raise Unsupported(refused.problem) from None
        self.limit = float(plugin.limit(self.config, self.system))
        self.supplied, self.steps = 0.0, 0
        self.start = self.measure()

    def step(self, steps: int, dt: float) -> DyeReport:
        """So many steps. Raises Broken where the solver does not end well."""
        with np.errstate(all="ignore"):
            report: DyeReport = self.plugin.advance(self.system, self.state, self.memory, steps, dt)
        if report.status != "ok":
            raise BrokenRun(f"{report.status}: {report.message}")
        self.supplied += math.fsum(report.supplied)
        self.steps += steps
        return report

    def go(self, duration: float, longest: float) -> DyeRun:
        """`duration` [s] in whole steps of at most `longest` [s] and SHARE of the limit. Raises Unsupported, Broken."""
        self.step(*whole_steps(duration, min(longest, SHARE * self.limit)))
        return self

    def measure(self) -> float:
        """All dye, mobile and fixed, as the solver reports it."""
        report = self.step(0, 1.0)
        return math.fsum(report.mobile) + math.fsum(report.fixed)


# Laws of dye that spreads: a point source, a wave's decay, two layers, a bath, and diffusion that falls with dye.

SPREAD = 50.0
"""D t / size^2 of the point source at its end along x: a standard deviation of ten cells."""
SOURCE = "M / (4 pi t sqrt(Dx Dy)) exp(-x^2 / 4 Dx t - y^2 / 4 Dy t)"
RATIOS = {"isotropic": {"ratio": 1.0}, "anisotropic": {"ratio": 4.0}}
# Diffusion that falls with dye, D = D0 P phi0 / u where that is below its cap, is fast diffusion:
#
#     u_t = k (ln u)_xx,  k = D0 P phi0
#
# Barenblatt's solution, a source that spreads and keeps its dye, is of Cauchy's form here: 2 k t / (x^2 + (c k t)^2).
# Sources a period 2 pi / l apart add up to KERNEL, though the equation is not linear (Rosenau 1995, with cosh for cos),
# for with C = cosh(theta) - cos(l x) both u_t and k (ln u)_xx are l^2 k (1 - cosh(theta) cos(l x)) / C^2. m is the
# mean. By symmetry nothing passes x = 0 and x = pi / l, so that it is also what a source at the wall becomes between
# walls. It is nowhere below m tanh(theta / 2): with phi0 / cap less than that, the cap does not act.
KERNEL = "m sinh(theta) / (cosh(theta) - cos(l x)), theta = l^2 D0 P phi0 t / m"
MEAN, PHI0, CAP = 0.1, 0.02, 2.0
"""m, phi0 and cap: the cap acts below 0.1 of m."""
BEGIN, END = 0.3, 1.2
"""theta; the source's peak falls from 6.7 m to 1.9 m at the wall, and rises from 0.15 m to 0.54 m opposite to it."""


def _drop(plugin: Any, ratio: float) -> tuple[Float, tuple[Float, Float], tuple[float, float]]:
    """A full cell of the weft layer spread for a while, D being `ratio` times smaller across the yarns than along.

    Returns its amounts (ny, nx), places x and y from its middle [cells], and 2 D t along x and y [cells^2].
    """
    nx, ny = 121, 2 * math.ceil(6.0 * math.sqrt(2.0 * SPREAD / ratio)) + 1
    phi, duration = np.zeros((2, ny, nx)), SPREAD / RATE
    phi[0, ny // 2, nx // 2] = POROSITY
    run = DyeRun(plugin, make_cells(ny, nx, beside=1.0 / ratio), phi).go(duration, duration / 500.0)
    places = np.arange(float(nx)) - nx // 2, (np.arange(float(ny)) - ny // 2)[:, None]
    return run.phi[0], places, (2.0 * SPREAD, 2.0 * SPREAD / ratio)


@laws({f"point source, {name}": given for name, given in RATIOS.items()}, SOURCE)
def measure_source(plugin: Any, ratio: float) -> Measurement:
    """Dye from one cell spreads as a Gaussian, to a hundredth of its peak.

    Cells of size d leave d^2 / (8 D t) of the peak along either axis, 1 % of it at 2 D t = 25 d^2.
    """
    phi, (x, y), (wide, high) = _drop(plugin, ratio)
    peak = POROSITY / (2.0 * math.pi * math.sqrt(wide * high))
    exact = peak * np.exp(-(x**2) / (2.0 * wide) - y**2 / (2.0 * high))
    return Measurement(float(phi.max()) / peak, 1.0, float(np.abs(phi - exact).max()) / peak, 1e-2)


@laws({f"variance, {name}": given for name, given in RATIOS.items()}, SOURCE)
def measure_variance(plugin: Any, ratio: float) -> Measurement:
    """The second moment of a drop grows by 2 D t along either axis.

    That holds on cells and for any step alike: one step of weights w to the next cells adds 2 w to it.
    """
    phi, places, spread = _drop(plugin, ratio)
    along, across = (float((phi * place**2).sum() / phi.sum()) for place in places)
    error = max(abs(along / spread[0] - 1.0), abs(across / spread[1] - 1.0))
    return Measurement(along / across, ratio, error, 1e-4)


def make_wave(n: int, mean: float, height: float, times: int) -> tuple[Float, Callable[[float], float]]:
    """cos of half waves across n cells, twice in each direction, and its decay: exp(-4 sin^2 D t / d^2) each.

    Cosines at the middles of cells are eigenvectors of differences without flux at the ends.
    """
    wave = np.cos(math.pi * times * (np.arange(n) + 0.5) / n)
    speed = 8.0 * math.sin(0.5 * math.pi * times / n) ** 2 * RATE
    amounts = np.broadcast_to(mean + height * np.outer(wave, wave), (2, n, n)).copy()
    return amounts, lambda t: math.exp(-speed * t)


@laws("order, dye", "eigenvectors of differences")
def measure_order(plugin: Any) -> Measurement:
    """The error of a wave's decay falls with the order over five steps, halved: at least 1 where none is stated."""
    n = 16
    start, decay = make_wave(n, 0.25, 0.1, 2)
    cells, stated = make_cells(n, n), getattr(plugin, "order", None)
    duration = 1.0 / (8.0 * math.sin(math.pi / n) ** 2 * RATE)
    coarse = max(8, math.ceil(duration / DyeRun(plugin, cells, start).limit * (1.0 - 1e-12)))
    steps, errors = coarse * 2 ** np.arange(5), []
    exact = 0.25 + (start - 0.25) * decay(duration)
    # As even steps as a solver will take: those of a fine start would make coarse runs better than their order.
    settings = {"tolerance": 1e-12, "residual": 1e-13, "start": 1}
    for count in steps:
        run = DyeRun(plugin, cells, start, settings=settings)
        run.step(int(count), duration / count)
        errors.append(float(np.abs(run.phi - exact).max()))
    return fit_order(duration / steps, np.array(errors), float(stated or 1), least=stated is None)


@laws("two layers", "closed form")
def measure_exchange(plugin: Any) -> Measurement:
    """The difference of two layers, one of them dyed, decays as exp(-2 w t), w = D0 P T / d^2."""
    phi, duration = np.zeros((2, 4, 4)), 1.0 / RATE
    phi[0] = 0.4
    run = DyeRun(plugin, make_cells(4, 4, layers=0.5), phi).go(duration, duration / 2000.0)
    measured = float((run.phi[0] - run.phi[1]).mean()) / 0.4
    return Measurement(measured, math.exp(-1.0), abs(measured - math.exp(-1.0)), 1e-3)


@laws("bath", "Crank 1975, equation 4.18")
def measure_bath(plugin: Any) -> Measurement:
    """A sheet in a fixed bath takes up M_t / M_inf = 1 - sum of 8 / (m^2 pi^2) exp(-D m^2 pi^2 t / 4 l^2), m odd.

    The bath keeps the first column full. From its middle to the wall, where nothing passes, is half of the
    sheet, l; its own half cell counts as full.
    """
    n, share, bath = 64, 0.2, 0.4
    phi, length = np.zeros((2, 4, n)), n - 0.5
    phi[:, :, 0] = bath
    duration = share * length**2 / RATE
    run = DyeRun(plugin, make_cells(4, n), phi, supply=phi).go(duration, duration / 4000.0)
    odd = math.pi * (2.0 * np.arange(200) + 1.0)
    expected = 1.0 - float((8.0 / odd**2 * np.exp(-(odd**2) * share / 4.0)).sum())
    return relative(float(run.phi[0, 0, 1:].sum() + 0.5 * bath) / (bath * length), expected, 3e-3)


def average_sources(n: int, theta: float) -> Float:
    """(n,) means of the closed form over n cells between the walls: of 2 m / l atan(tan(l x / 2) / tanh(theta / 2))."""
    half = 0.5 * math.pi * np.arange(n + 1) / n
    whole = 2.0 * MEAN * n / math.pi * np.arctan2(np.sin(half), np.cos(half) * math.tanh(0.5 * theta))
    return np.asarray(np.diff(whole))


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
def measure_sources(plugin: Any, down: bool) -> Measurement:
    """With D = D0 phi0 / phi sources spread as Barenblatt's do, along the weft and across it, on 32 cells."""
    measured, error = _spread_sources(plugin, 32, 100, down)
    return Measurement(measured, 1.0, error, 3e-3)


@laws("fast diffusion, order", KERNEL)
def measure_cells(plugin: Any) -> Measurement:
    """The distance of sources to their closed form falls with the square of the cells' size, in steps that fall too."""
    numbers = np.array([12, 16, 24, 32])
    errors = [_spread_sources(plugin, int(n), int(4 * n), False)[1] for n in numbers]
    return fit_order(1.0 / numbers, np.array(errors), 2.0)


@laws(
    {"fast diffusion, wave": {"phi0": 0.1, "cap": 10.0}, "fast diffusion, cap": {"phi0": 5.0, "cap": 4.0}},
    "linearised u_t = div(grad u / u)",
)
def measure_wave(plugin: Any, phi0: float, cap: float) -> Measurement:
    """A small wave on even dye u decays with D0 phi0 / u, and with D0 cap where that is above the cap."""
    n, mean = 16, 0.25
    factor = min(cap, phi0 / mean)
    start, decay = make_wave(n, mean, 1e-4, 2)
    duration = 1.0 / factor / (8.0 * math.sin(math.pi / n) ** 2 * RATE)
    dye = Dye("dye", D0, weisz_zollinger=WeiszZollinger(phi0=phi0, cap=cap))
    run = DyeRun(plugin, make_cells(n, n), start, dye).go(duration, duration / 200.0)
    return relative(float(np.ptp(run.phi[0]) / np.ptp(start[0])), decay(duration * factor), 5e-3)


# Laws of how much dye there is.


def _uneven() -> tuple[Cells, Float]:
    """Cells of any porosity, a third of them with any resist, half of them full."""
    rng, shape = np.random.default_rng(4), (2, 24, 26)
    resist = rng.random(shape) * (rng.random(shape) < 0.3)
    cells = make_cells(*shape[1:], layers=0.3, beside=0.4, porosity=rng.random(shape), resist=resist)
    return cells, cells.mobile_room * (rng.random(shape) < 0.5)


@laws("balance", "fluxes cancel in pairs")
def measure_balance(plugin: Any) -> Measurement:
    """mobile + fixed - supplied stays as it is, but for rounding: 1e-13 of it, times sqrt(steps)."""
    cells, phi = _uneven()
    supply = np.zeros_like(phi)
    supply[:, 5:9, 5:9] = 0.5 * cells.mobile_room[:, 5:9, 5:9]
    run = DyeRun(plugin, cells, phi, ADSORBED, supply).go(400.0, 2.0)
    return relative(run.measure() - run.supplied, run.start, 1e-13 * math.sqrt(run.steps))


@laws({"bounds": {"length": 0.2}, "bounds, longest steps": {"length": 20.0}}, "dye paper, equations 6 and 9")
def measure_bounds(plugin: Any, length: float) -> Measurement:
    """0 <= phi <= V_u and 0 <= A <= V_d, at steps of at most 0.2 or 20 SIZE^2 / D0, or as long as it allows."""
    cells, phi = _uneven()
    run, worst = DyeRun(plugin, cells, phi, ADSORBED), 0.0
    for _ in range(20):
        run.go(4.0 * length * SIZE**2 / D0, length * SIZE**2 / D0)
        over = max(float((run.phi - cells.mobile_room).max()), float((run.fixed - cells.fixed_room).max()))
        worst = max(worst, over, -float(run.phi.min()), -float(run.fixed.min()))
    return Measurement(worst, 0.0, worst, 1e-14)


@laws("resist line", "V_u = 0 there")
def measure_resist(plugin: Any) -> Measurement:
    """Nothing comes through a line of B = 1 across the cloth: not a molecule in it or behind it."""
    resist, phi = np.zeros((2, 12, 20)), np.zeros((2, 12, 20))
    resist[:, :, 10:12] = 1.0
    phi[:, :, :10] = POROSITY
    run = DyeRun(plugin, make_cells(12, 20, layers=0.5, resist=resist), phi, ADSORBED, phi).go(2000.0, 5.0)
    behind = float(np.abs(run.phi[:, :, 10:]).max() + np.abs(run.fixed[:, :, 10:]).max())
    return Measurement(behind, 0.0, behind, 0.0)


def _taken(
    plugin: Any,
    isotherm: Isotherm,
    duration: float,
    step: float,
    uptake: Literal["difference", "amount"] = "difference",
) -> float:
    """Return what fibre takes of even dye AMOUNT in `duration` / r, in steps of at most `step` / r, r = ADSORB."""
    dye, phi = Dye("dye", D0, TAKEN, isotherm, uptake=uptake), np.full((2, 4, 4), AMOUNT)
    return float(DyeRun(plugin, make_cells(4, 4), phi, dye).go(duration / ADSORB, step / ADSORB).fixed.mean())


@laws({f"uptake by {name}": {"uptake": name, "end": end} for name, end in (("difference", 2.0), ("amount", 1.0))},
      "closed form")  # fmt: skip
def measure_uptake(plugin: Any, uptake: Literal["difference", "amount"], end: float) -> Measurement:
    """Even dye M, which fibre takes up without a limit, is taken up as A = M / n (1 - exp(-n r t)), r = D_ab / d^2.

    It is the solution of dA/dt = r (phi - A), n = 2, and of dA/dt = r phi, n = 1.
    """
    measured = _taken(plugin, Isotherm("partition", 1.0), 0.5, 0.5 / 2000.0, uptake)
    return relative(measured, AMOUNT / end * (1.0 - math.exp(-0.5 * end)), 1e-3)


@laws({f"rest, {name}": {"isotherm": of, "limit": a} for name, (of, a) in LAWS.items()}, "A = A_d(M - A)")
def measure_rest(plugin: Any, isotherm: Isotherm, limit: Callable[[float], float]) -> Measurement:
    """Even dye M that adsorbs until nothing changes leaves A on the fibre as the isotherm A_d says.

    Fibre takes at least r (phi - A) until it holds what it may: that is done before 5 / r.
    """
    expected = bisect(0.0, AMOUNT, lambda held: limit(AMOUNT - held) <= held)
    return relative(_taken(plugin, isotherm, 5.0, 1e-3), expected, 3e-3)


@laws("dye's stated limit", "D0 dt / d^2 times the sum of P T is 1")
def measure_limit(plugin: Any) -> Measurement:
    """The finest pattern fades at 0.999 of the stated limit, if any, and grows at 1.05 of it, in 60 steps.

    Who states none must let it fade at LONG explicit steps, too.
    """
    n = 40
    place = np.indices((n, n)).sum(axis=0) % 2
    phi = np.broadcast_to(0.25 + 1e-6 * (place - 0.5), (2, n, n)).copy()

    def growth(share: float, steps: int) -> float:
        run = DyeRun(plugin, make_cells(n, n), phi)
        run.step(steps, share * run.limit if math.isfinite(run.limit) else LONG / (4.0 * RATE))
        return float(np.ptp(run.phi)) / float(np.ptp(phi))

    if not math.isfinite(DyeRun(plugin, make_cells(n, n), phi).limit):
        fading = growth(1.0, 6)
        return Measurement(fading, 0.0, max(0.0, fading - 1.0), 1e-9)
    below, above = growth(0.999, 60), growth(1.05, 60)
    return Measurement(above, below, max(0.0, below - 1.0) + max(0.0, 1.0 - above), 1e-9)
