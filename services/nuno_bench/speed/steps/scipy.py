"""SciPy beside our solvers on a smooth stiff sheet: the time to an error, given compiled forces and NumPy's."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from nuno.scene import scene_file
from nuno.simulation.run import Simulation
from nuno_bench.report.result import Result
from nuno_bench.speed.steps.sliced import SlicedCloth
from nuno_bench.speed.steps.stiff import SCENE, run
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Fabric, Float

Accelerate = Callable[[Float, Float, Float], None]
"""Writes accelerations [m/s^2] at positions [m] and velocities [m/s], all (3, n), into its last argument."""

SIDE = 32
SMOOTH = (
    f"objects.0.model.resolution=[{SIDE}, {SIDE}]",
    "objects.0.model.pin=[top-row]",
    "objects.0.model.rotate={axis: [1, 0, 0], angle: 0}",
    "objects.0.model.velocity=[0.3, 0, 0]",
    "objects.0.model.fabric.damping_ratio=0",
    "damping=0",
)
"""The same sheet without damping, hung by its whole upper row and pushed sideways in its plane. Held at two
corners it is chaotic: no method of any tolerance has six digits of a position left after a second."""
WANTED = {1e-3: 3.0, 1e-6: 1.5}
"""Errors as shares of the cloth's size, and how many times faster than SciPy's best they must be reached."""
NUMPY = 20.0
"""The same at the first of the errors, where SciPy is given NumPy's forces."""
OURS = {
    "dopri5": [("dopri5", f"tolerance: 1e-{n}") for n in (5, 6, 7, 8)],
    "dop853": [("dop853", f"tolerance: 1e-{n}") for n in (5, 6, 7, 8, 9, 10)],
}
STEPS = (60, 80, 120, 240)
"""Steps a frame of the methods of a fixed step."""
THEIRS = {"RK45": (1e-4, 1e-6, 1e-8), "DOP853": (1e-4, 1e-6, 1e-8, 1e-10)}
GIVEN_NUMPY = {"RK45": (1e-4, 1e-5), "DOP853": (1e-4,)}
IMPLICIT = {"LSODA": 1e-5, "Radau": 1e-4}
"""Tolerances of the methods that want a matrix; each is tried once."""
LIMIT = 60.0
"""What an implicit method may take [s]."""

Curve = list[tuple[float, float]]
"""Errors and wall times [s]."""


@cache
def _exact() -> Float:
    return run(*SMOOTH, "solver={plugin: dop853, tolerance: 1e-12, dt: auto}").x


def _error(x: Float) -> float:
    return float(np.sqrt(((x - _exact()) ** 2).sum(axis=1).mean()) / np.sqrt(2.0))


def scipy_peer(repeats: int) -> list[Result]:
    """Time to an error at the end of a second, ours against SciPy's with the same compiled forces and NumPy's."""
    repeats = min(repeats, 3)
    ours: dict[str, Curve] = {}
    for name, choices in OURS.items():
        ours[name] = [_point([*SMOOTH, f"solver={{plugin: {p}, {c}, dt: auto}}"], repeats) for p, c in choices]
    for name in ("leapfrog", "rk4"):
        chosen = [[*SMOOTH, f"solver={{plugin: {name}, dt: {1 / 60 / n!r}}}", "frame_rate=60 Hz"] for n in STEPS]
        ours[name] = [_point(each, repeats) for each in chosen]
    start, compiled, sliced = _problem()
    theirs = {name: [_explicit(start, compiled, name, r, repeats) for r in each] for name, each in THEIRS.items()}
    ends, notes = implicit(start, compiled)
    theirs |= {name: [(_error(x), seconds)] for name, (x, seconds) in ends.items()}
    results = []
    for wanted, bar in WANTED.items():
        what = f"{SIDE}x{SIDE}, to {wanted:g} of its size after a second, against SciPy"
        results.append(_compare(what, ours, theirs, wanted, bar, notes))
    given = {name: [_explicit(start, sliced, name, rtol, 1) for rtol in each] for name, each in GIVEN_NUMPY.items()}
    what = f"{SIDE}x{SIDE}, to {max(WANTED):g}, against SciPy with forces by NumPy slices"
    return [*results, _compare(what, ours, given, max(WANTED), NUMPY, ())]


def _compare(
    what: str, ours: dict[str, Curve], theirs: dict[str, Curve], wanted: float, bar: float, notes: Sequence[str]
) -> Result:
    own, other = _fastest(ours, wanted), _fastest(theirs, wanted)
    if own is None or other is None:
        return Result("scipy", what, "times faster", bar=bar, failure="the error was not reached")
    told = [f"{own[0]} {own[1]:.3g} s, SciPy's {other[0]} {other[1]:.3g} s", *notes]
    return Result("scipy", what, "times faster", (other[1] / own[1],), bar=bar, note="; ".join(told))


def _point(overrides: list[str], repeats: int) -> tuple[float, float]:
    """Error and median wall time [s]."""
    ends = [run(*overrides) for _ in range(repeats)]
    return _error(ends[0].x), float(np.median([end.seconds for end in ends]))


