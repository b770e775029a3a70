"""Newton's method for an implicit stage: x = x^ + g v, v = v^ + g a(x, v).

The residual is the force that is missing, m (a(x, v) - (v - v^) / g), and the step in x solves (M / g^2 + K + C / g) dx
= residual with K and C of nuno_kernels.forces.linear; nuno_integrators.implicit.linear_solve says how. Forces without a
matrix (contact with bodies, wind, forces in Python, damping) act on each vertex alone or nearly so: their derivative is
one 3 x 3 block a vertex, by moving all vertices together along each axis. Contact and friction are exact that way; a
triangle's wind is lumped.

Cloth that meets cloth shortens steps so that no iterate has passed through (role `bound`), and says what a step would
bring into touch, with which it is solved again (role `foresee`): the active set of a quadratic program.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from nuno_integrators.implicit.conjugate import along
from nuno_integrators.implicit.linear_solve import (
    Counts,
    Solver,
    compile_solver,
    is_touched,
    make_solver,
    solve_again,
    solve_linear,
)
from nuno_integrators.packing import parts, silence
from nuno_kernels import block_kernel, kernel
from nuno_kernels.step.acceleration import Packed, evaluate
from nuno_kernels.terms import call_each, kernels_of
from nuno_schemas.fabric import Bool, Float

# The stiffness of forces that act on each vertex alone: measured by differences, made symmetric and positive.

MOST_SWEEPS = 12
"""sweeps at most: Jacobi's method converges quadratically, and 3 x 3 matrices take four or five"""
EPSILON = float(np.finfo(float).eps)


@kernel
def rotate(a: Float, vectors: Float, p: int, q: int) -> None:
    """Apply one rotation of Jacobi's method, which makes a[p, q] zero (Golub & Van Loan, Matrix Computations, 8.5)."""
    if a[p, q] == 0.0:
        return
    tau = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
    t = (1.0 if tau >= 0.0 else -1.0) / (abs(tau) + np.sqrt(1.0 + tau * tau))
    c = 1.0 / np.sqrt(1.0 + t * t)
    s = t * c
    for k in range(3):
        a[k, p], a[k, q] = c * a[k, p] - s * a[k, q], s * a[k, p] + c * a[k, q]
    for k in range(3):
        a[p, k], a[q, k] = c * a[p, k] - s * a[q, k], s * a[p, k] + c * a[q, k]
    for k in range(3):
        vectors[k, p], vectors[k, q] = c * vectors[k, p] - s * vectors[k, q], s * vectors[k, p] + c * vectors[k, q]


@kernel
def keep_positive(a: Float, vectors: Float, values: Float) -> None:
    """Replace the symmetric a (3, 3) by its part with positive eigenvalues; the others are scratch."""
    minor = a[0, 0] * a[1, 1] - a[0, 1] * a[0, 1]
    rest = a[0, 1] * a[1, 2] - a[1, 1] * a[0, 2]
    determinant = a[2, 2] * minor + a[0, 2] * rest - a[1, 2] * (a[0, 0] * a[1, 2] - a[0, 1] * a[0, 2])
    if a[0, 0] > 0.0 and minor > 0.0 and determinant > 0.0:
        return
    # Entry by entry: array expressions take seconds more to compile, above all for the errors of shapes that differ.
    size = 0.0
    for i in range(3):
        for j in range(3):
            vectors[i, j] = 1.0 if i == j else 0.0
            if abs(a[i, j]) > size or np.isnan(a[i, j]):
                size = abs(a[i, j])
    for _ in range(MOST_SWEEPS):
        if max(abs(a[0, 1]), abs(a[0, 2]), abs(a[1, 2])) <= EPSILON * size:
            break
        rotate(a, vectors, 0, 1)
        rotate(a, vectors, 0, 2)
        rotate(a, vectors, 1, 2)
    for k in range(3):
        values[k] = max(a[k, k], 0.0)
    for i in range(3):
        for j in range(3):
            a[i, j] = 0.0
            for k in range(3):
                a[i, j] += vectors[i, k] * values[k] * vectors[j, k]


@block_kernel
def add_stiffness(base: Float, moved: Float, scale: Any, diagonal: Float) -> None:
    """Subtract from own (6, n) the change of the accelerations base (3, n) as all vertices move along each axis, (3, 3,
    n): scale (n,) times the differences, mass over the way.
    """
    a, vectors, values = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for p in range(base.shape[1]):
        for i in range(3):
            for j in range(3):
                a[i, j] = 0.5 * scale[p] * ((base[i, p] - moved[j, i, p]) + (base[j, p] - moved[i, j, p]))
        if not np.any(a):
            continue
        keep_positive(a, vectors, values)
        for i in range(3):
            diagonal[i, p] += a[i, i]
        diagonal[3, p] += a[0, 1]
        diagonal[4, p] += a[0, 2]
        diagonal[5, p] += a[1, 2]


