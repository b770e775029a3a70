"""Yarns that go round the body: nowhere inside, no point moved, taut, straight where nothing is in the way."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from closed_meshes import box, outward, sphere, torus
from knit_bodies import brute_depths, knit, samples, wrapped

from nuno_contact.figures.leg import leg_mesh
from nuno_geometry.closest_point import closest_points
from nuno_geometry.files.mesh import read_closed
from nuno_geometry.tree import build_tree
from nuno_knit.paths import Paths, find_paths
from nuno_knit.repair import CHECKED, CLEAR, LIES, LOST, Repair, Repaired, YarnConfig, repair
from nuno_knit.skin import Skin
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Int, State
from nuno_schemas.operation import Surface

DEEPEST = 1e-5
"""The bar [m]."""
TOLERANCE = 1e-6


def link(*places: list[float]) -> tuple[Paths, Float]:
    """One yarn through places."""
    n = len(places)
    return Paths(
        np.arange(n, dtype=np.int32), np.array([0, n]), np.zeros(1, np.int32), ("yarn",), np.ones(1)
    ), np.array(places)


def length(found: Repaired) -> float:
    return float(np.linalg.norm(np.diff(found.points, axis=0), axis=1).sum())


def on_mesh(x: Float, faces: Int, points: Float) -> Float:
    return closest_points(build_tree(x, faces), points).point


@pytest.mark.quick(low=[0.12])
@pytest.mark.parametrize(("number", "low", "high"), [(150, 0.12, 0.7), (150, 0.01, 0.7)])
def test_no_sample_lies_in_the_leg(number: int, low: float, high: float) -> None:
    """150 x 150 points on the procedural leg, from the ankle up and with heel and foot; links cut it before."""
    x, faces = leg_mesh(96)
    paths = find_paths(knit("tube", number // 2, number - 1))
    points = wrapped(x, faces, number, number, low, high, 0.13)
    tree = build_tree(x, faces)
    before = closest_points(tree, samples(points[paths.vertex], paths.ptr, 3)).distance
    assert (before < -DEEPEST).sum() > 1000
    found = repair(paths, points, Skin(x, faces), TOLERANCE)
    assert not (found.status == LOST).any()
    assert closest_points(tree, samples(found.points, found.ptr, CHECKED)).distance.min() > -DEEPEST


@pytest.mark.parametrize("name", ["leg.obj", "body.obj"])
def test_no_sample_lies_in_a_real_leg(name: str, shared_data: Path) -> None:
    x, faces = read_closed(shared_data / name)
    tree = build_tree(x, faces)
    paths = find_paths(knit("tube", 60, 119))
    left = x[x[:, 0] > 0.0]
    points = wrapped(x, faces, 120, 120, 0.05, 0.7, 0.09, left)
    found = repair(paths, points, Skin(x, faces), TOLERANCE)
    assert closest_points(tree, samples(found.points, found.ptr, CHECKED)).distance.min() > -DEEPEST


@pytest.mark.full
def test_no_sample_lies_in_the_leg_by_brute_force() -> None:
    """Distances to every triangle and winding numbers, for a coarse leg whose links cut deep; its own vertices, too."""
    x, faces = leg_mesh(12)
    paths = find_paths(knit("tube", 3, 5))
    points = wrapped(x, faces, 6, 6, 0.1, 0.7, 0.13)
    corner = np.argmin(np.linalg.norm(x - points[:, None], axis=-1), axis=1)
    for placed in (points, x[corner]):
        assert brute_depths(samples(placed[paths.vertex], paths.ptr, 3), x, faces).max() > 100.0 * DEEPEST
        found = repair(paths, placed, Skin(x, faces), TOLERANCE)
        assert brute_depths(samples(found.points, found.ptr, 8), x, faces).max() < DEEPEST


def test_points_stay_and_keep_their_order() -> None:
    x, faces = leg_mesh(48)
    paths = find_paths(knit("tube", 20, 39))
    points = wrapped(x, faces, 40, 40, 0.1, 0.7, 0.13)
    found = repair(paths, points, Skin(x, faces), TOLERANCE)
    own = found.vertex >= 0
    assert np.array_equal(found.vertex[own], paths.vertex)
    assert found.points[own].tobytes() == points[paths.vertex].tobytes()
    for y in range(paths.number):
        mine = found.vertex[found.ptr[y] : found.ptr[y + 1]]
        assert mine[mine >= 0].tolist() == paths.vertex[paths.ptr[y] : paths.ptr[y + 1]].tolist()


def test_points_gained_lie_on_edges_of_their_faces() -> None:
    x, faces = leg_mesh(48)
    points = wrapped(x, faces, 40, 40, 0.1, 0.7, 0.13)
    found = repair(find_paths(knit("tube", 20, 39)), points, Skin(x, faces), TOLERANCE)
    new = found.vertex < 0
    assert new.sum() > 100
    a, b, c = (x[faces[found.face[new], k]] for k in range(3))
    p = found.points[new]
    off = [np.linalg.norm(np.cross(p - s, e - s), axis=1) / np.linalg.norm(e - s, axis=1) for s, e in
           ((a, b), (b, c), (c, a))]  # fmt: skip
    assert np.min(off, axis=0).max() < 1e-12


def test_a_link_round_the_edge_of_a_box_bends_there() -> None:
    """Ends equally far from the edge: the shortest way over both faces is in the plane of the mean normal."""
    x, faces = box((2.0, 2.0, 2.0))
    paths, ends = link([0.7, 1.0, 0.2], [1.0, 0.7, -0.1])
    found = repair(paths, ends, Skin(x, faces), TOLERANCE)
    assert length(found) == pytest.approx(np.hypot(0.6, 0.3), rel=1e-12)
    bends = found.points[1:-1]
    assert np.allclose(bends[np.argmax(bends[:, :2].sum(axis=1))], [1.0, 1.0, 0.05], atol=1e-12)


def test_links_on_a_sphere_become_arcs_of_great_circles() -> None:
    """Of order two in the mesh's size: a sphere's mesh and its chords lie below it by squares of their lengths."""
    a, b = np.array([0.9, 0.3, 0.2]), np.array([0.2, 0.4, 0.8])
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    errors = []
    for rings in (12, 24, 48, 96):
        x, faces = sphere(rings)
        paths, _ = link([0, 0, 0], [0, 0, 0])
        found = repair(paths, on_mesh(x, faces, np.stack([a, b])), Skin(x, faces), 1e-9)
        errors.append(float(np.arccos(a @ b)) - length(found))
    order = np.polyfit(np.log([1 / 12, 1 / 24, 1 / 48, 1 / 96]), np.log(np.abs(errors)), 1)[0]
    assert order == pytest.approx(2.0, abs=0.15)


def test_over_a_hollow_links_stay_straight() -> None:
    """Inside of a ring's hole, along the axis, the surface curves away from the link's ends."""
    x, faces = torus(48, 32)
    top, bottom = on_mesh(x, faces, np.array([[0.71, 0.15, 0.0], [1.0, 0.3, 0.1]]))
    paths, ends = link(list(top), list(bottom))
    hollow = on_mesh(x, faces, np.array([[0.7, 0.0, 0.12], [0.7, 0.0, -0.12]]))
    found = repair(link(list(hollow[0]), list(hollow[1]))[0], hollow, Skin(x, faces), TOLERANCE)
    assert found.status.tolist() == [CLEAR] and len(found.points) == 2
    assert repair(paths, ends, Skin(x, faces), TOLERANCE).status.tolist() == [LIES]


def test_links_that_float_above_the_skin_stay_straight_until_they_would_cut_it() -> None:
    x, faces = sphere(48)
    far = np.array([[1.2, 0.0, -0.4], [1.2, 0.0, 0.4]])
    near = np.array([[0.95, 0.0, -0.4], [0.95, 0.0, 0.4]])
    skin = Skin(x, faces)
    assert repair(link([0.0], [0.0])[0], far, skin, TOLERANCE).status.tolist() == [CLEAR]
    found = repair(link([0.0], [0.0])[0], near, skin, TOLERANCE)
    assert found.status.tolist() == [LIES]
    assert closest_points(skin.tree, samples(found.points, found.ptr, CHECKED)).distance.min() > -2.0 * TOLERANCE


def test_a_link_through_a_plate_goes_round_its_edge() -> None:
    """Its ends face opposite ways, so that no plane holds it and the normals: it is halved until planes do."""
    x, faces = box((1.0, 0.01, 1.0))
    paths, ends = link([0.497, 0.005, 0.0], [0.497, -0.005, 0.02])
    found = repair(paths, ends, Skin(x, faces), TOLERANCE)
    assert found.status.tolist() == [LIES]
    assert brute_depths(samples(found.points, found.ptr, 8), x, faces).max() < DEEPEST


def test_without_skin_links_are_straight() -> None:
    fabric = knit("panel", 3, 4)
    paths = find_paths(fabric)
    found = repair(paths, fabric.position, None, TOLERANCE)
    assert np.array_equal(found.points, fabric.position[paths.vertex])
    assert (found.face < 0).all() and not found.normal.any()


def test_paths_follow_every_link_once() -> None:
    for form, wales, courses in (("panel", 4, 3), ("tube", 2, 1), ("tube", 5, 4)):
        fabric = knit(form, wales, courses)
        assert fabric.springs is not None and fabric.yarns is not None
        paths = find_paths(fabric)
        pairs = {tuple(sorted(pair)) for pair in paths.pairs.tolist()}
        assert len(pairs) == len(paths.pairs) == fabric.springs.number
        assert pairs == {tuple(sorted(pair)) for pair in fabric.springs.pairs().tolist()}
        assert paths.rings.tolist() == [form == "tube"] * courses + [False] * (paths.number - courses)


def test_the_operation_says_what_it_did() -> None:
    x, faces = outward(*leg_mesh(24))
    fabric = knit("tube", 10, 19)
    points = wrapped(x, faces, 20, 20, 0.1, 0.7, 0.13)
    state, config = State(points, 0.0 * points, 0.0), YarnConfig(radius=2e-5)
    outcome = Repair().apply(config, fabric, state, Surface(x, faces))
    assert outcome.curves is not None and outcome.facts["lost"] == 0
    assert outcome.facts["links"] == fabric.springs.number if fabric.springs else 0
    assert outcome.facts["inserted"] == len(outcome.curves.points) - len(find_paths(fabric).vertex) > 0
    assert 0.0 <= outcome.facts["deepest"] <= DEEPEST
    assert np.allclose(np.linalg.norm(outcome.curves.normal, axis=1), 1.0, atol=1e-12)
    assert (outcome.curves.radius == 2e-5).all()


def test_cloth_without_yarns_is_refused() -> None:
    fabric = knit("panel", 2, 2)
    plain = Fabric("net", fabric.position, fabric.velocity, fabric.mass, fabric.pinned, fabric.faces, fabric.springs)
    with pytest.raises(BadInput, match="no yarns"):
        Repair().apply(YarnConfig(), plain, State(fabric.position, fabric.velocity, 0.0), None)
