"""Penalty contact: depth, restitution, unions, Coulomb friction with true sticking, equal bytes."""

import numba
import numpy as np
import pytest
from contact_world import STILL, G, box, capsule, contact_for, fall, geometry, move, plane, points, settle

from nuno_contact.penalty.contact import add_contact, commit_contact, count_contacts, limit_approach
from nuno_contact.penalty.plugin import Penalty, PenaltyConfig, slip_speed
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric

DOWN = np.array([0.0, -G, 0.0])


def force_on(contact, x, v=None, s=0.0):
    force = np.zeros_like(x)
    add_contact(contact, x, np.zeros_like(x) if v is None else v, s, force, None)
    return force


@pytest.mark.parametrize(
    ("shape", "height"),
    [
        (plane((0, 0.5, 0)), 0.5),
        (capsule((0, 0, 0), (0, 0, 0), 0.5), 0.5),
        (capsule((-1, 0.1, 0), (1, 0.1, 0), 0.4), 0.5),
        (box((0, 0, 0), (1, 0.5, 1)), 0.5),
    ],
    ids=["plane", "sphere", "capsule", "box"],
)
def test_rest_depth_is_weight_over_stiffness(shape, height):
    mass, k = np.array([2e-3]), 40.0
    contact = contact_for(geometry(shape), mass, k)
    x, v = points((0.0, height + 1e-3, 0.0)), np.zeros((3, 1))
    fall(x, v, mass, DOWN, contact, 0.0, 1.0, 20000, 1e-4, np.zeros((3, 1)))
    assert height - x[1, 0] == pytest.approx(mass[0] * G / k, rel=1e-9)
    assert np.abs(v).max() < 1e-12
    assert count_contacts(contact)["touching"] == 1


def restitution(zeta):
    """Of a point on a damped spring that cannot pull (Schwager & Poeschel 2007, zeta < 1/sqrt 2):
    e = exp(-zeta (pi - atan(2 zeta w / (1 - 2 zeta^2))) / w), w = sqrt(1 - zeta^2); it leaves where
    k depth = c speed, before the depth is 0.
    """
    w = np.sqrt(1.0 - zeta**2)
    return np.exp(-zeta / w * (np.pi - np.arctan2(2.0 * zeta * w, 1.0 - 2.0 * zeta**2)))


@pytest.mark.parametrize("speed", [1.0, 100.0])
@pytest.mark.parametrize("zeta", [0.1, 0.3, 0.6])
@pytest.mark.parametrize("body_moves", [False, True])
def test_impact_keeps_the_closed_form_share_of_its_speed(speed, zeta, body_moves):
    mass, k, duration = np.array([1e-3]), 1000.0, 0.02
    contact = contact_for(geometry(plane(), damping=zeta), mass, k)
    gap = 1e-3 * speed
    x, v = points((0.0, gap, 0.0)), np.zeros((3, 1))
    if body_moves:
        move(contact, duration, shift=(0.0, speed * duration, 0.0))
    else:
        v[1] = -speed
    fall(x, v, mass, np.zeros(3), contact, 0.0, 1.0, 40000, duration / 40000, np.zeros((3, 1)))
    relative = v[1, 0] - (speed if body_moves else 0.0)
    assert relative == pytest.approx(restitution(zeta) * speed, rel=2e-3)


@pytest.mark.parametrize("speed", [0.05, 0.1, 7.0])
def test_a_dashpot_sees_no_more_than_the_depth_gone_through_at_its_rate(speed):
    """k depth + c min(speed, rate depth): over a step of 1 / rate no more than the way inside of the body."""
    mass, k, depth, rate = np.array([2e-3]), 40.0, 1e-3, 100.0
    contact = contact_for(geometry(plane(), damping=0.3), mass, k)
    limit_approach(contact, rate)
    force = force_on(contact, points((0.0, -depth, 0.0)), points((0.0, -speed, 0.0)))
    damping = 0.6 * np.sqrt(k * mass[0])
    assert force[1, 0] == pytest.approx(k * depth + damping * min(speed, rate * depth), rel=1e-12)


def test_contact_never_pulls():
    mass = np.ones(1)
    contact = contact_for(geometry(plane(), friction=1.0, damping=2.0), mass, 100.0)
    x, v = points((0.0, -0.01, 0.0)), points((3.0, 50.0, 0.0))
    np.testing.assert_array_equal(force_on(contact, x, v), 0.0)


