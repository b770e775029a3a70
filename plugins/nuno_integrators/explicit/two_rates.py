"""Tension at two rates: springs that limit the step act in every step, the others twice as strongly in every second.

A few short or stiff springs, or light vertices, set the step for all: of a skirt's 12,000 springs the 1,344 of the weft
near the waist. The others bear steps twice as long. They are kicks to those few, as contact is to all of tension
(nuno_integrators.explicit.respa): no farther apart than a share of their own limit, and where they feed no mode of the
few. Not chosen: a third rate, for springs slow enough for four steps are few, and a trial with more of them diverged;
more mass for the few, which gives longer steps to all, but is other cloth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nuno_integrators.stability import measure_rates
from nuno_kernels.forces.springs import pack_springs
from nuno_kernels.step.acceleration import Packed
from nuno_kernels.terms import Terms, kernels_of
from nuno_schemas.fabric import Bool, Fabric, Float, Springs, State
from nuno_schemas.system import System

Rates = tuple[float, float]
SHARES = (0.25, 0.15, 0.1)
"""Springs up to such a share of the greatest squared frequency are tried as the slower ones."""
MOST = 0.5
"""share of the springs that may be the quicker ones: with more, there is little to gain"""


@dataclass(frozen=True)
class TwoRates:
    """The forces of every second step, with slower springs twice as strong, and those of the steps between."""

    twice: Terms
    quick: Terms
    springs: tuple[int, int]
    """how many of them, the first, are springs"""

    def parts(self, fast: Packed) -> tuple[Packed, Packed]:
        """Return the system of every second step, and that of the others, of one with all tension."""
        of_springs = _of_springs(fast.forces)
        on, others = bool(fast.forces_on[of_springs].all()), fast.forces_on[~of_springs]
        acting = (np.concatenate([np.full(number, on), others]) for number in self.springs)
        twice, quick = (
            fast._replace(forces=t, forces_on=o) for t, o in zip((self.twice, self.quick), acting, strict=True)
        )
        return twice, quick


def _of_springs(forces: Terms) -> Bool:
    return np.array([kernels_of(term).name == "springs" for term in forces], np.bool_)


def two_rates(system: System, packed: Packed, start: State, bears: Callable[[Rates, Rates], bool]) -> TwoRates | None:
    """Divide the springs of a system; None where hardly any bear longer steps. `bears` says whether kicks of forces
    with the second rates (omega, damping) [1/s], in every second step, are safe beside forces with the first.
    """
    fabric = system.fabric
    if fabric.springs is None or not fabric.springs.number or fabric.yarns is not None:
        return None
    springs, squared = fabric.springs, squared_frequencies(fabric)
    tension = replace(system, terms=(), damping=0.0, fabric=replace(fabric, hinges=None, bending=None, friction=None))
    for share in SHARES:
        quick = squared > share * squared.max()
        if springs.count[quick].sum() > MOST * springs.number:
            return None
        few, others = take_runs(springs, quick), take_runs(springs, ~quick)
        slow = replace(tension, fabric=replace(tension.fabric, springs=others, membrane=None))
        fast = replace(tension, fabric=replace(tension.fabric, springs=few))
        if bears(measure_rates(fast, start), measure_rates(slow, start)):
            n, strength = fabric.number, np.where(quick, 1.0, 2.0)
            terms = pack_springs(strengthen(springs, strength), n), pack_springs(few, n)
            rest = [term for term, of in zip(packed.forces, _of_springs(packed.forces), strict=True) if not of]
            twice, between = (Terms((*some, *rest), packed.forces.roles, packed.forces.given) for some in terms)
            return TwoRates(twice, between, (len(terms[0]), len(terms[1])))
    return None


def squared_frequencies(fabric: Fabric) -> Float:
    """Return the greatest squared frequency [1/s^2] of a spring of each run (m,) between its two vertices alone."""
    assert fabric.springs is not None
    firm = fabric.springs.stiffest()
    inverse = np.divide(1.0, fabric.mass, out=np.zeros(fabric.number), where=~fabric.pinned)
    greatest = np.zeros(len(firm.count))
    runs = np.repeat(np.arange(len(firm.count)), firm.count)
    np.maximum.at(greatest, runs, firm.per_spring(firm.k) * inverse[firm.pairs()].sum(axis=1))
    return greatest


CONSTANTS = ("k", "rest", "c", "lock", "k_lock")


def take_runs(springs: Springs, chosen: Bool) -> Springs:
    """Return the chosen runs (m,)."""
    taken = {name: getattr(springs, name)[chosen] for name in ("first", "count", "stride", "kind")}
    constants = {name: values[_spread(springs, values, chosen)] for name, values in _constants(springs, CONSTANTS)}
    return replace(springs, **taken, **constants)


def strengthen(springs: Springs, factor: Float) -> Springs:
    """Return springs whose force is that of each run times its factor (m,)."""
    scaled = _constants(springs, ("k", "c", "k_lock"))
    return replace(springs, **{name: values * _spread(springs, values, factor) for name, values in scaled})


def _constants(springs: Springs, names: tuple[str, ...]) -> list[tuple[str, Float]]:
    return [(name, getattr(springs, name)) for name in names if getattr(springs, name) is not None]


def _spread(springs: Springs, values: Float, of_run: Any) -> Any:
    """Return what each run has (m,) for constants per run or per spring."""
    return of_run if values.shape == springs.count.shape else np.repeat(of_run, springs.count)
