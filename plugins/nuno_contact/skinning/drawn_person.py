"""A person's skin on a skeleton, to draw in the place of the capsules that cloth meets."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from nuno_contact.colliders.body_parts import carrier_of, find_roles
from nuno_contact.motions.rotations import rest_positions
from nuno_contact.skinning.figure import Figure
from nuno_contact.skinning.gait import fit_gait
from nuno_schemas.bodies import Skin, rotation_matrices
from nuno_schemas.fabric import Float, Int
from nuno_schemas.plugin import DrawnSkin, Mover
from nuno_schemas.vectors import dot, norm

DATA = Path(__file__).parents[1] / "body_shapes" / "person.npz"
"""Made by scenes/make_person.py from the CC0 body whose sections gave the capsules their radii."""
LOOKED = np.arange(0.0, 6.0, 0.25)
"""Times [s] at which the skin is drawn into the capsules."""
COVERED = ("hips", "left_thigh", "right_thigh", "left_shin", "right_shin")
"""Parts that lie within the capsules, so that they do not show through cloth: round capsules have the girths of a body
that is wider than deep."""
TRUNK = ("hips", "spine", "chest")
"""Parts that fill the hips' capsules, so that a waistband round these closes on the skin: a back is hollow there."""


class Person(NamedTuple):
    """The skin (v, 3) [m] in its bind pose and its triangles (t, 3), its joints and height [m]; the parts' names, and
    the part (v, c) and weight (v, c) of what carries each vertex.
    """

    x: Float
    faces: Int
    figure: Figure
    parts: tuple[str, ...]
    part: Int
    weight: Float


@cache
def read_person() -> Person:
    """Read the skin that comes with the project."""
    with np.load(DATA, allow_pickle=False) as data:
        figure = Figure(dict(zip(data["names"].tolist(), data["places"], strict=True)), float(data["height"]))
        weight = data["weight"].astype(np.float64)
        return Person(
            data["x"].astype(np.float64), data["faces"].astype(np.int32), figure, tuple(data["parts"].tolist()),
            data["part"].astype(np.int32), weight / weight.sum(axis=1, keepdims=True),
        )  # fmt: skip


def draw_person(mover: Mover, height: float, frame: Int, a: Float, b: Float, radius: Float) -> DrawnSkin:
    """Return the skin of a person of this height [m] on the joints of a motion, with capsules on `frame` (p,) from
    a to b (p, 3) of `radius` (p,) [m]. Raises BadInput for a motion without a body's joints.

    The skin is bent from its own pose into that of the skeleton at rest, part by part as a motion is retargeted, and
    then follows the skeleton's joints. Its trunk fills the hips' capsules, its hips and legs lie within all capsules.
    """
    person, roles = read_person(), find_roles(mover)
    scale = height / person.figure.height
    figure = Figure({name: scale * place for name, place in person.figure.places.items()}, height)
    gait = fit_gait(mover, roles, figure, 0.0, 0.0, 0.0)
    goes = [name if name in roles else carrier_of(name, roles) for name in person.parts]
    number, joint = [list(roles).index(name) for name in goes], np.array([roles[name] for name in goes], np.int32)
    rest = rest_positions(mover.parents, mover.offsets)
    place = rest[joint]
    # A skeleton's hips may be anywhere in the pelvis; a body's are between its hip joints.
    place[goes.index("hips")] = 0.5 * (rest[roles["left_thigh"]] + rest[roles["right_thigh"]])
    bent = Skin(gait.place[number], person.part, person.weight).bend(scale * person.x, gait.aligned[number], place)
    hips = frame == roles["hips"]
    inside, out = from_nearest(bent, a[hips] + rest[roles["hips"]], b[hips] + rest[roles["hips"]], radius[hips])
    bent += (share_of(person, TRUNK) * np.maximum(-inside, 0.0))[:, None] * out
    share = share_of(person, COVERED)
    covered = np.flatnonzero(share)
    skin = Skin(np.ascontiguousarray(rest), np.ascontiguousarray(joint[person.part]), person.weight)
    part = Skin(rest, skin.joint[covered], skin.weight[covered])
    for t in () if mover.live is not None else LOOKED.tolist():
        rotation, origin = mover.pose(t)
        matrix = rotation_matrices(rotation)
        start, end = ((matrix[frame] * point[:, None]).sum(axis=2) + origin[frame] for point in (a, b))
        outside, out = from_nearest(part.bend(bent[covered], rotation, origin), start, end, radius)
        off = -np.maximum(outside, 0.0)[:, None] * out
        bent[covered] += share[covered, None] * (off[:, :, None] * matrix[part.joint[:, 0]]).sum(axis=1)
    return DrawnSkin(np.ascontiguousarray(bent), person.faces, skin)


def share_of(person: Person, parts: Sequence[str]) -> Float:
    """Return the weight (v,) that parts have of each vertex."""
    chosen = np.isin(person.part, [person.parts.index(name) for name in parts])
    return np.asarray(np.where(chosen, person.weight, 0.0).sum(axis=1))


def from_nearest(x: Float, a: Float, b: Float, radius: Float) -> tuple[Float, Float]:
    """Return the signed distance (n,) [m] of points x (n, 3) from the nearest of capsules a to b (p, 3), negative
    inside, and the unit vectors (n, 3) out of it.
    """
    along = b - a
    share = np.clip(dot(x[:, None] - a, along) / np.maximum(dot(along, along), 1e-30), 0.0, 1.0)
    away = x[:, None] - (a + share[..., None] * along)
    distance = norm(away)
    nearest = (distance - radius).argmin(axis=1)
    rows = np.arange(len(x))
    away, distance = away[rows, nearest], distance[rows, nearest]
    return distance - radius[nearest], away / np.maximum(distance, 1e-30)[:, None]
