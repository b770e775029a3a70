"""Patterns in triangles, and sewn: curves, areas and lengths of the cloth as cut, one surface, prints."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from sewing_patterns import FEW, REAL, back, front, panel, pattern, read, read_pattern, stitch, tube
from sewn_surface import angles, areas, lengths, loops, require_surface

from nuno.scene.files import SceneFiles
from nuno_cloth.models.pattern import lay_out
from nuno_cloth.models.triangles import find_edges
from nuno_cloth.sewing.curves import Arc, Bezier, Curve, area_under, draw, length_of, spread, turning_of
from nuno_cloth.sewing.pattern import Pattern, find_openings
from nuno_cloth.sewing.refine import close_short
from nuno_cloth.sewing.sew import Sewn, sew

SPACINGS = [0.007, 0.01, 0.015, 0.03]
quick = pytest.mark.quick(spacing=[0.03], garment=FEW)


@pytest.fixture(scope="module", params=SPACINGS)
def spacing(request: pytest.FixtureRequest) -> float:
    return float(request.param)


@pytest.fixture(scope="module", params=REAL)
def garment(request: pytest.FixtureRequest, spacing: float, shared_data: Path) -> tuple[Pattern, Sewn]:
    cut = read_pattern(SceneFiles(shared_data / "patterns"), f"{request.param}.json")
    return cut, sew(cut, spacing)


@quick
def test_triangles_are_as_large_as_the_panels_and_edges_as_long(garment: tuple[Pattern, Sewn], spacing: float) -> None:
    """Within 0.1 %, by the curves' own integrals, whatever the triangles' size; the promise of segments.ACCURATE."""
    cut, sewn = garment
    area = areas(sewn)
    assert area.min() > 0.0
    for k, one in enumerate(cut.panels.values()):
        assert area[sewn.panel == k].sum() == pytest.approx(abs(one.area), rel=1e-3)
        for edge, run in zip(one.edges, sewn.edges[k], strict=True):
            assert np.hypot(*np.diff(sewn.flat[run], axis=0).T).sum() == pytest.approx(edge.length, rel=1e-3)


@quick
def test_a_sewn_garment_is_one_surface(garment: tuple[Pattern, Sewn], spacing: float) -> None:
    """Of Euler's characteristic 2 - (holes): a sphere with as many holes as the pattern has openings."""
    cut, sewn = garment
    require_surface(cut, sewn)
    sides = len(find_edges(sewn.sewn_faces).pairs)
    assert sewn.number - sides + len(sewn.faces) == 2 - len(find_openings(cut))


@quick
def test_triangles_are_well_shaped_away_from_tips_and_short_edges(
    garment: tuple[Pattern, Sewn], spacing: float
) -> None:
    """At least 20 degrees; but where the cloth ends in a tip of less than 60 degrees within 4 sides, or a side of the
    outline is less than half as long as it should be.
    """
    _, sewn = garment
    least = angles(sewn)
    for k, runs in enumerate(sewn.edges):
        outline = sewn.flat[np.concatenate([run[:-1] for run in runs])]
        ahead, behind = np.roll(outline, -1, axis=0) - outline, np.roll(outline, 1, axis=0) - outline
        length = np.hypot(*ahead.T)
        cosine = (ahead * behind).sum(axis=1) / (length * np.roll(length, 1))
        narrow = (cosine > 0.5) | (length < 0.5 * spacing) | (np.roll(length, 1) < 0.5 * spacing)
        own = sewn.panel == k
        middle = sewn.flat[sewn.faces[own]].mean(axis=1)
        far = np.full(len(middle), np.inf)
        for tip in outline[narrow]:
            far = np.minimum(far, np.hypot(*(middle - tip).T))
        assert least[own][far > 4.0 * spacing].min(initial=60.0) >= 20.0, sewn.names[k]