# The unknowns of an implicit stage, how far it is solved, and vertices that it leaves where they are.


class Limits(NamedTuple):
    """The accuracy to which a stage is solved.

    residual  force that may be missing at a vertex, as a share of the largest single force
    most      Newton steps
    cut       whether vertices that contact holds back in a stalled stage are left in place, and counted
    """

    residual: float
    most: int
    cut: bool = False


@dataclass
class Stage:
    """Memory of the solver for one packed system.

    x, v (3, n) are the stage's unknowns; mass (n,) is 0 where a vertex is pinned, or held for the rest of the stage.
    grips hold vertices on bodies (nuno_contact.sliding.grip), and missing (3, n) is the residual without them [N].
    """

    packed: Packed
    mass: Float
    size: float
    scale: float
    solver: Solver
    x: Float
    v: Float
    a: Float
    residual: Float
    missing: Float
    others: Packed | None
    grips: tuple[Any, ...] = ()

    @property
    def counts(self) -> Counts:
        return self.solver.counts


def make_stage(packed: Packed, position: Float, size: float) -> Stage:
    """`position` (n, 3) and `size` are the cloth's at rest [m]."""
    w = packed.inverse_mass
    mass = np.divide(1.0, w, out=np.zeros_like(w), where=w > 0.0)
    matrices = {kernels_of(term).name for term in packed.forces if "rows" in kernels_of(term)}
    lumped = packed.late is not None or len(matrices) < len(parts(packed))
    others = silence(packed, *matrices) if lumped else None
    stiffest = max(call_each(packed, "stiffest"), default=0.0)
    x, v, a, residual, missing = np.zeros((5, 3, w.shape[0]))
    return Stage(packed, mass, size, stiffest, make_solver(packed, position), x, v, a, residual, missing, others)


def hold(st: Stage, held: Bool) -> None:
    """Hold vertices (n,) in place."""
    st.mass[held] = 0.0
    st.solver.linear.inverse_mass[held] = 0.0
    st.solver.linear.inverse[:, held] = 0.0


def let_go(st: Stage, packed: Packed, count: bool) -> None:
    """Release all held vertices, and count them if `count`."""
    held = (st.mass == 0.0) & (packed.inverse_mass > 0.0)
    if held.any():
        if count:
            call_each(packed, "cut", held)
        st.solver.linear.inverse_mass[:] = packed.inverse_mass
        st.mass[held] = 1.0 / packed.inverse_mass[held]


SLOW = 0.3
"""A Newton step that leaves more than this share of the residual is followed by one with the exact matrix. Buckling
cloth holds compressed springs in balance: without their negative stiffness every step goes a tenth of the way. Far from
the end the exact matrix is mostly not positive, and not worth trying."""
SLOPE = 0.5
"""A step is shortened if the residual along it has changed sign and exceeds this share of its former value."""
MOST_TRIALS = 6
HELD_BACK = 5
"""factor on the number of Newton steps where cloth meets cloth: a step that contact has shortened goes as far as the
contact, which the next takes into account; and which pairs touch and slide takes some to settle. Three sheets that meet
at 16 m/s in a step of 1/60 s take 40, and a halving costs more."""
STALLED, FALLS = 14, 0.9
"""A stage stalls after so many Newton steps that contact shortened, none of which left less than this share of the
least residual before: cloth pressed together harder than contact can push it apart goes no farther."""
WAITS = 40
"""Newton steps beyond the required residual, until bodies are in place: each step pushes cloth before them by about its
thickness."""
FORESEEN = 4
"""number of times that a Newton step is solved again with the contacts it was found to make"""
REACH = 1e-7
"""share of the cloth's size by which vertices are moved to differentiate forces that act on each alone"""


@block_kernel
def missing_force(a: Float, u: Float, vhat: Float, g: float, mass: Float, out: Float) -> float:
    """Compute out = mass (a - (u - vhat) / g), 0 for mass 0; return the largest norm."""
    largest = 0.0
    for p in range(out.shape[1]):
        square = 0.0
        for row in range(3):
            f = mass[p] * (a[row, p] - (u[row, p] - vhat[row, p]) / g) if mass[p] > 0.0 else 0.0
            out[row, p] = f
            square += f * f
        # Not max(): NaN must propagate.
        largest = largest if square <= largest * largest else np.sqrt(square)
    return largest


