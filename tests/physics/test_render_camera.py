"""Laws of camera fitting and of the colour map."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nuno_schemas.colour import colours, parse_hex, to_linear, to_srgb
from nuno_schemas.errors import BadInput
from nuno_schemas.pictures import Camera, axes, frame


def project(camera, points):
    """(n, 2) picture coordinates, -1 to 1 on both axes."""
    right, up, forward = axes(camera)
    relative = points - camera.eye
    depth = relative @ forward
    assert (depth > 0).all()
    slope = math.tan(camera.fov / 2)
    aspect = camera.size[0] / camera.size[1]
    return np.column_stack([relative @ right / depth / slope / aspect, relative @ up / depth / slope])


@pytest.mark.parametrize("azimuth", [0.0, 0.9, 4.0])
@pytest.mark.parametrize("elevation", [-0.3, 0.4, math.pi / 2])
@pytest.mark.parametrize("size", [(960, 720), (200, 700)])
def test_points_fill_the_picture_up_to_the_margin(azimuth, elevation, size):
    points = np.random.default_rng(3).normal(size=(300, 3)) * [1.0, 2.0, 0.5] + [10.0, -5.0, 2.0]
    camera = frame(points, azimuth, elevation, size, fov=0.6, margin=0.1)
    place = project(camera, points)
    assert np.abs(place).max() < 0.8 + 1e-9
    # Some axis touches its margin on both sides: nothing larger would fit.
    touches = (place.max(axis=0) > 0.8 - 1e-9) & (place.min(axis=0) < -0.8 + 1e-9)
    assert touches.any()


def test_axes_are_a_right_handed_frame():
    camera = frame(np.eye(3), 0.7, 0.3)
    right, up, forward = axes(camera)
    assert np.allclose(np.array([right, up, -forward]) @ np.array([right, up, -forward]).T, np.eye(3), atol=1e-14)
    assert np.allclose(np.cross(right, up), -forward, atol=1e-14)


def test_azimuth_zero_looks_along_y_and_turns_counter_clockwise():
    points = np.array([[-1.0, -1, -1], [1, 1, 1]])
    assert np.allclose(axes(frame(points, 0.0, 0.0))[2], [0, 1, 0])
    assert np.allclose(axes(frame(points, math.pi / 2, 0.0))[2], [-1, 0, 0])


def test_points_that_are_not_finite_do_not_count():
    points = np.random.default_rng(0).normal(size=(20, 3))
    broken = np.vstack([points, [[np.nan, 0, 0], [np.inf, 0, 0]]])
    assert np.array_equal(frame(points).eye, frame(broken).eye)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.ones((1, 3)), np.full((4, 3), np.nan)])
def test_no_extent_still_gives_a_camera(points):
    camera = frame(points)
    assert np.isfinite(camera.eye).all()
    assert np.linalg.norm(camera.eye - camera.target) > 0


@pytest.mark.parametrize("bad", [{"fov": 0.0}, {"fov": math.nan}, {"margin": 0.5}, {"size": (0, 10)}])
def test_bad_arguments_are_refused(bad):
    with pytest.raises(BadInput, match="camera"):
        frame(np.eye(3), **bad)


def test_camera_without_direction_is_refused():
    for eye, up in ((np.zeros(3), [0.0, 0, 1]), (np.array([0, 0, 1.0]), [0.0, 0, 1])):
        with pytest.raises(BadInput, match="camera"):
            axes(Camera(eye, np.zeros(3), np.array(up), 0.5, (10, 10)))


def test_srgb_transfer_is_inverted_and_meets_its_standard_values():
    value = np.linspace(0, 1, 1001)
    assert np.abs(to_srgb(to_linear(value)) - value).max() < 1e-6
    assert abs(to_linear(0.5) - 0.21404114) < 1e-7
    assert np.allclose(parse_hex("#ff8000"), [1.0, 0.21586, 0.0], atol=1e-5)


def test_equal_steps_of_value_are_equal_steps_of_lightness():
    # CIE 1976 lightness of the map's luminance: a straight line, to within 2 of 100.
    value = np.linspace(0, 1, 101)
    luminance = colours(value, 0.0, 1.0) @ [0.2126, 0.7152, 0.0722]
    lightness = np.where(luminance > 0.008856, 116 * np.cbrt(luminance) - 16, 903.3 * luminance)
    assert (np.diff(lightness) > 0).all()
    line = lightness[0] + value * (lightness[-1] - lightness[0])
    assert np.abs(lightness - line).max() < 2.0


def test_limits_missing_values_and_empty_ranges():
    low, high, missing = parse_hex("#440154"), parse_hex("#fde725"), parse_hex("#9a9a9a")
    assert np.allclose(colours([-5.0, 2.0, np.nan, 9.0], 2.0, 3.0), [low, low, missing, high])
    assert np.allclose(colours([1.0, 2.0], 1.0, 1.0), [low, low])
