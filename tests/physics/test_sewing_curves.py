"""Edges of panels: lengths and areas by closed forms, and polygons as long as what they stand for."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from nuno_cloth.sewing.curves import Arc, Bezier, Curve, area_under, draw, length_of, spread, turning_of

START, END = np.array([0.1, 0.2]), np.array([0.5, -0.1])
CURVES = {
    "quadratic": Bezier(np.array([[0.0, 0.0], [0.3, 0.4], [0.5, 0.0]])),
    "cubic": Bezier(np.array([[0.0, 0.0], [0.1, 0.3], [0.4, 0.2], [0.5, -0.1]])),
    "with an inflection": Bezier(np.array([[0.0, 0.0], [0.3, 0.3], [0.2, -0.3], [0.5, 0.0]])),
    "quarter": Arc.between(np.array([1.0, 0.0]), np.array([0.0, 1.0]), 1.0, large=False, right=True),
    "three quarters": Arc.between(np.array([1.0, 0.0]), np.array([0.0, 1.0]), 1.0, large=True, right=True),
}


def sides(points: np.ndarray) -> np.ndarray:
    return np.asarray(np.hypot(*np.diff(points, axis=0).T))


def test_a_parabola_has_its_closed_length_and_two_thirds_of_its_triangle() -> None:
    """y = x^2 from -1 to 1: length sqrt(5) + asinh(2) / 2; over its chord 2/3 of the control points' triangle."""
    curve = Bezier(np.array([[-1.0, 1.0], [0.0, -1.0], [1.0, 1.0]]))
    assert length_of(curve) == pytest.approx(np.sqrt(5.0) + np.arcsinh(2.0) / 2.0, rel=1e-9)
    closed = area_under(curve) + area_under(Bezier(np.array([[1.0, 1.0], [-1.0, 1.0]])))
    assert closed == pytest.approx(2.0 / 3.0 * 2.0, rel=1e-12)


@pytest.mark.parametrize(("right", "large"), [(r, big) for r in (False, True) for big in (False, True)])
def test_an_arc_is_on_its_circle_and_bulges_to_its_side(right: bool, large: bool) -> None:
    radius = 0.3
    arc = Arc.between(START, END, radius, large, right)
    t = np.linspace(0.0, 1.0, 21)
    np.testing.assert_allclose(arc.at(np.array([0.0, 1.0])), [START, END], atol=1e-15)
    np.testing.assert_allclose(np.hypot(*(arc.at(t) - arc.centre).T), radius, rtol=1e-14)
    chord = END - START
    way = arc.at(np.array([0.5]))[0] - START
    assert (chord[0] * way[1] - chord[1] * way[0] < 0.0) == right
    angle = 2.0 * np.arcsin(0.5 * np.hypot(*chord) / radius)
    assert length_of(arc) == pytest.approx(radius * (2.0 * np.pi - angle if large else angle), rel=1e-12)


def test_an_arc_too_small_to_reach_says_what_would() -> None:
    with pytest.raises(ValueError, match=r"at least 0\.25"):
        Arc.between(START, END, 0.2, large=False, right=True)


@pytest.mark.parametrize("name", CURVES)
def test_slopes_and_bends_are_derivatives(name: str) -> None:
    curve, t, h = CURVES[name], np.linspace(0.1, 0.9, 5), 1e-5
    np.testing.assert_allclose(curve.slope(t), (curve.at(t + h) - curve.at(t - h)) / (2 * h), atol=1e-8)
    np.testing.assert_allclose(curve.bend(t), (curve.slope(t + h) - curve.slope(t - h)) / (2 * h), atol=1e-7)


@pytest.mark.parametrize("name", CURVES)
def test_points_part_a_curve_into_equal_arcs(name: str) -> None:
    curve = CURVES[name]

    def between(a: float, b: float) -> float:
        return float(quad(lambda t: float(np.hypot(*curve.slope(np.array([t]))[0])), a, b, epsabs=1e-13)[0])

    t = spread(curve, 7)
    arcs = [between(a, b) for a, b in pairwise(t)]
    np.testing.assert_allclose(arcs, between(0.0, 1.0) / 7, rtol=1e-9)
    assert length_of(curve) == pytest.approx(between(0.0, 1.0), rel=1e-10)


@pytest.mark.parametrize("name", CURVES)
@pytest.mark.parametrize("finer", [1, 2, 5])
def test_a_polygon_is_as_long_as_its_curve(name: str, finer: int) -> None:
    curve: Curve = CURVES[name]
    n = finer * int(np.ceil(turning_of(curve) / (np.pi / 3)))
    points = draw(curve, n)
    assert sides(points).sum() == pytest.approx(length_of(curve), rel=1e-7)
    np.testing.assert_array_equal(points[[0, -1]], curve.at(np.array([0.0, 1.0])))
    assert sides(points).max() < 1.15 * sides(points).min()


def test_a_circles_polygon_misses_half_the_area_of_an_inscribed_one() -> None:
    """Sector minus polygon: R^2 (theta - sin theta) / 2 a side inscribed, half of it where it is as long as the arc."""
    curve, n = CURVES["quarter"], 40
    assert isinstance(curve, Arc)
    points = draw(curve, n)
    (x, y), (dx, dy) = points[:-1].T, np.diff(points, axis=0).T
    missed = area_under(curve) - 0.5 * float((x * dy - y * dx).sum())
    theta = 0.5 * np.pi / n
    assert missed == pytest.approx(0.5 * n * (theta - np.sin(theta)) / 2.0, rel=0.1)
