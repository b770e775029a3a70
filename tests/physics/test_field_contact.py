"""Contact with distance fields: as with the shape itself within the tolerance, wherever the body stands and moves."""

from __future__ import annotations

from dataclasses import replace

import closed_meshes as meshes
import numpy as np
import pytest
from contact_world import G, capsule, contact_for, fall, geometry, move

from nuno_contact.fields.build import build_field
from nuno_contact.fields.sample import sample_field
from nuno_contact.figures.leg import leg_mesh
from nuno_contact.penalty.contact import Contact, add_contact, count_contacts
from nuno_geometry.closest_point import closest_points
from nuno_geometry.tree import build_tree
from nuno_schemas.bodies import FIELD, DistanceField, Geometry, rotation_matrices
from nuno_schemas.fabric import Float, Int

TURN = np.array([0.8, 0.2, -0.5, 0.26])
TURN /= np.linalg.norm(TURN)
PLACE = np.array([0.3, -0.7, 1.1])
MASS = 1e-3


def field_body(x: Float, faces: Int, tolerance: float, friction: float = 0.0) -> tuple[Geometry, DistanceField]:
    """A body of one field, on one frame."""
    field = build_field(x, faces, tolerance)
    plain = geometry((FIELD, 0, 0, x.min(axis=0), x.max(axis=0), 0.0), friction=friction)
    return Geometry(**{**plain.__dict__, "fields": (field,)}), field


def forces(contact: Contact, x: Float, v: Float, parallel: bool = False) -> Float:
    force = np.zeros_like(x)
    add_contact(contact, x, v, 0.0, force, 2 if parallel else None)
    return force


@pytest.mark.full
def test_cloth_comes_to_rest_on_a_ball_where_it_does_on_its_field() -> None:
    """Points that fall on a rough ball stay where they land, on one of triangles as on a true one."""
    radius, tolerance, k = 0.3, 2e-3, 200.0
    rng = np.random.default_rng(0)
    around, out = rng.uniform(0.0, 2.0 * np.pi, 200), 0.12 * np.sqrt(rng.random(200))
    start = np.stack([out * np.cos(around), np.full(200, radius + 1e-3), out * np.sin(around)])
    shape, field = field_body(*meshes.sphere(48, radius), tolerance, friction=1.0)
    ends = []
    for body in (shape, geometry(capsule((0, 0, 0), (0, 0, 0), radius), friction=1.0)):
        contact = contact_for(body, np.full(200, MASS), k)
        x, v = start.copy(), np.zeros_like(start)
        fall(x, v, np.full(200, MASS), np.array([0.0, -G, 0.0]), contact, 0.0, 1.0, 8000, 1e-4, np.zeros_like(x))
        assert np.abs(v).max() < 1e-3 and count_contacts(contact)["touching"] == 200
        ends.append(x)
    assert np.linalg.norm(ends[0] - ends[1], axis=0).max() < tolerance
    depth = -sample_field(field, ends[0].T)[:, 0]
    upright = np.sqrt(1.0 - (out / radius) ** 2)
    np.testing.assert_allclose(depth, MASS * G * upright / k, rtol=0.05)


@pytest.mark.full
def test_an_impact_goes_as_deep_into_a_field_as_into_the_ball() -> None:
    """u sqrt(m / k), a quarter of a swing, which soft contact makes as long as it likes: no fault of the field."""
    radius, tolerance, k, speed = 0.3, 5e-4, 80.0, 1.0
    rng = np.random.default_rng(1)
    out = rng.normal(size=(3, 50))
    out /= np.linalg.norm(out, axis=0)
    mass, deepest = np.full(50, MASS), []
    shape, _ = field_body(*meshes.sphere(48, radius), tolerance)
    for body in (shape, geometry(capsule((0, 0, 0), (0, 0, 0), radius))):
        contact = contact_for(replace(body, damping=np.zeros(1)), mass, k)
        x, v, depth = (radius + 1e-3) * out, -speed * out, np.zeros(50)
        for step in range(400):
            fall(x, v, mass, np.zeros(3), contact, step / 400, (step + 1) / 400, 1, 2e-5, np.zeros_like(x))
            depth = np.maximum(depth, radius - np.linalg.norm(x, axis=0))
        deepest.append(depth)
    np.testing.assert_allclose(deepest[1], speed * np.sqrt(MASS / k), rtol=0.01)
    assert np.abs(deepest[0] - deepest[1]).max() < tolerance


