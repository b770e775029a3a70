"""Bending of any mesh of triangles: a plate of the measured rigidities, against closed forms of plates."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.sparse
import scipy.sparse.linalg
from energies import bending_energy
from nets import make_system
from triangle_sheets import KINDS, matrix, plate, square

from nuno.simulation.cloth import join_fabrics
from nuno_cloth.fabrics.presets import Material
from nuno_cloth.models.bending import build_bending
from nuno_cloth.models.triangles import yarn_axes
from nuno_integrators.implicit.conjugate import multiply
from nuno_integrators.implicit.matrix import fill, make_linear
from nuno_integrators.packing import pack, to_rows
from nuno_kernels.forces.energy import measure_energy
from nuno_kernels.step.acceleration import evaluate
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float

PLATE = Material(0.1, 1e3, 1e3, 1e2, 2e-5, 1e-5)
ISOTROPIC = replace(PLATE, bend_warp=1e-5)
FREE_SQUARE = np.array([13.468, 19.596, 24.270])
"""Frequencies of a free square plate, omega a^2 sqrt(rho / B), nu = 0.3 (Leissa 1973, J. Sound Vib. 31, 257-293)."""


def crumpled(fabric: Fabric) -> Float:
    return np.asarray(fabric.position + np.random.default_rng(1).normal(0.0, 1e-2, fabric.position.shape))


def force(fabric: Fabric, x: Float) -> Float:
    a = np.zeros((3, fabric.number))
    evaluate(to_rows(x), np.zeros_like(a), 0.0, a, pack(make_system(fabric)))
    return np.asarray(fabric.mass[:, None] * a.T)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("angle", [0.0, 30.0, 90.0])
def test_constant_curvature_stores_what_was_measured(kind: str, angle: float) -> None:
    """On any mesh and along any direction: (B_w k_w^2 + B_f k_f^2 + 2 B_1 k_w k_f + 4 B_t k_t^2) / 2 per area."""
    material = replace(PLATE, bend_poisson=0.2, bend_bias=1.6e-5)
    points, faces = square(kind, 8)
    cloth = plate(points, faces, material, angle)
    for k_x, k_y, k_xy in ((1e-3, 0.0, 0.0), (0.0, 1e-3, 0.0), (1e-3, -2e-3, 5e-4)):
        x = cloth.position.copy()
        x[:, 2] = 0.5 * k_x * x[:, 0] ** 2 + 0.5 * k_y * x[:, 1] ** 2 + k_xy * x[:, 0] * x[:, 1]
        c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        warp, weft = np.array([c, s]), np.array([-s, c])
        tensor = np.array([[k_x, k_xy], [k_xy, k_y]])
        k_w, k_f, k_t = warp @ tensor @ warp, weft @ tensor @ weft, warp @ tensor @ weft
        both = 0.2 * np.sqrt(material.bend_warp * material.bend_weft)
        expected = material.bend_warp * k_w**2 + material.bend_weft * k_f**2 + 2.0 * both * k_w * k_f
        expected += 4.0 * material.bend_twist * k_t**2
        assert 2.0 * bending_energy(cloth, x)[0] == pytest.approx(expected, rel=1e-8)


def test_a_strip_along_the_bias_is_as_stiff_as_was_measured() -> None:
    """Bent by a moment along it alone, a plate has the curvature S M, its compliance S along the strip's axes."""
    for bias in (1.0e-5, 1.6e-5):
        material = replace(PLATE, bend_poisson=0.1, bend_bias=bias)
        both = 0.1 * np.sqrt(material.bend_warp * material.bend_weft)
        rigidity = np.array([[material.bend_warp, both, 0], [both, material.bend_weft, 0], [0, 0, material.bend_twist]])
        moment = np.array([0.5, 0.5, 0.5])  # of warp, weft and twist, for one along the diagonal
        curvature = np.linalg.solve(rigidity, moment)
        assert moment @ curvature == pytest.approx(1.0 / bias, rel=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_a_free_plate_swings_as_plates_do(kind: str) -> None:
    """The three lowest frequencies, squared: within 6 % at 12 edges a side and 2 % at 24, on any mesh."""
    material = replace(ISOTROPIC, bend_poisson=0.3)
    expected = FREE_SQUARE**2 * material.bend_warp / material.density
    errors = []
    for n in (7, 13, 25):
        cloth = plate(*square(kind, n), material)
        stiffness, mass = matrix(cloth), scipy.sparse.diags(cloth.mass)
        shift = -1e-3 * expected[0]
        found = scipy.sparse.linalg.eigsh(stiffness, k=6, M=mass, sigma=shift, return_eigenvectors=False)
        rigid, found = np.split(np.sort(found), [3])
        assert np.abs(rigid).max() < 1e-6 * expected[0]
        errors.append(np.abs(found / expected - 1.0).max())
    assert errors[1] < 0.06 and errors[2] < 0.02
    assert errors[2] < 0.5 * errors[1] + 0.001 and errors[2] < 0.3 * errors[0]


def test_motion_and_even_strain_cost_nothing() -> None:
    cloth = plate(*square("irregular", 8), PLATE)
    x = cloth.position @ np.array([[0.9, 0.3, -0.1], [0.2, 1.1, 0.4], [0.0, 0.0, 1.0]]) + [1.0, 2.0, 3.0]
    strongest = np.abs(force(cloth, crumpled(cloth))).max()
    assert np.abs(force(cloth, x)).max() < 1e-12 * strongest


def test_a_folded_piece_is_laid_open_across_its_edge() -> None:
    """A strip that lies folded flat onto itself bends, laid open, as the flat one does."""
    points, faces = square("diagonal", 9)
    flat = plate(points, faces, PLATE)
    folded = flat.position.copy()
    beyond = folded[:, 0] > 0.5
    folded[beyond, 0] = 1.0 - folded[beyond, 0]
    axes = yarn_axes(folded[faces], np.array([0.0, 1.0, 0.0]))
    bending = build_bending(PLATE, folded[faces], faces, *axes, np.zeros(len(folded), bool))
    assert bending is not None and flat.bending is not None
    np.testing.assert_array_equal(bending.pairs, flat.bending.pairs)
    np.testing.assert_allclose(bending.weight, flat.bending.weight, atol=1e-9 * np.abs(flat.bending.weight).max())


@pytest.mark.parametrize(("warp", "instead"), [
    ([0.0, 1.0, 0.0], [0.0, 0.0, 1.0]), ([0.03, -2.0, 0.02], [0.0, 0.0, 1.0]), ([0.0, 1e-9, 1.0], [0.0, 1.0, 0.0]),
    ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
])  # fmt: skip
def test_cloth_that_its_warp_is_normal_to_has_another_axis(warp: list[float], instead: list[float]) -> None:
    """However its triangles are numbered, all yarns go one way, in level cloth that is not quite flat, too."""
    x, faces = square("irregular", 6)
    normal, other = np.array(warp) / np.linalg.norm(warp), np.array(instead)
    third = np.cross(other, normal)
    rough = np.random.default_rng(0).uniform(-1e-3, 1e-3, len(x))
    laid = x[:, :1] * other + x[:, 1:2] * third + rough[:, None] * normal
    for order in range(3):
        found = yarn_axes(laid[np.roll(faces, order, axis=1)], np.array(warp))
        assert np.abs(found[0] @ other).min() > 0.99 and np.sign(found[0] @ other).min() > 0.0


def test_the_force_is_the_gradient_of_the_energy_in_kernels_and_in_the_check() -> None:
    cloth = plate(*square("irregular", 8), PLATE)
    x, way = crumpled(cloth), np.random.default_rng(2).standard_normal(cloth.position.shape)
    energy, gradient = bending_energy(cloth, x)
    rows = to_rows(x)
    packed = pack(make_system(cloth))
    assert measure_energy(rows, 0.0 * rows, cloth.mass, packed).kinds["bending"] == pytest.approx(energy, rel=1e-12)
    np.testing.assert_allclose(force(cloth, x), -gradient, atol=1e-12 * np.abs(gradient).max())
    slope = (bending_energy(cloth, x + 1e-3 * way)[0] - bending_energy(cloth, x - 1e-3 * way)[0]) / 2e-3
    assert (gradient * way).sum() == pytest.approx(slope, rel=1e-9)
    linear = make_linear(packed)
    linear.own[...] = 0.0
    fill(rows, 0.0, packed, linear)
    expected = force(cloth, x) - force(cloth, x + way)
    np.testing.assert_allclose(multiply(linear, to_rows(way), None).T, expected, atol=1e-10 * np.abs(expected).max())


def test_large_pieces_have_the_same_forces_on_any_number_of_threads() -> None:
    cloth = plate(*square("irregular", 70), PLATE)
    x, found = crumpled(cloth), []
    for threads in (1, 2):
        a = np.zeros((3, cloth.number))
        evaluate(to_rows(x), np.zeros_like(a), 0.0, a, pack(make_system(cloth, threads=threads)))
        found.append(a)
    np.testing.assert_array_equal(*found)
    np.testing.assert_allclose(cloth.mass[:, None] * found[0].T, -bending_energy(cloth, x)[1], rtol=0, atol=1e-14)


def test_pieces_that_are_joined_keep_their_energy() -> None:
    cloth = plate(*square("irregular", 6), PLATE)
    both, x = join_fabrics([cloth, cloth], "both"), crumpled(cloth)
    energy = bending_energy(both, np.concatenate([x, cloth.position]))[0]
    assert energy == pytest.approx(bending_energy(cloth, x)[0], rel=1e-12)


@pytest.mark.parametrize("shape", ["two triangles", "a row", "a fan"])
def test_pieces_of_few_triangles_bend_and_move_freely(shape: str) -> None:
    points, faces = {
        "two triangles": (np.array([[0.0, 0], [1, 0], [0, 1], [1, 1]]), [[0, 1, 2], [1, 3, 2]]),
        "a row": (np.array([[0.0, 0], [1, 0], [2, 0], [3, 0], [0, 1], [1, 1], [2, 1], [3, 1]]),
                  [[0, 1, 4], [1, 5, 4], [1, 2, 5], [2, 6, 5], [2, 3, 6], [3, 7, 6]]),
        "a fan": (np.array([[0.0, 0], [1, 0], [0, 1], [-1, 0], [0, -1]]), [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]]),
    }[shape]  # fmt: skip
    cloth = plate(points, np.array(faces, np.int32), PLATE)
    values = np.linalg.eigvalsh(matrix(cloth).toarray())
    assert np.abs(values[:3]).max() < 1e-12 * values[-1] and values[3] > 1e-3 * values[-1]


@pytest.mark.parametrize(("fields", "said"), [
    ({"bend_bias": 1.0}, "below"), ({"bend_bias": 0.0}, "above 0"), ({"bend_poisson": 1.0}, "less than 1"),
])  # fmt: skip
def test_a_bias_that_does_not_go_with_warp_and_weft_is_refused(fields: dict[str, Any], said: str) -> None:
    from nuno_cloth.fabrics.material import Measured

    with pytest.raises((BadInput, ValueError), match=said):
        Measured.model_validate({"preset": "denim"} | fields)
