"""Axes of tubes and rows round limbs: closed forms, and loops that never cross on a leg."""

from __future__ import annotations

import math
from pathlib import Path

import closed_meshes as meshes
import numpy as np
import pytest
from tubes import bent, straight, tube

from nuno_contact.body_shapes.leg import leg_mesh
from nuno_geometry.centreline import find_axis, follow_axis
from nuno_geometry.closest_point import closest_points
from nuno_geometry.harmonic import solve_harmonic
from nuno_geometry.limb import Rows, find_limb, lay_rows
from nuno_geometry.mesh_files.mesh import read_closed
from nuno_geometry.sections import cut_mesh
from nuno_geometry.tree import build_tree
from nuno_knit.structure import ROOM, Over, _lift_off
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float


def link_lengths(points: Float) -> tuple[Float, Float]:
    """Lengths of rows' links (r, q), round them, and of those between rows (r - 1, q)."""
    round_it = np.linalg.norm(np.roll(points, -1, axis=1) - points, axis=-1)
    return round_it, np.linalg.norm(np.diff(points, axis=0), axis=-1)


def test_a_field_between_two_ends_of_a_tube_is_its_height() -> None:
    x, faces = tube(21, 24, straight, lambda s: 0.1)
    given = (x[:, 1] < 0.11) | (x[:, 1] > 0.89)
    field = solve_harmonic(x, faces, given, x[:, 1])
    assert np.abs(field - x[:, 1]).max() < 1e-7


def test_a_field_that_is_not_found_is_refused_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    x, faces = tube(21, 24, straight, lambda s: 0.1)
    given = (x[:, 1] < 0.11) | (x[:, 1] > 0.89)
    monkeypatch.setattr("nuno_geometry.harmonic.ROUNDS", 3)
    with pytest.raises(BadInput, match="no smooth field was found"):
        solve_harmonic(x, faces, given, x[:, 1])


def test_a_point_on_the_surface_is_moved_out_along_its_rows_normal() -> None:
    x, faces = meshes.box((2.0, 2.0, 2.0))
    over = Over(body="box", between=(0.0, 1.0), clearance=2.0**-8)
    points, up = np.zeros((3, 1, 3)), np.zeros((3, 1, 3))
    points[:, 0, 1], up[:, 0, 1] = (2.0, 1.0 - 2.0**-8, 2.0), 1.0
    position = _lift_off(over, Rows(points, up, np.ones(3), 1.0), x, faces)
    assert position[1] == pytest.approx([0.0, 1.0 + 2.0 * ROOM, 0.0], abs=1e-12)


def test_rows_of_a_straight_tube_are_level_and_equal() -> None:
    x, faces = tube(21, 32, straight, lambda s: 0.1)
    line = np.linspace([0.0, 0.2, 0.0], [0.0, 0.8, 0.0], 9)
    rows = lay_rows(x, faces, line, 13, 32, False)
    assert rows.height == pytest.approx(0.6, rel=1e-3)
    assert np.abs(rows.points[..., 1] - np.linspace(0.2, 0.8, 13)[:, None]).max() < 1e-4
    polygon = 2 * 32 * 0.1 * np.sin(np.pi / 32)
    assert rows.girth == pytest.approx(np.full(13, polygon), rel=1e-6)
    round_it, between = link_lengths(rows.points)
    assert np.ptp(round_it) < 1e-2 * round_it.mean() and between == pytest.approx(np.full((12, 32), 0.05), rel=2e-3)
    # To the right as seen from outside: with the end up, from the seam at -z towards -x.
    assert rows.points[0, 0, 2] < 0.0 and abs(rows.points[0, 0, 0]) < 1e-6 and rows.points[0, 8, 0] < -0.09


def test_rows_of_a_bent_tube_are_radii() -> None:
    """By symmetry levels of a torus are its radial planes, and their heights equal angles."""
    x, faces = tube(61, 32, bent, lambda s: 0.1)
    angle = 0.5 * np.pi * np.linspace(0.15, 0.85, 65)
    line = 0.5 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    points = lay_rows(x, faces, line, 15, 24, False).points
    turn = np.arctan2(points[..., 1], points[..., 0])
    assert np.abs(turn - np.linspace(angle[0], angle[-1], 15)[:, None]).max() < 0.02


