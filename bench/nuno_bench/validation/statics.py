"""Laws of what hangs: a chain's stretch, its curve and its frequencies, a heavy strip, a draped disc."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from nuno_bench.fabric_tests import specimens
from nuno_bench.piles import DOWN, G, build_model
from nuno_bench.validation.law import (
    ACCURATE,
    NONE,
    Laws,
    Measurement,
    SolverRun,
    Unsupported,
    bisect,
    chain,
    choose_step,
    fit_order,
    make_fabric,
    relative,
)
from nuno_bench.validation.oscillator import KEEPS_ANGULAR_MOMENTUM, order_found
from nuno_schemas.fabric import Fabric, Float, Springs
from nuno_schemas.system import System

laws = Laws()
DROP = {1: 0.123471, 10: 0.700200, 100: 0.937524}
"""Drop / length of a heavy cantilever at w L^3 / B, from theta'' = -Gamma (1 - s) cos theta,
theta(0) = theta'(1) = 0."""
LOOKS = 12
POISSON = {"0": 0.0, "0.3": 0.3, "-1/3": -1.0 / 3.0}


def settle(run: SolverRun, duration: float, longest: float, measure: Callable[[Float], float], slack: float) -> float:
    """Run on until `measure` of the positions rests, and return it: two looks that change it by less than `slack`.

    There are LOOKS looks in `duration`. Speeds would not do: an adaptive method keeps those of its
    tolerance. Raises Unsupported where it still moves at the end: the law is of rest.
    """
    steps, dt = choose_step(run, duration / LOOKS, longest, LOOKS)
    changes, before = [math.inf], measure(run.state.x)
    for _ in range(LOOKS):
        run.go(steps, dt)
        now = measure(run.state.x)
        changes.append(abs(now - before))
        before = now
        if max(changes[-2:]) < slack:
            return now
    raise Unsupported(f"not yet at rest after {duration:.2g} s: {changes[-1]:.1g} off {duration / LOOKS:.2g} s ago")


def hung(n: int, k: float, rest: Float | float, last: float = 1.0) -> Fabric:
    """A chain of length 1 m and n masses that weigh 1 kg, the last of them only that share of its own, held above."""
    x, mass = np.zeros((n + 1, 3)), np.full(n + 1, 1.0 / n)
    x[:, 1] = -np.linspace(0.0, 1.0, n + 1)
    mass[-1] *= last
    return make_fabric(x, chain(n + 1, k, rest), mass, np.arange(n + 1) == 0)


@laws("elongation", "closed form")
def measure_elongation(plugin: Any) -> Measurement:
    """A hanging chain of lumped masses, half a mass at its end, stretches by w L^2 / (2 E A) exactly."""
    n, stiffness = 16, 100.0 * G
    # The slowest mode has omega = pi/2 sqrt(E A g / (w L)) = 49 1/s; twice that is its critical damping.
    run = SolverRun(plugin, System(hung(n, stiffness * n, 1.0 / n, 0.5), DOWN, 60.0), ACCURATE)
    expected = G / (2.0 * stiffness)
    measured = settle(run, 2.0, 5e-3, lambda x: float(-1.0 - x[-1, 1]), 1e-5 * expected)
    return relative(measured, expected, 1e-4)


@laws("catenary", "closed form")
def measure_catenary(plugin: Any) -> Measurement:
    """A chain of 40 links, 1.5 spans long, hangs as y = a cosh(x / a): it sags by a (cosh(d / 2a) - 1)."""
    n, span, length, strain = 40, 1.0, 1.5, 1e-4
    a = bisect(0.05 * span, 50.0 * span, lambda a: 2.0 * a * math.sinh(span / (2.0 * a)) <= length, 80)
    tension = G * 1.0 * a / length
    x, s = np.zeros((n + 1, 3)), np.linspace(-0.5, 0.5, n + 1)
    x[:, 0], x[:, 1] = s * span, -0.6 * (1.0 - (2.0 * s) ** 2)
    springs = chain(n + 1, tension / strain * n / length, length / n, 0.02)
    fabric = make_fabric(x, springs, np.full(n + 1, 1.0 / n), np.abs(s) == 0.5)
    run = SolverRun(plugin, System(fabric, DOWN, 8.0), ACCURATE)
    expected = a * (math.cosh(span / (2.0 * a)) - 1.0)
    measured = settle(run, 6.0, 5e-3, lambda x: float(-x[:, 1].min()), 1e-4 * expected)
    return relative(measured, expected, 2e-3)