@quick
def test_seams_are_stitched_evenly_from_end_to_end(garment: tuple[Pattern, Sewn], spacing: float) -> None:
    """Each pair is as far along its edge as the other, by its share of the length: so gathers are spread."""
    cut, sewn = garment
    place = {one: k for k, one in enumerate(sewn.names)}
    for seam in sewn.seams:
        (one, k), (other, j) = seam.seam.one, seam.seam.other
        runs = sewn.edges[place[one]][k], sewn.edges[place[other]][j]
        np.testing.assert_array_equal(seam.pairs[:, 0], runs[0])
        np.testing.assert_array_equal(seam.pairs[:, 1], runs[1] if seam.seam.right_wrong else runs[1][::-1])
        np.testing.assert_array_equal(*sewn.merged[seam.pairs].T)
        share = [np.hypot(*np.diff(sewn.flat[run], axis=0).T) for run in seam.pairs.T]
        np.testing.assert_allclose(share[0] / share[0].sum(), share[1] / share[1].sum(), rtol=0.15)
        assert seam.lengths == (cut.edge(seam.seam.one).length, cut.edge(seam.seam.other).length)


@quick
def test_short_sides_are_closed_and_the_garment_stays_one_surface(
    garment: tuple[Pattern, Sewn], spacing: float
) -> None:
    """With its holes. Of each panel 0.1 % of the cloth is left out at most; what stays has the shape it was cut to."""
    cut, sewn = garment
    least = min(3e-3, 0.2 * spacing)
    closed = close_short(sewn, least)
    require_surface(cut, closed)
    assert closed.number - len(find_edges(closed.sewn_faces).pairs) + len(closed.faces) == 2 - len(find_openings(cut))
    np.testing.assert_array_equal(closed.flat, sewn.flat)
    whole, left = (np.bincount(one.panel, areas(one), len(one.names)) for one in (sewn, closed))
    assert (left <= whole).all() and (left >= 0.999 * whole).all()
    assert sewn.number - closed.number <= (lengths(sewn) < least).sum()


@pytest.mark.parametrize("short", [0.4e-3, 1.9e-3])
def test_an_edge_of_a_millimetre_makes_no_small_triangles(tmp_path: Path, short: float) -> None:
    """Beside a seam, and the seam's length is what the rest of it was cut to; a longer one stays."""
    dx = 100.0 * short
    notched = panel((0, 0), (30, 0), (30, 20), (dx, 20), (0, 20), translation=[-15, 100, 15])
    seams = stitch("front[1]", "back[2]"), stitch("front[4]", "back[0]")
    cut = read(tmp_path, pattern({"front": notched, "back": back()}, *seams))
    sewn = sew(cut, 0.02)
    closed = close_short(sewn, 3e-3)
    assert lengths(sewn).min() == pytest.approx(short) and lengths(closed).min() > 5e-3
    assert closed.number == sewn.number - 1 and areas(sewn).sum() - areas(closed).sum() <= 0.5 * short * 0.03
    assert close_short(sewn, 0.5 * short) is sewn
    require_surface(cut, closed)


def test_a_side_is_not_closed_where_that_would_pinch_the_cloth(tmp_path: Path) -> None:
    """A strip that is one triangle wide is left as it is across, from rim to rim."""
    strip = panel((0, 0), (1, 0), (1, 20), (0, 20), translation=[0, 100, 15])
    sewn = sew(read(tmp_path, pattern({"strip": strip})), 0.02)
    closed = close_short(sewn, 0.015)
    require_surface(read(tmp_path, pattern({"strip": strip})), closed)
    assert closed.number > 0.5 * sewn.number


def test_the_shirt_has_a_neck_a_hem_and_two_cuffs(shared_data: Path) -> None:
    cut = read_pattern(SceneFiles(shared_data / "patterns"), "shirt.json")
    sewn = sew(cut, 0.02)
    length = sorted(100.0 * sum(cut.edge(side).length for side in opening) for opening in find_openings(cut))
    assert len(loops(sewn)) == 4
    np.testing.assert_allclose(length, [42.518, 42.518, 68.62, 109.825], atol=0.1)


