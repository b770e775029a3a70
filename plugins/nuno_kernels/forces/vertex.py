"""Forces on each vertex alone: what a term's type says of one vertex, compiled into a kernel over blocks.

Newton's method has their derivative without a matrix: all vertices move together.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from nuno_kernels import block_kernel, kernel
from nuno_kernels.step.blocks import BLOCK
from nuno_kernels.terms import define, overloaded, parameters_of, register
from nuno_schemas.fabric import Float

T = TypeVar("T", bound=type)
GIVEN = ("x", "v", "t")
"""what a force may take besides its term: position [m] and velocity [m/s] of a vertex, three numbers, and time [s]"""


def _own(role: str) -> Any:
    """Return a function f(term, x, v, t) for kernels: the term's own of a role, of which it takes what it names."""

    def build(term: Any) -> Any:
        own = term.instance_class.kernels.find(role)
        taken = ", ".join(["term", *parameters_of(own)[1:]])
        return define("own_of", "term, x, v, t", f"    return own({taken})", own=own)

    return overloaded("term, x, v, t", build)


force_at, energy_at = _own("at_vertex"), _own("energy_at_vertex")


@block_kernel
def push_vertices(term: Any, block: int, origin: int, x: Float, v: Float, force: Float, t: float) -> None:
    """Add the forces on a block's vertices at the time t [s]."""
    end = min(origin + BLOCK, x.shape[1])
    for i in range(np.uint64(origin), np.uint64(end)):
        push = force_at(term, (x[0, i], x[1, i], x[2, i]), (v[0, i], v[1, i], v[2, i]), t)
        c = i - np.uint64(origin)
        force[0, c] += push[0]
        force[1, c] += push[1]
        force[2, c] += push[2]


@kernel
def sum_energy(term: Any, x: Float) -> float:
    """Return the energy [J] of all vertices at x (3, n)."""
    total = 0.0
    for i in range(x.shape[1]):
        total += energy_at(term, (x[0, i], x[1, i], x[2, i]), (0.0, 0.0, 0.0), 0.0)
    return total


def vertex_force(name: str) -> Callable[[T], T]:
    """Register a type of term, a NamedTuple of arrays and numbers, as a force on each vertex alone.

    Its method force(self, x, v, t) returns the newtons on a vertex, three numbers; it leaves out what it does not
    depend on. If it has a method energy(self, x), that returns joules. Both are compiled.
    """

    def registered(kind: T) -> T:
        taken = parameters_of(kind.force)[1:]  # type: ignore[attr-defined]
        if not set(taken) <= set(GIVEN):
            raise TypeError(f"{kind.__name__}.force takes {', '.join(taken)}: there are {', '.join(GIVEN)}")
        roles = {"block": push_vertices, "at_vertex": kernel(kind.force)}  # type: ignore[attr-defined]
        if hasattr(kind, "energy"):
            roles |= {"energy": sum_energy, "energy_at_vertex": kernel(kind.energy)}
        register(kind, name, reads_velocity=lambda term: "v" in taken, **roles)
        kind.registered_by = kind.__module__  # type: ignore[attr-defined]
        return kind

    return registered