@laws({f"chain frequency {mode + 1}": {"mode": mode} for mode in range(3)}, "zeros of the Laguerre polynomial L_24")
def measure_frequency(plugin: Any, mode: int) -> Measurement:
    """A hanging chain of n = 24 masses swings with its own omega sqrt(L / g).

    The squares of the frequencies are (n g / L) times the zeros of the Laguerre polynomial L_n, which tend to
    the continuous chain's 1.20241, 2.76004, 4.32686 (zeros of J0, halved). Rest lengths are shortened by
    what each link carries, so that all links are alike.
    """
    n, k = 24, 3e4
    roots = np.polynomial.laguerre.lagroots([0.0] * n + [1.0])
    omega = math.sqrt(float(roots[mode]) * G * n)
    # The mode's shape from the free end: L_0, L_1, ... of the root.
    shape = np.array([np.polynomial.laguerre.lagval(roots[mode], [0.0] * i + [1.0]) for i in range(n, -1, -1)])
    fabric = hung(n, k, (1.0 - G * np.arange(n, 0, -1) / k) / n)
    fabric.position[:, 0] = 1e-5 * shape
    run = SolverRun(plugin, System(fabric, DOWN), ACCURATE)
    steps, dt = choose_step(run, 0.25 * math.pi / omega, 5e-3 / omega)
    angles = [0.0]
    for _ in range(8):
        run.go(steps, dt)
        angles.append(math.atan2(-(run.state.v[:, 0] @ shape) / omega, run.state.x[:, 0] @ shape))
    turned = abs(float(np.unwrap(angles)[-1]))
    scale = math.sqrt(G)  # over sqrt(g / L), L = 1 m
    return relative(turned / (8 * steps * dt) / scale, omega / scale, 2e-3)


def strip(gamma: float, elements: int) -> tuple[System, float]:
    """A clamped strip of square cells and plate rigidity w L^3 / gamma, straight; and its free length [m].

    The first two rows hold the direction of the first step, which is the slope at its middle: the
    free length starts there, so that 64 elements are 65.5 rows from there on. It is damped near-critically for
    its slowest mode: bending, 3.516 sqrt(B / (density L^4)), or swinging.
    """
    density, length, rows = 0.2, 0.2, elements + 2
    step, rigidity = length / (rows - 1.5), density * G * length**3 / gamma
    size, fabric = (step, step * (rows - 1)), stiff(density, rigidity)
    piece = build_model("sheet", {"size": size, "resolution": (2, rows), "plane": "xz", "fabric": fabric})
    cloth = make_fabric(piece.position, piece.springs, piece.mass, np.arange(piece.number) < 4, hinges=piece.hinges)
    bending, swinging = 3.516 * math.sqrt(G / (gamma * length)), 1.2 * math.sqrt(G / length)
    return System(cloth, DOWN, 1.4 * math.hypot(bending, swinging)), length


def stiff(density: float, rigidity: float, **more: float) -> dict[str, float]:
    """Cloth of a mass per area [kg/m^2] and a plate rigidity [N m], hardly stretchable, without damping."""
    alike = {"bend_warp": rigidity, "bend_weft": rigidity, "damping_ratio": 0.0}
    return {"density": density, "warp": 400.0, "weft": 400.0, "shear": 100.0, **alike, **more}


def swatch(**fields: Any) -> Fabric:
    """A specimen of irregular triangles; its fabric is given in SI."""
    return build_model("swatch", fields, seed=1)


@laws("mesh cantilever", "theta'' = -Gamma (1 - s) cos theta")
def measure_mesh_cantilever(plugin: Any) -> Measurement:
    """A heavy strip of irregular triangles, 24 edges long, drops as the elastica does at w L^3 / B = 10, settled."""
    gamma, length, density, edges = 10.0, 0.2, 0.2, 24
    edge, rigidity = length / edges, density * G * length**3 / gamma
    size = length + 3.0 * edge, 2.0 * edge
    cloth = swatch(size=size, hold=3.0 * edge, edge=edge, fabric=stiff(density, rigidity))
    end = cloth.position[:, 0] > length - 1e-9
    damping = 1.4 * math.hypot(3.516 * math.sqrt(G / (gamma * length)), 1.2 * math.sqrt(G / length))
    run, expected = SolverRun(plugin, System(cloth, DOWN, damping), ACCURATE), DROP[10]
    measured = settle(run, 48.0 / damping, 0.02, lambda x: float(-x[end, 1].mean()) / length, 1e-3 * expected)
    return relative(measured, expected, 2e-2)


