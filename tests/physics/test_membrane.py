"""Triangles of constant strain: the force is the energy's gradient, the matrix its second derivative, for any mesh."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from nets import make_system

from nuno.plugin_contract import registry
from nuno.simulation.cloth import join_fabrics
from nuno_cloth.models.delaunay import fill_outline
from nuno_integrators.implicit.conjugate import multiply
from nuno_integrators.implicit.matrix import fill, make_linear
from nuno_integrators.packing import pack, to_rows
from nuno_kernels.forces.energy import measure_energy
from nuno_kernels.step.acceleration import evaluate
from nuno_schemas.fabric import Fabric, Float, Membrane, State

MODULI = np.array([400.0, 2000.0, 30.0, 50.0])
MASS = 1e-3


def make_piece(spacing: float = 0.02) -> Fabric:
    """An irregular piece of 10 cm, its warp along y."""
    corners = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]])
    sides = [corners[k - 1] + np.linspace(0.0, 1.0, 5, endpoint=False)[:, None] * (corners[k] - corners[k - 1])
             for k in (1, 2, 3, 0)]  # fmt: skip
    points, faces = fill_outline(np.concatenate(sides), spacing)
    edges = np.stack([points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]]], axis=2)
    inverse, number = np.linalg.inv(edges), len(faces)
    across, along = (np.ascontiguousarray(inverse[:, :, axis]) for axis in (0, 1))
    moduli = np.repeat(MODULI[:, None], number, axis=1)
    membrane = Membrane(faces, along, across, 0.5 * np.linalg.det(edges), moduli, np.zeros((3, number)))
    x, n = np.column_stack([points, np.zeros(len(points))]), len(points)
    return Fabric("piece", x, np.zeros((n, 3)), np.full(n, MASS), np.zeros(n, bool), faces, membrane=membrane)


def crumpled(piece: Fabric) -> Float:
    return np.asarray(piece.position + np.random.default_rng(1).normal(0.0, 2e-3, piece.position.shape))


def force(piece: Fabric, x: Float) -> Float:
    a = np.zeros((3, piece.number))
    evaluate(to_rows(x), np.zeros_like(a), 0.0, a, pack(make_system(piece)))
    return np.asarray(MASS * a.T)


def energy(piece: Fabric, x: Float) -> float:
    rows = to_rows(x)
    return measure_energy(rows, np.zeros_like(rows), piece.mass, pack(make_system(piece))).kinds["membrane"]


def test_the_force_is_the_gradient_of_the_energy() -> None:
    piece = make_piece()
    x, way = crumpled(piece), np.random.default_rng(2).standard_normal(piece.position.shape)
    slope = (energy(piece, x + 1e-6 * way) - energy(piece, x - 1e-6 * way)) / 2e-6
    found = force(piece, x)
    assert slope == pytest.approx(-(found * way).sum(), rel=1e-7)
    assert np.abs(found.sum(axis=0)).max() < 1e-12 * np.abs(found).sum()


@pytest.mark.parametrize("share", [1e-4, -1e-4])
def test_constant_strain_stores_what_the_moduli_say(share: float) -> None:
    """On an irregular mesh, strained by e_w, e_f and sheared by g."""
    piece = make_piece()
    x = piece.position @ np.array([[1.0 + 2.0 * share, 0.0, 0.0], [0.5 * share, 1.0 + share, 0.0], [0.0, 0.0, 1.0]])
    warp, weft, both, shear = MODULI
    e, f, g = np.hypot(1.0 + share, 0.5 * share) - 1.0, 2.0 * share, 0.5 * share * (1.0 + 2.0 * share)
    expected = 0.5e-2 * (warp * e * e + weft * f * f + 2.0 * both * e * f + shear * g * g)
    assert energy(piece, x) == pytest.approx(expected, rel=1e-9)


def test_the_matrix_is_the_second_derivative_and_positive_without_its_geometric_part() -> None:
    piece = make_piece()
    packed, x = pack(make_system(piece)), crumpled(piece)
    way, linear = np.random.default_rng(3).standard_normal(x.shape), make_linear(packed)
    linear.own[...] = 0.0
    fill(to_rows(x), 0.0, packed, linear, exact=True)
    expected = -(force(piece, x + 1e-7 * way) - force(piece, x - 1e-7 * way)) / 2e-7
    np.testing.assert_allclose(multiply(linear, to_rows(way), None).T, expected, atol=1e-8 * np.abs(expected).max())
    fill(to_rows(x), 0.0, packed, linear)
    units = np.eye(3 * piece.number).reshape(-1, piece.number, 3)
    matrix = np.array([multiply(linear, to_rows(unit), None).T.ravel() for unit in units])
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12 * np.abs(matrix).max())
    assert np.linalg.eigvalsh(matrix)[0] > -1e-12 * np.abs(matrix).max()


def stepped(solver: str, dt: float, steps: int, damping: float, **settings: Any) -> State:
    """A crumpled piece let go of, damped by so much of its moduli's [s]."""
    piece = make_piece()
    assert piece.membrane is not None
    lag = damping * np.repeat(MODULI[[0, 1, 3], None], piece.membrane.number, axis=1)
    piece = replace(piece, membrane=replace(piece.membrane, damping=lag))
    plugin, system = registry.load("nuno.integrators", solver), make_system(piece)
    state = State(crumpled(piece), np.zeros_like(piece.position))
    memory = plugin.prepare(plugin.Config(**settings), system, state)
    assert plugin.advance(system, state, memory, None, steps, dt).status == "ok"
    return state


def test_xpbd_comes_to_the_implicit_step_and_both_to_the_explicit_one() -> None:
    """Iterated, to that of the same length; implicit Euler as the step is halved, with order 1, damping included."""
    exact = stepped("rk4", 2e-6, 500, 1e-5).x
    errors = []
    for steps in (100, 200):
        implicit = stepped("implicit_euler", 1e-3 / steps, steps, 1e-5, residual=1e-10)
        swept = stepped("xpbd", 1e-3 / steps, steps, 1e-5, iterations=100)
        np.testing.assert_allclose(swept.x, implicit.x, atol=1e-8)
        errors.append(np.abs(implicit.x - exact).max())
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)


def test_damping_takes_energy() -> None:
    """Of a free piece, from rest, more than nothing and never any momentum."""
    piece = make_piece()
    left = [stepped("rk4", 5e-6, 400, damping) for damping in (0.0, 5e-5)]
    total = [energy(piece, state.x) + 0.5 * MASS * float((state.v**2).sum()) for state in left]
    begun = energy(piece, crumpled(piece))
    assert total[0] == pytest.approx(begun, rel=1e-4)
    assert total[1] < 0.9 * begun
    assert max(np.abs(state.v.sum(axis=0)).max() for state in left) < 1e-12 * np.abs(left[0].v).sum()


def test_pieces_that_are_joined_keep_their_energy() -> None:
    piece = make_piece()
    both = join_fabrics([piece, piece], "both")
    x = crumpled(piece)
    assert energy(both, np.concatenate([x, piece.position])) == pytest.approx(energy(piece, x), rel=1e-12)
