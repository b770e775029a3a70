"""Panels cut as more than half of a ring start as a cone in waves round the trunk, whatever they are laid through."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sewing_patterns import Body, column, moved, panel, pattern, read, stitch, together
from worn_tubes import put_on, turns

from nuno_cloth.sewing.flare import find_ring, flare
from nuno_cloth.sewing.sew import sew
from nuno_kernels.meshes.closest_point import closest_points
from nuno_kernels.meshes.tree import build_tree
from nuno_schemas.errors import BadInput

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
