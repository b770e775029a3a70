"""The largest frequency and damping rate of a system, and the step that they allow.

The largest eigenvalue of -da/dx (squared angular frequency) and of -da/dv (damping rate) is found
by the Lanczos method in the mass inner product, in which both are symmetric, with products taken as
central differences of the compiled acceleration. The basis is not kept: the recurrence needs three
vectors, and lost orthogonality only repeats eigenvalues that have converged.

The largest Ritz value theta lies below the eigenvalue, its residual beta |s_k| away at most; adding
the residual gives the upper bound (Zhou & Li 2011, Linear Algebra Appl. 435, 480-493).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from nuno_integrators.packing import pack, reads_velocity, silence_bodies, to_rows
from nuno_kernels import kernel
from nuno_kernels.forces.energy import measure_energy
from nuno_kernels.forces.python import raise_error
from nuno_kernels.step.acceleration import Packed, evaluate
from nuno_kernels.terms import call_each, kernels_of
from nuno_schemas.fabric import Bool, Fabric, Float, Springs, State
from nuno_schemas.system import System

FEWEST, MOST, CHECK = 24, 160, 8
"""Lanczos steps: at least, at most, and between checks of the residual"""

MARGIN = 0.02
"""share of the residual in an eigenvalue's bound: 1 % of the frequency"""


@kernel
def weigh(u: Float, w: Float, mass: Float) -> float:
    """Return the sum of mass u.w over all vertices, in one fixed order."""
    total = 0.0
    for row in range(3):
        for p in range(u.shape[1]):
            total += mass[p] * u[row, p] * w[row, p]
    return total


def largest_eigenvalue(multiply: Callable[[Float], Float], mass: Float) -> float:
    """Return an upper bound on the largest eigenvalue, 0 at least, of an operator on rows (3, n).

    It is symmetric in the inner product weighted by mass (n,); vertices of mass 0 are held. The array that `multiply`
    returns is its own: it is read before the next call.
    """
    free = mass > 0.0
    size = 3 * int(free.sum())
    if size == 0:
        return 0.0
    u = np.random.default_rng(20240229).standard_normal((3, mass.shape[0]))
    u[:, ~free] = 0.0
    u /= np.sqrt(np.where(free, mass, 1.0))
    u /= np.sqrt(weigh(u, u, mass))
    # Two vectors are enough: the next one overwrites the one before. On a large sheet this
    # is where a run needs most memory.
    before, beta, bound = np.zeros_like(u), 0.0, 0.0
    alphas: list[float] = []
    betas: list[float] = []
    while len(alphas) < min(size, MOST):
        w = before
        w *= -beta
        w += multiply(u)
        alphas.append(weigh(w, u, mass))
        for row in range(3):
            w[row] -= alphas[-1] * u[row]
        beta = float(np.sqrt(weigh(w, w, mass)))
        last = len(alphas) == min(size, MOST)
        scale = max(map(abs, alphas))
        if last or beta <= 1e-9 * scale or (len(alphas) >= FEWEST and len(alphas) % CHECK == 0):
            tridiagonal = np.diag(alphas) + np.diag(betas, 1) + np.diag(betas, -1)
            values, vectors = np.linalg.eigh(tridiagonal)
            residual = beta * abs(vectors[-1, -1])
            bound = values[-1] + max(residual, MARGIN * abs(values[-1]))
            if residual <= MARGIN * values[-1] or beta <= 1e-9 * scale:
                break
        betas.append(beta)
        w /= beta
        before, u = u, w
    return max(0.0, float(bound))


def measure_rates(system: System, state: State) -> tuple[float, float]:
    """Return bounds from above on the largest angular frequency and damping rate [1/s] in the present state.

    What a term declares for when it becomes active (contact) is added.
    """
    packed, x, v, reach = _prepare(system, state)
    mass = np.where(system.fabric.pinned, 0.0, system.fabric.mass)
    moved, a, b = np.empty_like(x), np.empty_like(x), np.empty_like(x)

    def difference(u: Float, base: Float, step: float) -> Float:
        """Return -(da/dx) u or -(da/dv) u, whichever of x and v is `base`."""
        width = step / max(float(u.max()), -float(u.min()))
        for sign, out in ((width, a), (-width, b)):
            np.multiply(u, sign, out=moved)
            np.add(moved, base, out=moved)
            evaluate(moved if base is x else x, moved if base is v else v, 0.0, out, packed)
        np.subtract(b, a, out=b)
        np.divide(b, 2.0 * width, out=b)
        return b

    def stiffness(u: Float) -> Float:
        return difference(u, x, reach)

    def friction(u: Float) -> Float:
        return difference(u, v, 1e-3)

    squared = largest_eigenvalue(stiffness, mass) + sum(term.omega_squared for term in system.terms)
    uniform = not reads_velocity(
        packed._replace(damping=0.0, moved=any("hold" in kernels_of(t) for t in packed.bodies))
    )
    rate = packed.damping if uniform else largest_eigenvalue(friction, mass)
    raise_error(packed.bodies, system.leave)
    return float(np.sqrt(squared)), rate + sum(term.damping_rate for term in system.terms)


