"""XPBD on bodies: depth, friction and bindings, and forces that are no constraint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contact_world import G, contact_for, geometry, move, plane
from nets import make_fabric, make_system, start
from xpbd_nets import DOWN, POSES, STILL, advance, chain, sheet

from nuno_integrators.implicit.plugin import ImplicitEuler
from nuno_integrators.xpbd import XPBD
from nuno_schemas.bodies import Poses
from nuno_schemas.system import Carried, Term


@pytest.mark.parametrize("iterations", [1, 8])
@pytest.mark.parametrize("dt", [1e-3, 1.0 / 60.0])
def test_a_vertex_at_rest_sinks_m_g_over_k_at_any_step(dt, iterations):
    contact = contact_for(geometry(plane()), np.array([1e-2]), 1e4)
    move(contact, 1.0)
    fabric = make_fabric(np.array([[0.0, 1e-3, 0.0]]), mass=1e-2)
    system = make_system(fabric, DOWN, 20.0, (Term("contact", (contact,)),))
    state = advance(system, int(1.0 / dt), dt, POSES, iterations=iterations)
    assert -state.x[0, 1] == pytest.approx(1e-2 * G / 1e4, rel=1e-9)


@pytest.mark.parametrize("share", [0.9, 1.2])
def test_an_incline_holds_or_lets_go_as_coulomb_says(share):
    mu, k, mass = 0.4, 1e5, 1e-2
    alpha = np.arctan(share * mu)
    contact = contact_for(geometry(plane(), friction=mu), np.array([mass]), k)
    move(contact, 1.0)
    gravity = G * np.array([np.sin(alpha), -np.cos(alpha), 0.0])
    fabric = make_fabric(np.array([[0.0, -mass * G * np.cos(alpha) / k, 0.0]]), mass=mass)
    system = make_system(fabric, gravity, terms=(Term("contact", (contact,)),))
    half, end = (advance(system, steps, 1.0 / 400, POSES).x[0] for steps in (200, 400))
    if share < 1.0:
        assert abs(end[0] - half[0]) < 1e-12
        assert end[0] < 1e-4
    else:
        assert end[0] == pytest.approx(0.5 * G * (np.sin(alpha) - mu * np.cos(alpha)), rel=0.01)
    assert end[1] == pytest.approx(-mass * G * np.cos(alpha) / k, rel=1e-6)


def draped(n):
    """A sheet that falls on a slope with friction."""
    fabric = replace(sheet(n), pinned=np.zeros(n * n, bool))
    fabric = replace(fabric, position=fabric.position[:, [0, 2, 1]] + np.array([0.0, 1e-3, 0.0]))
    shape = geometry(plane(normal=(0.1, 0.995, 0.0)), friction=0.4)
    contact = contact_for(shape, fabric.mass, 500.0)
    move(contact, 1.0)
    return make_system(fabric, DOWN, 0.7, (Term("contact", (contact,)),))


def test_contact_and_friction_are_solved_together_with_the_cloth():
    system = draped(8)
    poses = STILL, replace(STILL, t=0.08)
    ours = advance(system, 40, 2e-3, poses, iterations=300)
    exact = advance(system, 40, 2e-3, poses, plugin=ImplicitEuler(), residual=1e-10)
    assert (ours.x @ [0.1, 0.995, 0.0] < 0.0).sum() > 15, "it touches"
    assert np.abs(ours.x - exact.x).max() < 2e-8


def test_bound_vertices_end_where_their_body_is_and_pull_the_rest():
    fabric = chain(5, 1e3, 1e-2)
    local = fabric.position[:1].copy()
    carried = Carried(np.array([0], np.int32), local, np.array([0], np.int32))
    system = make_system(fabric, carried=(carried,))
    moved = Poses(0.5, np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0]]))
    state = advance(system, 500, 1e-3, (STILL, moved))
    np.testing.assert_allclose(state.x[0], [0.0, 1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(state.v[0], [0.0, 2.0, 0.0], atol=1e-14)
    assert state.x[-1, 1] > 0.2


def test_forces_without_constraint_state_their_limit_and_act():
    """A drag of 400 1/s written in Python: (1 - 400 h) a step, stable below 2 / 400 s."""

    def drag(x, v, t, out):
        out -= 400.0 * 1e-3 * v

    fabric = replace(chain(1, 1e7, 1e-3), velocity=np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    fabric = replace(fabric, springs=None)
    system = make_system(fabric, terms=(Term("python", drag),))
    limit = XPBD().limit(XPBD.Config(), system, start(system)).dt
    assert 0.9 * 2.0 / 400 < limit <= 2.0 / 400
    state = advance(system, 10, 1e-3)
    assert state.v[1, 0] == pytest.approx(0.6**10, rel=1e-12)
