"""Coulomb friction with true sticking: incline, moving bodies, anchors that change frames."""

import numpy as np
import pytest
from contact_world import STILL, G, capsule, contact_for, fall, geometry, move, plane, points, settle

from nuno_contact.penalty.contact import add_contact
from nuno_contact.penalty.plugin import slip_speed

MU = 0.4


def slope(alpha):
    """Gravity in the frame of an incline of angle alpha that falls along +x."""
    return G * np.array([np.sin(alpha), -np.cos(alpha), 0.0])


def on_incline(alpha, k, mass, mu=MU):
    """A vertex at its rest depth on an incline, with its anchor set."""
    contact = contact_for(geometry(plane(), friction=mu), mass, k)
    x, v = points((0.0, -mass[0] * G * np.cos(alpha) / k, 0.0)), np.zeros((3, 1))
    settle(contact, x, v)
    return contact, x, v


def give(share, grip, k):
    """How far a vertex goes at most when a load of share * grip [N] is put on it at once.

    The friction spring stretches to grip / k and has then the energy (share - 1/2) grip^2 / k left,
    which sliding against (1 - share) grip takes away; a quasi-static load would stop at share.
    """
    return grip / k * (1.0 + (share - 0.5) / (1.0 - share))


@pytest.mark.quick(share=[0.99])
@pytest.mark.parametrize("share", [0.5, 0.9, 0.99])
def test_sticks_for_good_below_the_friction_angle(share):
    """It gives way once, because it is let go at once, then stands still: no creep in 20 s."""
    mass, k = np.array([1e-2]), 1e4
    alpha = np.arctan(share * MU)
    contact, x, v = on_incline(alpha, k, mass)
    fall(x, v, mass, slope(alpha), contact, 0.0, 0.0, 20000, 1e-4, np.zeros((3, 1)))
    rest = x.copy()
    assert 0.0 < x[0, 0] < give(share, MU * mass[0] * G * np.cos(alpha), k)
    fall(x, v, mass, slope(alpha), contact, 0.0, 0.0, 200000, 1e-4, np.zeros((3, 1)))
    np.testing.assert_allclose(x, rest, rtol=0.0, atol=1e-15)
    assert np.abs(v).max() < 1e-12


@pytest.mark.parametrize("share", [1.01, 1.5])
def test_slides_above_the_friction_angle_as_coulomb_says(share):
    """s = 1/2 g (sin a - mu cos a) t^2. The friction spring must first take up mu N / k, which
    a stiff contact does in no time: the error falls with 1/sqrt(k).
    """
    mass, alpha, duration = np.array([1e-2]), np.arctan(share * MU), 1.0
    expected = 0.5 * G * (np.sin(alpha) - MU * np.cos(alpha)) * duration**2
    errors = []
    for k, dt in ((1e4, 1e-4), (1e6, 1e-5)):
        contact, x, v = on_incline(alpha, k, mass)
        fall(x, v, mass, slope(alpha), contact, 0.0, 0.0, round(0.5 * duration / dt), dt, np.zeros((3, 1)))
        before = v[0, 0]
        fall(x, v, mass, slope(alpha), contact, 0.0, 0.0, round(0.5 * duration / dt), dt, np.zeros((3, 1)))
        assert v[0, 0] - before == pytest.approx(2.0 * expected / duration**2 * 0.5 * duration, rel=1e-8)
        errors.append(abs(x[0, 0] - expected))
    assert errors[1] < 0.15 * errors[0]
    assert errors[1] < 0.002


