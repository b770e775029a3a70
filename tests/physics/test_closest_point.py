"""The closest point of a mesh: as brute force finds it, at the mesh's order, on the right side, always the same."""

from __future__ import annotations

import closed_meshes as meshes
import numpy as np
import pytest

from nuno_geometry.closest_point import closest_points
from nuno_geometry.tree import build_tree
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_wrinkle.lines import scan_triangles


def soup(seed: int, count: int) -> tuple[Float, Int]:
    """Triangles that share vertices at random: slivers, some without area, some points, some repeated."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(count, 3))
    x[: count // 4] = x[0] + np.linspace(0, 1, count // 4)[:, None] * (x[1] - x[0])
    x[count // 4 : count // 2] *= [1.0, 1.0, 1e-9]
    faces = rng.integers(0, count, size=(2 * count, 3)).astype(np.int32)
    faces[::17, 2] = faces[::17, 1]
    faces[::41] = faces[::41, :1]
    faces[1::13] = faces[0]
    return x, faces


def places(seed: int, x: Float, faces: Int) -> Float:
    """Points near, far, on vertices, on edges and in triangles."""
    rng = np.random.default_rng(seed)
    corners = x[faces[rng.integers(0, len(faces), 60)]]
    weights = rng.dirichlet(np.ones(3), 60)
    middle = 0.5 * (corners[:, 0] + corners[:, 1])
    inside = np.einsum("fi,fij->fj", weights, corners)
    near = inside + 1e-3 * rng.normal(size=inside.shape)
    far = 1e3 * rng.normal(size=(60, 3))
    return np.concatenate([2 * rng.normal(size=(200, 3)), far, corners[:, 2], middle, inside, near])


def slack(x: Float, faces: Int) -> Float:
    """(f,) how far rounding may put the closest point of a triangle off: eps / sin, at most its width."""
    b, c = (x[faces[:, k]] - x[faces[:, 0]] for k in (1, 2))
    area, size = np.linalg.norm(np.cross(b, c), axis=1), np.linalg.norm(b, axis=1) * np.linalg.norm(c, axis=1)
    longest = np.maximum(np.linalg.norm(b, axis=1), np.linalg.norm(c, axis=1))
    with np.errstate(divide="ignore", invalid="ignore"):
        steep, width = np.nan_to_num(size / area, nan=np.inf), np.nan_to_num(area / longest)
    return np.asarray(4e-15 + np.minimum(4e-15 * steep, width))


@pytest.mark.parametrize("count", [3, 9, 400])
def test_a_scan_of_all_triangles_finds_what_the_tree_finds(count: int) -> None:
    x, faces = soup(2, count)
    p = places(2, x, faces)
    found = closest_points(build_tree(x, faces), p)
    face, weights, distance = scan_triangles(p, x, faces)
    assert np.array_equal(face, found.face) and weights.tobytes() == found.weights.tobytes()
    np.testing.assert_allclose(distance, np.abs(found.distance), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("count", [3, 5, 9, 33, 400])
@pytest.mark.parametrize("seed", [0, 1])
def test_brute_force_finds_no_nearer_triangle(seed: int, count: int) -> None:
    x, faces = soup(seed, count)
    p = places(seed, x, faces)
    found = closest_points(build_tree(x, faces), p)
    each = meshes.brute_distance(p, x, faces)
    scale = 1.0 + np.linalg.norm(p, axis=1)
    assert (np.abs(found.distance) >= each.min(axis=1) - 4e-15 * scale).all()
    assert (np.abs(found.distance) <= (each + slack(x, faces) * scale[:, None]).min(axis=1)).all()
    there = np.einsum("ni,nij->nj", found.weights, x[faces[found.face]])
    assert np.abs(there - found.point).max() < 4e-15 * np.abs(x).max()
    assert np.abs(np.linalg.norm(p - there, axis=1) - np.abs(found.distance)).max() < 4e-13
    assert (found.weights >= -1e-15).all() and np.abs(found.weights.sum(axis=1) - 1.0).max() < 1e-15


def test_start_threads_and_order_change_no_bit() -> None:
    x, faces = meshes.torus(40, 24)
    tree, rng = build_tree(x, faces), np.random.default_rng(2)
    # Vertices and middles of edges are equally near to several triangles.
    p = np.concatenate([x, 0.5 * (x[faces[:, 0]] + x[faces[:, 1]]), rng.normal(size=(2000, 3))])
    one = closest_points(tree, p, threads=1)
    order = rng.permutation(len(p))
    many = closest_points(tree, p[order], rng.integers(0, len(faces), len(p)).astype(np.int32))
    for name in ("point", "face", "weights", "distance"):
        assert getattr(one, name)[order].tobytes() == getattr(many, name).tobytes()
    lowest = np.array([np.flatnonzero((faces == i).any(axis=1)).min() for i in range(len(x))])
    assert np.array_equal(one.face[: len(x)], lowest)


@pytest.mark.parametrize("count", [3, 33, 400])
def test_whatever_the_start_is_the_nearest_triangle_is_found(count: int) -> None:
    """The search goes up from the start, so that each start is a way of its own through the tree."""
    x, faces = soup(3, count)
    tree, p = build_tree(x, faces), places(3, x, faces)[::7]
    found = closest_points(tree, p)
    for start in range(len(faces)):
        again = closest_points(tree, p, np.full(len(p), start, np.int32))
        assert all(a.tobytes() == b.tobytes() for a, b in zip(found, again, strict=True))


@pytest.mark.parametrize("count", [1, 8, 9, 64, 65, 500, 4097])
def test_every_node_and_leaf_is_a_child_of_its_parent(count: int) -> None:
    """Last nodes of levels have fewer than eight children."""
    x = np.random.default_rng(7).normal(size=(3 * count, 3))
    tree = build_tree(x, np.arange(3 * count, dtype=np.int32).reshape(-1, 3))
    there = np.isfinite(tree.boxes.reshape(-1, 6, 8)[:, 0])
    node, lane = np.nonzero(there)
    first = tree.child[node]
    inner = first >= 0
    assert np.array_equal(tree.parent[(first + lane)[inner]], node[inner])
    assert np.array_equal(tree.leaf_parent[(-1 - first + lane)[~inner]], node[~inner])
    assert tree.parent[0] == -1 and inner.sum() == len(tree.parent) - 1 and (~inner).sum() == len(tree.leaf_parent)


@pytest.mark.parametrize(
    ("name", "mesh"),
    [
        pytest.param("torus", meshes.torus(30, 16), marks=pytest.mark.full),
        ("plate", meshes.box((1.0, 1e-4, 1.0))),
        ("needle", meshes.box((1e-3, 2.0, 1e-3))),
    ],
)
def test_sign_is_that_of_the_winding_number(name: str, mesh: tuple[Float, Int]) -> None:
    """Thin plates and needles; the middle of a ring, where the nearest face is seen from a hollow."""
    x, faces = mesh
    rng = np.random.default_rng(3)
    size = np.ptp(x, axis=0)
    p = (rng.random((3000, 3)) - 0.5) * size * 1.5
    corner = x[rng.integers(0, len(x), 500)]
    p = np.concatenate([p, corner * (1 + 1e-6 * rng.normal(size=corner.shape))])
    found = closest_points(build_tree(x, faces), p)
    inside = meshes.winding_number(p, x, faces) > 0.5
    clear = np.abs(found.distance) > 1e-12
    assert inside.any() and not inside.all()
    assert np.array_equal((found.distance < 0.0)[clear], inside[clear])


def test_sign_where_one_face_alone_would_be_wrong() -> None:
    """Two spikes on a fan: behind a sharp corner, single faces' normals point away from points outside."""
    x = np.array([[0, 0, 0], [1, 0.02, 0.3], [1, -0.3, -0.05], [1, 0.05, -0.3], [3, 0.0, 0.0]], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [4, 2, 1], [4, 3, 2], [4, 1, 3]], np.int32)
    x, faces = meshes.outward(x, faces)
    rng = np.random.default_rng(4)
    p = x[rng.integers(0, 5, 4000)] + rng.normal(size=(4000, 3)) * 0.2
    found = closest_points(build_tree(x, faces), p)
    inside = meshes.winding_number(p, x, faces) > 0.5
    assert np.array_equal(found.distance < 0.0, inside)


