"""Hinges: angle, energy, gradient, symmetries, and the bending energy of a cylinder."""

from __future__ import annotations

import numpy as np
import pytest
from nets import accelerations, find_hinges, make_fabric, make_hinges, make_system, triangulate

from nuno_integrators.packing import pack, to_rows
from nuno_kernels.forces.energy import measure_energy
from nuno_kernels.forces.hinges import HingeLists, HingeRuns
from nuno_kernels.step.blocks import BLOCK
from nuno_schemas.fabric import Float, Hinges
from nuno_schemas.system import System
from nuno_wrinkle.edges import fold_angles


def sheet(rows: int, columns: int, spacing: float = 0.1) -> Float:
    row, column = np.divmod(np.arange(rows * columns), columns)
    return np.stack([column * spacing, row * spacing, np.zeros(rows * columns)], axis=1)


def crumpled(rows: int, columns: int, size: float, seed: int) -> tuple[Float, Hinges]:
    rng = np.random.default_rng(seed)
    quads = find_hinges(triangulate(rows, columns))
    h = quads.shape[0]
    hinges = make_hinges(quads, rng.uniform(0.5, 2.0, h), rng.uniform(-2.0, 2.0, h))
    return sheet(rows, columns) + size * rng.standard_normal((rows * columns, 3)), hinges


def energy(system: System, x: Float) -> float:
    rows = to_rows(x)
    return measure_energy(rows, 0.0 * rows, system.fabric.mass, pack(system)).kinds["hinges"]


@pytest.mark.parametrize("angle", [-3.0, -1.0, -1e-9, 0.0, 0.5, 2.0, 3.1])
def test_angle_is_positive_in_a_valley(angle: float) -> None:
    """Edge on the x axis, left triangle flat, right one turned by `angle` towards the normals (+z)."""
    position = np.array([[0, 0, 0], [1, 0, 0], [0.3, 1, 0], [0.6, -np.cos(angle), np.sin(angle)]], float)
    quads = np.array([[0, 1, 2, 3]], np.int32)
    assert abs(fold_angles(position, quads)[0] - angle) < 1e-14
    for rest in (0.0, 0.7, -2.0):
        system = make_system(make_fabric(position, hinges=make_hinges(quads, np.array([2.5]), np.array([rest]))))
        exact = 2.0 * 2.5 * np.sin(0.5 * (angle - rest)) ** 2
        assert abs(energy(system, position) - exact) < 1e-15 + 1e-14 * exact


@pytest.mark.parametrize("size", [0.01, 0.1])
def test_force_is_minus_the_gradient_of_energy(size: float) -> None:
    x, hinges = crumpled(4, 5, size, 1)
    system = make_system(make_fabric(x, hinges=hinges, mass=1.0))
    force, h = accelerations(system, x, 0 * x), 1e-6
    for vertex in range(x.shape[0]):
        for axis in range(3):
            ahead, behind = x.copy(), x.copy()
            ahead[vertex, axis] += h
            behind[vertex, axis] -= h
            slope = (energy(system, ahead) - energy(system, behind)) / (2 * h)
            assert abs(force[vertex, axis] + slope) < 1e-7 * np.abs(force).max()


def test_forces_keep_momentum_and_angular_momentum() -> None:
    x, hinges = crumpled(9, 9, 0.05, 2)
    force = accelerations(make_system(make_fabric(x, hinges=hinges, mass=1.0)), x, 0 * x)
    scale = np.abs(force).sum()
    assert np.abs(force.sum(axis=0)).max() < 1e-14 * scale
    assert np.abs(np.cross(x, force).sum(axis=0)).max() < 1e-14 * scale


def test_forces_turn_with_the_cloth() -> None:
    x, hinges = crumpled(6, 7, 0.05, 3)
    q, _ = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))
    q *= np.sign(np.linalg.det(q))
    system = make_system(make_fabric(x, hinges=hinges, mass=1.0))
    there, here = accelerations(system, x @ q.T, 0 * x), accelerations(system, x, 0 * x) @ q.T
    assert np.abs(there - here).max() < 1e-11 * np.abs(here).max()


