"""The collision service's own measure of penetration, against trimesh and against itself."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh
from cloth_in_bodies import turns_about
from persons import person, skinned

from nuno.collision import distance as mesh_module
from nuno.collision.distance import Solid, are_inside, distances, measure_inside, penetration, signed_distance
from nuno.collision.messages import decode_geometry, decode_poses, encode_geometry, encode_poses
from nuno.plugin_contract.guards import check_body
from nuno_schemas.bodies import BOX, CAPSULE, MESH, PLANE, Geometry, Poses, Skin, rotation_matrices
from nuno_schemas.plugin import BodyShape, Mover

TURN = np.array([0.8, 0.2, -0.5, 0.26])
TURN /= np.linalg.norm(TURN)
PLACE = np.array([0.3, -0.7, 1.1])
A, B, RADIUS = np.array([0.1, 0.0, -0.1]), np.array([0.2, 0.3, 0.1]), 0.15
CENTRE, HALF = np.array([-0.1, 0.1, 0.0]), np.array([0.2, 0.1, 0.3])


def bodies(*parts: tuple[int, np.ndarray, np.ndarray, float]) -> Geometry:
    """One body of primitives on one frame."""
    kind, a, b, radius = zip(*parts, strict=True)
    count = len(parts)
    zeros = np.zeros(count, np.int32)
    one = np.ones(1)
    return Geometry(
        ("body",), ("body/world",), np.array(kind, np.int8), zeros, zeros, np.array(a), np.array(b),
        np.array(radius), one, one, one,
    )  # fmt: skip


def posed(rotation: np.ndarray = TURN, place: np.ndarray = PLACE) -> Poses:
    return Poses(0.0, rotation[None], place[None])


def mesh_of(name: str) -> trimesh.Trimesh:
    if name == "box":
        mesh = trimesh.creation.box(extents=2 * HALF)
        mesh.apply_translation(CENTRE)
        return mesh
    length = np.linalg.norm(B - A)
    mesh = trimesh.creation.capsule(height=length, radius=RADIUS, count=[96, 96])
    mesh.apply_translation([0.0, 0.0, 0.5 * length - mesh.bounds.mean(axis=0)[2]])
    mesh.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], (B - A) / length))
    mesh.apply_translation(A)
    return mesh


@pytest.mark.parametrize(("name", "facet"), [("box", 1e-12), ("capsule", 2 * RADIUS * (1 - np.cos(np.pi / 96)))])
def test_distance_is_that_to_the_mesh(name: str, facet: float) -> None:
    part = (BOX, CENTRE, HALF, 0.0) if name == "box" else (CAPSULE, A, B, RADIUS)
    local = np.random.default_rng(1).uniform(-0.35, 0.35, (150, 3))
    points = local @ rotation_matrices(TURN[None])[0].T + PLACE
    found = signed_distance(points, bodies(part), posed())
    _, expected, _ = trimesh.proximity.closest_point_naive(mesh_of(name), local)
    np.testing.assert_allclose(np.abs(found), expected, atol=facet)
    mesh = mesh_of(name)
    below = [(np.sum((p - mesh.triangles_center) * mesh.face_normals, axis=1) < 0).all() for p in local]
    clear = np.abs(found) > facet
    np.testing.assert_array_equal(np.array(below)[clear], found[clear] < 0)
    assert 5 < (found < 0).sum() < 145


def test_plane_depth_is_the_height_below_it() -> None:
    normal = np.array([0.48, 0.6, 0.64])
    plane = bodies((PLANE, 0.2 * normal, normal, 0.0))
    points = np.random.default_rng(2).uniform(-1, 1, (50, 3))
    still = posed(np.array([1.0, 0, 0, 0]), np.zeros(3))
    np.testing.assert_allclose(penetration(points, plane, still), np.maximum(0.2 - points @ normal, 0), atol=1e-15)


def test_passing_primitives_over_changes_nothing() -> None:
    rng = np.random.default_rng(3)
    parts = [(CAPSULE, *rng.uniform(-2, 2, (2, 3)), float(rng.uniform(0.05, 0.6))) for _ in range(20)]
    parts += [(BOX, rng.uniform(-2, 2, 3), rng.uniform(0.05, 0.8, 3), 0.0) for _ in range(20)]
    geometry = bodies(*parts)
    inside = 0
    for offset in rng.uniform(-2, 2, (10, 3)):
        points = offset + rng.uniform(-0.3, 0.3, (40, 3))
        expected = np.maximum(-signed_distance(points, geometry, posed()), 0.0)
        assert penetration(points, geometry, posed()).tobytes() == expected.tobytes()
        inside += np.count_nonzero(expected)
    assert 40 < inside < 360


def test_points_that_are_not_finite_are_outside() -> None:
    points = np.array([[np.nan, 0, 0], [np.inf, 0, 0], PLACE + rotation_matrices(TURN[None])[0] @ CENTRE])
    depth = penetration(points, bodies((BOX, CENTRE, HALF, 0.0)), posed())
    np.testing.assert_allclose(depth, [0.0, 0.0, HALF.min()])
    assert not penetration(points[:2], bodies((BOX, CENTRE, HALF, 0.0)), posed()).any()


def square(size: float, cells: int, z: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a square sheet at a height."""
    side = np.linspace(-0.5 * size, 0.5 * size, cells + 1)
    across, along = (part.reshape(-1) for part in np.meshgrid(side, side, indexing="ij"))
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).reshape(-1, 1)
    faces = np.concatenate([corner + np.array(at) for at in ([0, cells + 1, 1], [1, cells + 1, cells + 2])])
    return np.stack([across, along, np.full(len(across), z)], axis=1), faces.astype(np.int32)


