"""Where a person's joints lie, found from the mesh alone; and which joints of a motion they are."""

from __future__ import annotations

import math

import numpy as np
import pytest
from persons import ARMS, limbs, person

from nuno_contact.colliders.body_parts import find_roles
from nuno_contact.motions.rotations import from_axis_angle
from nuno_contact.skin.figure import find_figure
from nuno_schemas.bodies import rotation_matrices
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import Mover

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
