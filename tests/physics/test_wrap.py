"""Panels sewn to themselves: tubes round the limb they lie beside; wide skirts start as a cone in waves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sewing_patterns import Body, column, moved, panel, pattern, read, stitch, together
from worn_tubes import put_on, turns

from nuno_cloth.sewing.sew import sew
from nuno_cloth.sewing.wrap import find_ring, flare, tubes, wrap
from nuno_geometry.closest_point import closest_points
from nuno_geometry.tree import build_tree
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric
from nuno_schemas.vectors import dot

ONE_PIECE = "one[1]", "one[3]"


def tube(width: float, height: float, **fields: Any) -> dict[str, Any]:
    """A rectangle [cm] about its own middle, its two sides sewn to each other."""
    w, h = 0.5 * width, 0.5 * height
    return pattern({"one": panel((-w, -h), (w, -h), (w, h), (-w, h), **fields)}, stitch(*ONE_PIECE))


def require_round(cloth: Fabric, body: Body, origin: Any, axis: Any) -> None:
    """Both ends go once round a line, in opposite ways; its outside is outside, and nothing of it in the body."""
    origin, axis = np.asarray(origin, float), np.asarray(axis, float)
    assert turns(cloth, origin, axis) == [-1, 1]
    a, b, c = (cloth.position[cloth.faces[:, k]] for k in range(3))
    out = 0.5 * (a + b) - origin
    out -= dot(out, axis)[:, None] * axis
    assert (dot(np.cross(b - a, c - a), out) > 0.0).mean() > 0.99
    points = np.concatenate([(1.0 - s) * a + s * b for s in np.linspace(0.0, 1.0, 5)])
    assert np.asarray(closest_points(build_tree(*body), points).distance).min() > 0.0


@pytest.mark.quick(edge=[0.03])
@pytest.mark.parametrize("edge", [0.01, 0.03])
@pytest.mark.parametrize("turn", [0.0, 90.0, 180.0])
def test_a_tube_goes_round_the_trunk_from_wherever_it_is_placed(tmp_path: Path, turn: float, edge: float) -> None:
    """Before, beside and behind it: it is placed with its outside away from the body."""
    body, angle = column((0.1, 0.08), (0.9, 1.4)), np.radians(turn)
    at = [25.0 * np.sin(angle), 115.0, 25.0 * np.cos(angle)]
    cloth = put_on(tmp_path, tube(70.0, 30.0, translation=at, rotation=[0, turn, 0]), body, edge)
    require_round(cloth, body, [0, 1, 0], [0, 1, 0])


@pytest.mark.quick(angle=[40.0])
@pytest.mark.parametrize("angle", [0.0, 40.0, 90.0])
def test_a_sleeve_goes_round_its_arm_and_a_leg_round_its_own(tmp_path: Path, angle: float) -> None:
    """The tube lies before one of two limbs, which point any way; the other is left alone."""
    turn = Rotation.from_euler("z", angle, degrees=True).as_matrix()
    limb = column((0.045, 0.05), (-0.3, 0.3))
    limbs = moved(limb, turn, [0.25, 1.2, 0.0]), moved(limb, turn.T, [-0.25, 1.2, 0.0])
    body = together(column((0.1, 0.08), (0.0, 1.0)), *limbs)
    cloth = put_on(tmp_path, tube(40.0, 25.0, translation=[25, 120, 20], rotation=[0, 0, angle]), body)
    require_round(cloth, body, [0.25, 1.2, 0.0], turn @ [0, 1, 0])


@pytest.mark.full
def test_a_skirt_of_one_piece_goes_round_both_legs_and_no_arm(tmp_path: Path) -> None:
    legs = (moved(column((0.06, 0.06), (0.0, 0.9)), np.eye(3), [x, 0, 0]) for x in (-0.08, 0.08))
    arms = (moved(column((0.04, 0.04), (0.6, 1.3)), np.eye(3), [x, 0, 0]) for x in (-0.35, 0.35))
    body = together(column((0.14, 0.1), (0.85, 1.4)), *legs, *arms)
    flared = panel((-55, -30), (55, -30), (45, 30), (-45, 30), translation=[0, 75, 30])
    cloth = put_on(tmp_path, pattern({"one": flared}, stitch(*ONE_PIECE)), body)
    for x in (-0.08, 0.0, 0.08):
        require_round(cloth, body, [x, 1, 0], [0, 1, 0])
    assert turns(cloth, np.array([0.35, 1.0, 0.0]), np.array([0.0, 1.0, 0.0])) == [0, 0]


def test_darts_are_no_tubes_and_stay_where_they_are_placed(tmp_path: Path) -> None:
    """A dart in two parts has edges that do not meet, and a tip; a side seam in two parts has none, in any order."""
    dart = panel((0, 0), (30, 0), (30, 20), (20, 20), (17, 12), (15, 5), (13, 12), (10, 20), (0, 20))
    body = column((0.1, 0.08), (0.9, 1.4))
    darted = sew(read(tmp_path, pattern({"one": dart}, stitch("one[3]", "one[6]"), stitch("one[4]", "one[5]"))), 0.02)
    assert tubes(darted, 0) == []
    np.testing.assert_array_equal(wrap(darted, *body, 0.01), darted.placed)
    sides = panel((-15, 0), (15, 0), (15, 10), (15, 20), (-15, 20), (-15, 10))
    for stitches in (
        (stitch("one[1]", "one[5]"), stitch("one[2]", "one[4]")),
        (stitch("one[4]", "one[2]"), stitch("one[1]", "one[5]")),
    ):
        (pairs,) = tubes(sew(read(tmp_path, pattern({"one": sides}, *stitches)), 0.02), 0)
        assert len(pairs) == 12


UP = np.array([0.0, 1.0, 0.0])


def skirt(inner: float, outer: float, half: float) -> dict[str, Any]:
    """Two rings [cm] that each fill twice so many degrees, round a waist at 1 m, drawn as GarmentCode draws them."""
    way = np.array([np.sin(np.radians(half)), -np.cos(np.radians(half))])
    (a, b), (c, d) = inner * way, outer * way
    large = int(half > 90.0)
    front = panel((-a, b), (-c, d), (c, d), (a, b), translation=[0, 100 - b, 20],
                  curves={1: {"type": "circle", "params": [outer, large, 1]},
                          3: {"type": "circle", "params": [inner, large, 0]}})  # fmt: skip
    back = panel((-a, b), (a, b), (c, d), (-c, d), translation=[0, 100 - b, -20],
                 curves={0: {"type": "circle", "params": [inner, large, 1]},
                         2: {"type": "circle", "params": [outer, large, 0]}})  # fmt: skip
    return pattern({"front": front, "back": back}, stitch("front[0]", "back[3]"), stitch("front[2]", "back[1]"))


def with_arms() -> Body:
    """A trunk, legs, and arms that hang beside it."""
    legs = (moved(column((0.06, 0.06), (0.0, 0.9)), np.eye(3), [x, 0, 0]) for x in (-0.08, 0.08))
    arms = (moved(column((0.04, 0.04), (0.8, 1.3)), np.eye(3), [x, 0, 0]) for x in (-0.4, 0.4))
    return together(column((0.14, 0.1), (0.85, 1.4)), *legs, *arms)


@pytest.mark.full
@pytest.mark.quick(half=[160.0])
@pytest.mark.parametrize("half", [95.0, 120.0, 160.0])
def test_a_circle_skirt_goes_round_trunk_and_legs_and_no_arm(tmp_path: Path, half: float) -> None:
    body, inner = with_arms(), 90.0 / 4.0 / np.radians(half)
    cloth = put_on(tmp_path, skirt(inner, inner + 50.0, half), body, 0.03)
    for x in (-0.08, 0.0, 0.08):
        assert turns(cloth, np.array([x, 1.0, 0.0]), UP) == [-1, 1]
    a, b, c = (cloth.position[cloth.faces[:, k]] for k in range(3))
    assert np.cross(b - a, c - a).sum(axis=0)[1] > 0.0  # a cone's outside looks up
    points = np.concatenate([(1.0 - s) * a + s * b for s in np.linspace(0.0, 1.0, 5)])
    assert np.asarray(closest_points(build_tree(*body), points).distance).min() > 0.0
    for x in (-0.4, 0.4):
        assert turns(cloth, np.array([x, 1.0, 0.0]), UP) == [0, 0]


@pytest.mark.quick(half=[85.0])
@pytest.mark.parametrize("half", [40.0, 60.0, 85.0])
def test_a_wide_skirt_whose_panels_are_laid_through_the_hands_starts_narrower(tmp_path: Path, half: float) -> None:
    """Of less than a circle, as wide as the arms are apart: round trunk and legs, inside of the hands."""
    body, inner = with_arms(), 90.0 / 4.0 / np.radians(half)
    cloth = put_on(tmp_path, skirt(inner, inner + 50.0, half), body, 0.05)
    for x in (-0.08, 0.0, 0.08):
        assert turns(cloth, np.array([x, 1.0, 0.0]), UP) == [-1, 1]
    a, b = (cloth.position[cloth.faces[:, k]] for k in range(2))
    points = np.concatenate([(1.0 - s) * a + s * b for s in np.linspace(0.0, 1.0, 5)])
    assert np.asarray(closest_points(build_tree(*body), points).distance).min() > 0.0
    # Where the hands are the cloth is between them.
    there = cloth.position[np.abs(cloth.position[:, 1] - 0.9) < 0.1]
    assert np.abs(there[np.abs(there[:, 2]) < 0.04, 0]).max() < 0.4


def test_a_skirt_that_starts_with_arms_through_it_is_refused_by_its_panel(tmp_path: Path) -> None:
    """Of arms that are held out level, far beyond the hem, no skirt that is narrow comes clear."""
    level = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    body = together(with_arms(), moved(column((0.04, 0.04), (-0.8, 0.8)), level, [0, 0.75, 0]))
    with pytest.raises(BadInput, match=r"panel (front|back) cannot be put round wearer, and starts in it"):
        put_on(tmp_path, skirt(16.0, 66.0, 85.0), body, 0.06)


def test_what_is_less_than_half_a_ring_stays_as_it_is_placed(tmp_path: Path) -> None:
    body = column((0.14, 0.1), (0.5, 1.4))
    for half, ring in ((85.0, False), (95.0, True)):
        sewn = sew(read(tmp_path, skirt(16.0, 60.0, half)), 0.03)
        found = [find_ring(sewn, k) for k in range(2)]
        assert [one is not None for one in found] == [ring, ring]
        assert np.array_equal(flare(sewn, sewn.placed, *body, 0.01), sewn.placed) is not ring
        for one in filter(None, found):
            np.testing.assert_allclose([one.inner, np.degrees(one.turn)], [0.16, 2.0 * half], rtol=1e-2)