def test_overlapping_primitives_of_a_body_act_as_their_deepest():
    mass, shapes = np.ones(1), [capsule((0, 0, 0), (1, 0, 0), 0.5), capsule((0.4, -0.1, 0), (0.5, -0.1, 0), 0.55)]
    x = points((0.45, 0.42, 0.1))
    alone = [force_on(contact_for(geometry(shape), mass, 10.0), x) for shape in shapes]
    assert np.linalg.norm(alone[0]) > np.linalg.norm(alone[1]) > 0.0
    for order in (shapes, shapes[::-1]):
        np.testing.assert_array_equal(force_on(contact_for(geometry(*order), mass, 10.0), x), alone[0])


def test_different_bodies_add_up():
    mass = np.ones(1)
    shapes = [plane(), plane((0, 0, 0), (1, 0, 0))]
    x = points((-0.01, -0.02, 0.0))
    both = geometry(shapes[0], (*shapes[1][:2], 1, *shapes[1][3:]))
    np.testing.assert_allclose(force_on(contact_for(both, mass, 100.0), x)[:, 0], [1.0, 2.0, 0.0], rtol=1e-15)


def test_points_on_the_axis_are_pushed_out_and_counted():
    contact = contact_for(
        geometry(capsule((0, 0, 0), (1, 0, 0), 0.1), capsule((5, 0, 0), (5, 0, 0), 0.1)), np.ones(3), 7.0
    )
    force = force_on(contact, points((0.5, 0, 0), (5, 0, 0), (0.5, 0.05, 0)))
    np.testing.assert_allclose(np.linalg.norm(force, axis=0), [0.7, 0.7, 0.35], rtol=1e-12)
    assert count_contacts(contact)["on_capsule_axis"] == 2


def crowd(n, seed=0):
    """Vertices in and round a small body of every kind of primitive, which moves and turns."""
    rng = np.random.default_rng(seed)
    mass = rng.uniform(0.5, 2.0, n)
    shape = geometry(
        capsule((-1, 0, 0), (1, 0.2, 0), 0.4), capsule((0, 0, 0.8), (0, 0, 0.8), 0.3, frame=1),
        box((0.5, -0.6, 0), (0.4, 0.2, 0.5), frame=1, body=1), plane((0, -1, 0), (0.1, 1, 0), frame=0, body=1),
        friction=0.4,
    )  # fmt: skip
    contact = contact_for(shape, mass, 50.0 * mass)
    turn = np.array([[0.99, 0.1, 0.0, 0.05], [0.98, 0.0, -0.1, 0.1]])
    move(contact, 0.1, turn / np.linalg.norm(turn, axis=1, keepdims=True), shift=rng.normal(size=(2, 3)) * 0.1)
    x = rng.uniform(-1.5, 1.5, (3, n))
    return contact, x[:, np.argsort(x[0])].copy(), rng.normal(size=(3, n)), mass


def test_skipping_distant_primitives_changes_no_bit():
    """Sorted vertices make tight blocks, most of them skipped; shuffled ones make blocks as wide as
    the scene, none of them skipped: every vertex must get the same bits.
    """
    n = 5000
    contact, x, v, _ = crowd(n)
    order = np.random.default_rng(3).permutation(n)
    shuffled, *_ = crowd(n)
    shuffled.stiffness[:], shuffled.damping[:] = contact.stiffness[:, order], contact.damping[:, order]
    y, w = x[:, order].copy(), v[:, order].copy()
    for _ in range(3):
        force, other = force_on(contact, x, v, 0.5), force_on(shuffled, y, w, 0.5)
        assert force[:, order].tobytes() == other.tobytes()
        assert (np.abs(force).sum(axis=0) > 0.0).sum() > 500
        commit_contact(contact, x, v, 0.5, None)
        commit_contact(shuffled, y, w, 0.5, None)
        assert contact.anchor_frame[:, order].tobytes() == shuffled.anchor_frame.tobytes()
        x += 0.01 * v
        y += 0.01 * w


@pytest.mark.parametrize("threads", [1, 2])
def test_any_number_of_threads_gives_equal_bytes(threads):
    if threads > numba.config.NUMBA_NUM_THREADS:
        pytest.skip(f"numba was started with fewer than {threads} threads")
    serial, x, v, _ = crowd(3000)
    parallel, *_ = crowd(3000)
    before = numba.get_num_threads()
    numba.set_num_threads(threads)
    try:
        for s in (0.1, 0.6, 1.0):
            force = force_on(serial, x, v, s)
            other = np.zeros_like(x)
            add_contact(parallel, x, v, s, other, threads)
            assert np.abs(force).max() > 0.0
            assert force.tobytes() == other.tobytes()
            commit_contact(serial, x, v, s, None)
            commit_contact(parallel, x, v, s, threads)
            assert serial.anchor.tobytes() == parallel.anchor.tobytes()
            assert serial.anchor_frame.tobytes() == parallel.anchor_frame.tobytes()
            x += 0.02 * v
    finally:
        numba.set_num_threads(before)