def _prepare(system: System, state: State) -> tuple[Packed, Float, Float, float]:
    """Return the system to differentiate, and the reach of the differences [m].

    The reach is 1e-5 of the shortest spring: curvature then spoils 1e-10 of a product and rounding
    1e-11 R/L, for which positions are taken from their middle where no force depends on the place.
    """
    if system.fabric.springs is not None:
        # A spring that locks may do so at any time: it counts as if it had.
        system = replace(system, fabric=replace(system.fabric, springs=system.fabric.springs.stiffest()))
    packed = silence_bodies(pack(system, copy=False))
    packed.time[0] = state.t
    x, v = to_rows(state.x), to_rows(state.v)
    # A slipping element holds again as soon as it turns.
    call_each(packed, "stick", x)
    if x.shape[1] and not any(callable(term.data) for term in system.terms):
        x -= 0.5 * (x.min(axis=1, keepdims=True) + x.max(axis=1, keepdims=True))
    energy = measure_energy(x, v, system.fabric.mass, packed)
    if energy.zero_length:
        fabric = _with_loose_springs(system.fabric, state.x)
        packed = silence_bodies(pack(replace(system, fabric=fabric), copy=False))
        packed.time[0] = state.t
        call_each(packed, "stick", x)
    extent = float(np.abs(x).max(initial=0.0)) or 1.0
    return packed, x, v, 1e-5 * min(max(energy.shortest, 1e-6 * extent), extent)


def _with_loose_springs(fabric: Fabric, position: Float) -> Fabric:
    """Give springs of zero length the rest length 0.

    They exert no force now, but have stiffness k along any direction they take.
    """
    assert fabric.springs is not None
    s, pairs = fabric.springs, fabric.springs.pairs()
    zero = (position[pairs[:, 0]] == position[pairs[:, 1]]).all(axis=1)
    k, rest, c = (s.per_spring(value) for value in (s.k, s.rest, s.c))
    return replace(fabric, springs=Springs.from_pairs(pairs, k, np.where(zero, 0.0, rest), c))


Amplification = Callable[..., Float]
"""amplification(omega, damping, dt), arrays of one shape: the matrices (2, 2, ...) of one step on x'' = -omega^2 x -
damping x'"""


def spectral_radius(matrix: Float) -> Float:
    """Return the largest modulus of the eigenvalues of matrices (2, 2, ...)."""
    half = 0.5 * (matrix[0, 0] + matrix[1, 1])
    det = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]
    disc = half * half - det
    return np.asarray(np.where(disc < 0.0, np.sqrt(np.abs(det)), np.abs(half) + np.sqrt(np.maximum(disc, 0.0))))


def critical_step(amplification: Amplification, omega: Float, damping: Float) -> Float:
    """Return the steps (m,) [s] up to which |x|, |v| stay bounded on x'' = -omega^2 x - damping x', of rates (m,), of
    which one of each pair is above 0.

    The first crossing of spectral radius 1; 0 for a method that grows at any step, inf where there is nothing to limit.
    """
    rate = np.maximum(omega, damping)

    def grows(step: Float) -> Bool:
        matrix = amplification(np.broadcast_to(omega, step.shape), np.broadcast_to(damping, step.shape), step)
        return np.asarray(spectral_radius(matrix) > 1.0 + 1e-13)

    tried = np.cumsum(np.full((160, len(rate)), 0.05 / rate), axis=0)
    crossed = grows(tried)
    first, column = crossed.argmax(axis=0), np.arange(len(rate))
    high, low = tried[first, column], np.where(first > 0, tried[first - 1, column], 0.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        grown = grows(middle)
        low, high = np.where(grown, low, middle), np.where(grown, middle, high)
    return np.where(crossed.any(axis=0), np.where(low > 1e-5 / rate, low, 0.0), np.inf)


def stable_step(amplification: Amplification, omega: float, damping: float, least: float) -> float:
    """Return the step [s] that is stable for every mode up to `omega` with damping from `least` to `damping`.

    The fastest and the most damped mode need not be one: a stability region with lobes may allow the two together what
    it denies to either alone.
    """
    shares = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
    frequencies, rates = np.meshgrid(shares * omega, least + shares * (damping - least))
    acting = np.maximum(frequencies, rates) > 0.0
    return float(critical_step(amplification, frequencies[acting], rates[acting]).min(initial=np.inf))