def test_a_conveyor_brings_a_point_to_its_speed():
    """It gains mu g a second until it moves along with the belt, then sticks to it."""
    mass, k, speed, dt = np.array([1e-2]), 1e5, 1.5, 2e-5
    contact = contact_for(geometry(plane(), friction=MU), mass, k)
    x, v = points((0.0, -mass[0] * G / k, 0.0)), np.zeros((3, 1))
    down = np.array([0.0, -G, 0.0])
    move(contact, 0.2, shift=(speed * 0.2, 0, 0))
    fall(x, v, mass, down, contact, 0.0, 1.0, 10000, dt, np.zeros((3, 1)))
    assert v[0, 0] == pytest.approx(MU * G * 0.2, rel=1e-3)
    for k in range(1, 4):
        move(contact, 0.2, shift=(speed * 0.2, 0, 0), start=(speed * 0.2 * k, 0, 0))
        fall(x, v, mass, down, contact, 0.0, 1.0, 10000, dt, np.zeros((3, 1)))
    np.testing.assert_allclose(v[:, 0], [speed, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("share", [0.9, 1.2])
def test_a_turntable_carries_a_point_while_friction_can_hold_it(share):
    """Sticking needs omega^2 r < mu g: below, the point circles at its radius; above, it leaves."""
    mass, k, radius, dt = np.array([1e-2]), 1e5, 0.3, 2e-5
    omega = np.sqrt(share * MU * G / radius)
    contact = contact_for(geometry(plane(), friction=MU), mass, k)
    x, v = points((radius, -mass[0] * G / k, 0.0)), points((0.0, 0.0, -omega * radius))
    settle(contact, x, v)
    frame_time = 0.02
    for k in range(50):
        before, after = (0.5 * omega * frame_time * i for i in (k, k + 1))
        turn0, turn = (np.array([np.cos(half), 0.0, np.sin(half), 0.0]) for half in (before, after))
        move(contact, frame_time, turn, turn0=turn0)
        fall(x, v, mass, np.array([0.0, -G, 0.0]), contact, 0.0, 1.0, 1000, dt, np.zeros((3, 1)))
    away = np.hypot(x[0, 0], x[2, 0])
    if share < 1.0:
        assert 0.0 < away - radius < give(share, MU * mass[0] * G, 1e5)
        angle = np.arctan2(-x[2, 0], x[0, 0]) - omega
        assert abs((angle + np.pi) % (2 * np.pi) - np.pi) < 1e-3
    else:
        assert away > 1.2 * radius


def test_an_anchor_passes_from_frame_to_frame_without_a_jump():
    """Two pieces of a body in frames that are turned and moved differently: a stuck vertex that
    goes from one to the other keeps its friction force.
    """
    mass, k = np.ones(1), 100.0
    turn = np.array([STILL, [0.6, 0.0, 0.8, 0.0]])
    shape = geometry(capsule((0, 0, -1), (0, 0, 1), 0.5), capsule((0, 0, 0), (0, 0, 0), 0.5, frame=1), friction=1e3)
    contact = contact_for(shape, mass, k)
    move(contact, 1.0, turn0=turn, start=[(0, 0, 0), (0, 0, 1.3)])
    v, force = np.zeros((3, 1)), np.zeros((3, 1))
    x = points((0.0, 0.45, 1.0))
    settle(contact, x, v)
    assert contact.anchor_frame[0, 0] == 0
    x[2] += 0.14
    add_contact(contact, x, v, 0.0, before := force.copy(), None)
    settle(contact, x, v)
    assert contact.anchor_frame[0, 0] == 0
    x[2] += 0.02
    add_contact(contact, x, v, 0.0, between := force.copy(), None)
    settle(contact, x, v)
    assert contact.anchor_frame[0, 0] == 1
    add_contact(contact, x, v, 0.0, after := force.copy(), None)
    np.testing.assert_allclose(after, between, atol=1e-12)
    assert abs(before[2, 0]) > 5.0


def test_friction_is_never_more_than_mu_times_the_normal_force():
    rng = np.random.default_rng(5)
    n = 400
    mass = np.ones(n)
    contact = contact_for(geometry(plane(), friction=MU), mass, 50.0)
    x, v = rng.normal(size=(3, n)) * 0.1, rng.normal(size=(3, n))
    for _ in range(5):
        settle(contact, x, v)
        x, v = x + 0.05 * rng.normal(size=(3, n)), rng.normal(size=(3, n))
        force = np.zeros((3, n))
        add_contact(contact, x, v, 0.0, force, None)
        assert (force[1] >= 0.0).all()
        tangential = np.hypot(force[0], force[2])
        assert (tangential <= MU * force[1] * (1.0 + 1e-12)).all()
        assert (tangential > 0.99 * MU * force[1]).sum() > 100


def test_leaving_the_body_drops_the_anchor():
    mass = np.ones(1)
    contact = contact_for(geometry(plane(), friction=MU), mass, 50.0)
    v = np.zeros((3, 1))
    settle(contact, points((0.0, -0.1, 0.0)), v)
    assert contact.anchor_frame[0, 0] == 0
    settle(contact, points((0.0, 1e-9, 0.0)), v)
    assert contact.anchor_frame[0, 0] == -1
    add_contact(contact, points((0.2, -0.1, 0.0)), v, 0.0, force := np.zeros((3, 1)), None)
    np.testing.assert_array_equal(force[:, 0], [0.0, 5.0, 0.0])


@pytest.mark.quick(damping=[0.0, 1.0])
@pytest.mark.parametrize("damping", [0.0, 0.3, 0.5, 1.0, 2.0])
def test_what_starts_to_slide_is_faster_than_coulomb_says_by_no_more_than_is_said(damping):
    """Let go at rest on an incline: all of what is said where the pull is hardly more than friction, as it falls with
    1 / sqrt(k) at any step, and less under a stronger one.
    """
    mass, duration = np.array([1e-2]), 0.3
    for share, least in ((1.001, 0.98), (1.5, 0.2)):
        alpha = np.arctan(share * MU)
        weight = G * np.array([np.sin(alpha), -np.cos(alpha), 0.0])
        for k, dt in ((1e4, 1e-5), (1e4, 2e-6), (1e6, 2e-6)):
            contact = contact_for(geometry(plane(), friction=MU, damping=damping), mass, k)
            x, v = points((0.0, -mass[0] * G * np.cos(alpha) / k, 0.0)), np.zeros((3, 1))
            settle(contact, x, v)
            fall(x, v, mass, weight, contact, 0.0, 0.0, round(duration / dt), dt, np.zeros((3, 1)))
            gained = v[0, 0] - (weight[0] + MU * weight[1]) * duration
            said = slip_speed(damping) * MU * -weight[1] * np.sqrt(mass[0] / k)
            assert least * said < gained < 1.005 * said, (share, k, dt)


def test_what_turns_round_is_faster_by_twice_as_much():
    """Thrown up an incline it comes to rest with the friction spring drawn out the other way."""
    mass, k, speed, damping, duration, dt = np.array([1e-2]), 1e4, 0.5, 0.5, 0.3, 1e-5
    alpha = np.arctan(1.001 * MU)
    pull, grip = G * np.sin(alpha), MU * G * np.cos(alpha)
    contact = contact_for(geometry(plane(), friction=MU, damping=damping), mass, k)
    x, v = points((0.0, -mass[0] * G * np.cos(alpha) / k, 0.0)), points((-speed, 0.0, 0.0))
    settle(contact, x, v)
    fall(x, v, mass, slope(alpha), contact, 0.0, 0.0, round(duration / dt), dt, np.zeros((3, 1)))
    gained = v[0, 0] - (pull - grip) * (duration - speed / (pull + grip))
    assert gained == pytest.approx(2.0 * slip_speed(damping) * grip * np.sqrt(mass[0] / k), rel=0.02)
