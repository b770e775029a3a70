"""Spring and hinge forces: the formula, the energy, symmetries, equal results in every layout."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from nets import (
    accelerations,
    find_hinges,
    grid_springs,
    make_fabric,
    make_hinges,
    make_system,
    random_net,
    reference_forces,
    run,
    start,
    triangulate,
)

from nuno.simulation.start_checks import start_warnings
from nuno_integrators.explicit.fixed_step import SymplecticEuler
from nuno_integrators.packing import pack, to_rows
from nuno_kernels.forces.energy import measure_energy
from nuno_kernels.forces.hinges import HingeLists, HingeRuns
from nuno_kernels.forces.springs import SpringRuns
from nuno_kernels.step.blocks import BLOCK
from nuno_schemas.fabric import Fabric, Float, Hinges, Springs, State
from nuno_schemas.system import System
from nuno_wrinkle.edges import fold_angles


def shaken(position: Float, size: float, seed: int = 1) -> tuple[Float, Float]:
    rng = np.random.default_rng(seed)
    return position + size * rng.standard_normal(position.shape), rng.standard_normal(position.shape)


def as_pairs(springs: Springs, seed: int, spread: float = 0.0) -> Springs:
    """The same springs as a plain list in random order and with random direction."""
    rng = np.random.default_rng(seed)
    order = rng.permutation(springs.number)
    pairs = springs.pairs()[order]
    flip = rng.random(order.size) < 0.5
    pairs[flip] = pairs[flip][:, ::-1]
    k = springs.per_spring(springs.k)[order] * (1.0 + spread * rng.random(order.size))
    return Springs.from_pairs(pairs, k, springs.per_spring(springs.rest)[order], springs.per_spring(springs.c)[order])


@pytest.mark.parametrize("c", [0.0, 0.05])
@pytest.mark.parametrize("shape", [(5, 7), (9, 40), (3, 300), (70, 90)])
def test_runs_follow_the_formula(shape: tuple[int, int], c: float) -> None:
    position, springs = grid_springs(*shape, 0.01, c=c)
    x, v = shaken(position, 2e-3)
    expected = reference_forces(x, v, springs) / 1e-3
    a = accelerations(make_system(make_fabric(position, springs)), x, v)
    assert np.abs(a - expected).max() < 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("c", [0.0, 0.05])
@pytest.mark.parametrize("spread", [0.0, 0.3])
def test_any_net_follows_the_formula(c: float, spread: float) -> None:
    position, springs = grid_springs(60, 90, 0.01, c=c)
    assert position.shape[0] > BLOCK
    listed = as_pairs(springs, 3, spread)
    x, v = shaken(position, 2e-3)
    expected = reference_forces(x, v, listed) / 1e-3
    system = make_system(make_fabric(position, listed))
    packed = pack(system)
    (runs,) = (term for term in packed.forces if isinstance(term, SpringRuns))
    assert (runs.each is not None) == (spread > 0.0)
    assert np.abs(accelerations(system, x, v) - expected).max() < 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("c", [0.0, 0.05])
def test_irregular_net_follows_the_formula(c: float) -> None:
    position, springs = random_net(150, 3000, 5, c)
    x, v = shaken(position, 1e-2)
    expected = reference_forces(x, v, springs) / 1e-3
    a = accelerations(make_system(make_fabric(position, springs)), x, v)
    assert np.abs(a - expected).max() < 1e-12 * np.abs(expected).max()


def test_net_across_many_blocks_follows_the_formula() -> None:
    rng = np.random.default_rng(7)
    n = 2 * BLOCK + 100
    position = rng.uniform(0.0, 1.0, (n, 3))
    pairs = np.stack([rng.integers(0, n // 2, 4000), rng.integers(n // 2, n, 4000)], axis=1).astype(np.int32)
    one = np.ones(4000)
    springs = Springs.from_pairs(pairs, one, 0.3 * one, 0.1 * one)
    v = rng.standard_normal((n, 3))
    expected = reference_forces(position, v, springs)
    a = accelerations(make_system(make_fabric(position, springs, mass=1.0)), position, v)
    assert np.abs(a - expected).max() < 1e-12 * np.abs(expected).max()


def test_runs_with_other_strides_and_wrapping_rows() -> None:
    """A tube's closing springs: one per row, from the last column to the first."""
    rows, columns = 20, 24
    position, springs = grid_springs(rows, columns, 0.01)
    seam = Springs(
        np.array([[columns - 1, 0]], np.int32), np.array([rows], np.int32), np.array([columns], np.int32),
        np.array([50.0]), np.array([0.01]), np.array([0.02]), np.zeros(1, np.int8),
    )  # fmt: skip
    both = Springs.join([springs, seam])
    x, v = shaken(position, 1e-3)
    expected = reference_forces(x, v, both) / 1e-3
    a = accelerations(make_system(make_fabric(position, both)), x, v)
    assert np.abs(a - expected).max() < 1e-12 * np.abs(expected).max()


