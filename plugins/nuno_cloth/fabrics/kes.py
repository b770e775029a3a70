"""Virtual KES tests: the stiffness of a fabric on a mesh, in the units of its measures.

A specimen is strained at its border, its inside relaxes to rest, and force or energy give the stiffness. With the sides
held (the deformation is then the same everywhere) a preset's values must result exactly. With free sides, as in the KES
apparatus, a wide specimen narrows and is a little softer: between C and C - G^2 / C'.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from nuno_cloth.fabrics.energy import elastic_energy
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Bool, Fabric, Float

STRAIN = 1e-4
"""Strain, and shear angle [rad], of the tests: the difference of forces at + and - STRAIN has an error of order
STRAIN^2."""

TURN = 0.02
"""Angle between neighbouring rows in the bending test [rad]: 1 - cos differs from half its square
by TURN^2 / 12 of it."""


@dataclass(frozen=True)
class Measures:
    """Results: tensile and shear [N/m], bending rigidities per width [N m], weight [kg/m^2]."""

    warp: float
    weft: float
    shear: float
    bend_warp: float
    bend_weft: float
    density: float


def measure(
    piece: Fabric,
    resolution: tuple[int, int],
    size: tuple[float, float],
    sides_held: bool = True,
) -> Measures:
    """Run all tests on a specimen, a sheet of `size` (across, along) [m] with `resolution` vertices."""
    rows, cols = resolution[1], resolution[0]
    return Measures(
        warp=stretch(piece, rows, cols, along=1, sides_held=sides_held),
        weft=stretch(piece, rows, cols, along=0, sides_held=sides_held),
        shear=shear(piece, rows, cols, sides_held=sides_held),
        bend_warp=bend(piece, rows, cols, along=1),
        bend_weft=bend(piece, rows, cols, along=0),
        density=float(piece.mass.sum() / (size[0] * size[1])),
    )


def _grips(rows: int, cols: int, along: int, depth: int = 1) -> tuple[Bool, Bool]:
    """Return the vertices (n,) in the two grips: the outer `depth` rows (along 1) or columns (along 0)."""
    low = np.zeros((rows, cols), np.bool_)
    high = np.zeros((rows, cols), np.bool_)
    if along == 1:
        low[-depth:], high[:depth] = True, True
    else:
        low[:, :depth], high[:, -depth:] = True, True
    return low.ravel(), high.ravel()


def stretch(piece: Fabric, rows: int, cols: int, along: int, sides_held: bool = True) -> float:
    """Return the tensile stiffness [N/m] of a flat piece in the plane xy, along x (weft) or y (warp)."""
    x = piece.position
    low, high = _grips(rows, cols, along)
    fixed = _in_plane(low | high)
    if sides_held:
        fixed[:, 1 - along] = True
    length, width = np.ptp(x[:, along]), np.ptp(x[:, 1 - along])
    forces = []
    for strain in (STRAIN, -STRAIN):
        start = x.copy()
        start[:, along] *= 1 + strain
        _, gradient = relax(piece, start, fixed)
        forces.append(float(gradient[high, along].sum()))
    return float((forces[0] - forces[1]) / (2 * STRAIN) / width) if length > 0 else 0.0


def shear(piece: Fabric, rows: int, cols: int, sides_held: bool = True) -> float:
    """Return the shear stiffness [N/m per rad]: the top row slides along x over the bottom row."""
    x = piece.position
    low, high = _grips(rows, cols, 1)
    left, right = _grips(rows, cols, 0)
    held = (low | high | left | right) if sides_held else (low | high)
    width, height = np.ptp(x[:, 0]), np.ptp(x[:, 1])
    energies = []
    for angle in (STRAIN, -STRAIN):
        start = x.copy()
        start[:, 0] += angle * x[:, 1]
        energies.append(relax(piece, start, _in_plane(held))[0])
    return float(sum(energies) / STRAIN**2 / (width * height))


def bend(piece: Fabric, rows: int, cols: int, along: int) -> float:
    """Return the bending rigidity per width [N m] of the yarns along x (weft) or y (warp).

    The outer two rows at either end lie on a cylinder, one step of arc apart, and hold its tangents. The fold lines
    between the grips bend (rows - 2) steps of length.
    """
    x = piece.position
    lines = rows if along == 1 else cols
    step = np.ptp(x[:, along]) / (lines - 1)
    width = np.ptp(x[:, 1 - along])
    radius = 0.5 * step / np.sin(0.5 * TURN)
    angle = x[:, along] / step * TURN
    start = x.copy()
    start[:, along] = radius * np.sin(angle)
    start[:, 2] = radius * (np.cos(angle) - 1)
    low, high = _grips(rows, cols, along, 2)
    fixed = np.repeat((low | high)[:, None], 3, axis=1)
    energy, _ = relax(piece, start, fixed)
    return float(2 * energy / (TURN**2 * (lines - 2) / step * width))


def _in_plane(held: Bool) -> Bool:
    """Return the fixed coordinates (n, 3): all of the held vertices, z of the others."""
    fixed = np.repeat(held[:, None], 3, axis=1)
    fixed[:, 2] = True
    return fixed


def relax(piece: Fabric, start: Float, fixed: Bool) -> tuple[float, Float]:
    """Return energy [J] and gradient (n, 3) [N] at rest, from `start` (n, 3), with some coordinates fixed.

    Raises RunFailed if the piece does not come to rest.
    """
    free = ~fixed
    x = start.copy()

    def evaluate(values: Float) -> tuple[float, Float]:
        x[free] = values
        energy, gradient = elastic_energy(piece, x)
        return energy, gradient[free]

    x[free] = minimise(evaluate, start[free])
    return elastic_energy(piece, x)


def minimise(evaluate: Callable[[Float], tuple[float, Float]], start: Float, tolerance: float = 1e-12) -> Float:
    """Return the minimum by L-BFGS (Nocedal and Wright, algorithm 7.5) with backtracking.

    Stops when the gradient is below 1e-6 of its first norm, or the energy changes by less than `tolerance`. Rejected:
    SciPy's L-BFGS-B, which stops at absolute sizes, needs scaled energies, and takes twice as long to the same digits.
    """
    x = start.copy()
    energy, gradient = evaluate(x)
    first = np.linalg.norm(gradient)
    steps: list[tuple[Float, Float]] = []
    for _ in range(2000):
        if np.linalg.norm(gradient) <= 1e-6 * first or first == 0:
            return x
        direction = _quasi_newton(gradient, steps)
        slope = float(gradient @ direction)
        size = 1.0
        while True:
            trial = x + size * direction
            trial_energy, trial_gradient = evaluate(trial)
            if trial_energy <= energy + 1e-4 * size * slope:
                break
            size *= 0.5
            if size < 1e-12:
                return x
        steps = [*steps[-19:], (trial - x, trial_gradient - gradient)]
        done = energy - trial_energy <= tolerance * abs(energy)
        x, energy, gradient = trial, trial_energy, trial_gradient
        if done:
            return x
    raise RunFailed("the specimen did not come to rest in 2000 iterations")


def _quasi_newton(gradient: Float, steps: Sequence[tuple[Float, Float]]) -> Float:
    """Return the direction by the two-loop recursion; without history the gradient times -1e-3 m/N."""
    direction = -gradient
    weights = []
    for s, y in reversed(steps):
        weight = (s @ direction) / (s @ y)
        direction = direction - weight * y
        weights.append(weight)
    if steps:
        s, y = steps[-1]
        direction = direction * ((s @ y) / (y @ y))
    else:
        direction = direction * 1e-3
    for (s, y), weight in zip(steps, reversed(weights), strict=True):
        direction = direction + s * (weight - (y @ direction) / (s @ y))
    return np.asarray(direction)
