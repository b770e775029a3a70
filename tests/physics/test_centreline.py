"""Axes of tubes: a cylinder's, a cone's, an arc's, and girths along them; points outside are refused."""

from __future__ import annotations

import math

import closed_meshes as meshes
import numpy as np
import pytest
from tubes import bent, straight, tube

from nuno_contact.figures.leg import leg_mesh
from nuno_kernels.meshes.centreline import find_axis, follow_axis
from nuno_kernels.meshes.loops import cut_mesh
from nuno_schemas.errors import BadInput


def polygon(radius: float, around: int) -> float:
    return 2 * around * radius * math.sin(math.pi / around)


@pytest.mark.parametrize("ends", [((0.02, 0.2, 0.01), (-0.01, 0.7, 0.02)), ((0.0, 0.3, 0.03), (0.0, 0.45, -0.03))])
def test_places_off_the_middle_of_a_slim_tube_have_its_middle_as_axis(ends: tuple[tuple[float, ...], ...]) -> None:
    """Points of the axis are nearer to each other than the places are to the middle."""
    axis = find_axis(*tube(41, 24, straight, lambda s: 0.05), np.array(ends[0]), np.array(ends[1]))
    assert np.abs(axis.points[:, [0, 2]]).max() < 1e-5
    assert (np.diff(axis.points[:, 1]) > 0.0).all()
    assert axis.points[[0, -1], 1] == pytest.approx([ends[0][1], ends[1][1]], abs=0.015)


def test_axis_and_girth_of_a_cylinder_off_its_middle() -> None:
    x, faces = tube(60, 40, straight, lambda s: 0.12)
    axis = find_axis(x, faces, np.array([0.05, 0.1, 0.02]), np.array([-0.04, 0.9, 0.05]), 32)
    inner = axis.points[3:-3]
    assert np.abs(inner[:, [0, 2]]).max() < 2e-3
    assert axis.girth[3:-3] == pytest.approx(polygon(0.12, 40), rel=2e-3)
    assert (np.diff(axis.along) > 0).all()


def test_girth_of_a_cone_falls_as_its_radius() -> None:
    x, faces = tube(60, 40, straight, lambda s: 0.15 - 0.1 * s)
    axis = find_axis(x, faces, np.array([0.0, 0.1, 0.0]), np.array([0.0, 0.9, 0.0]), 32)
    expected = np.array([polygon(0.15 - 0.1 * y, 40) for y in axis.points[:, 1]])
    assert np.abs(axis.points[:, [0, 2]]).max() < 1e-3
    assert axis.girth == pytest.approx(expected, rel=1e-2)


def test_axis_of_an_arc_converges_at_order_two() -> None:
    errors = []
    for rows in (16, 32, 64):
        x, faces = tube(2 * rows, 24, bent, lambda s: 0.12)
        ends = [bent(s)[0] for s in (0.08, 0.92)]
        axis = find_axis(x, faces, ends[0], ends[1], rows)
        errors.append(float(np.abs(np.hypot(axis.points[2:-2, 0], axis.points[2:-2, 1]) - 0.5).max()))
        assert np.abs(axis.points[:, 2]).max() < 1e-3
    assert errors[-1] < 1e-3
    assert errors[0] / errors[-1] > 8.0, errors


def test_given_points_keep_their_places_and_get_girths() -> None:
    x, faces = tube(40, 64, bent, lambda s: 0.1)
    points = np.array([bent(s)[0] for s in np.linspace(0.1, 0.9, 33)])
    axis = follow_axis(x, faces, points)
    assert np.array_equal(axis.points, points)
    assert axis.girth[1:-1] == pytest.approx(polygon(0.1, 64), rel=5e-3)
    assert axis.at(np.array([0.0, 1.0])) == pytest.approx(points[[0, -1]])


def test_points_outside_are_refused_with_their_distance() -> None:
    x, faces = tube(20, 24, straight, lambda s: 0.1)
    with pytest.raises(BadInput, match=r"axis\[1\]") as refusal:
        follow_axis(x, faces, np.array([[0.0, 0.5, 0.0], [0.4, 0.5, 0.0]]))
    assert "0.3" in str(refusal.value)
    with pytest.raises(BadInput, match="same place"):
        follow_axis(x, faces, np.array([[0.0, 0.5, 0.0], [0.0, 0.5, 0.0]]))
    with pytest.raises(BadInput, match="outside"):
        find_axis(x, faces, np.array([0.0, -0.5, 0.0]), np.array([0.0, 0.5, 0.0]))


def test_a_section_through_vertices_is_closed() -> None:
    """A plane just through rings of vertices still cuts one loop, of the same girth as beside them."""
    x, faces = tube(21, 24, straight, lambda s: 0.1)
    loops = cut_mesh(x, faces, x[:, 1] - 0.5)
    assert len(loops) == 1
    assert loops[0].girth == pytest.approx(polygon(0.1, 24), rel=1e-9)
    assert loops[0].centroid() == pytest.approx([0.0, 0.5, 0.0], abs=1e-12)
    ring = cut_mesh(*meshes.torus(20, 12), meshes.torus(20, 12)[0][:, 0] - 0.05)
    assert len(ring) == 2


def test_axis_of_the_leg_goes_round_the_heel() -> None:
    """From thigh to toes it stays inside, and its girths fall from thigh to ankle but for the calf."""
    axis = find_axis(*leg_mesh(36), np.array([0.0, 0.74, 0.0]), np.array([0.0, 0.02, 0.17]), 48)
    assert np.abs(axis.points[:, 0]).max() < 2e-3
    assert axis.points[-1, 2] > 0.12 and axis.along[-1] == pytest.approx(0.87, rel=0.05)
    calf = int(np.argmin(np.abs(axis.points[:, 1] - 0.32)))
    ankle = int(np.argmin(np.abs(axis.points[:, 1] - 0.113)))
    assert axis.girth[calf] == pytest.approx(0.35, rel=0.03)
    assert axis.girth[ankle] == pytest.approx(0.212, rel=0.08)
