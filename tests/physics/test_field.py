"""Sampled distance fields: within their tolerance of the exact distance, the same bits, and contact with them."""

from __future__ import annotations

from dataclasses import replace

import closed_meshes as meshes
import numpy as np
import pytest
from contact_world import G, capsule, contact_for, fall, geometry, move

from nuno_contact.body_shapes.leg import leg_mesh
from nuno_contact.distance_fields.build import build_field
from nuno_contact.distance_fields.cells import Exact
from nuno_contact.distance_fields.sample import sample_field
from nuno_contact.penalty.contact import Contact, add_contact, count_contacts
from nuno_geometry.closest_point import closest_points
from nuno_geometry.tree import build_tree
from nuno_schemas.bodies import FIELD, DistanceField, Geometry, rotation_matrices
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int

CASES = {
    "sphere": (meshes.sphere(24), 5e-3),
    "box": (meshes.box((1.0, 0.4, 0.6)), 1e-2),
    "torus": (meshes.torus(48, 24), 1e-2),
    "plate": (meshes.box((1.0, 4e-3, 0.5)), 1e-2),
    "leg": (leg_mesh(24), 2e-3),
}


def places(x: Float, faces: Int, reach: float, count: int = 20_000) -> Float:
    """Half of the points within `reach` of the surface, half anywhere in the box about it."""
    rng = np.random.default_rng(7)
    corners = x[faces[rng.integers(0, len(faces), count)]]
    on = np.einsum("fi,fij->fj", rng.dirichlet(np.ones(3), count), corners)
    low, high = x.min(axis=0) - reach, x.max(axis=0) + reach
    return np.concatenate([on + rng.uniform(-reach, reach, on.shape), rng.uniform(low, high, (count, 3))])


@pytest.mark.parametrize("name", list(CASES))
def test_error_is_within_the_tolerance_near_the_surface_and_in_proportion_far_from_it(name: str) -> None:
    (x, faces), tolerance = CASES[name]
    field = build_field(x, faces, tolerance)
    p = places(x, faces, field.band)
    exact = closest_points(build_tree(x, faces), p).distance
    error = np.abs(sample_field(field, p)[:, 0] - exact)
    assert (error <= tolerance * np.maximum(1.0, np.abs(exact) / field.band)).all()
    assert error.max() > 0.1 * tolerance
    assert np.abs(sample_field(field, x)[:, 0]).max() <= tolerance


def leaf_sizes(field: DistanceField, p: Float) -> Float:
    """(n,) edge [m] of the leaf that each of the points (n, 3) lies in."""
    place = (p - field.low) / field.size
    cell = np.minimum(np.floor(place).astype(np.int64), field.shape - 1)
    place, size = place - cell, np.full(len(p), field.size)
    at = field.child[(cell[:, 0] * field.shape[1] + cell[:, 1]) * field.shape[2] + cell[:, 2]]
    while (inner := at >= 0).any():
        place = np.where(inner[:, None], 2.0 * place, place)
        part = inner[:, None] & (place >= 1.0)
        place -= part
        at = np.where(inner, field.child[np.where(inner, at + part @ [4, 2, 1], 0)], at)
        size[inner] *= 0.5
    return size