@pytest.mark.full
def test_nothing_rests_inside_of_a_body_by_more_than_the_tolerance() -> None:
    """A net laid over a leg on its side: by the exact distance to the mesh, not by the field."""
    x, faces = leg_mesh(48)
    x = np.ascontiguousarray(x[:, [1, 2, 0]])
    tolerance, k = 1e-3, 200.0
    body, _ = field_body(x, faces, tolerance, friction=0.3)
    low, high = x.min(axis=0), x.max(axis=0)
    u, w = np.meshgrid(np.linspace(low[0], high[0], 40), np.linspace(low[2], high[2], 12))
    points = np.stack([u.ravel(), np.full(u.size, high[1] + 0.01), w.ravel()])
    mass, v = np.full(points.shape[1], MASS), np.zeros_like(points)
    contact = contact_for(body, mass, k)
    tree = build_tree(x, faces)
    fall(points, v, mass, np.array([0.0, -G, 0.0]), contact, 0.0, 1.0, 4000, 1e-4, np.zeros_like(v))
    assert count_contacts(contact)["touching"] > 20
    # It comes at up to 1.4 m/s and is stopped by k: m v^2 = k depth^2 at most.
    stop = float(np.sqrt(MASS / k)) * 1.4 + MASS * G / k
    assert closest_points(tree, points.T).distance.min() > -tolerance - stop
    fall(points, v, mass, np.array([0.0, -G, 0.0]), contact, 0.0, 1.0, 4000, 1e-4, np.zeros_like(v))
    still = np.abs(v).max(axis=0) < 1e-2
    assert still.sum() > 20
    assert closest_points(tree, points.T[still]).distance.min() > -tolerance - 2.0 * MASS * G / k


@pytest.mark.full
def test_force_turns_and_moves_with_the_body() -> None:
    x, faces = meshes.torus(40, 20, 0.3, 0.1)
    body, field = field_body(x, faces, 2e-3, friction=0.4)
    rng = np.random.default_rng(3)
    normal = meshes.torus(40, 20, 0.3, 0.08)[0]
    points = np.ascontiguousarray((normal + 0.01 * rng.normal(size=normal.shape)).T)
    v = rng.normal(size=points.shape)
    still, moved = (contact_for(body, np.full(points.shape[1], MASS), 100.0) for _ in range(2))
    move(moved, 1.0, turn0=TURN, start=PLACE)
    turn = rotation_matrices(TURN[None])[0]
    there = np.ascontiguousarray(turn @ points + PLACE[:, None])
    here, away = forces(still, points, v), forces(moved, there, np.ascontiguousarray(turn @ v))
    assert (np.abs(here).max(axis=0) > 0.0).mean() > 0.3
    np.testing.assert_allclose(away, turn @ here, atol=1e-9 * np.abs(here).max())
    assert forces(still, points, v, parallel=True).tobytes() == here.tobytes()
    touched = still.deepest[0] >= 0
    inside = sample_field(field, points.T)[:, 0] < 0.0
    assert np.array_equal(touched, inside)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_every_body_is_met_by_its_own_field(order: tuple[int, int]) -> None:
    """Two fields and a capsule: points inside of one feel what they feel where it is alone."""
    shapes = [(meshes.sphere(16, 0.2), (0.0, 0.0, 0.0)), (meshes.box((0.3, 0.3, 0.3)), (1.0, 0.0, 0.0))]
    parts = [(x + np.array(at), faces) for (x, faces), at in (shapes[i] for i in order)]
    fields = tuple(build_field(x, faces, 5e-3) for x, faces in parts)
    primitives = [(FIELD, 0, 2 * i, x.min(axis=0), x.max(axis=0), 0.0) for i, (x, _) in enumerate(parts)]
    both = geometry(primitives[0], capsule((5, 0, 0), (5, 0, 0), 0.1, body=1), primitives[1])
    contact = contact_for(Geometry(**{**both.__dict__, "fields": fields}), np.ones(2), 10.0)
    points = np.array([[0.15, 1.0], [0.0, 0.13], [0.0, 0.0]])
    found = forces(contact, points, np.zeros_like(points))
    np.testing.assert_allclose(found, [[0.5, 0.0], [0.0, 0.2], [0.0, 0.0]], atol=0.06)
