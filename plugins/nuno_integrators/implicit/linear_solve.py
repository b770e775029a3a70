"""The linear solve of a Newton step: conjugate gradients while they are quick, a factorisation where they are not.

A step begins with conjugate gradients. The first time that they take too long, the stage is begun anew with
factorisations, whose cost does not depend on stiffness. The choice is made in every step, from counts alone, so
that the result depends neither on the machine nor on what was solved before.

With exact solutions the springs' stiffness across their direction is taken from the tension that the last
Newton step expects, k (a.b / |a| - L) for a spring that it turns from a to b, and not from the present one,
k (|b| - L). On stiff cloth the two differ by orders of magnitude: a spring that turns by an angle is
longer by its square, times k. This is Newton's method for positions and tensions as unknowns of their own
(Trusty et al. 2022, SIGGRAPH Asia, "Mixed variational finite elements"), the tensions eliminated: the right
side is the same, and as k grows it becomes sequential quadratic programming for inextensible springs, whose
steps do not depend on k. With the loose solutions of conjugate gradients it gains nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from nuno_integrators.implicit.conjugate import along, keep_momentum, solve, turn_and_multiply
from nuno_integrators.implicit.factor import Factor, compile_factor, factorise, make_factor, solve_factored
from nuno_integrators.implicit.matrix import Linear, fill, make_linear
from nuno_integrators.implicit.plan import make_plan
from nuno_kernels.step.acceleration import Packed
from nuno_kernels.terms import kernels_of
from nuno_schemas.fabric import Float

# Conjugate gradients with a factorisation as preconditioner: for terms of the matrix that are not in the factor.

MOST = 200


def refine(a: Linear, factor: Factor, b: Float, tolerance: float, threads: int | None) -> int:
    """Bring a.x, the factor's solution for b (3, n), to A^-1 b, until sqrt(r.z) is `tolerance` of sqrt(b.x). Return the
    iterations; 0, with a.x unchanged, if the factor lacks nothing.
    """
    target = tolerance * tolerance * along(b, a.x)
    x, turn, before = a.x.copy(), 0.0, 1.0
    a.p[...], a.z[...] = 0.0, x
    turn_and_multiply(0.0, a, threads)
    np.subtract(b, a.q, out=a.r)
    for iteration in range(MOST):
        solve_factored(factor, a.r, a.z)
        rz = along(a.r, a.z)
        if not rz > target:
            break
        turn = rz / before if iteration else 0.0
        curvature = turn_and_multiply(turn, a, threads)
        if not curvature > 0.0:
            break
        step = rz / curvature
        x += step * a.p
        np.subtract(a.r, step * a.q, out=a.r)
        before = rz
    a.x[...] = x
    return iteration


FORCING = 0.05
"""share of the residual that conjugate gradients may leave: tighter saves few Newton steps for many products"""
PATIENCE = 4.0
"""Conjugate gradients may take this many times sqrt(n) iterations, which cost about as much as a factorisation.
Measured at 32 x 32 against half of it: a frame at 1e4 N/m takes 9 ms instead of 23, one at 1e8 95 instead of 86."""
LOOSE = 1e-2
"""the share where a factorisation is the preconditioner of terms that are not in it"""
MOST_ENTRIES = 1 << 27
"""entries of a factor, 1 GiB: springs without any order in space may need more, and use conjugate gradients"""


@dataclass
class Counts:
    """Counts of the solver's work: Newton and conjugate-gradient iterations, factorisations, forces evaluated, and
    steps that did not converge and were halved.
    """

    newton: int = 0
    linear: int = 0
    factorisations: int = 0
    evaluations: int = 0
    halvings: int = 0


@dataclass
class Solver:
    """Memory of the linear solver for one packed system.

    position  (n, 3) at rest: where the order of elimination comes from
    before    (3, n) where the last Newton step began, or the time step
    follow    whether `before` is a Newton step's: a spring's tension at a time step's start is taken as it is
    direct    whether this time step uses factorisations
    hindered  whether in this time step something shortens Newton's steps: it then stays with the gradients. Exact steps
              of stiff cloth are long, and right only as a whole (nuno_integrators.implicit.newton._search)
    barred    whether there is no room for a factor
    """

    linear: Linear
    position: Float
    before: Float
    follow: bool = False
    direct: bool = False
    hindered: bool = False
    barred: bool = False
    factor: Factor | None = None
    counts: Counts = field(default_factory=Counts)


def make_solver(packed: Packed, position: Float) -> Solver:
    """Allocate the matrix; a factor is allocated when one is needed."""
    return Solver(make_linear(packed), position, np.zeros((3, position.shape[0])))


def solve_linear(s: Solver, packed: Packed, x: Float, rate: float, residual: Float, exact: bool) -> bool:
    """Compute s.linear.x = A^-1 residual at x (3, n), by the exact matrix if that is asked for and positive.

    s.linear.own holds D already. False if conjugate gradients take too long: the stage is then to be begun
    anew with factorisations, because what a loose solution has done to stiff springs takes longer to mend.
    """
    n = x.shape[1]
    kinds = (True, False) if exact else (False,)
    if s.direct:
        if _factorise(s, packed, x, rate, residual, kinds):
            return True
    elif _iterate(s, packed, x, rate, residual, kinds, math.ceil(PATIENCE * math.sqrt(n))):
        return True
    elif not s.hindered and prefer_factors(s):
        return False
    _iterate(s, packed, x, rate, residual, (False,), 20 * n + 100)
    return True


def is_touched(s: Solver) -> bool:
    """Whether a term that foresees contact had a part in the last matrix."""
    terms = zip(s.linear.forces, s.linear.forces.rows, strict=True)
    return any(rows.number.any() for term, rows in terms if rows is not None and "foresee" in kernels_of(term))


def solve_again(s: Solver, packed: Packed, x: Float, rate: float, residual: Float) -> None:
    """Solve by conjugate gradients for another right side, with terms linearised anew."""
    _iterate(s, packed, x, rate, residual, (False,), math.ceil(PATIENCE * math.sqrt(x.shape[1])))


def _iterate(
    s: Solver, packed: Packed, x: Float, rate: float, residual: Float, kinds: tuple[bool, ...], most: int
) -> bool:
    """Solve by conjugate gradients; return False if they need more than `most` iterations."""
    for exact in kinds:
        fill(x, rate, packed, s.linear, exact)
        s.linear.r[...] = residual
        done = solve(s.linear, FORCING, most, packed.threads)
        s.counts.linear += max(done, -1 - done)
        if done >= 0:
            keep_momentum(s.linear, packed.threads)
            return done < most
    # Rounding has made the matrix indefinite: the solution until then is still a descent direction.
    return True


def prefer_factors(s: Solver) -> bool:
    """Use factorisations for the rest of the time step; return False if a factor is too large. It is planned once."""
    if s.factor is None and not s.barred:
        plan = make_plan(s.position, s.linear)
        s.barred = plan.entries > MOST_ENTRIES
        s.factor = None if s.barred else make_factor(plan, s.position.shape[0])
    s.direct = not s.barred
    return s.direct


def _factorise(s: Solver, packed: Packed, x: Float, rate: float, residual: Float, kinds: tuple[bool, ...]) -> bool:
    """Solve by factorisation; return False if rounding has made the matrix indefinite."""
    assert s.factor is not None
    for exact in kinds:
        fill(x, rate, packed, s.linear, exact, s.before, s.follow)
        s.counts.factorisations += 1
        if factorise(s.factor, s.linear):
            solve_factored(s.factor, residual, s.linear.x)
            if None in s.factor.plan.elements:
                s.counts.linear += refine(s.linear, s.factor, residual, LOOSE, packed.threads)
            return True
    return False


def compile_solver(s: Solver, packed: Packed, x: Float) -> None:
    """Compile what `solve_linear` needs, by solving for no force at x (3, n)."""
    solve_linear(s, packed, x, 1.0, np.zeros_like(x), False)
    compile_factor(s.linear)
