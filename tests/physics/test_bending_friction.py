"""Friction of bent cloth: its loop of moment over curvature against closed forms, on any mesh, in any direction."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from nets import make_system
from triangle_sheets import KINDS, square

from nuno.plugin_contract import registry
from nuno.simulation.cloth import join_fabrics
from nuno_cloth.fabrics.material import Measured
from nuno_cloth.fabrics.presets import Material
from nuno_cloth.models.bending_friction import SLIP, build_friction
from nuno_cloth.models.triangles import yarn_axes
from nuno_integrators.compiled import Compiled
from nuno_integrators.implicit.conjugate import multiply
from nuno_integrators.implicit.matrix import fill, make_linear
from nuno_integrators.packing import pack, to_rows
from nuno_integrators.stability import measure_rates
from nuno_kernels.forces.energy import measure_energy
from nuno_kernels.step.acceleration import Packed, evaluate
from nuno_kernels.terms import kernels_of
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.vectors import face_areas

HB = np.array([3e-4, 1e-4])
SIDE = 0.02
MATERIAL = Material(0.1, 1e3, 1e3, 1e2, 1e-5, 1e-5, hysteresis_warp=2.0 * HB[0], hysteresis_weft=2.0 * HB[1])


def piece(kind: str, n: int, angle: float = 0.0, material: Material = MATERIAL) -> Fabric:
    """2 cm x 2 cm whose warp makes an angle [degrees] with x; of friction alone."""
    points, faces = square(kind, n)
    x, turn = np.column_stack([SIDE * (points - 0.5), np.zeros(len(points))]), np.radians(angle)
    axes = yarn_axes(x[faces], np.array([np.cos(turn), np.sin(turn), 0.0]))
    share = np.repeat(face_areas(x[faces]) * material.density / 3, 3)
    mass = np.bincount(faces.reshape(-1), share, len(x)).astype(np.float64)
    friction = build_friction(material, x[faces], faces, *axes, np.zeros(len(x), bool))
    return Fabric("piece", x, 0.0 * x, mass, np.zeros(len(x), bool), faces, friction=friction)


def rolled(cloth: Fabric, curvature: float) -> Float:
    """On a cylinder round y."""
    x = cloth.position.copy()
    if curvature:
        x[:, 0], x[:, 2] = np.sin(curvature * x[:, 0]) / curvature, (1 - np.cos(curvature * x[:, 0])) / curvature
    return x


def force(cloth: Fabric, packed: Packed, x: Float) -> Float:
    a = np.zeros((3, cloth.number))
    evaluate(to_rows(x), np.zeros_like(a), 0.0, a, packed)
    return np.asarray(cloth.mass[:, None] * a.T)


def settle(packed: Packed, x: Float) -> None:
    terms = [term for term in packed.bodies if kernels_of(term).name == "bending_friction"]
    assert len(terms) == 1
    kernels_of(terms[0]).find("settle")(terms[0], to_rows(x), to_rows(0.0 * x), 1.0, None)


def loop(cloth: Fabric, path: Float) -> tuple[Float, Packed]:
    """Moments per width along a path of curvatures: work of each step over its area and change of curvature."""
    packed, moments = pack(make_system(cloth)), []
    area = face_areas(cloth.position[cloth.faces]).sum()
    for before, after in itertools.pairwise(path):
        middle = force(cloth, packed, rolled(cloth, 0.5 * (before + after)))
        way = rolled(cloth, after) - rolled(cloth, before)
        moments.append(-(middle * way).sum() / (after - before) / area)
        settle(packed, rolled(cloth, after))
    return np.array(moments), packed


@pytest.mark.parametrize("kind", KINDS)
def test_the_loop_is_as_wide_as_was_measured_and_takes_the_work(kind: str) -> None:
    """Along the warp: HB on the way there, -HB on the way back, 4 HB (k_max - k_s) for a cycle, within 1 %."""
    cloth, most = piece(kind, 25), 100.0
    up, down = np.linspace(-most, most, 401), np.linspace(most, -most, 401)
    path = np.concatenate([np.linspace(0.0, -most, 101), up[1:], down[1:]])
    moments, _ = loop(cloth, path)
    middle = 0.5 * (path[1:] + path[:-1])
    flat, rising = np.abs(middle) < 40.0, np.diff(path) > 0.0
    np.testing.assert_allclose(moments[100:][(flat & rising)[100:]], HB[0], rtol=0.01)
    np.testing.assert_allclose(moments[100:][(flat & ~rising)[100:]], -HB[0], rtol=0.01)
    work = (moments * np.diff(path))[100:].sum()
    assert work == pytest.approx(4.0 * HB[0] * (most - SLIP), rel=0.01)


@pytest.mark.parametrize(("angle", "expected"), [(0.0, HB[0]), (90.0, HB[1]), (45.0, None)])
def test_each_direction_has_its_own(angle: float, expected: float | None) -> None:
    """At 45 degrees e = (1, 1, 1) / 2, and the moment (H_w + H_f + 2 H_t) / 4, H_t their geometric mean."""
    expected = expected or 0.25 * (np.sqrt(HB[0]) + np.sqrt(HB[1])) ** 2
    moments, _ = loop(piece("irregular", 25, angle), np.linspace(0.0, 20.0, 81))
    assert moments[-1] == pytest.approx(expected, rel=0.01)


def test_below_its_slip_it_is_an_elastic_plate() -> None:
    """And then stores what the work was, to the last digits, and gives it back."""
    cloth = piece("irregular", 15)
    packed = pack(make_system(cloth))
    x = rolled(cloth, 0.5 * SLIP)
    rows = to_rows(x)
    stored = measure_energy(rows, 0.0 * rows, cloth.mass, packed).kinds["bending_friction"]
    area = face_areas(cloth.position[cloth.faces]).sum()
    assert stored == pytest.approx(0.5 * HB[0] / SLIP * (0.5 * SLIP) ** 2 * area, rel=1e-3)
    settle(packed, x)
    assert np.abs(force(cloth, packed, cloth.position)).max() == 0.0


@pytest.mark.parametrize("kind", KINDS)
def test_its_force_is_a_gradient_without_momentum(kind: str) -> None:
    """Of what it stores while nothing slips, however crumpled; and of m held where all slips it has no momentum."""
    cloth = piece(kind, 9)
    random = np.random.default_rng(1)
    packed = pack(make_system(cloth))
    x = np.asarray(rolled(cloth, 40.0) + random.normal(0.0, 1e-4, cloth.position.shape))
    found = force(cloth, packed, x)
    assert np.abs(found).max() > 0.0
    assert np.abs(found.sum(axis=0)).max() < 1e-12 * np.abs(found).sum()
    turning = np.cross(x, found)
    assert np.abs(turning.sum(axis=0)).max() < 1e-10 * np.abs(turning).sum()
    (term,) = (term for term in packed.forces if kernels_of(term).name == "bending_friction")
    kernels_of(term).find("stick")(term, to_rows(x))
    base, way = x + random.normal(0.0, 1e-8, x.shape), random.normal(0.0, 1.0, x.shape)

    def energy(at: Float) -> float:
        rows = to_rows(at)
        return measure_energy(rows, 0.0 * rows, cloth.mass, packed).kinds["bending_friction"]

    slope = (energy(base + 1e-9 * way) - energy(base - 1e-9 * way)) / 2e-9
    assert -(force(cloth, packed, base) * way).sum() == pytest.approx(slope, rel=1e-5)


def test_its_matrix_is_its_derivative_where_it_holds_and_flat() -> None:
    cloth = piece("irregular", 9)
    packed, way = pack(make_system(cloth)), np.random.default_rng(3).normal(0.0, 1.0, cloth.position.shape)
    linear = make_linear(packed)
    linear.own[...] = 0.0
    fill(to_rows(cloth.position), 0.0, packed, linear)
    before, after = (force(cloth, packed, cloth.position + size * way) for size in (-1e-10, 1e-10))
    expected = (before - after) / 2e-10
    np.testing.assert_allclose(multiply(linear, to_rows(way), None).T, expected, atol=1e-6 * np.abs(expected).max())
    units = np.eye(3 * cloth.number).reshape(-1, cloth.number, 3)
    matrix = np.array([multiply(linear, to_rows(unit), None).T.ravel() for unit in units])
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12 * np.abs(matrix).max())
    assert np.linalg.eigvalsh(matrix)[0] > -1e-12 * np.abs(matrix).max()


def test_what_slips_counts_as_if_it_held_in_the_limit_of_a_step() -> None:
    cloth = piece("irregular", 9)
    system = make_system(cloth)
    rates = [measure_rates(system, State(rolled(cloth, k), 0.0 * cloth.position))[0] for k in (0.0, 60.0)]
    assert rates[1] == pytest.approx(rates[0], rel=0.1)


def test_pieces_that_are_joined_have_the_same_forces() -> None:
    one, other = piece("irregular", 6), piece("diagonal", 5)
    both, x = join_fabrics([one, other], "both"), [rolled(one, 30.0), rolled(other, -20.0)]
    found = force(both, pack(make_system(both)), np.concatenate(x))
    for cloth, at, part in zip((one, other), x, (found[: one.number], found[one.number :]), strict=True):
        alone = force(cloth, pack(make_system(cloth)), at)
        np.testing.assert_allclose(part, alone, rtol=0, atol=1e-12 * np.abs(alone).max())


def swung(solver: str, steps: int, **settings: Any) -> tuple[State, Float]:
    """A curled piece, bending and friction, let go of for 20 ms; what its friction remembers."""
    from triangle_sheets import plate

    flat = piece("irregular", 7)
    cloth = replace(flat, bending=plate(flat.position, flat.faces, MATERIAL, 0.0).bending)
    plugin, system = registry.load("nuno.integrators", solver), make_system(cloth)
    state = State(rolled(cloth, 40.0), 0.0 * cloth.position)
    memory = plugin.prepare(plugin.Config(**settings), system, state)
    assert plugin.advance(system, state, memory, None, steps, 0.02 / steps).status == "ok"
    (kept,) = (array for name, array in memory.arrays.items() if "rested" in name)
    return state, kept


@pytest.mark.full
def test_all_solvers_come_to_the_same_and_remember_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Friction found at every stage of tiny steps is what all others come to: implicit ones as they are shortened, and
    explicit ones that hold it meanwhile, to 1 % of the way.
    """
    with monkeypatch.context() as patch:
        patch.setattr(Compiled, "holds", False)
        exact, kept = swung("rk4", 20000)
    assert np.abs(kept).max() > SLIP
    way = np.abs(exact.x - rolled(piece("irregular", 7), 40.0)).max()

    def error(solver: str, steps: int, **settings: Any) -> float:
        state, own = swung(solver, steps, **settings)
        assert np.abs(own).max() > SLIP
        return float(np.abs(state.x - exact.x).max() / way)

    for solver in ("rk4", "leapfrog", "xpbd"):
        assert error(solver, 20000) < 0.01
    coarse, fine = (error("implicit_euler", steps, residual=1e-8) for steps in (500, 4000))
    assert fine < 0.04 and fine < 0.4 * coarse


