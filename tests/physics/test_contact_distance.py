"""Signed distances and normals against meshes, closed forms and finite differences."""

import numpy as np
import pytest
import trimesh
from cloth_in_bodies import meeting
from contact_world import box, capsule, contact_for, geometry, move, plane

from nuno.collision.bodies import surface
from nuno_contact.margins import STRETCHED, triangle_spread
from nuno_contact.penalty.contact import pose_bodies
from nuno_contact.penalty.distance import Bodies, primitive_distance
from nuno_schemas.bodies import Poses, rotation_matrices

TURN = np.array([0.8, 0.2, -0.5, 0.26])
TURN /= np.linalg.norm(TURN)
PLACE = np.array([0.3, -0.7, 1.1])

SHAPES = {
    "capsule": capsule((0.1, -0.3, 0.2), (-0.2, 0.5, 0.1), 0.25),
    "sphere": capsule((0.1, -0.3, 0.2), (0.1, -0.3, 0.2), 0.4),
    "box": box((0.1, 0.2, -0.1), (0.3, 0.5, 0.2)),
}


def posed(shape):
    contact = contact_for(geometry(shape), np.ones(1), 1.0)
    move(contact, 1.0, turn0=TURN, start=PLACE)
    pose_bodies(0.0, contact)
    return contact


def measure(contact, points):
    bodies = Bodies(contact.kind, contact.frame, contact.posed, contact.frames)
    found = (primitive_distance(tuple(p), 0.0, 0.0, 0, 0, bodies, None) for p in points)
    return np.array([(distance, *normal, mark) for distance, normal, mark in found])


def cloud(number=300, seed=1):
    return PLACE + np.random.default_rng(seed).uniform(-0.8, 0.8, (number, 3))


@pytest.mark.parametrize("name", SHAPES)
def test_distance_is_that_to_a_fine_mesh(name):
    _, _, _, a, b, radius = SHAPES[name]
    if name == "box":
        mesh = trimesh.creation.box(extents=2.0 * np.array(b))
        mesh.apply_translation(a)
    elif name == "sphere":
        mesh = trimesh.creation.icosphere(subdivisions=5, radius=radius)
        mesh.apply_translation(a)
    else:
        along = np.array(b) - np.array(a)
        length = np.linalg.norm(along)
        mesh = trimesh.creation.capsule(height=length, radius=radius, count=[96, 96])
        mesh.apply_translation([0.0, 0.0, 0.5 * length - mesh.bounds.mean(axis=0)[2]])
        mesh.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], along / length))
        mesh.apply_translation(a)
    local = np.array(a) + np.random.default_rng(2).uniform(-0.45, 0.45, (80, 3))
    points = local @ rotation_matrices(TURN[None])[0].T + PLACE
    _, expected, _ = trimesh.proximity.closest_point_naive(mesh, local)
    found = measure(posed(SHAPES[name]), points)[:, 0]
    facet = 1e-12 if name == "box" else 0.4 * (1.0 - np.cos(np.pi / 96)) * 2.0
    np.testing.assert_allclose(np.abs(found), expected, atol=facet)
    inside = found < -facet
    assert 5 < inside.sum() < 75
    normals, origins = mesh.face_normals, mesh.triangles_center
    below = np.array([(np.sum((p - origins) * normals, axis=1) < 0.0).all() for p in local])
    np.testing.assert_array_equal(below[np.abs(found) > facet], inside[np.abs(found) > facet])


def test_plane_distance_is_the_height_above_it():
    normal = np.array([0.48, 0.6, 0.64])
    contact = posed(plane((0.2, 0.1, 0.3), normal))
    matrix = rotation_matrices(TURN[None])[0]
    points = cloud()
    height = (points - (matrix @ [0.2, 0.1, 0.3] + PLACE)) @ (matrix @ normal)
    np.testing.assert_allclose(measure(contact, points)[:, 0], height, atol=1e-14)


@pytest.mark.parametrize("name", [*SHAPES, "plane"])
def test_normal_is_the_gradient_of_the_distance(name):
    contact = posed(SHAPES.get(name) or plane((0.2, 0.1, 0.3), (0.48, 0.6, 0.64)))
    points, h = cloud(), 1e-6
    found = measure(contact, points)
    ahead, behind = ([measure(contact, points + s * h * e)[:, 0] for e in np.eye(3)] for s in (1.0, -1.0))
    slope = (np.array(ahead) - np.array(behind)).T / (2.0 * h)
    np.testing.assert_allclose(np.linalg.norm(found[:, 1:4], axis=1), 1.0, atol=1e-14)
    smooth = np.linalg.norm(slope, axis=1) > 1.0 - 1e-6  # off the edges where two faces are equally near
    assert smooth.sum() > 290
    np.testing.assert_allclose(found[smooth, 1:4], slope[smooth], atol=1e-8)