@laws("crease", "B kappa = HB")
def measure_crease(plugin: Any) -> Measurement:
    """A piece of irregular triangles that was rolled up, and is let go of, keeps the curvature 2HB / 2B."""
    side, edge, most, rigidity, width = 0.01, 1e-3, 100.0, 1e-5, 6e-4
    fabric = stiff(0.2, rigidity, hysteresis_warp=width, hysteresis_weft=width)
    cloth = swatch(size=(side, side), edge=edge, fabric=fabric)
    flat = cloth.position.copy()
    middle = np.argsort(np.abs(flat[:, 0] - 0.5 * side))[: len(flat) // 2]
    cloth.position[:, 0] = np.sin(most * (flat[:, 0] - 0.5 * side)) / most
    cloth.position[:, 1] = (1.0 - np.cos(most * (flat[:, 0] - 0.5 * side))) / most
    # Its slowest mode of bending, critically damped: it opens without swinging.
    slowest = 22.4 * math.sqrt(rigidity / (0.2 * side**4))
    run = SolverRun(plugin, System(cloth, NONE, 2.0 * slowest), ACCURATE)

    def curvature(x: Float) -> float:
        """Return the curvature of the circle that fits the middle half best [1/m]."""
        plane = x[middle][:, :2] - x[middle][:, :2].mean(axis=0)
        sums = np.column_stack([2.0 * plane, np.ones(len(plane))])
        centre = np.linalg.lstsq(sums, np.square(plane).sum(axis=1), rcond=None)[0]
        return float(1.0 / math.sqrt(centre[2] + centre[0] ** 2 + centre[1] ** 2))

    expected = width / (2.0 * rigidity)
    measured = settle(run, 40.0 / slowest, 2e-4, curvature, 2e-3 * expected)
    return relative(measured, expected, 3e-2)


@laws({f"cantilever {gamma}": {"gamma": gamma} for gamma in DROP}, "theta'' = -Gamma (1 - s) cos theta")
def measure_cantilever(plugin: Any, gamma: int) -> Measurement:
    """A heavy strip of 64 elements drops as the elastica does at w L^3 / B = Gamma, over its length, settled."""
    (system, length), expected = strip(gamma, 64), DROP[gamma]
    run = SolverRun(plugin, system, ACCURATE)
    measured = settle(run, 48.0 / system.damping, 0.02, lambda x: float(-x[-2:, 1].mean()) / length, 1e-3 * expected)
    return relative(measured, expected, 1e-2)


@laws({f"lateral buckling {name}": {"poisson": value} for name, value in POISSON.items()}, "zero of Bessel's J -1/6")
def measure_buckling(plugin: Any, poisson: float, layout: str = "irregular") -> Measurement:
    """A narrow strip on its side loses all stiffness against tipping over at w L^3 / B = 12.85 sqrt(2 / (1 + nu)).

    By the forces that the solver reports. The strip is 120 edges long and 2 wide.
    """
    density, rigidity = 0.2, 1e-5
    fabric = {"density": density, "warp": 4e3, "weft": 4e3, "shear": 4e2, "bend_poisson": poisson}
    fabric |= {"bend_warp": rigidity, "bend_weft": rigidity}
    narrow = rigidity * (1.0 - poisson**2)
    found = specimens.tips_over(fabric, narrow, density, 0.2, 120, 2, solver=plugin.name, layout=layout)
    return relative(found, specimens.critical(poisson), 3e-2)


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
    run = SolverRun(plugin, System(cloth, DOWN, 2.0 * swing), ACCURATE)
    return settle(run, 60.0 / swing, 0.1 / swing, lambda x: float(-x[free, 1].mean()) / radius, 1e-5)


@laws("drape", "dimensions")
def measure_drape(plugin: Any) -> Measurement:
    """A disc of twice the size and three times the weight with the same w a^3 / B drapes alike, from a start alike."""
    return relative(sunk(plugin, 2.0, 3.0), sunk(plugin, 1.0, 1.0), 1e-3)


# Laws of nets that fly, swing and turn: order on a nonlinear problem, invariants, symmetry, forces.

net_laws = Laws()
ROUNDING = 1e-10
"""Share of a quantity that rounding over some hundred steps may change."""
DURATION = 0.2


def random_net(n: int, springs: int, seed: int, c: float = 0.0) -> tuple[Float, Springs]:
    """Vertices in a box of 1 m and distinct random springs, 1 to 100 N/m, near their rest length."""
    rng = np.random.default_rng(seed)
    position = rng.uniform(0.0, 1.0, (n, 3))
    every = np.array([(i, j) for i in range(n) for j in range(i + 1, n)], np.int32)
    pairs = every[rng.permutation(len(every))[:springs]]
    length = np.linalg.norm(position[pairs[:, 1]] - position[pairs[:, 0]], axis=1)
    rest = length * rng.uniform(0.8, 1.1, springs)
    return position, Springs.from_pairs(pairs, rng.uniform(1.0, 100.0, springs), rest, c * rng.uniform(0.5, 1, springs))


def swinging_net() -> System:
    """Twelve vertices, two of them pinned; damped springs, gravity and viscous damping."""
    position, springs = random_net(12, 40, 11, c=0.3)
    pinned = np.arange(12) < 2
    velocity = np.random.default_rng(2).standard_normal((12, 3)) * ~pinned[:, None]
    return System(make_fabric(position, springs, 1.0, pinned, velocity), DOWN, 0.8)


@cache
def _swung() -> Float:
    """x and v (2, n, 3) of the swinging net at its end, by SciPy to rounding."""
    net = swinging_net()
    start = np.stack([net.fabric.position, net.fabric.velocity])
    end = solve_ivp(
        lambda _, y: slopes(net, y.reshape(start.shape)).ravel(), (0.0, DURATION), start.ravel(), "DOP853",
        [DURATION], rtol=3e-14, atol=1e-15,
    )  # fmt: skip
    return np.asarray(end.y).reshape(start.shape)


@net_laws("order, net", "forces by their definition, integrated by SciPy")
def measure_order(plugin: Any) -> Measurement:
    """The error on a swinging net after 0.2 s, against an independent solution, falls with the nominal order."""
    first, ratio = {1: (400, 2.0), 2: (50, 2.0), 4: (20, 2.0), 5: (20, 1.5)}.get(plugin.order, (100, 2.0))
    if plugin.order > 5:
        first, ratio = 14, 1.17
    counts, errors = np.round(first * ratio ** np.arange(4)), []
    for count in counts:
        run = SolverRun(plugin, swinging_net())
        run.go(int(count), DURATION / count)
        errors.append(float(np.abs(run.both() - _swung()).max()))
    return order_found(plugin, counts, DURATION, np.array(errors), float(np.abs(_swung()).max()))


@net_laws("projectile", "closed form")
def measure_projectile(plugin: Any) -> Measurement:
    """A particle flies as x = x0 + v t + g t^2 / 2, v = v0 + g t.

    From order 2 on exactly; a first-order method is off by g t dt / 2 at most.
    """
    count, dt = 100, 0.01
    velocity = np.tile([1.0, 2.0, 0.0], (3, 1))
    run = SolverRun(plugin, System(make_fabric(np.zeros((3, 3)), velocity=velocity), DOWN))
    run.go(count, dt)
    exact = np.array([1.0, 2.0 - 0.5 * G, 0.0])
    allowed = 1e-11 if plugin.order > 1 else 0.5 * G * dt * (1.0 + 1e-9)
    error = max(np.abs(run.state.x - exact).max(), np.abs(run.state.v - [1.0, 2.0 - G, 0.0]).max())
    return Measurement(float(run.state.x[0, 1]), float(exact[1]), float(error), allowed)


def free_net(turn: Float | None = None) -> System:
    """Thirty vertices of uneven mass that fly about; turned as a whole by an orthogonal matrix."""
    position, springs = random_net(30, 150, 3)
    velocity = np.random.default_rng(1).standard_normal((30, 3))
    mass = np.random.default_rng(2).uniform(0.5, 2.0, 30)
    q = np.eye(3) if turn is None else turn
    return System(make_fabric(position @ q.T, springs, mass, velocity=velocity @ q.T), NONE)


@net_laws("sideways drift", "momentum")
def measure_drift(plugin: Any) -> Measurement:
    """The centre of mass of a net that vibrates and falls does not move sideways."""
    fabric = free_net().fabric
    weight = fabric.mass[:, None] / fabric.mass.sum()
    still = fabric.velocity - (weight * fabric.velocity).sum(axis=0)
    run = SolverRun(plugin, System(replace(fabric, velocity=still), DOWN))
    run.go(400, 1e-3)
    moved = (weight * (run.state.x - fabric.position)).sum(axis=0)
    fell = abs(float(moved[1])) or np.nan
    aside = float(np.abs(moved[[0, 2]]).max())
    return Measurement(aside, 0.0, aside / fell, ROUNDING)


@net_laws("momentum", "Newton's third law")
def measure_momentum(plugin: Any) -> Measurement:
    """A free net keeps its momentum to rounding, as a share of the sum of its parts' momenta."""
    run = SolverRun(plugin, free_net())
    parts = run.system.fabric.mass[:, None] * run.system.fabric.velocity
    run.go(400, 1e-3)
    change = run.system.fabric.mass[:, None] * run.state.v - parts
    largest = float(np.abs(change.sum(axis=0)).max())
    return Measurement(largest, 0.0, largest / float(np.abs(parts).sum()), ROUNDING)


@net_laws("angular momentum", "central forces")
def measure_angular(plugin: Any) -> Measurement:
    """A free net keeps its angular momentum: to rounding by kicks and drifts, else to the nominal order at least."""
    if plugin.name in KEEPS_ANGULAR_MOMENTUM:
        change = _turned(plugin, 400, 0.4)
        return Measurement(change, 0.0, change, ROUNDING)
    first, ratio = {1: (400, 2.0), 2: (60, 2.0), 4: (30, 2.0)}.get(plugin.order, (20, 1.5))
    if plugin.order > 5:
        first, ratio = 10, 1.3
    counts = np.round(first * ratio ** np.arange(4))
    changes = np.array([_turned(plugin, int(count), 0.2) for count in counts])
    if changes.max() < ROUNDING:
        return Measurement(float(changes[0]), 0.0, float(changes[0]), ROUNDING)
    return fit_order(0.2 / counts, changes, plugin.order, least=True)


def _turned(plugin: Any, count: int, duration: float) -> float:
    """Change of the free net's angular momentum over so many steps, as a share of the sum of its parts'."""
    run = SolverRun(plugin, free_net())
    weight = run.system.fabric.mass[:, None]
    before = weight * np.cross(run.state.x, run.state.v)
    run.go(count, duration / count)
    after = weight * np.cross(run.state.x, run.state.v)
    return float(np.abs((after - before).sum(axis=0)).max() / np.abs(before).sum())


@net_laws("rotation", "isotropy of space")
def measure_rotation(plugin: Any) -> Measurement:
    """A turned net moves as the net does, turned."""
    q, _ = np.linalg.qr(np.random.default_rng(8).standard_normal((3, 3)))
    ends = []
    for turn in (np.eye(3), q):
        run = SolverRun(plugin, free_net(turn))
        run.go(100, 1e-3)
        ends.append(run.state.x @ turn)
    apart = float(np.abs(ends[0] - ends[1]).max())
    return Measurement(apart, 0.0, apart, ROUNDING)


@cache
def _crumpled() -> Fabric:
    """A sheet of denim, 6 x 6, with springs and hinges, crumpled a little."""
    fabric = {"preset": "denim", "damping_ratio": 0}
    piece = build_model("sheet", {"resolution": (6, 6), "size": (0.1, 0.1), "fabric": fabric})
    x = piece.position + 2e-3 * np.random.default_rng(5).standard_normal(piece.position.shape)
    return make_fabric(x, piece.springs, piece.mass, hinges=piece.hinges)


@net_laws("force, energy", "central differences")
def measure_gradient(plugin: Any) -> Measurement:
    """force = -grad energy, of springs and hinges: from a short step out of rest, and of the reported energy."""
    run = SolverRun(plugin, System(_crumpled(), DOWN))
    fabric = run.system.fabric
    dt, reach = 1e-4 / float(plugin.limit(run.config, run.system, run.state).omega), 1e-7
    run.go(1, dt)
    force = fabric.mass[:, None] * run.state.v / dt
    probe = SolverRun(plugin, run.system)
    slope = np.zeros_like(force)
    for place in np.ndindex(*force.shape):
        energies = []
        for move in (reach, -reach):
            probe.state.x[...], probe.state.v[...] = fabric.position, 0.0
            probe.state.x[place] += move
            energies.append(probe.energy())
        slope[place] = (energies[0] - energies[1]) / (2.0 * reach)
    scale = float(np.abs(force).max())
    return Measurement(scale, float(np.abs(slope).max()), float(np.abs(force + slope).max() / scale), 1e-5)


def slopes(system: System, y: Float) -> Float:
    """(2, n, 3) derivatives of positions and velocities y: of springs, gravity and viscous damping, nothing else."""
    fabric, springs = system.fabric, system.fabric.springs
    (x, v), force = y, np.zeros_like(y[0])
    if springs is not None:
        i, j = springs.pairs().T
        k, rest, c = (springs.per_spring(values) for values in (springs.k, springs.rest, springs.c))
        d = x[j] - x[i]
        length = np.sqrt((d * d).sum(axis=1))
        along = d / length[:, None]
        pull = k * (length - rest) + c * ((v[j] - v[i]) * along).sum(axis=1)
        np.add.at(force, i, pull[:, None] * along)
        np.add.at(force, j, -pull[:, None] * along)
    a = force / fabric.mass[:, None] + system.gravity - system.damping * v
    return np.stack([v, np.where(fabric.pinned[:, None], 0.0, a)])