@pytest.mark.quick(solver=["symplectic_euler"])
@pytest.mark.parametrize("solver", ["symplectic_euler", "leapfrog", "rk4", "dopri5"])
def test_friction_that_is_held_does_not_feed_a_swing(solver: str) -> None:
    """Far below its slip a piece rings on and gains nothing."""
    cloth = piece("irregular", 7)
    plugin, system = registry.load("nuno.integrators", solver), make_system(cloth)
    state = State(rolled(cloth, 0.01 * SLIP), 0.0 * cloth.position)
    memory = plugin.prepare(plugin.Config(), system, state)
    omega, _ = measure_rates(system, state)
    totals = []
    for _ in range(60):
        report = plugin.advance(system, state, memory, None, 100, 0.05 / omega)
        assert report.status == "ok"
        totals.append(report.energy["kinetic"] + report.energy["bending_friction"])
    assert max(totals) < 1.01 * totals[0] and totals[-1] > 0.5 * totals[0]


def test_cloth_that_is_held_all_over_has_none() -> None:
    points, faces = square("diagonal", 3)
    x = np.column_stack([SIDE * points, np.zeros(len(points))])
    axes = yarn_axes(x[faces], np.array([1.0, 0.0, 0.0]))
    assert build_friction(MATERIAL, x[faces], faces, *axes, np.ones(len(x), bool)) is None


def test_a_loop_wider_than_bending_allows_is_refused() -> None:
    for fields, said in (({"hysteresis_warp": 0.1}, "at most"), ({"hysteresis_weft": -1.0}, "greater than or equal")):
        with pytest.raises(ValueError, match=said):
            Measured.model_validate({"preset": "denim"} | fields)