@pytest.mark.parametrize("cells", [3, 40])
def test_cloth_in_a_body_has_the_area_of_their_section(cells: int) -> None:
    """A disc of a ball, also where all vertices are outside of it; a half of a plane's; a strip of a limb's."""
    still = posed(np.array([1.0, 0, 0, 0]), np.zeros(3))
    x, faces = square(1.0, cells, 0.08)
    ball = bodies((CAPSULE, np.zeros(3), np.zeros(3), 0.1))
    each, area, depth = measure_inside(x, faces, ball, still)
    np.testing.assert_array_equal(each, penetration(x, ball, still))
    vertices = each.max()
    if cells == 3:
        assert vertices == 0.0 and depth == pytest.approx(0.02, abs=1e-12) and area > 0.0
    else:
        assert area == pytest.approx(np.pi * (0.1**2 - 0.08**2), rel=0.05) and vertices <= depth <= 0.02 + 1e-12
    limb = bodies((CAPSULE, np.array([0, -1.0, 0]), np.array([0, 1.0, 0]), 0.1))
    if cells == 40:
        half = bodies((PLANE, np.array([0.003, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]), 0.0))
        assert measure_inside(x, faces, half, still).area == pytest.approx(0.503, rel=0.01)
        assert measure_inside(x, faces, limb, still).area == pytest.approx(2.0 * 0.06, rel=0.05)
    assert measure_inside(x + np.array([0, 0, 0.021]), faces, limb, still)[1:] == (0.0, 0.0)


def test_cloth_in_a_mesh_is_that_in_its_ball() -> None:
    still, (x, faces) = posed(np.array([1.0, 0, 0, 0]), np.zeros(3)), square(0.4, 40, 0.03)
    ball = trimesh.creation.icosphere(5, 0.1)
    corner, number = np.full(3, 0.1), np.zeros(len(ball.faces), np.int32)
    mesh = replace(
        bodies((MESH, -corner, corner, 0.0)),
        vertices=np.array(ball.vertices), faces=np.array(ball.faces, np.int32), owner=number,
    )  # fmt: skip
    exact = bodies((CAPSULE, np.zeros(3), np.zeros(3), 0.1))
    found, own = (measure_inside(x, faces, body, still) for body in (mesh, exact))
    assert found.area == pytest.approx(own.area, rel=0.01)
    assert found.area_depth == pytest.approx(own.area_depth, abs=1e-4)
    np.testing.assert_array_equal(found.depth, penetration(x, mesh, still))
    met = measure_inside(x, faces, mesh, still, [0])
    assert met[1:] == (0.0, 0.0) and met.depth.tobytes() == found.depth.tobytes()


