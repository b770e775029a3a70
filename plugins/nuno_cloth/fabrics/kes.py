"""Virtual KES tests: the stiffness of a fabric on a mesh in the units of its measures, and a table of the presets."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from nuno_cloth.fabrics.presets import PRESETS, Material, complete
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Bool, Fabric, Float
from nuno_schemas.preset import Measure, Preset

# Energies of a specimen and their gradients in plain NumPy: nuno_kernels has the fast ones.


def spring_energy(fabric: Fabric, x: Float) -> tuple[float, Float]:
    """Return the sum of k (|d| - rest)^2 / 2 [J] and its gradient (n, 3) [N]; x (n, 3) [m].

    A spring of length 0 has no direction and gives no gradient.
    """
    gradient = np.zeros_like(x)
    springs = fabric.springs
    if springs is None:
        return 0.0, gradient
    pairs = springs.pairs()
    k, rest = springs.per_spring(springs.k), springs.per_spring(springs.rest)
    d = x[pairs[:, 1]] - x[pairs[:, 0]]
    length = np.linalg.norm(d, axis=1)
    pull = k * (length - rest)
    along = d * (pull / np.where(length > 0, length, np.inf))[:, None]
    np.add.at(gradient, pairs[:, 1], along)
    np.add.at(gradient, pairs[:, 0], -along)
    return float(0.5 * (pull * (length - rest)).sum()), gradient


def hinge_energy(fabric: Fabric, x: Float) -> tuple[float, Float]:
    """Return the sum of k (1 - cos(angle - rest)) [J] and its gradient (n, 3) [N]; x (n, 3) [m].

    The angle is 0 if flat, positive if the triangles fold towards their normals. Its gradient is n1 |e| / |n1|^2 and n2
    |e| / |n2|^2 at the opposite vertices, and the reaction is shared by the ends of the edge like that of a lever
    (Tamstorf and Grinspun 2013).
    """
    gradient = np.zeros_like(x)
    hinges = fabric.hinges
    if hinges is None:
        return 0.0, gradient
    quads = hinges.quads()
    k, rest = hinges.per_hinge(hinges.k), hinges.per_hinge(hinges.rest)
    x0, x1, x2, x3 = (x[quads[:, i]] for i in range(4))
    e = x1 - x0
    n1, n2 = np.cross(e, x2 - x0), np.cross(x3 - x0, e)
    ee, q1, q2 = (np.einsum("ij,ij->i", a, a) for a in (e, n1, n2))
    size = np.sqrt(q1 * q2)
    angle = np.arctan2(np.einsum("ij,ij->i", n1, x3 - x0) * np.sqrt(ee) / size, np.einsum("ij,ij->i", n1, n2) / size)
    moment = (k * np.sin(angle - rest))[:, None]
    g2, g3 = n1 * (np.sqrt(ee) / q1)[:, None], n2 * (np.sqrt(ee) / q2)[:, None]
    t2, t3 = (np.einsum("ij,ij->i", y - x0, e) / ee for y in (x2, x3))
    g1 = -(t2[:, None] * g2 + t3[:, None] * g3)
    for corner, g in enumerate((-(g1 + g2 + g3), g1, g2, g3)):
        np.add.at(gradient, quads[:, corner], moment * g)
    return float((k * (1 - np.cos(angle - rest))).sum()), gradient


def elastic_energy(fabric: Fabric, x: Float) -> tuple[float, Float]:
    """Return the energy of springs and hinges [J] and its gradient (n, 3) [N]."""
    (stretched, pull), (bent, turn) = spring_energy(fabric, x), hinge_energy(fabric, x)
    return stretched + bent, pull + turn


# Virtual KES tests: the stiffness of a fabric on a mesh, in the units of its measures.
#
# A specimen is strained at its border, its inside relaxes to rest, and force or energy give the stiffness. With the
# sides held (the deformation is then the same everywhere) a preset's values must result exactly. With free sides, as in
# the KES apparatus, a wide specimen narrows and is a little softer: between C and C - G^2 / C'.

STRAIN = 1e-4
"""Strain, and shear angle [rad], of the tests: the difference of forces at + and - STRAIN has an error of order
STRAIN^2."""

TURN = 0.02
"""Angle between neighbouring rows in the bending test [rad]: 1 - cos differs from half its square
by TURN^2 / 12 of it."""


def measure(
    piece: Fabric,
    resolution: tuple[int, int],
    size: tuple[float, float],
    sides_held: bool = True,
) -> Material:
    """Run all tests on a specimen, a sheet of `size` (across, along) [m] with `resolution` vertices. Return what they
    find: stiffness in tension and shear, bending rigidities and density.
    """
    rows, cols = resolution[1], resolution[0]
    return Material(
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
    SciPy's L-BFGS-B, as fast with scaled energies, but three times slower where OpenBLAS has several threads.
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


# The presets as a table: values of their sources, and results of virtual tests on a mesh.

COLUMNS = (
    ("density", "g/m^2", 1e3),
    ("warp", "N/m", 1.0),
    ("weft", "N/m", 1.0),
    ("shear", "N/m", 1.0),
    ("bend_warp", "uN*m", 1e6),
    ("bend_weft", "uN*m", 1e6),
)
"""Fields of a material, units of the table, and the number of these in one SI unit."""


RESOLUTION, SIZE = (9, 9), (0.05, 0.05)
"""Vertices of a specimen, and its sides [m]."""


def list_presets(cut: Callable[[str], Fabric]) -> tuple[Preset, ...]:
    """Return every preset with tests of a specimen, RESOLUTION and SIZE, that `cut` makes by the preset's name. With
    the sides held a specimen has the preset's values but for the tests' geometry (kes.py); with free sides, as in the
    apparatus, it narrows and is softer in tension.
    """
    return tuple(_preset(name, material, cut(name)) for name, material in PRESETS.items())


def _preset(name: str, material: Material, piece: Fabric) -> Preset:
    held, free = (measure(piece, RESOLUTION, SIZE, sides_held) for sides_held in (True, False))
    measures = tuple(_measure(material, held, free, *column) for column in COLUMNS)
    damping = Measure("damping_ratio", "", material.damping_ratio)
    return Preset(name, material.source, (*measures, damping), complete(material.how))


def _measure(material: Material, held: Material, free: Material, field: str, unit: str, per_si: float) -> Measure:
    tests = {"sides held": held, "sides free": free}
    measured = {test: getattr(results, field) * per_si for test, results in tests.items()}
    return Measure(field, unit, getattr(material, field) * per_si, measured)