def test_force_is_minus_the_gradient_of_energy() -> None:
    position, springs = random_net(12, 40, 2)
    system = make_system(make_fabric(position, springs, mass=0.5), gravity=np.array([0.3, -9.81, 1.0]))
    packed, mass = pack(system), system.fabric.mass
    force = accelerations(system, position, 0 * position) * mass[:, None]

    def energy(x: Float) -> float:
        return measure_energy(to_rows(x), to_rows(0 * x), mass, packed).total

    h = 1e-5
    for vertex in range(12):
        for axis in range(3):
            ahead, behind = position.copy(), position.copy()
            ahead[vertex, axis] += h
            behind[vertex, axis] -= h
            slope = (energy(ahead) - energy(behind)) / (2 * h)
            assert abs(force[vertex, axis] + slope) < 1e-7 * np.abs(force).max()


def test_forces_keep_momentum_and_angular_momentum() -> None:
    position, springs = random_net(200, 2500, 4, c=0.2)
    x, v = shaken(position, 0.02)
    force = accelerations(make_system(make_fabric(position, springs, mass=1.0)), x, v)
    scale = np.abs(force).sum()
    assert np.abs(force.sum(axis=0)).max() < 1e-14 * scale
    assert np.abs(np.cross(x, force).sum(axis=0)).max() < 1e-14 * scale


def test_forces_turn_with_the_net() -> None:
    position, springs = random_net(50, 400, 6, c=0.2)
    x, v = shaken(position, 0.02)
    q, _ = np.linalg.qr(np.random.default_rng(8).standard_normal((3, 3)))
    system = make_system(make_fabric(position, springs, mass=1.0))
    there, here = accelerations(system, x @ q.T, v @ q.T), accelerations(system, x, v) @ q.T
    assert np.abs(there - here).max() < 1e-12 * np.abs(here).max()


def test_rigid_motion_is_not_damped() -> None:
    """Damping along the spring sees only the rate of its length."""
    position, springs = random_net(50, 400, 6, c=5.0)
    exact = Springs.from_pairs(
        springs.pairs(),
        springs.k,
        np.linalg.norm(np.diff(position[springs.pairs()], axis=1)[:, 0], axis=1),
        springs.c,
    )
    spin = np.array([1.0, -2.0, 0.5])
    v = np.cross(spin, position) + np.array([3.0, 2.0, 1.0])
    a = accelerations(make_system(make_fabric(position, exact, mass=1.0)), position, v)
    assert np.abs(a).max() < 1e-12


def test_rest_without_gravity_is_exactly_no_motion() -> None:
    position, springs = random_net(40, 300, 9)
    rest = np.sqrt(((position[springs.pairs()[:, 1]] - position[springs.pairs()[:, 0]]) ** 2).sum(axis=1))
    system = make_system(make_fabric(position, Springs.from_pairs(springs.pairs(), springs.k, rest, springs.c)))
    state = start(system)
    run(SymplecticEuler(), system, state, 50, 1e-3)
    assert state.x.tobytes() == position.tobytes()
    assert not state.v.any()