def test_bodies_cross_the_bus_unchanged() -> None:
    geometry = bodies((CAPSULE, A, B, RADIUS), (BOX, CENTRE, HALF, 0.0))
    back = decode_geometry(encode_geometry(geometry))
    for name, value in vars(geometry).items():
        np.testing.assert_array_equal(getattr(back, name), value)
    poses = decode_poses(encode_poses(posed(), 3))
    assert poses.rotation.tobytes() == posed().rotation.tobytes()
    assert poses.translation.tobytes() == posed().translation.tobytes()


def joined(parts: Sequence[Geometry]) -> Geometry:
    """One geometry of several, each on frames of its own."""

    def shifted(name: str, length: str) -> Any:
        before = np.cumsum([0, *(len(getattr(part, length)) for part in parts)])
        return np.concatenate(
            [getattr(part, name) + at for part, at in zip(parts, before, strict=False)], dtype=np.int32
        )

    plain = ("kind", "a", "b", "radius", "stiffness", "damping", "friction", "vertices")
    shifts = {"frame": "frames", "body": "bodies", "faces": "vertices", "owner": "kind"}
    return Geometry(
        bodies=tuple(f"{name}{i}" for i, part in enumerate(parts) for name in part.bodies),
        frames=tuple(f"{i}/{name}" for i, part in enumerate(parts) for name in part.frames),
        skins=tuple(skin for part in parts for skin in part.skins),
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in plain},
        **{name: shifted(name, length) for name, length in shifts.items()},
    )


def cube() -> Geometry:
    """A mesh of 8 vertices and 12 triangles on one frame."""
    box = trimesh.creation.box(2.0 * HALF)
    faces, one = np.array(box.faces, np.int32), bodies((MESH, -HALF, HALF, 0.0))
    return replace(one, vertices=np.array(box.vertices), faces=faces, owner=np.zeros(12, np.int32))