def test_gradient_is_a_unit_vector_to_the_second_order_of_the_cells() -> None:
    """Between unit vectors that turn by h / R along an edge: mean 1 - |g| is (h / R)^2 / 6 in cells
    of one size, and no more than twice that where smaller ones take their larger neighbours' values. The gradient
    leans from the ball's normal by as much as facets of pi / 64 do.
    """
    x, faces = meshes.sphere(64)
    way = np.random.default_rng(1).normal(size=(20_000, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    sizes, short, lean = [], [], []
    for tolerance in (3.2e-2, 8e-3, 2e-3):
        field = build_field(x, faces, tolerance)
        gradient = sample_field(field, way)[:, 1:]
        length = np.linalg.norm(gradient, axis=1)
        sizes.append(float(np.mean(leaf_sizes(field, way) ** 2)))
        short.append(float(np.mean(1.0 - length)))
        lean.append(float(np.mean(np.linalg.norm(gradient / length[:, None] - way, axis=1))))
    share = np.array(short) / sizes
    assert sizes[0] > 8.0 * sizes[2]
    assert np.all((share > 0.1) & (share < 0.35)), share
    assert max(lean) < 0.25 * np.pi / 64


def test_distance_and_gradient_are_continuous_between_leaves_of_all_sizes() -> None:
    """On lines along x they never jump: steps of a thousandth of the smallest leaf change them by as little."""
    x, faces = CASES["box"][0]
    field = build_field(x, faces, 1e-2)
    smallest, step = field.size / 2**6, 1e-6
    rng = np.random.default_rng(2)
    start = rng.uniform([-0.6, -0.3, -0.4], [0.6, 0.3, 0.4], (200, 3))
    start[:, 0] = field.low[0] + smallest * np.round((start[:, 0] - field.low[0]) / smallest)
    sides = [sample_field(field, start + np.array([way * step, 0.0, 0.0])) for way in (-1.0, 1.0)]
    assert np.abs(sides[1] - sides[0])[:, 0].max() < 4.0 * step
    assert np.abs(sides[1] - sides[0])[:, 1:].max() < 4.0 * 2.0 * step / smallest


def test_threads_change_no_bit() -> None:
    (x, faces), tolerance = CASES["leg"]
    one, many = (build_field(x, faces, tolerance, threads=count) for count in (1, 2))
    assert one.child.tobytes() == many.child.tobytes() and one.corners.tobytes() == many.corners.tobytes()
    p = places(x, faces, one.band, 5000)
    assert sample_field(one, p, threads=1).tobytes() == sample_field(one, p, threads=2).tobytes()


@pytest.mark.full
def test_a_surface_with_a_hole_has_the_signs_of_its_winding_number() -> None:
    x, faces = meshes.sphere(24)
    top = x[faces].mean(axis=1)[:, 1] > 0.97
    tolerance = 2e-2
    field = build_field(x, faces[~top], tolerance, closed=False)
    p = places(x, faces, 0.2, 1000)
    winding = meshes.winding_number(p, x, faces[~top])
    whole = closest_points(build_tree(x, faces), p).distance
    # Where a hole is seen under a wide angle there is no inside: about the missing cap both are right.
    cap = np.linalg.norm(p - [0.0, 1.0, 0.0], axis=1) < 0.35
    clear = (np.abs(whole) > tolerance) & ~cap
    value = sample_field(field, p)[:, 0]
    assert top.sum() > 40 and cap.any()
    assert np.array_equal(value[clear] < 0.0, winding[clear] > 0.5)
    assert np.array_equal(value[clear] < 0.0, whole[clear] < 0.0)


def test_a_leaky_ring_has_the_signs_of_the_exact_solid_angles() -> None:
    """Groups that are far count as dipoles: signs differ from the exact winding number's only beside one half."""
    x, faces = meshes.torus(40, 24)
    faces = np.delete(faces, np.s_[::9], axis=0)
    p = places(x, faces, 0.5, 1000)
    found = Exact(build_tree(x, faces), closed=False).measure(p)[:, 0] < 0.0
    exact = meshes.winding_number(p, x, faces)
    clear = np.abs(exact - 0.5) > 0.05
    assert np.array_equal(found[clear], exact[clear] > 0.5)
    assert 0.1 < np.mean(found) < 0.9


def test_far_from_its_box_a_field_is_never_too_short_and_too_long_by_no_more_than_the_body() -> None:
    (x, faces), tolerance = CASES["torus"]
    field = build_field(x, faces, tolerance)
    p = np.random.default_rng(3).normal(size=(2000, 3)) * 20.0
    exact = closest_points(build_tree(x, faces), p).distance
    value = sample_field(field, p)[:, 0]
    assert (value >= exact * (1.0 - tolerance / field.band)).all()
    assert (value <= exact + np.linalg.norm(np.ptp(x, axis=0))).all()
    assert np.isnan(sample_field(field, np.full((1, 3), np.nan))[0, 0])


def test_a_field_that_would_be_too_large_is_refused_with_its_size_before_it_is_built() -> None:
    x, faces = CASES["box"][0]
    with pytest.raises(BadInput, match="too large") as caught:
        build_field(x, faces, 1e-4, most_bytes=1 << 22)
    size = float(str(caught.value.value).split("at least ")[1].split(" MiB")[0].replace(",", ""))
    assert size > 4.0 and "4 MiB" in str(caught.value.limit)


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
