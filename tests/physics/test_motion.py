"""Keyframes and the hula: exact at keys, smooth between, periodic, feet on the floor."""

import numpy as np
import pytest

from nuno_contact.motions.hula import Hula, HulaConfig
from nuno_contact.motions.keyframes import Keyframes, KeyframesConfig
from nuno_schemas.bodies import rotation_matrices
from nuno_schemas.errors import BadInput


class NoFiles:
    def resolve(self, name):
        raise AssertionError(name)


def keyframes(**config):
    return Keyframes().prepare(KeyframesConfig(**config), NoFiles())


def hula(**config):
    return Hula().prepare(HulaConfig(**config), NoFiles())


def matrix(mover, t):
    return rotation_matrices(mover.pose(t)[0])[0]


def test_keys_are_met_and_linear_between():
    mover = keyframes(times=[1.0, "2 s", 4.0], positions=[(0, 0, 0), ("1 m", 0, 0), (1, 2, 0)])
    for t, place in [
        (0, (0, 0, 0)),
        (1, (0, 0, 0)),
        (1.5, (0.5, 0, 0)),
        (2, (1, 0, 0)),
        (3, (1, 1, 0)),
        (9, (1, 2, 0)),
    ]:
        np.testing.assert_allclose(mover.pose(t)[1], [place], atol=1e-15)
        np.testing.assert_array_equal(mover.pose(t)[0], [[1.0, 0.0, 0.0, 0.0]])


def test_the_three_forms_of_a_rotation_agree():
    third = np.sin(np.pi / 6)
    forms = [
        keyframes(times=[0], rotations=[[0, 0, "60 deg"]], form="euler"),
        keyframes(times=[0], rotations=[[0, 0, 5, "60 deg"]], form="axis_angle"),
        keyframes(times=[0], rotations=[[2 * np.cos(np.pi / 6), 0, 0, 2 * third]], form="quaternion"),
    ]
    expected = [[0.5, -np.sqrt(0.75), 0.0], [np.sqrt(0.75), 0.5, 0.0], [0.0, 0.0, 1.0]]
    for mover in forms:
        np.testing.assert_allclose(matrix(mover, 0.0), expected, atol=1e-15)


def test_euler_angles_turn_about_x_then_y_then_z():
    mover = keyframes(times=[0], rotations=[["90 deg", "90 deg", 0]])
    np.testing.assert_allclose(matrix(mover, 0.0) @ [0, 1, 0], [1, 0, 0], atol=1e-15)


def test_rotation_between_keys_has_constant_rate():
    mover = keyframes(times=[0, 2], rotations=[[0, 0, 0], [0, "2 rad", 0]])
    for t in np.linspace(0, 2, 9):
        np.testing.assert_allclose(matrix(mover, t)[0], [np.cos(t), 0.0, np.sin(t)], atol=1e-15)


def test_ease_stands_still_at_keys_and_loop_repeats():
    config = {"times": [0, 1, 2], "positions": [(0, 0, 0), (1, 0, 0), (0, 0, 0)], "between": "ease"}
    mover, loop = keyframes(**config), keyframes(**config, end="loop")
    h = 1e-4
    for t in (0.0, 1.0, 2.0):
        speed = (mover.pose(t + h)[1] - mover.pose(t - h)[1]) / (2 * h)
        assert np.abs(speed).max() < 1e-6
    for t in (0.3, 1.7):
        np.testing.assert_allclose(loop.pose(t + 4.0)[1], mover.pose(t)[1], atol=1e-14)
    assert mover.pose(5.3)[1][0, 0] == 0.0


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ({"times": []}, "at least one keyframe"),
        ({"times": [0, 1, 1]}, "increase"),
        ({"times": [0, 1], "positions": [(0, 0, 0)]}, "1 positions for 2 times"),
        ({"times": [0], "rotations": [[1, 0]]}, "3 numbers"),
        ({"times": [0, 1], "rotations": [[0, 0, 0], [0, 90, 0]]}, "14.3 turns between two keys are lost"),
        ({"times": [0, 1], "rotations": [[0, 0, 0], [0, 0, "360 deg"]]}, "1 turns between"),
        ({"times": [0, 1], "rotations": [[0, 0, 1, 0], [0, 0, 1, 45]], "form": "axis_angle"}, "7.16 turns"),
        ({"times": [0], "rotations": [[0, 0, 0, 1]], "form": "axis_angle"}, "direction"),
        ({"times": [0], "rotations": [[0, 0, 0, 0]], "form": "quaternion"}, "direction"),
    ],
)
def test_keys_without_sense_are_refused(config, words):
    with pytest.raises(BadInput, match=words):
        keyframes(**config)


def places(mover, times):
    return np.array([mover.pose(t)[1] for t in times])


def test_hula_starts_from_rest_and_never_jerks():
    mover, h = hula(), 4e-3
    x = places(mover, np.arange(0.0, 5.0, h))
    v = np.diff(x, axis=0) / h
    a = np.diff(v, axis=0) / h
    assert np.abs(v[0]).max() < 1e-4
    assert np.abs(a[:3]).max() < 0.1
    assert 0.2 < np.linalg.norm(v, axis=2).max() < 2.0
    assert np.linalg.norm(a, axis=2).max() < 15.0
    assert np.linalg.norm(np.diff(a, axis=0) / h, axis=2).max() < 150.0
    np.testing.assert_array_equal(mover.pose(0.0)[1], mover.pose(-1.0)[1])


def test_hula_is_periodic_after_its_ramp():
    mover = hula(tempo="1.25 Hz", ramp="1 s")
    for t in (1.0, 1.3, 2.9):
        for now, later in zip(mover.pose(t), mover.pose(t + 0.8), strict=True):
            np.testing.assert_allclose(later, now, atol=1e-12)


def test_hips_go_round_a_circle_flattened_to_the_front():
    x = places(hula(amplitude="6 cm", ramp=0), np.linspace(0.0, 1.25, 26))[:, 0]
    np.testing.assert_allclose((x[:, 0] / 0.06) ** 2 + (x[:, 2] / 0.045) ** 2, 1.0, atol=1e-12)
    np.testing.assert_allclose(np.ptp(x[:, 1]), 0.0, atol=1e-15)


def test_feet_stay_and_bones_keep_their_length():
    mover = hula(height="1.5 m", position=(1, "20 cm", -2))
    x = places(mover, np.arange(0.0, 4.0, 0.07))
    for foot in ("left_foot", "right_foot", "left_foot_end"):
        assert np.ptp(x[:, mover.joints.index(foot)], axis=0).max() < 1e-14
    assert x[0, mover.joints.index("left_foot"), 1] == pytest.approx(0.2 + 0.045 * 1.5, abs=1e-14)
    lengths = np.linalg.norm(x[:, 1:] - x[:, mover.parents[1:]], axis=2)
    np.testing.assert_allclose(lengths, np.tile(np.linalg.norm(mover.offsets[1:], axis=1), (len(x), 1)), rtol=1e-13)
    assert (mover.parents[1:] < np.arange(1, len(mover.joints))).all()


def test_a_circle_wider_than_the_legs_reach_is_refused():
    with pytest.raises(BadInput, match="further than the legs reach"):
        hula(amplitude="30 cm")