@pytest.mark.parametrize("order", list(itertools.permutations(range(4))))
def test_any_mix_of_bodies_crosses_the_bus_with_each_where_it_is_alone(order: tuple[int, ...]) -> None:
    """A ball, a rigid mesh and two skins of other numbers of vertices and frames, in any order."""
    short = replace(skinned(), bodies=("short",))
    thin = short.skins[0]
    still = Skin(np.zeros((1, 3)), np.zeros((len(thin.joint), 1), np.int32), np.ones((len(thin.joint), 1)))
    longer = replace(short, bodies=("still",), frames=("still/world",), skins=(still,))
    every = [bodies((CAPSULE, A, B, RADIUS)), cube(), short, longer]
    parts = [every[i] for i in order]
    back = decode_geometry(encode_geometry(joined(parts)))
    turns = np.random.default_rng(0).normal(size=(len(back.frames), 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    poses, first = Poses(0.0, turns, turns[:, 1:] * 0.1), 0
    for i, part in enumerate(parts):
        own = slice(first, first + len(part.frames))
        first = own.stop
        if len(part.faces):
            alone = part.placed(0, Poses(0.0, poses.rotation[own], poses.translation[own]))
            for here, there in zip(back.placed(i, poses), alone, strict=True):
                assert here.tobytes() == there.tobytes()
    whole = BodyShape(back.frames, back.kind, back.frame, back.a, back.b, back.radius, back.vertices, back.faces,
                      back.owner, skins=back.skins)  # fmt: skip
    joints = len(back.frames)
    check_body(whole, Mover(back.frames, np.full(joints, -1, np.int32), np.zeros((joints, 3)), lambda t: turns))


def test_depth_in_a_mesh_is_that_in_the_box_it_has_the_shape_of() -> None:
    """Moved and turned, with points whose rays hit edges and corners."""
    half = np.array([0.5, 0.3, 0.2])
    box = trimesh.creation.box(2.0 * half)
    x, faces = np.array(box.vertices), np.array(box.faces, np.int32)
    one, rest = np.zeros(1, np.int32), (np.full(1, np.nan), np.zeros(1), np.zeros(1))
    bounds = (-half[None], half[None], np.zeros(1))
    names = (("body",), ("body/world",))
    mesh = Geometry(*names, np.array([MESH], np.int8), one, one, *bounds, *rest, x, faces, np.zeros(12, np.int32))
    plain = Geometry(*names, np.array([BOX], np.int8), one, one, np.zeros((1, 3)), half[None], np.zeros(1), *rest)
    poses = Poses(0.0, np.array([[math.cos(0.4), 0.0, math.sin(0.4), 0.0]]), np.array([[0.1, 0.2, 0.3]]))
    steps = np.linspace(-0.6, 0.6, 13)
    local = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    local = np.concatenate([local, np.random.default_rng(0).uniform(-0.6, 0.6, (500, 3))])
    points = local @ rotation_matrices(poses.rotation)[0].T + poses.translation[0]
    assert np.abs(penetration(points, mesh, poses) - penetration(points, plain, poses)).max() < 1e-14
    assert np.abs(signed_distance(points, mesh, poses) - signed_distance(points, plain, poses)).max() < 1e-14
    back = decode_geometry(encode_geometry(mesh))
    assert np.array_equal(back.faces, faces) and np.array_equal(back.vertices, x)


def test_the_distance_to_a_mesh_is_that_to_all_its_triangles_by_looking_at_few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of triangles of unlike sizes, slivers among them: near, far, on them, and as near to many."""
    ball = trimesh.creation.icosphere(4)
    box = trimesh.creation.box((8.0, 6.0, 10.0))
    fan = trimesh.Trimesh([[2, 0, 0], [3, 0, 0], [2.5, 1e-9, 0], [2.5, 0, 2]], [[0, 1, 2], [2, 1, 3]], process=False)
    mesh = trimesh.util.concatenate([ball, box, fan])
    solid = Solid(np.ascontiguousarray(mesh.vertices), *2 * (np.ascontiguousarray(mesh.faces, np.int32),))
    rng, looked = np.random.default_rng(4), []
    points = np.concatenate(
        [rng.uniform(-6, 6, (80, 3)), 0.99 * ball.vertices[:80], mesh.vertices[-9:], np.zeros((1, 3))]
    )
    original = mesh_module.to_triangles
    monkeypatch.setattr(mesh_module, "to_triangles", lambda p, *t: (looked.append(len(p)), original(p, *t))[1])
    found = distances(points, solid)
    _, expected, _ = trimesh.proximity.closest_point_naive(mesh, points)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert (found[-10:-1] < 1e-15).all()
    assert sum(looked) < 0.1 * len(points) * len(mesh.faces)
    monkeypatch.setattr(mesh_module, "AT_ONCE", 1000)
    assert distances(points, solid).tobytes() == found.tobytes()


def test_inside_is_where_a_mesh_goes_round_as_solid_angles_have_it() -> None:
    """Of a person that passes through itself and of boxes, also where rays hit corners and edges; and in folds."""
    x, faces = person(0.04)
    x = x + 0.12 * np.sin(9.0 * x[:, 1:2]) * np.array([1.0, 0.0, 0.5])
    box = trimesh.creation.box(np.full(3, 0.5))
    boxes = [np.array(box.vertices) + at for at in (np.zeros(3), np.array([0.25, 0.0, 0.0]), np.array([0.0, 0.5, 0.0]))]
    rng = np.random.default_rng(6)
    around = x[rng.integers(0, len(x), 500)] + 0.03 * rng.normal(size=(500, 3))
    grid = np.stack(np.meshgrid(*3 * [np.linspace(-0.45, 0.55, 9)], indexing="ij"), axis=-1).reshape(-1, 3)
    corner = np.concatenate([grid, [[0.2, 0.25, 0.25], [0.4, 0.25, 0.0], [-0.2, 0.0, 0.0]]])
    joined = np.concatenate(boxes), np.concatenate([box.faces + 8 * k for k in range(3)]).astype(np.int32)
    most = 0.0
    for mesh, points in (((x, faces), around), (joined, corner)):
        turns = np.array([turns_about(p, mesh[0][mesh[1]]) for p in points])
        sure = np.abs(turns - turns.round()) < 1e-6  # not on the surface
        inside = are_inside(points, Solid(*mesh, mesh[1]))
        np.testing.assert_array_equal(inside[sure], turns.round()[sure] != 0.0)
        assert 50 < inside.sum() < sure.sum() - 50
        most = max(most, turns[sure].max())
    assert most > 1.5
