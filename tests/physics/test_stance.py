"""Where a person's joints lie, and how it stands: a garment is put on one that stands and faces +z."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from persons import ARMS, limbs, person
from scipy.spatial.transform import Rotation
from sewing_patterns import Body, column, moved, together

from nuno_cloth.models.triangles import find_edges
from nuno_cloth.models.wearer import check_openings, check_place, check_stance
from nuno_contact.colliders.body_parts import find_roles
from nuno_contact.motions.rotations import from_axis_angle
from nuno_contact.skinning.figure import find_figure
from nuno_geometry.tree import build_tree
from nuno_schemas.bodies import rotation_matrices
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import Mover

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


def box(*spans: tuple[float, float]) -> Body:
    return np.array(spans).T, np.zeros((0, 3), np.int32)


SHIRT, SKIRT, DRESS, HOODED = ((low, high) for low, high in ((0.9, 1.42), (0.1, 1.09), (0.11, 1.41), (0.03, 1.89)))
AROUND = (-0.9, 0.9), (-0.2, 0.2)


@pytest.mark.parametrize("worn", [SHIRT, SKIRT, DRESS, HOODED])
def test_a_garment_is_placed_round_a_body_that_stands_on_the_floor_or_it_is_asked_to(worn: tuple[float, float]) -> None:
    """Origins at the pelvis, in the middle, above the head, below the feet; and beside. The move that is said helps."""
    panels, (wide, deep) = box(AROUND[0], worn, AROUND[1])[0], AROUND
    for shift in ([0, 0, 0], [0, -1.12, 0], [0, -0.85, 0], [0, -1.8, 0], [3.0, 0, 0], [0, -1.12, -1.5], [0, 0.6, 0]):
        x = box(wide, (0.0, 1.7), deep)[0] + shift
        if not any(shift) or (worn is SHIRT and shift[1] > 0):  # which it could as well wear there
            check_place(panels, x, "wearer")
            continue
        with pytest.raises(BadInput, match="does not stand where") as caught:
            check_place(panels, x, "wearer")
        assert len(repr(caught.value.value)) <= 120  # what is longer is cut off where it is printed
        move = re.search(r"bodies\.wearer\.collider\.centre=\[(.*)\]", str(caught.value.remedy))
        assert move
        np.testing.assert_allclose([float(one) for one in move[1].split(",")], -np.array(shift, float), atol=1e-9)
        check_place(panels, x + [float(one) for one in move[1].split(",")], "wearer")


def test_a_garment_may_hang_below_a_bust_and_be_placed_at_a_body_of_another_origin() -> None:
    wide, deep = AROUND
    for worn in (SHIRT, SKIRT):
        check_place(box(wide, worn, deep)[0], box(wide, (0.8, 1.5), deep)[0], "bust")
    check_place(box(wide, (-0.2, 0.3), deep)[0], box(wide, (-1.12, 0.54), deep)[0], "wearer")


def panels(wide: float, heights: tuple[float, float], sleeve: float = 0.0) -> Float:
    """Points of a front and a back, the left sleeve longer."""
    x, y = np.meshgrid(np.linspace(-wide, wide + sleeve, 24), np.linspace(*heights, 9))
    return np.concatenate([np.stack([x, y, 0.0 * x + z], axis=2).reshape(-1, 3) for z in (-0.2, 0.25)])


@pytest.mark.parametrize(
    "placed", [panels(0.5, SHIRT), panels(0.3, SKIRT), panels(0.3, DRESS), panels(0.4, SHIRT, 0.2)]
)
def test_a_body_next_to_the_panels_is_refused_with_a_move_that_helps(placed: Float) -> None:
    """Its box overlaps that of the panels, and its arms may be between them."""
    x, faces = figure()
    for shift in ([0, 0, 0], [0.1, 0, 0], [0, 0, 0.05], [0.5, 0, 0], [-0.5, 0, 0.3], [0, 0, 0.4], [0, 0, -0.3]):
        there = x + np.array(shift, float)
        if max(map(abs, shift)) < 0.2:
            check_place(placed, there, "wearer", build_tree(there, faces))
            continue
        with pytest.raises(BadInput, match="does not stand where") as caught:
            check_place(placed, there, "wearer", build_tree(there, faces))
        move = re.search(r"collider\.centre=\[(.*)\]", str(caught.value.remedy))
        assert move
        there = there + [float(one) for one in move[1].split(",")]
        check_place(placed, there, "wearer", build_tree(there, faces))


def test_what_is_worn_on_a_limb_or_hangs_on_one_side_is_not_misplaced() -> None:
    x, faces = figure()
    tree = build_tree(x, faces)
    sleeve = panels(0.15, (1.3, 1.5)) - [-0.5, 0.0, 0.0]
    cape = panels(0.4, (0.8, 1.5))[: 24 * 9] - [0.0, 0.0, 0.1]
    for placed in (sleeve, cape):
        check_place(placed, x, "wearer", tree)


def test_a_body_is_in_an_opening_of_its_garment() -> None:
    """A tube round the trunk, next to it, above it; a sheet with one outline has no opening."""
    x, faces = figure()
    tree = build_tree(x, faces)
    tube, around = column((0.25, 0.2), (0.9, 1.5))[0][:-2], column((0.25, 0.2), (0.9, 1.5))[1][:-128]
    edges = find_edges(around)
    check_openings(tube, edges, tree, "wearer")
    for shift in ([0.0, 0.0, 1.0], [0.0, 1.5, 0.0]):
        with pytest.raises(BadInput, match="nothing of the body goes through") as caught:
            check_openings(tube + shift, edges, tree, "wearer")
        assert caught.value.field == "over.body"
    sheet = np.array([[0, 1, 1], [1, 1, 1], [0, 2, 1], [1, 2, 1]], float)
    check_openings(sheet, find_edges(np.array([[0, 1, 3], [0, 3, 2]], np.int32)), tree, "wearer")


SPACING = 0.025


@pytest.mark.parametrize(
    "arms", [ARMS, pytest.param(math.radians(85.0), marks=pytest.mark.full)], ids=["A-pose", "T-pose"]
)
def test_joints_are_found_where_limbs_bend(arms: float) -> None:
    """Of a person made of limbs from joint to joint: within 4 cm, shoulders within 8; as large, twice as large."""
    x, faces = person(SPACING, arms)
    figure = find_figure(x, faces)
    made = limbs(arms)
    low = x[:, 1].min() - 0.04 + 0.048  # its feet are rounded by so much below their bones
    for side, first in (("left", 4), ("right", 11)):
        places = {
            "forearm": made[first + 1][1], "hand": made[first + 2][1], "shin": made[first + 4][1],
            "thigh": made[first + 4][0], "arm": made[first + 1][0],
        }  # fmt: skip
        for name, place in places.items():
            off = np.linalg.norm(figure[f"{side}_{name}"] - place - np.array([0.0, low, 0.0]))
            assert off < (0.08 if name == "arm" else 0.04), (side, name, off)
    twice = find_figure(2.0 * x, faces)
    assert all(np.abs(twice[name] - 2.0 * place).max() < 1e-9 for name, place in figure.places.items())


def test_joints_are_known_by_many_names() -> None:
    """As captures, cinema programs and nuno call them."""
    sets = {
        "pelvis": ("Hips", "mixamorig:Hips", "hips"), "chest": ("Spine1", "mixamorig:Spine2", "chest"),
        "head": ("Head", "mixamorig:Head", "head"), "arm": ("Left{}", "mixamorig:Left{}", "left_{}"),
    }  # fmt: skip
    limbs_of = (
        ("Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot"), ("Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot"),
        ("arm", "forearm", "hand", "thigh", "shin", "foot"),
    )  # fmt: skip
    for k, names in enumerate(limbs_of):
        joints = [sets["pelvis"][k], sets["chest"][k], sets["head"][k]]
        parents = [-1, 0, 1]
        for side in ("Left", "Right"):
            pattern = sets["arm"][k].replace("Left", side).replace("left", side.lower())
            at = len(joints)
            joints += [pattern.format(name) for name in names]
            parents += [1, at, at + 1, 0, at + 3, at + 4]
        mover = Mover(tuple(joints), np.array(parents, np.int32), np.zeros((15, 3)), lambda t: (np.eye(4), np.eye(3)))
        roles = find_roles(mover)
        assert joints[roles["left_forearm"]].lower().endswith("left" + names[1].lower()) or k == 2
        assert len(roles) == 15 and len(set(roles.values())) == 15


def turned_by(angle: float, axis: list[float]) -> Float:
    return rotation_matrices(from_axis_angle(np.array(axis), angle)[None])[0]


@pytest.mark.parametrize(
    ("matrix", "problem"),
    [
        (turned_by(0.5 * math.pi, [1.0, 0.0, 0.0]), "lies down"),
        (turned_by(math.pi, [0.0, 1.0, 0.0]), "does not face"),
        (turned_by(0.5 * math.pi, [0.0, 1.0, 0.0]), "legs|face"),
        (turned_by(math.pi, [0.0, 0.0, 1.0]), "legs"),
    ],
    ids=["lies", "faces back", "faces aside", "on its head"],
)
def test_a_body_that_does_not_stand_facing_ahead_is_refused(matrix: Float, problem: str) -> None:
    x, faces = person(SPACING)
    with pytest.raises(BadInput, match=problem) as caught:
        find_figure(np.ascontiguousarray(x @ matrix.T), faces)
    assert caught.value.remedy and caught.value.limit