def test_flat_cloth_at_rest_feels_exactly_nothing() -> None:
    x = sheet(12, 13)
    quads = find_hinges(triangulate(12, 13))
    system = make_system(make_fabric(x, hinges=make_hinges(quads, np.ones(len(quads)), np.zeros(len(quads)))))
    assert not accelerations(system, x, 0 * x).any()


@pytest.mark.parametrize("along", [0, 1])
def test_cylinder_stores_half_b_curvature_squared_per_area(along: int) -> None:
    """k = B e^2 / (A1 + A2) on a grid with alternating diagonals; the error falls as spacing^2."""
    bending, curvature, errors = 3e-5, 2.0, []
    for cells in (16, 32):
        spacing = 1.0 / cells
        flat = sheet(cells + 1, cells + 1, spacing)
        quads = find_hinges(triangulate(cells + 1, cells + 1))
        e = np.linalg.norm(flat[quads[:, 1]] - flat[quads[:, 0]], axis=1)
        hinges = make_hinges(quads, bending * e**2 / spacing**2, 0.0 * e)
        angle = curvature * flat[:, along]
        x = flat.copy()
        x[:, along], x[:, 2] = np.sin(angle) / curvature, (1.0 - np.cos(angle)) / curvature
        inner = 1.0 - spacing
        stored = energy(make_system(make_fabric(x, hinges=hinges)), x) / inner
        errors.append(abs(stored / (0.5 * bending * curvature**2) - 1.0))
    assert errors[1] < 1e-3
    assert errors[1] < 0.27 * errors[0]


def test_runs_and_lists_agree() -> None:
    """Rows of hinges across an edge to the next row, on a sheet of several blocks."""
    rows, columns = 70, 130
    first = [[(r + 1) * columns + 1, r * columns + 1, r * columns, r * columns + 2] for r in range(rows - 1)]
    count = np.full(rows - 1, columns - 2, np.int32)
    rng = np.random.default_rng(6)
    k, rest = rng.uniform(0.5, 2.0, rows - 1), rng.uniform(-0.5, 0.5, rows - 1)
    runs = Hinges(np.array(first, np.int32), count, np.ones(rows - 1, np.int32), k, rest)
    lists = make_hinges(runs.quads(), runs.per_hinge(k), runs.per_hinge(rest))
    x = sheet(rows, columns) + 0.02 * rng.standard_normal((rows * columns, 3))
    assert rows * columns > 2 * BLOCK
    systems = [make_system(make_fabric(x, hinges=hinges, mass=1.0)) for hinges in (runs, lists)]
    assert [[type(term) for term in pack(system).forces] for system in systems] == [[HingeRuns], [HingeLists]]
    a, b = (accelerations(system, x, 0 * x) for system in systems)
    assert np.abs(a - b).max() < 1e-13 * np.abs(a).max()
    assert abs(energy(systems[0], x) / energy(systems[1], x) - 1.0) < 1e-13


def test_triangles_without_area_are_skipped() -> None:
    quads = np.array([[0, 1, 2, 3], [4, 5, 6, 7], [8, 8, 9, 10]], np.int32)
    position = np.random.default_rng(4).standard_normal((11, 3))
    position[6] = 0.3 * position[4] + 0.7 * position[5]
    system = make_system(make_fabric(position, hinges=make_hinges(quads, np.ones(3), np.full(3, 0.3)), mass=1.0))
    a = accelerations(system, position, 0 * position)
    assert np.isfinite(a).all()
    assert a[:4].any(axis=1).all()
    assert not a[4:].any()
    assert np.isfinite(energy(system, position))


def test_stiffness_never_exceeds_k() -> None:
    """The second derivative along the angle is k cos(angle - rest)."""
    quads, k, h = np.array([[0, 1, 2, 3]], np.int32), 2.0, 1e-4
    for angle in np.linspace(-3.0, 3.0, 13):
        stored = []
        for turned in (angle - h, angle, angle + h):
            x = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, -np.cos(turned), np.sin(turned)]])
            system = make_system(make_fabric(x, hinges=make_hinges(quads, np.array([k]), np.array([0.4]))))
            stored.append(energy(system, x))
        second = (stored[0] - 2 * stored[1] + stored[2]) / h**2
        assert abs(second - k * np.cos(angle - 0.4)) < 1e-6
