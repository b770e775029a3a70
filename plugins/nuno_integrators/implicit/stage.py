"""The unknowns of an implicit stage, how far it is solved, and vertices that it leaves where they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from nuno_integrators.implicit.linear_solve import Counts, Solver, make_solver
from nuno_integrators.packing import parts, silence
from nuno_kernels.step.acceleration import Packed, call_each
from nuno_kernels.terms import kernels_of
from nuno_schemas.fabric import Bool, Float


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


def make_stage(packed: Packed, position: Float, size: float, python: bool) -> Stage:
    """`position` (n, 3) and `size` are the cloth's at rest [m]; `python` says whether a force is written in Python."""
    w = packed.inverse_mass
    mass = np.divide(1.0, w, out=np.zeros_like(w), where=w > 0.0)
    matrices = {kernels_of(term).name for term in packed.forces if kernels_of(term).rows is not None}
    lumped = python or packed.late is not None or len(matrices) < len(parts(packed))
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
