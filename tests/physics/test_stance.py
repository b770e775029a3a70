"""A garment is put on a body that stands and faces +z: one that lies or faces another way is refused, by its feet."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sewing_patterns import Body, column, moved, together

from nuno_cloth.models.stance import check_stance
from nuno_schemas.errors import BadInput

OUT = Rotation.from_euler("z", 90.0, degrees=True).as_matrix()


def figure(feet: bool = True) -> Body:
    """A trunk on two legs with feet, arms held out, wider so than it is high."""
    parts = [column((0.15, 0.1), (0.8, 1.6))]
    for side in (-1.0, 1.0):
        parts.append(moved(column((0.06, 0.06), (0.0, 0.9)), np.eye(3), [0.1 * side, 0.0, 0.0]))
        parts.append(moved(column((0.04, 0.04), (-0.35, 0.35)), OUT, [0.5 * side, 1.4, 0.0]))
        if feet:
            parts.append(moved(column((0.04, 0.12), (0.0, 0.06)), np.eye(3), [0.1 * side, 0.0, 0.08]))
    return together(*parts)


def turned(body: Body, axis: str, angle: float) -> Body:
    return moved(body, Rotation.from_euler(axis, angle, degrees=True).as_matrix(), [0.0, 0.0, 0.0])


@pytest.mark.parametrize("angle", [0.0, 40.0, -40.0, 50.0, -90.0, 180.0])
def test_a_body_faces_the_way_that_its_feet_point(angle: float) -> None:
    body = turned(figure(), "y", angle)
    if abs(angle) < 45.0:
        check_stance(*body, "wearer")
        return
    with pytest.raises(BadInput, match="faces another way") as caught:
        check_stance(*body, "wearer")
    told = re.search(r"feet point (\d+) degrees off \+z", str(caught.value.value))
    assert caught.value.field == "over.body" and told and abs(int(told[1]) - abs(angle)) <= 1.0


def test_a_body_without_feet_says_nothing_of_where_it_faces() -> None:
    for angle in (0.0, 90.0, 180.0):
        check_stance(*turned(figure(feet=False), "y", angle), "wearer")
        check_stance(*turned(column((0.2, 0.12), (0.9, 1.5)), "y", angle), "wearer")


@pytest.mark.parametrize(("axis", "angle"), [("x", 90.0), ("x", -90.0), ("z", 90.0)])
def test_a_body_that_lies_is_refused(axis: str, angle: float) -> None:
    """On its back, on its front, and, with its arms along it, on its side."""
    x, faces = turned(figure(), axis, angle) if axis == "x" else turned(column((0.2, 0.12), (0.0, 1.7)), axis, angle)
    with pytest.raises(BadInput, match="the body lies") as caught:
        check_stance(x, faces, "wearer")
    assert "m high" in str(caught.value.value)