def test_resuming_from_stored_anchors_ends_in_the_same_bits():
    def steps(contact, x, v, mass, s0, s1):
        fall(x, v, mass, DOWN, contact, s0, s1, 50, 1e-3, np.zeros_like(x))

    contact, x, v, mass = crowd(300)
    steps(contact, x, v, mass, 0.0, 0.5)
    stored = [a.copy() for a in (x, v, contact.anchor, contact.anchor_frame)]
    assert (contact.anchor_frame >= 0).sum() > 30
    steps(contact, x, v, mass, 0.5, 1.0)
    resumed, *_ = crowd(300)
    y, w, resumed.anchor[:], resumed.anchor_frame[:] = stored
    steps(resumed, y, w, mass, 0.5, 1.0)
    assert (x.tobytes(), v.tobytes()) == (y.tobytes(), w.tobytes())
    bare, *_ = crowd(300)
    y, w = stored[0].copy(), stored[1].copy()
    steps(bare, y, w, mass, 0.5, 1.0)
    assert x.tobytes() != y.tobytes()


def test_no_vertices_and_far_from_the_origin():
    contact = contact_for(geometry(plane()), np.zeros(0), 1.0)
    assert force_on(contact, np.zeros((3, 0))).shape == (3, 0)
    commit_contact(contact, np.zeros((3, 0)), np.zeros((3, 0)), 1.0, None)
    assert count_contacts(contact) == {"touching": 0, "on_capsule_axis": 0}
    far = contact_for(geometry(capsule((1e6, 0, 0), (1e6, 1, 0), 0.1)), np.ones(1), 10.0)
    np.testing.assert_allclose(force_on(far, points((1e6 + 0.05, 0.5, 0)))[:, 0], [0.5, 0.0, 0.0], atol=1e-8)


def fabric(mass, springs=None, pinned=None):
    n = mass.shape[0]
    return Fabric(
        "cloth", np.zeros((n, 3)), np.zeros((n, 3)), mass, np.zeros(n, bool) if pinned is None else pinned,
        np.zeros((0, 3), np.int32), springs,
    )  # fmt: skip


@pytest.mark.parametrize("gravity", [DOWN, np.zeros(3)])
def test_auto_stiffness_stops_an_arrival_and_rests_shallow(gravity):
    mass = np.array([1e-5, 4e-5])
    term = Penalty().prepare(PenaltyConfig(), fabric(mass), geometry(plane()), gravity)
    k = term.data[0].stiffness[0]
    assert (mass * G / k).max() <= 5e-4
    assert (1.0 * np.sqrt(mass / k)).max() <= 1e-3  # largest depth of an undamped stop from 1 m/s
    assert term.omega_squared == pytest.approx((k / mass).max(), rel=1e-15)
    assert term.damping_rate == pytest.approx(2 * 0.3 * np.sqrt((k / mass).max()), rel=1e-15)


def test_limits_add_over_bodies_and_leave_pinned_vertices_out():
    mass, pinned = np.array([1.0, 1e-3]), np.array([False, True])
    shape = geometry(plane(), plane(body=1), stiffness=100.0, damping=0.5)
    term = Penalty().prepare(PenaltyConfig(), fabric(mass, pinned=pinned), shape, DOWN)
    assert term.omega_squared == 200.0
    assert term.damping_rate == 20.0


def test_the_report_gets_the_fastest_start_to_slide_of_all_free_vertices_and_bodies():
    mass, pinned = np.array([1.0, 4.0, 100.0]), np.array([False, False, True])
    shape = geometry(plane(), plane(body=1), stiffness=100.0, damping=1.0)
    shape.friction[:] = 0.1, 0.3
    term = Penalty().prepare(PenaltyConfig(), fabric(mass, pinned=pinned), shape, DOWN)
    assert term.facts["slip_speed"] == pytest.approx(np.exp(-1.0) * 0.3 * G * np.sqrt(4.0 / 100.0), rel=1e-12)


