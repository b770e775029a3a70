"""Energy and stretch of a fabric, measured once a frame."""

from __future__ import annotations

import math
from typing import NamedTuple

from nuno_kernels import inlined, kernel
from nuno_kernels.forces.hinges import FLAT, HingeLists, HingeRuns
from nuno_kernels.forces.springs import SpringLists, SpringRuns
from nuno_kernels.lanes import cross, dot, edge
from nuno_kernels.step.acceleration import Packed
from nuno_kernels.step.blocks import BLOCK
from nuno_kernels.terms import Measured, kernels_of
from nuno_schemas.fabric import Float


class Energy(NamedTuple):
    """Energies by kind [J] and the shape of the springs.

    stretch is the largest |d| / L - 1 (0 without springs; springs of rest length 0 do not count),
    shortest the smallest |d| > 0 [m] (inf without), zero_length the springs with |d| = 0, which
    exert no force.
    """

    kinds: dict[str, float]
    stretch: float
    shortest: float
    zero_length: int

    @property
    def total(self) -> float:
        return sum(self.kinds.values())


@inlined
def measure_spring(
    x: Float, i: int, j: int, constants: Float, c: int, locks: bool | None, stretch: float, shortest: float
) -> tuple[float, float, float, int]:
    """Return the energy of one spring, and the updated stretch, shortest length and zero-length mark."""
    d, k, rest = edge(x, i, j), constants[0, c], constants[1, c]
    length = math.sqrt(dot(d, d))
    if rest > 0.0:
        stretch = max(stretch, length / rest - 1.0)
    if length > 0.0:
        shortest = min(shortest, length)
    energy = 0.5 * k * (length - rest) ** 2
    if locks is not None:
        energy += 0.5 * constants[3, c] * max(length - constants[4, c], 0.0) ** 2
    return energy, stretch, shortest, 1 if length == 0.0 else 0


@kernel
def measure_spring_runs(runs: SpringRuns, x: Float) -> Measured:
    """Return energy, stretch, shortest length and number of zero-length springs.

    A spring that two blocks compute counts where its i end is at home.
    """
    energy, stretch, shortest, zeros = 0.0, -1.0, math.inf, 0
    task, constants = runs.task, runs.constants
    for t in range(task.shape[0]):
        i, j, at = task[t, 0], task[t, 1], task[t, 3]
        if task[t, 4] & 1 == 0:
            continue
        for q in range(task[t, 2]):
            c = at if runs.each is None else at + q
            e, stretch, shortest, zero = measure_spring(x, i + q, j + q, constants, c, runs.locks, stretch, shortest)
            energy += e
            zeros += zero
    return Measured(energy, stretch, shortest, zeros)


@kernel
def measure_spring_lists(lists: SpringLists, x: Float) -> Measured:
    """Return energy, stretch, shortest length and number of zero-length springs of listed springs."""
    energy, stretch, shortest, zeros = 0.0, -1.0, math.inf, 0
    start, ends, constants = lists.start, lists.ends, lists.constants
    for block in range(start.shape[0] - 1):
        width = min(BLOCK, x.shape[1] - block * BLOCK)
        for c in range(start[block], start[block + 1]):
            if ends[2, c] < width:
                e, stretch, shortest, zero = measure_spring(
                    x, ends[0, c], ends[1, c], constants, c, lists.locks, stretch, shortest
                )
                energy += e
                zeros += zero
    return Measured(energy, stretch, shortest, zeros)


@kernel
def measure_hinge(x: Float, i0: int, i1: int, i2: int, i3: int, k_cos: float, k_sin: float) -> float:
    """Return the energy of one hinge.

    1 - cos(d) is taken as sin(d)^2 / (1 + cos(d)), which keeps its digits where d is small.
    """
    e, d2, d3 = edge(x, i0, i1), edge(x, i0, i2), edge(x, i0, i3)
    n1, n2 = cross(e, d2), cross(d3, e)
    q1, q2, ee = dot(n1, n1), dot(n2, n2), dot(e, e)
    if q1 <= FLAT * ee * dot(d2, d2) or q2 <= FLAT * ee * dot(d3, d3):
        return 0.0
    inverse = 1.0 / math.sqrt(q1 * q2)
    sine, cosine = dot(n1, d3) * math.sqrt(ee) * inverse, dot(n1, n2) * inverse
    k = math.sqrt(k_cos * k_cos + k_sin * k_sin)
    s, c = k_cos * sine - k_sin * cosine, k_cos * cosine + k_sin * sine
    return float(s * s / (k + c) if c > 0.0 else k - c)


@kernel
def measure_hinge_runs(runs: HingeRuns, x: Float) -> float:
    """Return the energy of all hinges in runs, each counted where its first vertex is at home."""
    energy, task, constants = 0.0, runs.task, runs.constants
    for t in range(task.shape[0]):
        if task[t, 6] & 1:
            i0, i1, i2, i3, at = task[t, 0], task[t, 1], task[t, 2], task[t, 3], task[t, 5]
            for q in range(task[t, 4]):
                energy += measure_hinge(x, i0 + q, i1 + q, i2 + q, i3 + q, constants[0, at], constants[1, at])
    return energy


@kernel
def measure_hinge_lists(lists: HingeLists, x: Float) -> float:
    """Return the energy of all listed hinges, each counted where its first vertex is at home."""
    energy, start, corners, constants = 0.0, lists.start, lists.corners, lists.constants
    for block in range(start.shape[0] - 1):
        width = min(BLOCK, x.shape[1] - block * BLOCK)
        for c in range(start[block], start[block + 1]):
            if corners[4, c] < width:
                energy += measure_hinge(
                    x, corners[0, c], corners[1, c], corners[2, c], corners[3, c], constants[0, c], constants[1, c]
                )
    return energy


@kernel
def measure_vertices(x: Float, v: Float, mass: Float, gravity: Float) -> tuple[float, float]:
    """Return the kinetic and gravitational energy for x, v (3, n) and masses (n,) [kg]."""
    kinetic, potential = 0.0, 0.0
    for p in range(x.shape[1]):
        kinetic += 0.5 * mass[p] * (v[0, p] * v[0, p] + v[1, p] * v[1, p] + v[2, p] * v[2, p])
        potential -= mass[p] * (gravity[0] * x[0, p] + gravity[1] * x[1, p] + gravity[2] * x[2, p])
    return kinetic, potential


def measure_energy(x: Float, v: Float, mass: Float, packed: Packed) -> Energy:
    """Return energy and stretch of a packed system at x, v (3, n) with masses (n,) [kg]."""
    kinetic, gravitational = measure_vertices(x, v, mass, packed.gravity)
    kinds = {"kinetic": kinetic, "gravitational": gravitational, "springs": 0.0, "hinges": 0.0}
    stretch, shortest, zeros = -1.0, math.inf, 0
    for term in packed.forces:
        measure, name = kernels_of(term).find("energy"), kernels_of(term).name
        if measure is not None:
            found = measure(term, x)
            if isinstance(found, Measured):
                stretch, shortest = max(stretch, found.stretch), min(shortest, found.shortest)
                zeros += found.zero_length
                found = found.energy
            kinds[name] = kinds.get(name, 0.0) + float(found)
    return Energy(kinds, stretch if stretch > -1.0 else 0.0, shortest, zeros)