@pytest.mark.parametrize("to_tip", [False, True])
def test_rows_of_a_leg_cover_it_and_never_cross(to_tip: bool) -> None:
    x, faces = leg_mesh(32)
    axis = find_limb(x, faces)
    assert axis.points[0][2] > 0.1 > axis.points[0][1] and axis.points[-1][1] > 0.65  # from the toes to the thigh
    rows = lay_rows(x, faces, axis.at(np.linspace(0.1, 0.93, 65)), 40, 30, to_tip)
    # On it, or off it where a band spans a hollow.
    distance = closest_points(build_tree(x, faces), rows.points.reshape(-1, 3)).distance
    assert distance.min() > -5e-4 and np.median(distance) < 1e-4
    # Every quad of the net is seen from the same side from outside: no row is past the next.
    across = np.roll(rows.points, -1, axis=1) - rows.points
    up = np.diff(rows.points, axis=0)
    assert ((np.cross(across[:-1], up) * rows.normal[:-1]).sum(axis=-1) > 0.0).all()
    assert (rows.girth[0] < 0.1 * rows.girth.mean()) == to_tip
    round_it, _ = link_lengths(rows.points)
    assert (round_it.max(axis=1) < 1.2 * rows.girth / 30).all()


@pytest.mark.quick(radius=[0.05])
@pytest.mark.parametrize("radius", [0.05, 0.15])
def test_the_axis_of_a_limb_with_flat_ends_is_its_middle_and_any_part_of_it_has_rows(radius: float) -> None:
    """The two vertices farthest apart are on the caps' rims, on opposite sides."""
    x, faces = tube(41, 24, straight, lambda s: radius)
    axis = find_limb(x, faces)
    assert np.abs(axis.points[:, [0, 2]]).max() < 1e-6 * radius
    assert axis.along[-1] > 0.83
    for first, last in ((0.0, 1.0), (0.2, 0.8), (0.3, 0.9), (0.5, 0.51)):
        ends = axis.at(np.array([first, last]))
        rows = lay_rows(x, faces, axis.at(np.linspace(first, last, 65)), 5, 12, False)
        assert rows.points[[0, -1], :, 1] == pytest.approx(np.repeat(ends[:, 1:2], 12, 1), abs=1e-3)
        assert rows.girth == pytest.approx(np.full(5, 2 * 24 * radius * np.sin(np.pi / 24)), rel=1e-6)


def test_any_part_of_a_scanned_legs_axis_has_rows_across_it(shared_data: Path) -> None:
    """It ends in a flat cap. Between the closest two of these ends there is no edge all round it."""
    x, faces = read_closed(shared_data / "leg.obj")
    axis = find_limb(x, faces)
    assert axis.points[0][1] < 0.02 and axis.points[-1][1] > 0.69
    step = np.diff(axis.points, axis=0)
    assert ((step[1:] * step[:-1]).sum(axis=1) > 0.0).all()
    for first, last in ((0.15, 0.85), (0.2, 0.8), (0.23, 0.9), (0.3, 0.8), (0.8, 0.85)):
        line = axis.at(np.linspace(first, last, 65))
        rows = lay_rows(x, faces, line, 9, 12, False)
        for row, end, way in ((0, line[0], line[4] - line[0]), (-1, line[-1], line[-1] - line[-5])):
            assert np.abs((rows.points[row] - end) @ way).max() < 2e-3 * np.linalg.norm(way)
        assert rows.height == pytest.approx((last - first) * axis.along[-1], rel=0.06)


def test_ends_that_take_no_tube_out_of_the_mesh_are_refused() -> None:
    x, faces = tube(21, 24, straight, lambda s: 0.1)
    turned_back = np.array([[0.0, 0.3, 0.0], [0.0, 0.2, 0.0], [0.0, 0.8, 0.0]])
    with pytest.raises(BadInput, match="do not take one tube"):
        lay_rows(x, faces, turned_back, 8, 8, False)


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