def solve_stage(
    st: Stage, packed: Packed, xhat: Float, vhat: Float, g: float, s: float, start: Float, limits: Limits
) -> tuple[bool, float]:
    """Solve for st.x, st.v from their present guess st.v; return whether it converged, and the residual [N].

    `start` (3, n) is where the cloth is now.
    """
    result = _solve_stage(st, packed, xhat, vhat, g, s, start, limits)
    let_go(st, packed, result[0])
    return result


def _solve_stage(
    st: Stage, packed: Packed, xhat: Float, vhat: Float, g: float, s: float, start: Float, limits: Limits
) -> tuple[bool, float]:
    """Solve likewise, but leave stalled vertices held."""
    limit_approach(packed, g)
    for grip in st.grips:
        grip.pose(s)
        grip.lead(xhat, st.v, g)
    guess = st.v.copy()
    np.multiply(st.v, g, out=st.x)
    st.x += xhat
    _begin_apart(st, packed, xhat, g, s, start)
    st.solver.before[...], st.solver.follow = start, False
    worst, slow = _evaluate(st, packed, vhat, g, s), False
    left, waited, least, stalled = float(limits.most), 0, np.inf, 0
    for turn in range(HELD_BACK * limits.most + 1):
        allowed = limits.residual * largest_force(st, packed) + _rounding(st, g)
        if worst <= allowed:
            if waited == WAITS or not any(call_each(packed, "waits")):
                return True, worst
            waited += 1
        spent = turn == HELD_BACK * limits.most or left < 0.5 / HELD_BACK
        if packed.leave[0] or spent or not np.isfinite(worst) or (stalled == STALLED and not limits.cut):
            break
        before = worst
        if not _solve_newton(st, packed, g, s, slow):
            st.v[...] = guess
            return _solve_stage(st, packed, xhat, vhat, g, s, start, limits)
        unshortened = st.solver.linear.x.copy()
        shortened = any(call_each(packed, "bound", st.x, st.solver.linear.x, s, packed.threads))
        if shortened and st.solver.direct:
            st.solver.direct, st.solver.hindered = False, True
            st.v[...] = guess
            return _solve_stage(st, packed, xhat, vhat, g, s, start, limits)
        st.solver.hindered = st.solver.hindered or shortened
        # Springs do not have the tension that the whole step predicts.
        st.solver.follow = not shortened
        left -= 0.0 if shortened else 1.0 / HELD_BACK if is_touched(st.solver) else 1.0
        worst = _search(st, packed, vhat, g, s)
        slow = worst > SLOW * before and not shortened
        # Waiting for bodies is no stall: the stage is solved already.
        stalled = 0 if worst < FALLS * least or worst <= allowed else stalled + int(shortened)
        least = min(least, worst)
        if stalled == STALLED and limits.cut:
            hold(st, (st.solver.linear.x != unshortened).any(axis=0))
            least, stalled = np.inf, 0
    return False, worst


def _begin_apart(st: Stage, packed: Packed, xhat: Float, g: float, s: float, start: Float) -> None:
    """Shorten the first guess to where cloth does not yet meet."""
    d = st.x - start
    if any(call_each(packed, "bound", start, d, s, packed.threads)):
        np.add(start, d, out=st.x)
        np.subtract(st.x, xhat, out=st.v)
        st.v /= g


def limit_approach(packed: Packed, g: float) -> None:
    """Limit the approach that contact's dashpots see to the way within g [s]; see Contact.rate."""
    call_each(packed, "approach", 1.0 / g)


def _solve_newton(st: Stage, packed: Packed, g: float, s: float, exact: bool) -> bool:
    """Compute the Newton step into st.solver.linear.x; return False if the stage is to be begun anew."""
    _fill_diagonal(st, packed, g, s)
    st.counts.newton += 1
    done = solve_linear(st.solver, packed, st.x, 1.0 / g, st.residual, exact)
    for _ in range(FORESEEN if done and not st.solver.direct else 0):
        pull = st.residual.copy()
        if not any(call_each(packed, "foresee", st.x, st.solver.linear.x, pull)):
            break
        solve_again(st.solver, packed, st.x, 1.0 / g, pull)
    for grip in st.grips:
        grip.filter(st.solver.linear.x)
    st.solver.before[...], st.solver.follow = st.x, True
    return done