def _fastest(curves: dict[str, Curve], wanted: float) -> tuple[str, float] | None:
    """Method and time [s] at an error, between the points of each curve on logarithmic scales."""
    found = []
    for name, points in curves.items():
        for (e0, t0), (e1, t1) in itertools.pairwise(sorted(points, reverse=True)):
            if e1 <= wanted <= e0:
                share = np.log(e0 / wanted) / np.log(e0 / e1)
                found.append((float(t0 * (t1 / t0) ** share), name))
        found += [(t, name) for e, t in points if e <= wanted]
    return (min(found)[1], min(found)[0]) if found else None


def _problem() -> tuple[Simulation, Accelerate, Accelerate]:
    """The sheet at its start, its accelerations by our kernels, and by NumPy."""
    simulation = Simulation(scene_file.read(scene_file.find(SCENE), SMOOTH), None, None, 1)
    system = simulation.system
    cloth = SlicedCloth(simulation.fabric, np.asarray(system.gravity), system.damping)
    compiled: Accelerate = simulation.loaded.integrator.plugin.slopes(simulation.memory)
    return simulation, compiled, cloth.accelerate


def _explicit(
    simulation: Simulation, accelerate: Accelerate, method: str, rtol: float, repeats: int
) -> tuple[float, float]:
    """Error and median wall time [s] of an explicit method."""
    n, state = simulation.fabric.number, simulation.state

    def slopes(t: float, y: Float) -> Float:
        now, out = y.reshape(2, 3, n), np.empty((2, 3, n))
        out[0] = now[1]
        accelerate(now[0], now[1], out[1])
        return out.reshape(-1)

    start = np.concatenate([state.x.T.ravel(), state.v.T.ravel()])
    slopes(0.0, start)
    ends = [_solve(slopes, start, method, rtol) for _ in range(repeats)]
    return _error(ends[0][0][: 3 * n].reshape(3, n).T), float(np.median([seconds for _, seconds in ends]))


def _solve(slopes: Callable[[float, Float], Float], start: Float, method: str, rtol: float, **how: Any) -> Any:
    """The state after a second, and the wall time [s]. Raises RunFailed where the method gives up."""
    from scipy.integrate import solve_ivp

    began = time.perf_counter()
    done: Any = solve_ivp(slopes, (0.0, 1.0), start, method=method, rtol=rtol, atol=rtol, t_eval=[1.0], **how)
    if not done.success:
        raise RunFailed(f"SciPy's {method}: {done.message}")
    return done.y[:, -1], time.perf_counter() - began


def structure(fabric: Fabric) -> tuple[int, Any]:
    """Width of the band to either side, and the sparsity (6 n, 6 n) of the slopes' derivative, unknowns standing
    vertex by vertex: x, y, z and their velocities. A vertex's slopes depend on what springs join it to.
    """
    from scipy.sparse import coo_matrix, kron

    assert fabric.springs is not None
    pairs = fabric.springs.pairs().astype(np.int64)
    ends = np.concatenate([pairs, pairs[:, ::-1], np.column_stack([np.arange(fabric.number)] * 2)])
    joined = coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(fabric.number, fabric.number))
    return 6 * int(np.abs(pairs[:, 1] - pairs[:, 0]).max()) + 5, kron(joined, np.ones((6, 6))).tocsc()


def slopes_by_vertex(accelerate: Accelerate, n: int) -> Callable[[float, Float], Float]:
    """Slopes (6 n,) of the unknowns in the order of `structure`."""

    def slopes(t: float, y: Float) -> Float:
        now, out = np.ascontiguousarray(y.reshape(n, 2, 3).transpose(1, 2, 0)), np.empty((2, 3, n))
        out[0] = now[1]
        accelerate(now[0], now[1], out[1])
        return np.ascontiguousarray(out.transpose(2, 0, 1)).reshape(-1)

    return slopes


def implicit(
    simulation: Simulation, accelerate: Accelerate, limit: float = LIMIT
) -> tuple[dict[str, tuple[Float, float]], list[str]]:
    """Positions (n, 3) and wall time [s] of the methods that want a matrix, and what is to say of those that
    do not end within `limit` [s].

    They are told where it has entries, without which 6,144 columns of differences would be all that they do.
    """
    n, state = simulation.fabric.number, simulation.state
    band, sparsity = structure(simulation.fabric)
    told = {"LSODA": {"lband": band, "uband": band}, "Radau": {"jac_sparsity": sparsity}}
    plain, over = slopes_by_vertex(accelerate, n), 0.0

    def slopes(t: float, y: Float) -> Float:
        if time.perf_counter() > over:
            raise TimeoutError(f"{t:.2g} s of the second done")
        return plain(t, y)

    start = np.stack([state.x, state.v], axis=1).reshape(-1)
    done: dict[str, tuple[Float, float]] = {}
    notes = []
    for method, rtol in IMPLICIT.items():
        over = time.perf_counter() + limit
        try:
            end, seconds = _solve(slopes, start, method, rtol, **told[method])
        except (TimeoutError, RunFailed) as error:
            notes.append(f"{method} is left out: not done after {limit:g} s ({error})")
            continue
        done[method] = end.reshape(n, 2, 3)[:, 0].copy(), seconds
    return done, notes
