"""The matrix that implicit methods solve with, and the method by which they solve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from implicit_nets import dense, sheet
from nets import make_system

from nuno_integrators.implicit.conjugate import multiply, solve
from nuno_integrators.implicit.matrix import fill, make_linear
from nuno_integrators.packing import pack, to_rows
from nuno_kernels.step.acceleration import evaluate


@pytest.mark.quick(shuffle=[True])
@pytest.mark.parametrize("shuffle", [False, True])
def test_matrix_of_stretched_cloth_is_the_derivative_of_its_forces(shuffle, monkeypatch):
    monkeypatch.setattr("nuno_kernels.step.blocks.SMALL", 0)
    fabric = sheet(9, shuffle=shuffle)
    packed, rate = pack(make_system(fabric)), 200.0
    x = 1.02 * to_rows(fabric.position)
    linear = make_linear(packed)
    fill(x, rate, packed, linear)
    u = np.random.default_rng(1).standard_normal(x.shape) * ~fabric.pinned
    ahead, behind, v, e = np.empty_like(x), np.empty_like(x), np.zeros_like(x), 1e-7
    evaluate(x + e * u, v + e * rate * u, 0.0, ahead, packed, None)
    evaluate(x - e * u, v - e * rate * u, 0.0, behind, packed, None)
    expected = -fabric.mass * (ahead - behind) / (2.0 * e) * ~fabric.pinned
    np.testing.assert_allclose(multiply(linear, u, None), expected, atol=1e-8 * np.abs(expected).max())


@pytest.mark.quick(shuffle=[False])
@pytest.mark.parametrize("shuffle", [False, True])
def test_matrix_is_symmetric_and_never_negative_however_crumpled(shuffle, monkeypatch):
    monkeypatch.setattr("nuno_kernels.step.blocks.SMALL", 0)
    fabric = sheet(6, bend=1e-3 if not shuffle else 0.0, shuffle=shuffle)
    packed = pack(make_system(fabric))
    crumpled = to_rows(fabric.position) + 0.08 * np.random.default_rng(2).standard_normal((3, 36))
    linear = make_linear(packed)
    fill(crumpled, 100.0, packed, linear)
    free = np.tile(~fabric.pinned, 3)
    a = dense(linear, 36)[np.ix_(free, free)]
    np.testing.assert_allclose(a, a.T, atol=1e-10 * np.abs(a).max())
    assert np.linalg.eigvalsh(a).min() > -1e-10 * np.abs(a).max()


def test_flat_hinges_are_the_second_derivative_of_their_energy():
    """At the rest angle Gauss and Newton leave nothing out."""
    fabric = sheet(5, k=0.0, bend=1e-2)
    fabric = replace(fabric, springs=None, hinges=replace(fabric.hinges, rest=np.zeros(len(fabric.hinges.rest))))
    packed, x = pack(make_system(fabric)), to_rows(fabric.position)
    linear = make_linear(packed)
    fill(x, 1.0, packed, linear)
    u = np.random.default_rng(1).standard_normal(x.shape) * ~fabric.pinned
    ahead, behind, e = np.empty_like(x), np.empty_like(x), 1e-6
    evaluate(x + e * u, 0.0 * x, 0.0, ahead, packed, None)
    evaluate(x - e * u, 0.0 * x, 0.0, behind, packed, None)
    expected = -fabric.mass * (ahead - behind) / (2.0 * e) * ~fabric.pinned
    np.testing.assert_allclose(multiply(linear, u, None), expected, atol=1e-6 * np.abs(expected).max())


def test_conjugate_gradients_give_the_dense_solution():
    fabric = sheet(6)
    packed = pack(make_system(fabric))
    linear = make_linear(packed)
    linear.own[:3] = fabric.mass / 0.01**2
    fill(1.01 * to_rows(fabric.position), 100.0, packed, linear)
    free = np.tile(~fabric.pinned, 3)
    r = np.random.default_rng(0).standard_normal(3 * 36) * free
    expected = np.linalg.solve(dense(linear, 36)[np.ix_(free, free)], r[free])
    linear.r[...] = r.reshape(3, 36)
    iterations = solve(linear, 1e-12, 1000, None)
    assert iterations < 300
    np.testing.assert_allclose(linear.x.ravel()[free], expected, atol=1e-9 * np.abs(expected).max())