def compile_stage(st: Stage, packed: Packed, x: Float, v: Float) -> None:
    """Compile what `solve_stage` needs, by solving for no force at (x, v)."""
    st.x[...], st.v[...] = x, v
    _evaluate(st, packed, st.v, 1.0, 0.0)
    _fill_diagonal(st, packed, 1.0, 0.0)
    compile_solver(st.solver, packed, st.x)
    along(st.residual, st.solver.linear.x)
    largest_force(st, packed)
    turning_work(st.x, st.x, st.x, packed)


def _rounding(st: Stage, g: float) -> float:
    """Return the residual [N] that rounding alone leaves: of springs' lengths, and of momentum over the step."""
    place, speed = float(np.abs(st.x).max(initial=0.0)), float(np.abs(st.v).max(initial=0.0))
    return 16.0 * EPSILON * (st.scale * place + float(st.mass.max(initial=0.0)) * speed / g)


def _evaluate(st: Stage, packed: Packed, vhat: Float, g: float, s: float) -> float:
    evaluate(st.x, st.v, s, st.a, packed)
    st.counts.evaluations += 1
    worst = float(missing_force(st.a, st.v, vhat, g, st.mass, st.residual))
    if not st.grips:
        return worst
    st.missing[...] = st.residual
    for grip in st.grips:
        st.residual += grip.rub
        grip.filter(st.residual)
    return float(np.sqrt((st.residual * st.residual).sum(axis=0).max(initial=0.0)))


def _search(st: Stage, packed: Packed, vhat: Float, g: float, s: float) -> float:
    """Step along the solution d in st.solver.linear.x, less far if the residual along it changes sign.

    For conservative forces residual.d is minus the slope of the step's energy along d, which a minimum makes 0: the
    rule brings the secant's minimum, and needs no energy, so that it holds for friction and wind too. Where d is exact,
    the tension that springs get by turning does not count: the next step takes it back, and steps that avoid it are
    short on stiff cloth (the Maratos effect).
    """
    d = st.solver.linear.x
    before, gone, share = along(st.residual, d), 0.0, 1.0
    worst = np.inf
    for _ in range(MOST_TRIALS):
        st.x += (share - gone) * d
        st.v += ((share - gone) / g) * d
        gone = share
        worst = _evaluate(st, packed, vhat, g, s)
        after = along(st.residual, d)
        if st.solver.direct:
            after += turning_work(st.solver.before, st.x, d, packed)
        if after >= -SLOPE * abs(before):
            break
        # There is no secant where d is so short that it changes nothing, or goes uphill by rounding.
        share *= max(0.1, before / (before - after)) if before > after else 0.1
    return worst


def _fill_diagonal(st: Stage, packed: Packed, g: float, s: float) -> None:
    """Write each vertex's own stiffness, and its inertia, into the matrix."""
    diagonal = st.solver.linear.own
    diagonal[:3] = st.mass / (g * g) + (packed.damping / g) * st.mass
    diagonal[3:] = 0.0
    if st.others is not None:
        diagonal[:3] = st.mass / (g * g)
        _add_others(st, st.others._replace(bodies_on=packed.bodies_on, damping=packed.damping), g, s)
    for grip in st.grips:
        grip.stiffen(diagonal, st.scale)


def _add_others(st: Stage, others: Packed, g: float, s: float) -> None:
    """Add each vertex's own stiffness, symmetric and without negative parts."""
    base, moved = np.empty_like(st.a), np.empty((3, *st.a.shape))
    evaluate(st.x, st.v, s, base, others)
    step = REACH * st.size
    for axis in range(3):
        x, v = st.x.copy(), st.v.copy()
        x[axis] += step
        v[axis] += step / g
        evaluate(x, v, s, moved[axis], others)
    st.counts.evaluations += 4
    add_stiffness(base, moved, st.mass / step, st.solver.linear.own)


def largest_force(st: Stage, packed: Packed) -> float:
    """Return the largest single force [N] at st.x: of a spring, a weight, or the resultant on a vertex."""
    weight = float(np.linalg.norm(packed.gravity)) * float(st.mass.max(initial=0.0))
    inertia = float(np.sqrt(((st.a * st.mass) ** 2).sum(axis=0)).max(initial=0.0))
    return float(max(weight, inertia, *call_each(packed, "tension", st.x)))


def turning_work(before: Float, x: Float, d: Float, packed: Packed) -> float:
    """Return the work along d (3, n) of the tension that springs got by turning on their way from `before` to x [J].

    A spring that turns from a to b is longer than b's share along a, by the square of the angle. A linear step cannot
    predict that, and the next one takes it back.
    """
    return float(sum(call_each(packed, "turning", before, x, d)))