def test_springs_without_a_direction_are_warned_of_before_the_first_step() -> None:
    position = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0], [2, 0, 0], [2, 0, 0]])
    pairs, one = np.array([(0, 1), (1, 2), (2, 3), (3, 4)], np.int32), np.ones(4)
    rest = np.array([1.0, 0.5, 1.0, 0.0])  # the last is as long as it wants to be
    fabric = make_fabric(position, Springs.from_pairs(pairs, one, rest, one))
    (warning,) = start_warnings(fabric, position, None, None)
    assert warning.startswith("1 of 4 springs start") and "vertices 1 and 2" in warning
    (warning,) = start_warnings(replace(fabric, numbers=np.arange(10, 15, dtype=np.int32)), position, None, None)
    assert "vertices 11 and 12" in warning
    assert start_warnings(fabric, position + 0.1 * np.arange(5)[:, None], None, None) == []
    assert start_warnings(make_fabric(position), position, None, None) == []


def test_zero_length_springs_exert_no_force_and_are_counted() -> None:
    position = np.zeros((10, 3))
    position[8:, 0] = [0.0, 2.0]
    pairs = np.array([(i, i + 1) for i in range(9)], np.int32)
    one = np.ones(9)
    system = make_system(make_fabric(position, Springs.from_pairs(pairs, one, one, one), mass=1.0))
    a = accelerations(system, position, np.ones((10, 3)))
    assert np.isfinite(a).all()
    assert not a[:8].any()
    assert a[8, 0] == 1.0
    assert a[9, 0] == -1.0
    rows = to_rows(position)
    assert measure_energy(rows, rows, system.fabric.mass, pack(system)).zero_length == 8
    report = run(SymplecticEuler(), system, start(system), 1, 1e-3)
    assert report.status == "ok"
    assert report.counts["zero_length_springs"] == 7


def test_not_a_number_stays_visible() -> None:
    position, springs = grid_springs(6, 9, 0.01)
    x = position.copy()
    x[20, 1] = np.nan
    a = accelerations(make_system(make_fabric(position, springs)), x, 0 * x)
    assert np.isnan(a[20]).all()
    assert np.isnan(a[21]).all()
    system = make_system(make_fabric(x, springs))
    report = run(SymplecticEuler(), system, start(system), 1, 1e-5)
    assert report.status == "diverged"
    assert "vertex" in report.message


def result(fabric: Fabric) -> State:
    system = make_system(fabric, np.array([0.0, -9.81, 0.0]), 0.1)
    state = start(system)
    run(SymplecticEuler(), system, state, 20, 1e-4, frames=2)
    return state


def test_runs_and_pairs_agree_to_rounding() -> None:
    position, springs = grid_springs(40, 50, 0.01, c=0.01)
    x = shaken(position, 1e-3)[0]
    one = result(make_fabric(x, springs))
    two = result(make_fabric(x, as_pairs(springs, 4)))
    assert np.abs(one.x - two.x).max() < 1e-13


@pytest.mark.parametrize("c", [0.0, 0.01])
def test_small_nets_have_the_same_forces_and_energy_by_lists(c: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer springs than are worth runs go through lists, whatever they have; velocity counts where it did."""
    position, springs = grid_springs(9, 12, 0.01, c=c)
    x, v = shaken(position, 1e-3)
    system, found = make_system(make_fabric(position, springs)), []
    for small in (springs.number + 1, springs.number):
        monkeypatch.setattr("nuno_kernels.step.blocks.SMALL", small)
        packed = pack(system)
        assert (not any(isinstance(term, SpringRuns) for term in packed.forces)) == (small > springs.number)
        assert packed.velocity_matters == (c > 0.0)
        energy = measure_energy(to_rows(x), to_rows(v), system.fabric.mass, packed).total
        found.append((accelerations(system, x, v), energy))
    assert np.abs(found[0][0] - found[1][0]).max() < 1e-13 * np.abs(found[1][0]).max()
    assert abs(found[0][1] / found[1][1] - 1.0) < 1e-13


def test_stretch_is_the_largest_relative_elongation() -> None:
    position, springs = grid_springs(8, 8, 0.01)
    x = position * np.array([1.25, 1.0, 1.0])
    system = make_system(make_fabric(position, springs))
    energy = measure_energy(to_rows(x), to_rows(0 * x), system.fabric.mass, pack(system))
    assert abs(energy.stretch - 0.25) < 1e-12


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
def test_hinges_force_is_minus_the_gradient_of_energy(size: float) -> None:
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


def test_hinges_forces_keep_momentum_and_angular_momentum() -> None:
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
