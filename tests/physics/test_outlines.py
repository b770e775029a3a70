"""Where outlines cross and what lies inside of them: exactly, also where lines are all but parallel."""

from __future__ import annotations

import itertools
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from sewing_patterns import FEW, REAL, read_pattern

from nuno.scene.files import SceneFiles
from nuno_cloth.models.delaunay import is_inside
from nuno_cloth.sewing.curves import Bezier, Curve
from nuno_cloth.sewing.fill import triangulate_inside
from nuno_cloth.sewing.pattern_file import find_crossing
from nuno_cloth.sewing.refine import _locate
from nuno_dye.supplies.regions import Polygon, cover
from nuno_schemas.fabric import Float
from nuno_schemas.vectors import sides

SEED = 20261128


def line(start: Float, end: Float) -> Bezier:
    return Bezier(np.stack([start, end]))


def notched(start: Float, end: Float, at: float, wide: float, deep: float) -> list[Curve]:
    """A straight edge with a notch of three corners; more than 0 is to the left."""
    way = end - start
    left = np.array([-way[1], way[0]]) / np.linalg.norm(way)
    corners = [start, start + at * way, start + (at + 0.5 * wide) * way + deep * left, start + (at + wide) * way, end]
    return [line(a, b) for a, b in itertools.pairwise(corners)]


def turned(curves: list[Curve], angle: float) -> list[Curve]:
    c, s = np.cos(angle), np.sin(angle)
    return [Bezier(curve.points @ np.array([[c, s], [-s, c]])) for curve in curves if isinstance(curve, Bezier)]


def test_notches_and_darts_in_straight_slanted_edges_cross_nothing() -> None:
    """Each outline is simple by its making: two parts of one line, and a corner off it."""
    rng = np.random.default_rng(SEED)
    for _ in range(400):
        start, end = np.array([0.0, rng.uniform(-0.02, 0.02)]), np.array([0.36, rng.uniform(-0.02, 0.02)])
        wide, deep = rng.uniform(0.002, 0.08), rng.choice([-1.0, 1.0]) * rng.uniform(0.002, 0.08)
        hem = notched(start, end, rng.uniform(0.1, 0.8), wide, deep)
        corners = [end, np.array([0.36, 0.4]), np.array([0.0, 0.4]), start]
        rest = [line(a, b) for a, b in itertools.pairwise(corners)]
        assert find_crossing(turned([*hem, *rest], rng.uniform(0.0, 6.0))) is None


@pytest.mark.quick(name=FEW)
@pytest.mark.parametrize("name", REAL)
def test_real_patterns_may_be_notched_in_any_straight_edge(name: str, shared_data: Path) -> None:
    pattern, rng, number = (
        read_pattern(SceneFiles(shared_data / "patterns"), f"{name}.json"),
        np.random.default_rng(7),
        0,
    )
    for panel in pattern.panels.values():
        curves = [edge.curve for edge in panel.edges]
        for k, curve in enumerate(curves):
            if isinstance(curve, Bezier) and len(curve.points) == 2 and panel.edges[k].length > 0.1:
                # Out of the panel, where no other edge is.
                deep = -np.sign(panel.area) * 0.003
                cut = notched(*curve.points, rng.uniform(0.3, 0.6), rng.uniform(0.01, 0.1), deep)
                assert find_crossing([*curves[:k], *cut, *curves[k + 1 :]]) is None, (panel.name, k)
                number += 1
    assert number > 2


@pytest.mark.parametrize(
    ("corners", "edges", "place"),
    [
        ([(0, 0), (10, 10), (10, 0), (0, 8)], (0, 2), (40 / 9, 40 / 9)),
        ([(0, 0), (10, 0), (10, 5), (4, 0), (0, 5)], (0, 2), (4, 0)),  # a corner on another edge
        ([(0, 0), (10, 0), (10, 5), (8, 0), (3, 0), (3, 5)], (0, 2), (8, 0)),  # an edge that runs back along another
    ],
)
def test_what_crosses_or_touches_is_found_with_its_place(
    corners: list[tuple[float, float]], edges: tuple[int, int], place: tuple[float, float]
) -> None:
    points = np.array(corners, float)
    found = find_crossing([line(a, b) for a, b in zip(points, np.roll(points, -1, axis=0), strict=True)])
    assert found is not None and found[:2] == edges
    np.testing.assert_allclose(found[2], place, atol=1e-12)