def test_box_is_round_outside_its_corner():
    contact = contact_for(geometry(box((0, 0, 0), (1, 1, 1))), np.ones(1), 1.0)
    pose_bodies(0.0, contact)
    distance, *normal, _ = measure(contact, [(2.0, 2.0, 2.0)])[0]
    assert distance == pytest.approx(np.sqrt(3.0), rel=1e-15)
    np.testing.assert_allclose(normal, np.full(3, 1.0 / np.sqrt(3.0)), rtol=1e-15)


@pytest.mark.parametrize("end", [(0, 0, 0), (1, 0, 0), (0, 2, 0), (0.3, -0.4, 0.5), (0, 0, 1e-200), (0, 0, 1e-155)])
def test_a_point_on_the_axis_has_a_normal_across_it(end):
    contact = contact_for(geometry(capsule((0, 0, 0), end, 0.2)), np.ones(1), 1.0)
    pose_bodies(0.0, contact)
    distance, *normal, on_axis = measure(contact, [(0.0, 0.0, 0.0)])[0]
    assert (distance, on_axis) == (-0.2, 1)
    assert np.linalg.norm(normal) == pytest.approx(1.0, rel=1e-15)
    assert abs(np.dot(normal, end)) <= 1e-16 * np.linalg.norm(end)


def test_surface_vertices_lie_on_their_primitives_and_close():
    shape = geometry(SHAPES["capsule"], SHAPES["sphere"], SHAPES["box"])
    drawn = surface(shape)
    vertices, faces = drawn.vertices, drawn.faces
    assert (drawn.frame == 0).all()
    assert faces.dtype == np.int32
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    volume = 0.0
    for _, _, _, a, b, radius in (SHAPES["capsule"], SHAPES["sphere"]):
        volume += np.pi * radius**2 * np.linalg.norm(np.subtract(b, a)) + 4.0 / 3.0 * np.pi * radius**3
    volume += 8.0 * np.prod(SHAPES["box"][4])
    assert 0.95 * volume < mesh.volume < volume
    for name in SHAPES:
        part = surface(geometry(SHAPES[name])).vertices
        contact = contact_for(geometry(SHAPES[name]), np.ones(1), 1.0)
        pose_bodies(0.0, contact)
        np.testing.assert_allclose(measure(contact, part)[:, 0], 0.0, atol=1e-15)


KEPT_OFF = SHAPES | {"plate": box((0.1, 0.2, -0.1), (0.3, 0.5, 0.004))}


@pytest.mark.parametrize("shape", KEPT_OFF)
def test_no_triangle_enters_whose_corners_keep_their_margin(shape: str) -> None:
    """Triangles at random, moved away from a body's middle until each corner is at its margin."""
    rng, part = np.random.default_rng(4), KEPT_OFF[shape]
    triangles = 0.2 * rng.standard_normal((300, 3, 3))
    spread = triangle_spread(triangles.reshape(-1, 3), np.arange(900).reshape(-1, 3)) / STRETCHED**2
    contact = contact_for(geometry(part), np.ones(900), 1.0)._replace(spread=np.stack([spread, 0.0 * spread]))
    pose_bodies(0.0, contact)
    bodies = Bodies(contact.kind, contact.frame, contact.posed, contact.frames)
    middle = np.asarray(part[3]) if shape in ("box", "plate") else 0.5 * (np.asarray(part[3]) + part[4])
    inside = np.array([(i, j, 12 - i - j) for i in range(13) for j in range(13 - i)]) / 12.0

    def least(points: np.ndarray, spread: float) -> float:
        return min(primitive_distance(tuple(p), spread, 0.0, 0, 0, bodies, None)[0] for p in points)

    placed = []
    for triangle, own in zip(triangles, spread[::3], strict=True):
        way, low, high = rng.standard_normal(3), 0.0, 3.0
        start, way = triangle - triangle.mean(axis=0) + middle, way / np.linalg.norm(way)
        while high - low > 1e-9:
            off = 0.5 * (low + high)
            low, high = (low, off) if least(start + off * way, own) >= 0.0 else (off, high)
        assert least(inside @ (start + high * way), 0.0) >= -1e-9
        placed.append(start + (high + 1e-9) * way)
    still = Poses(0.0, np.array([[1.0, 0.0, 0.0, 0.0]]), np.zeros((1, 3)))
    assert not meeting(np.concatenate(placed), np.arange(900).reshape(-1, 3), geometry(part), still).any()


def test_a_triangle_of_equal_sides_at_its_margin_touches_a_ball_in_its_middle() -> None:
    turn = 2.0 * np.pi * np.arange(3) / 3.0
    corners = 0.15 * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(3)])
    spread = float(triangle_spread(corners, np.array([[0, 1, 2]]))[0]) / STRETCHED**2
    margin = np.sqrt(0.4**2 + spread) - 0.4
    corners[:, 2] = np.sqrt((0.4 + margin) ** 2 - 0.15**2)
    assert np.linalg.norm(corners.mean(axis=0)) == pytest.approx(0.4, abs=1e-12)