def test_a_tube_meets_where_it_lies_above_each_other(tmp_path: Path) -> None:
    """Front and back stand upright on each other: each pair of a seam differs in z alone, by 30 cm."""
    cut = read(tmp_path, tube())
    sewn = sew(cut, 0.02)
    require_surface(cut, sewn)
    for seam in sewn.seams:
        one, other = sewn.placed[seam.pairs[:, 0]], sewn.placed[seam.pairs[:, 1]]
        np.testing.assert_allclose(one - other, np.tile([0.0, 0.0, one[0, 2] - other[0, 2]], (len(one), 1)), atol=1e-12)
        assert abs(one[0, 2] - other[0, 2]) == pytest.approx(0.3, rel=1e-12)
    # As seen from outside: the front towards +z, the back, which is drawn from its wrong side, towards -z.
    corner = sewn.placed[sewn.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert np.array_equal(np.sign(normal[:, 2]), np.where(sewn.panel == 0, 1.0, -1.0))
    assert (areas(sewn) > 0.0).all()
    np.testing.assert_array_equal(sewn.warp, [[0.0, 1.0], [0.0, 1.0]])


@pytest.mark.parametrize("spacing", [0.01, 0.05, 0.5])
@pytest.mark.parametrize("right_wrong", [False, True])
def test_a_panel_sewn_to_itself_is_a_tube_at_any_size(right_wrong: bool, spacing: float, tmp_path: Path) -> None:
    seams = [stitch("band[1]", "band[3]")]
    if right_wrong:  # as half a turn in each of two panels, which is a whole one
        seams = [stitch("band[1]", "other[1]", "right_wrong"), stitch("band[3]", "other[3]", "right_wrong")]
    band = panel((0, 0), (30, 0), (30, 6), (0, 6))
    cut = read(tmp_path, pattern({"band": band, **({"other": band} if right_wrong else {})}, *seams))
    sewn = sew(cut, spacing)
    require_surface(cut, sewn)
    assert len(loops(sewn)) == 2 and sewn.number - len(find_edges(sewn.sewn_faces).pairs) + len(sewn.faces) == 0
    assert sewn.inside.sum() == right_wrong and areas(sewn).sum() == pytest.approx(0.3 * 0.06 * (1 + right_wrong))


@pytest.mark.parametrize("spacing", [0.01, 0.03, 0.3])
def test_a_dart_takes_cloth_away_and_leaves_no_hole(spacing: float, tmp_path: Path) -> None:
    darted = panel((0, 0), (12, 0), (15, 14), (18, 0), (30, 0), (30, 20), (0, 20), translation=[-15, 100, 15])
    seams = stitch("front[1]", "front[2]"), stitch("front[4]", "back[2]"), stitch("front[6]", "back[0]")
    cut = read(tmp_path, pattern({"front": darted, "back": back()}, *seams))
    sewn = sew(cut, spacing)
    require_surface(cut, sewn)
    hem = min(find_openings(cut), key=lambda sides: sum(cut.edge(side).length for side in sides))
    assert sum(cut.edge(side).length for side in hem) == pytest.approx(0.12 + 0.12 + 0.3)
    # The tip is one vertex, of the panel's inside once the dart is sewn.
    tip = sewn.merged[sewn.edges[0][1][-1]]
    assert all(tip not in loop for loop in loops(sewn))


@pytest.mark.quick(spacing=[0.015, 0.03])
@pytest.mark.parametrize("spacing", SPACINGS)
def test_a_sector_is_as_large_as_its_closed_form_says(spacing: float, tmp_path: Path) -> None:
    """A quarter of a ring between 20 and 60 cm, as a circle skirt is cut: pi (60^2 - 20^2) / 4."""
    arcs = {1: {"type": "circle", "params": [60.0, 0, 1]}, 3: {"type": "circle", "params": [20.0, 0, 0]}}
    cut = read(tmp_path, pattern({"skirt": panel((20, 0), (60, 0), (0, 60), (0, 20), curves=arcs)}))
    assert 1e4 * areas(sew(cut, spacing)).sum() == pytest.approx(np.pi * (60**2 - 20**2) / 4.0, rel=1e-3)


def test_gathers_have_as_many_stitches_as_the_longer_edge_wants(tmp_path: Path) -> None:
    wide = front(width=90.0)
    cut = read(tmp_path, pattern({"top": front(), "ruffle": wide}, stitch("top[0]", "ruffle[2]")))
    sewn = sew(cut, 0.02)
    assert sewn.seams[0].lengths == pytest.approx((0.3, 0.9)) and len(sewn.seams[0].pairs) == 46
    for run, step in zip(sewn.seams[0].pairs.T, (0.3 / 45, 0.9 / 45), strict=True):
        np.testing.assert_allclose(np.hypot(*np.diff(sewn.flat[run], axis=0).T), step, rtol=1e-12)


def test_the_grain_turns_with_a_panel_that_is_drawn_from_its_wrong_side(tmp_path: Path) -> None:
    """30 degrees to the left of y in the drawing are 30 to the right of it on the right side."""
    cut = read(tmp_path, pattern({"front": front() | {"grain": 30.0}, "back": back() | {"grain": 30.0}}))
    np.testing.assert_allclose(sew(cut, 0.05).warp, [[-0.5, np.sqrt(0.75)], [0.5, np.sqrt(0.75)]], atol=1e-15)


PROGRAM = """
import sys; sys.path.insert(0, {tests!r})
from pathlib import Path
from sewing_patterns import read, tube, panel
from nuno_cloth.sewing.sew import sew
import hashlib
curve = {{2: {{"type": "cubic", "params": [[0.3, 0.2], [0.7, -0.1]]}}}}
sewn = sew(read(Path({folder!r}), tube(front=panel((0, 0), (30, 0), (30, 20), (0, 20), curves=curve))), 0.01)
parts = (sewn.flat, sewn.placed, sewn.faces, sewn.merged)
print(hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest())
"""


@pytest.mark.quick(threads=["1"])
@pytest.mark.parametrize("threads", ["1", "2"])
def test_it_is_the_same_to_the_last_bit_on_any_number_of_threads(threads: str, tmp_path: Path) -> None:
    """As here, on as many as there are."""
    curve = {2: {"type": "cubic", "params": [[0.3, 0.2], [0.7, -0.1]]}}
    cut = read(tmp_path, tube(front=panel((0, 0), (30, 0), (30, 20), (0, 20), curves=curve)))
    found = set()
    for _ in range(2):
        sewn = sew(cut, 0.01)
        parts = sewn.flat, sewn.placed, sewn.faces, sewn.merged
        found.add(hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest())
    program = PROGRAM.format(tests=str(Path(__file__).resolve().parents[1]), folder=str(tmp_path))
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | dict.fromkeys(names, threads),
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    found.add(done.stdout.strip())
    assert len(found) == 1


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


@pytest.mark.quick(garment=FEW, grain=[30.0])
@pytest.mark.parametrize("grain", [0.0, 30.0])
@pytest.mark.parametrize("garment", REAL)
def test_triangles_lie_in_the_image_as_they_are_cut(shared_data: Path, garment: str, grain: float) -> None:
    """Sides of triangles along the warp and the weft are those of the panel, at one scale, also along seams."""
    sewn = sew(read_pattern(SceneFiles(shared_data / "patterns"), f"{garment}.json"), 0.03)
    cosine, sine = np.cos(np.radians(grain)), np.sin(np.radians(grain))
    x, y = sewn.warp.T
    sewn = replace(sewn, warp=np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1))
    uv, unit = lay_out(sewn)
    assert uv.min(axis=0) == pytest.approx([0.0, 0.0]) and uv.max() == pytest.approx(1.0)

    cut, shown = (points[np.roll(sewn.faces, -1, axis=1)] - points[sewn.faces] for points in (sewn.flat, uv))
    warp = sewn.warp[sewn.panel][:, None]
    weft = np.stack([warp[..., 1], -warp[..., 0]], axis=-1)
    expected = np.stack([(cut * weft).sum(axis=-1), (cut * warp).sum(axis=-1)], axis=-1)
    assert np.abs(shown - expected / unit).max() < 1e-12

    low, high = (
        np.array([f(uv[sewn.faces[sewn.panel == k], 0]) for k in range(len(sewn.names))]) for f in (np.min, np.max)
    )
    assert (low[1:] >= high[:-1] - 1e-12).all()