@pytest.mark.parametrize(
    ("field", "value"), [("stiffness", 0.0), ("damping", -0.1), ("friction", -1.0), ("friction", np.nan)]
)
def test_constants_without_sense_are_refused(field, value):
    shape = geometry(plane(), **{field: value})
    with pytest.raises(BadInput, match=field):
        Penalty().prepare(PenaltyConfig(), fabric(np.ones(1)), shape, DOWN)


def test_poses_turn_at_constant_rate_with_the_velocity_of_that_motion():
    """A material point's velocity by differences of its pose is what damping sees: a point that
    moves with the body feels no damping.
    """
    mass, axis = np.ones(1), np.array([1.0, 2.0, -2.0]) / 3.0
    turn = np.concatenate([[np.cos(0.6)], np.sin(0.6) * axis])
    contact = contact_for(geometry(box((0, 0, 0), (1, 1, 1)), friction=1.0, damping=0.5), mass, 10.0)
    move(contact, 0.25, turn, shift=(0.3, 0.1, -0.2), turn0=STILL)

    def place(s):
        force_on(contact, np.zeros((3, 1)), s=s)
        f = contact.frames[0]
        return f[:9].reshape(3, 3) @ [0.9, 0.5, 0.4] + f[9:12], f[:9].reshape(3, 3)

    h, s = 1e-5, 0.37
    v = ((place(s + h)[0] - place(s - h)[0]) / (2 * h * 0.25))[:, None]
    x, matrix = place(s)
    np.testing.assert_allclose(force_on(contact, x[:, None].copy(), v, s)[:, 0], matrix @ [1.0, 0, 0], atol=1e-8)
    half = np.concatenate([[np.cos(0.3)], np.sin(0.3) * axis])
    _, matrix = place(0.5)
    np.testing.assert_allclose(matrix, np.stack([_rotate(half, e) for e in np.eye(3)], axis=1), atol=1e-15)


def _rotate(q, vector):
    return vector + 2.0 * np.cross(q[1:], np.cross(q[1:], vector) + q[0] * vector)


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


@pytest.mark.parametrize("shape", [plane(), capsule((0, -1, 0), (0, -1, 0), 1.0), box((0, -1, 0), (1, 1, 1))])
def test_triangles_keep_a_margin_and_points_beside_them_do_not(shape):
    """A millimetre off a body a triangle of 1 cm is pushed, and a point, or any with `margin: 0`, is not."""
    x = np.array([[0.0, 1e-3, 0.0], [0.01, 1e-3, 0.0], [0.0, 1e-3, 0.01], [0.05, 1.5e-3, 0.05]])
    fabric = Fabric("both", x, 0.0 * x, np.full(4, 1e-3), np.zeros(4, bool), np.array([[0, 1, 2]], np.int32))
    force = {}
    for margin in ("auto", 0.0, 5e-3):
        (contact,) = Penalty().prepare(PenaltyConfig(margin=margin), fabric, geometry(shape), DOWN).data
        move(contact, 1.0)
        force[margin] = force_on(contact, x.T.copy())[1]
    assert (force["auto"][:3] > 0.0).all() and force["auto"][3] == 0.0
    assert not force[0.0].any() and (force[5e-3] > 0.0).all()


@pytest.mark.parametrize("start", [(0.0, 0.3, -0.2), (0.0, 0.3, 0.0)])
def test_a_sphere_rests_on_a_capsule_at_the_sum_of_their_radii(start):
    """The skirt paper's capsule against a sphere of radius r'': the margin is the sphere's radius. It sinks m g / k."""
    mass, r, sphere = np.array([2e-3]), 0.1, 0.03
    at, none = np.array([[0.0, 0.5, 0.0]]), np.zeros((0, 3), np.int32)
    fabric = Fabric("sphere", at, 0.0 * at, mass, np.zeros(1, bool), none)
    shape = geometry(capsule(start, (0.0, 0.3, 0.0), r))
    (contact,) = Penalty().prepare(PenaltyConfig(margin=sphere), fabric, shape, DOWN).data
    x, v = points((0.0, 0.3 + r + sphere + 1e-4, 0.0)), np.zeros((3, 1))
    move(contact, 1.0)
    fall(x, v, mass, DOWN, contact, 0.0, 1.0, 20000, 1e-4, np.zeros((3, 1)))
    depth = 0.3 + r + sphere - x[1, 0]
    assert depth == pytest.approx(mass[0] * G / contact.stiffness[0, 0], rel=1e-6) and depth < 0.1 * sphere
