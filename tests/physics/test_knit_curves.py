"""Yarns as smooth curves, and their repair round the body: no sample inside, taut, apart."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from closed_meshes import box, outward, sphere, torus
from knit_bodies import brute_depths, knit, samples, wrapped

from nuno_contact.body_shapes.leg import leg_mesh
from nuno_geometry.closest_point import closest_points
from nuno_geometry.mesh_files.mesh import read_closed
from nuno_geometry.tree import build_tree
from nuno_knit.paths import Paths, find_paths
from nuno_knit.repair import CHECKED, CLEAR, LIES, LOST, Repair, Repaired, YarnConfig, repair
from nuno_knit.skin import Skin
from nuno_knit.smooth import PIECES, Smooth, SmoothConfig, sample_curves
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Int, State
from nuno_schemas.operation import Surface, YarnCurves

DEEPEST = 1e-5
"""The bar [m]."""
RADIUS = 4e-5
ASIDE = np.array([1.3e-8, 0.7e-8, 0.0])
RNG = np.random.default_rng(5)


def smooth(fabric: Fabric, x: Float, skin: Surface | None = None, **config: Any) -> YarnCurves:
    made = Smooth().apply(
        SmoothConfig.model_validate({"radius": RADIUS} | config), fabric, State(x, 0.0 * x, 0.0), skin
    )
    assert made.curves is not None
    return made.curves


def stretched(form: str, wales: int, courses: int, across: float, up: float) -> tuple[Fabric, Float]:
    fabric = knit(form, wales, courses)
    return fabric, fabric.position * np.array([across, up, across if form == "tube" else 1.0])


def one_curve(points: Float, ring: bool, number: int) -> Float:
    return sample_curves(points, np.array([0, len(points)]), np.array([ring]), number)[0]


@pytest.mark.parametrize("ring", [False, True])
def test_curves_pass_through_their_points(ring: bool) -> None:
    points = RNG.normal(size=(9, 3))
    points[-1] = points[0] if ring else points[-1]
    assert np.array_equal(one_curve(points, ring, 5)[::5], points)


@pytest.mark.parametrize("ring", [False, True])
def test_directions_are_continuous_also_where_a_ring_closes(ring: bool) -> None:
    """The angle between pieces at a point vanishes as pieces grow short: of first order, by bounded curvature."""
    points = RNG.normal(size=(8, 3))
    points[-1] = points[0] if ring else points[-1]
    worst = []
    for number in (256, 1024, 4096, 16384):
        step = np.diff(one_curve(points, ring, number), axis=0)
        step /= np.linalg.norm(step, axis=1)[:, None]
        at = number * np.arange(1, len(points) - 1)
        before, after = step[at - 1], step[at]
        if ring:
            before, after = np.concatenate([before, step[-1:]]), np.concatenate([after, step[:1]])
        worst.append(float(np.linalg.norm(after - before, axis=1).max()))
    order = np.polyfit(np.log([256, 1024, 4096, 16384]), np.log(worst), 1)[0]
    assert order == pytest.approx(-1.0, abs=0.1)


def test_curves_turn_and_grow_with_their_points() -> None:
    points, turn = RNG.normal(size=(7, 3)), np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    moved = 3.0 * points @ turn.T + np.array([1.0, -2.0, 0.5])
    expected = 3.0 * one_curve(points, False, 6) @ turn.T + np.array([1.0, -2.0, 0.5])
    assert np.allclose(one_curve(moved, False, 6), expected, atol=1e-12)


def test_points_on_a_line_make_a_straight_curve_that_never_turns_back() -> None:
    share = np.array([0.0, 0.01, 0.02, 0.5, 0.51, 1.0])
    along = np.array([1.0, 2.0, -2.0])
    curve = one_curve(share[:, None] * along, False, 20)
    assert np.allclose(np.cross(curve, along), 0.0, atol=1e-14)
    assert (np.diff(curve @ along) > 0.0).all()


def crossings(curves: YarnCurves, number: int) -> list[tuple[bool, bool, bool, float]]:
    """Every crossing of two courses seen from +z: whether the upper piece is a leg's, whether the lower is, whether the
    lower course's is above, and the height between them [m].

    Yarns cross where both have a point: one is moved aside by a little, so that pieces cross between their ends.
    """
    first, yarn = curves.segments(), curves.yarn()
    a, b = curves.points[first], curves.points[first + 1]
    link = (first - curves.ptr[yarn[first]]) // number
    courses = np.diff(curves.ptr) > number + 1
    found = []
    for i in np.flatnonzero(courses[yarn[first]]):
        after = np.flatnonzero((yarn[first] == yarn[first[i]] + 1) & courses[yarn[first]])
        d, e, f = b[i] - a[i], b[after] - a[after], a[after] + ASIDE - a[i]
        cross = d[0] * e[:, 1] - d[1] * e[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            s = (f[:, 0] * e[:, 1] - f[:, 1] * e[:, 0]) / cross
            t = (f[:, 0] * d[1] - f[:, 1] * d[0]) / cross
        for k in np.flatnonzero((s >= 0.0) & (s < 1.0) & (t >= 0.0) & (t < 1.0)):
            height = (a[i] + s[k] * d - a[after[k]] - t[k] * e[k])[2]
            low, high = bool(link[i] % 2 == 0), bool(link[after[k]] % 2 == 0)
            found.append((low if height > 0.0 else high, high if height > 0.0 else low, height > 0.0, abs(height)))
    return found


@pytest.mark.parametrize("stretch", [(1.0, 1.0), (0.8, 1.4), (1.5, 0.9)])
def test_legs_lie_over_heads_and_sinkers(stretch: tuple[float, float]) -> None:
    """The face of plain knit. Every point of two courses is two crossings; at a panel's edges, where the upper course's
    yarn begins and ends, it is one.
    """
    wales, courses = 3, 4
    fabric, x = stretched("panel", wales, courses, *stretch)
    found = crossings(smooth(fabric, x, samples=16), 16)
    assert len(found) == (courses - 1) * (2 * (2 * wales - 2) + 2)
    assert all(upper and not lower for upper, lower, _, _ in found)
    # The lower course's legs pass over sinkers, the upper course's over heads: half each, but at the edges.
    assert sum(below for _, _, below, _ in found) == (courses - 1) * (2 * wales - 2)
    assert min(height for _, _, _, height in found) == pytest.approx(2.0 * RADIUS, rel=0.05)


@pytest.mark.parametrize("stretch", [(1.0, 1.0), (0.8, 1.4), (1.5, 0.9)])
@pytest.mark.parametrize(("links", "least"), [(25.0, 2.0), (15.0, 1.95), (8.0, 1.7), (4.0, 1.5)])
def test_yarns_touch_but_do_not_pass_through_each_other(
    stretch: tuple[float, float], links: float, least: float
) -> None:
    """Where the shortest link is 15 radii or more; below, they do by up to a quarter of their thickness."""
    fabric, x = stretched("panel", 3, 4, *stretch)
    radius = 1e-3 * min(stretch) / links
    curves = smooth(fabric, x, samples=32, radius=radius)
    yarn, nearest = curves.yarn(), np.inf
    for y in range(4):
        own, others = curves.points[yarn == y], curves.points[yarn != y]
        nearest = min(nearest, np.linalg.norm(own[:, None] - others, axis=-1).min())
    assert nearest > least * radius * (1.0 - 1e-9)


def test_on_a_tube_legs_are_outside() -> None:
    fabric, x = stretched("tube", 12, 4, 1.0, 1.0)
    curves = smooth(fabric, x, samples=16)
    paths = find_paths(fabric)
    course = curves.points[curves.ptr[0] : curves.ptr[1]]
    assert np.array_equal(course[0], course[-1]) and paths.rings[0]
    out = np.hypot(course[:-1, 0], course[:-1, 2]).reshape(-1, 2, 16)
    assert (out[:, 0, 8] > out[:, 1, 8] + 1.9 * RADIUS).all()


def test_without_curl_curves_pass_through_the_net() -> None:
    fabric, x = stretched("panel", 3, 3, 1.0, 1.0)
    curves, paths = smooth(fabric, x, samples=8, curl=0.0), find_paths(fabric)
    step = curves.points[:, None] - x[paths.vertex]
    assert np.linalg.norm(step, axis=-1).min(axis=0).max() < 1e-15


@pytest.mark.parametrize("wanted", [4, 9, 12])
def test_links_have_as_many_points_as_asked_for(wanted: int) -> None:
    fabric, x = stretched("tube", 4, 3, 1.0, 1.0)
    assert fabric.springs is not None and fabric.yarns is not None
    points = PIECES * int(np.ceil(wanted / PIECES))
    assert len(smooth(fabric, x, samples=wanted).points) == points * fabric.springs.number + fabric.yarns.number


def off_skin(curves: YarnCurves, x: Float, faces: Int) -> float:
    """How far the deepest sample lies below a radius above the skin [m]."""
    found = closest_points(build_tree(x, faces), samples(curves.points, curves.ptr, 6))
    return float(curves.radius[0] - found.distance.min())


@pytest.mark.full
@pytest.mark.parametrize(("low", "high"), [(0.12, 0.7), (0.01, 0.7)])
def test_no_sample_lies_in_the_leg(low: float, high: float) -> None:
    """Yarns of a radius, not lines: what is in the way is the skin moved out by it."""
    x, faces = leg_mesh(96)
    points = wrapped(x, faces, 100, 100, low, high, 0.13)
    assert off_skin(smooth(knit("tube", 50, 99), points, Surface(x, faces)), x, faces) < DEEPEST


@pytest.mark.parametrize("name", ["leg.obj", "body.obj"])
def test_no_sample_lies_in_a_real_leg(name: str, shared_data: Path) -> None:
    x, faces = read_closed(shared_data / name)
    points = wrapped(x, faces, 60, 60, 0.1, 0.7, 0.09, x[x[:, 0] > 0.0])
    assert off_skin(smooth(knit("tube", 30, 59), points, Surface(x, faces)), x, faces) < DEEPEST


@pytest.mark.full
def test_no_sample_lies_in_the_leg_by_brute_force() -> None:
    x, faces = leg_mesh(12)
    points = wrapped(x, faces, 4, 4, 0.1, 0.7, 0.13)
    curves = smooth(knit("tube", 2, 3), points, Surface(x, faces), samples=CHECKED)
    assert brute_depths(samples(curves.points, curves.ptr, 3), x, faces).max() < -RADIUS + DEEPEST


def test_a_net_that_is_not_finite_is_refused() -> None:
    fabric, x = stretched("panel", 2, 2, 1.0, 1.0)
    x[3, 1] = np.nan
    skin = Surface(*leg_mesh(12))
    for below in (None, skin):
        with pytest.raises(BadInput, match="finite"):
            smooth(fabric, x, below)


def test_yarns_are_as_thick_as_their_linear_densities_say() -> None:
    """Round yarns of one bulk density: areas are as densities. All leave as much room as the thickest needs."""
    yarns = ({"name": "thin", "k": 1.0, "density": "22 dtex"}, {"name": "covered", "k": 1.0, "density": "66 dtex"})
    fabric = knit("tube", 6, 8, yarns=yarns)
    made = smooth(fabric, fabric.position, radius=None)
    area = np.array([float((made.radius[made.kind == kind] ** 2).mean()) for kind in (0, 1)])
    assert area[1] / area[0] == pytest.approx(3.0, rel=1e-12)
    thickest = smooth(fabric, fabric.position, radius=float(made.radius.max()))
    assert np.array_equal(made.points, thickest.points) and (thickest.radius == made.radius.max()).all()
    given = smooth(fabric, fabric.position, radius=["10 um", "30 um"])
    assert given.radius == pytest.approx(np.array([1e-5, 3e-5])[given.kind])
    with pytest.raises(BadInput, match="one radius for each kind") as refused:
        smooth(fabric, fabric.position, radius=[1e-5, 2e-5, 3e-5])
    assert refused.value.limit == "2: thin, covered"


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
def test_knit_repair_no_sample_lies_in_the_leg(number: int, low: float, high: float) -> None:
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
def test_knit_repair_no_sample_lies_in_a_real_leg(name: str, shared_data: Path) -> None:
    x, faces = read_closed(shared_data / name)
    tree = build_tree(x, faces)
    paths = find_paths(knit("tube", 60, 119))
    left = x[x[:, 0] > 0.0]
    points = wrapped(x, faces, 120, 120, 0.05, 0.7, 0.09, left)
    found = repair(paths, points, Skin(x, faces), TOLERANCE)
    assert closest_points(tree, samples(found.points, found.ptr, CHECKED)).distance.min() > -DEEPEST


@pytest.mark.full
def test_knit_repair_no_sample_lies_in_the_leg_by_brute_force() -> None:
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