def slopes(errors: list[float], ratio: float) -> Float:
    return np.log(np.array(errors[:-1]) / np.array(errors[1:])) / np.log(ratio)


def test_distance_to_a_sphere_and_a_ring_converges_at_order_two() -> None:
    rng = np.random.default_rng(5)
    way = rng.normal(size=(2000, 3))
    p = way / np.linalg.norm(way, axis=1, keepdims=True) * rng.uniform(0.6, 1.6, (2000, 1))
    exact = np.linalg.norm(p, axis=1) - 1.0
    ring = np.hypot(np.hypot(p[:, 0], p[:, 2]) - 1.0, p[:, 1]) - 0.3
    errors = {"sphere": [], "ring": []}  # type: dict[str, list[float]]
    for rings in (12, 24, 48):
        for name, mesh, truth in (
            ("sphere", meshes.sphere(rings), exact),
            ("ring", meshes.torus(4 * rings, 2 * rings), ring),
        ):
            distance = closest_points(build_tree(*mesh), p).distance
            errors[name].append(float(np.abs(distance - truth).max()))
    for name, found in errors.items():
        assert np.all(np.abs(slopes(found, 2.0) - 2.0) < 0.15), (name, found)


def test_distance_to_a_box_is_exact() -> None:
    half = np.array([0.5, 0.2, 1.0])
    p = np.random.default_rng(6).uniform(-1.5, 1.5, (3000, 3))
    q = np.abs(p) - half
    exact = np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0)
    found = closest_points(build_tree(*meshes.box((1.0, 0.4, 2.0))), p)
    assert np.abs(found.distance - exact).max() < 1e-15


def test_points_without_a_place_are_refused() -> None:
    tree = build_tree(*meshes.box((1, 1, 1)))
    with pytest.raises(BadInput, match=r"points\[1\]"):
        closest_points(tree, np.array([[0.0, 0, 0], [np.nan, 0, 0]]))