def test_signs_are_those_of_fractions() -> None:
    rng = np.random.default_rng(SEED)
    a, b = rng.uniform(-1.0, 1.0, (2, 3000, 2))
    c = a + rng.uniform(-2.0, 2.0, (3000, 1)) * (b - a)  # on the line, but for rounding
    found = sides(a, b, c)
    for k in range(0, 3000, 10):
        (x, y), (u, v), (p, q) = ([Fraction(value) for value in point[k].tolist()] for point in (a, b, c))
        turn = (u - x) * (q - y) - (v - y) * (p - x)
        assert found[k] == (turn > 0) - (turn < 0)
    np.testing.assert_array_equal(found, -sides(b, a, c))
    assert {-1, 1} <= set(found.tolist()) and not sides(a, b, a).any()


def test_each_point_is_in_one_of_two_polygons_that_share_a_side() -> None:
    """Points on the side, but for rounding: a half-open rule, in exact signs, gives each to one."""
    rng = np.random.default_rng(SEED)
    for _ in range(20):
        low, high = np.array([rng.uniform(0.2, 0.8), 0.0]), np.array([rng.uniform(0.2, 0.8), 1.0])
        left = np.array([[0.0, 0.0], low, high, [0.0, 1.0]])
        right = np.array([low, [1.0, 0.0], [1.0, 1.0], high])
        points = low + rng.uniform(0.01, 0.99, (200, 1)) * (high - low)
        np.testing.assert_array_equal(is_inside(points, left) ^ is_inside(points, right), True)


def test_each_cell_is_dyed_once_where_two_parts_share_a_side() -> None:
    """Also where the side, written once each way, goes through the middles of cells."""
    rng, shape, size = np.random.default_rng(SEED), (40, 40), 0.0025
    for _ in range(30):
        low, high = (rng.integers(2, 38) + 0.5) * size, (rng.integers(2, 38) + 0.5) * size
        left = Polygon(shape="polygon", points=[(0, 0), (low, 0), (high, 0.1), (0, 0.1)])
        right = Polygon(shape="polygon", points=[(high, 0.1), (low, 0), (0.1, 0), (0.1, 0.1)])
        parts = [cover(part, shape, size).astype(int) for part in (left, right)]
        np.testing.assert_array_equal(parts[0] + parts[1], 1)


def test_a_notch_on_one_line_has_triangles_as_large_as_itself() -> None:
    rng = np.random.default_rng(SEED)
    for _ in range(40):
        way = rng.uniform(-1.0, 1.0, 2)
        left = np.array([-way[1], way[0]])
        along = [way * s for s in (0.0, 0.3, 0.45, 0.7, 1.0)]
        outline = np.array([*along[:2], 0.37 * way + 0.1 * left, *along[2:], way + left, left])
        faces = triangulate_inside(outline, len(outline))
        u, v = (outline[faces[:, k]] - outline[faces[:, 0]] for k in (1, 2))
        whole = 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
        assert whole.sum() == pytest.approx((1.0 - 0.5 * 0.15 * 0.1) * (way @ way), rel=1e-9) and (whole > 0.0).all()


def test_a_triangle_without_area_holds_no_point() -> None:
    corners = np.array([[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]], [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]])
    of, weight = _locate(corners, np.array([[0.2, 0.1], [0.9, 0.0]]))
    assert of.tolist() == [1, 1]
    np.testing.assert_allclose(weight, [[0.7, 0.2, 0.1], [0.1, 0.9, 0.0]], atol=1e-12)
