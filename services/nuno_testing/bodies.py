"""What colliders and motions owe."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from nuno.collision.distance import signed_distance
from nuno_schemas.bodies import OF_TRIANGLES, SKIN, Geometry, Poses
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import BodyShape, Mover
from nuno_testing.subject import Subject, made_twice

PLACES = np.array([[0.0, 1.0, 0.0], [0.0, 0.4, 0.0]])
DEPTH = 1e-3
PERSON: dict[str, tuple[str, tuple[float, float, float]]] = {
    "hips": ("", (0.0, 0.9, 0.0)), "spine": ("hips", (0.0, 0.1, 0.0)), "chest": ("spine", (0.0, 0.2, 0.0)),
    "head": ("chest", (0.0, 0.3, 0.0)),
    **{f"{side}_{name}": (parent.format(side), (sign * x, y, 0.0)) for side, sign in (("left", 1.0), ("right", -1.0))
       for name, parent, x, y in (
        ("arm", "chest", 0.2, 0.1), ("forearm", "{}_arm", 0.3, 0.0), ("hand", "{}_forearm", 0.25, 0.0),
        ("thigh", "hips", 0.1, -0.05), ("shin", "{}_thigh", 0.0, -0.4), ("foot", "{}_shin", 0.0, -0.4))},
}  # fmt: skip
"""Joints of a person in a T-pose: what carries each, and the way there from it [m]."""


def standing(joints: Sequence[str], parents: Sequence[int], offsets: Float) -> Mover:
    """A motion that stands still."""
    places = offsets.copy()
    for joint, parent in enumerate(parents):
        places[joint] += places[parent] if parent >= 0 else 0.0
    turn = np.eye(4)[np.zeros(len(joints), int)]
    return Mover(tuple(joints), np.array(parents, np.int32), offsets, lambda t: (turn, places))


def movers() -> list[Mover]:
    """One of two joints, and one of a person's."""
    names = list(PERSON)
    parents = [names.index(parent) if parent else -1 for parent, _ in PERSON.values()]
    person = standing(names, parents, np.array([offset for _, offset in PERSON.values()]))
    return [standing(("hips", "spine"), (-1, 0), PLACES), person]


def shape_of(subject: Subject, moves: bool) -> BodyShape | None:
    """The shape on two joints that stand still, or on a person's if it needs these, or by itself: None for one that
    needs a motion.
    """
    for mover in movers() if moves else [None]:
        try:
            shape: BodyShape = made_twice(partial(subject.plugin.build, subject.config, mover, subject.files))
        except BadInput:
            continue
        assert mover is None or shape.frames == mover.joints
        return shape
    assert not moves, "it stands neither by itself nor on two joints, nor on a person's"
    return None


class Distance:
    """Signed distances [m] of points (n, 3) to a shape whose frames are all at the origin, or where its skin is bound:
    by its distance fields, or, where `exact`, by the triangles that those were made of.
    """

    def __init__(self, shape: BodyShape, exact: bool) -> None:
        one, frames = np.ones(1), len(shape.frames)
        self.geometry = Geometry(
            ("body",), shape.frames, shape.kind, shape.frame, 0 * shape.frame, shape.a, shape.b, shape.radius, one, one,
            one, shape.vertices, shape.faces, shape.owner, () if exact else shape.fields, shape.skins,
        )  # fmt: skip
        places = np.zeros((frames, 3))
        for first, skin in zip(shape.frame[shape.kind == SKIN], shape.skins, strict=True):
            places[first : first + len(skin.place)] = skin.place
        self.poses = Poses(0.0, np.eye(4)[np.zeros(frames, int)], places)

    def __call__(self, points: Float) -> Float:
        return signed_distance(points, self.geometry, self.poses)


def it_stands_on_the_joints_of_its_motion(subject: Subject) -> None:
    """Or by itself in the world; built twice, it is the same."""
    moved, alone = shape_of(subject, True), shape_of(subject, False)
    assert moved is not None
    assert alone is None or alone.frames == ("world",)


def distances_are_those_to_points_of_its_surface(subject: Subject) -> None:
    """From anywhere outside, the way back along the distance's slope ends on the surface, and no sampled point of that
    is nearer.
    """
    shape = shape_of(subject, False) or shape_of(subject, True)
    assert shape is not None
    distance = Distance(shape, exact=True)
    reach = np.abs(np.concatenate([shape.a, shape.b])).max() + shape.radius.max() + 0.1
    points = reach * np.random.default_rng(3).uniform(-1.0, 1.0, (300, 3))
    points = points[distance(points) > 1e-2 * reach]
    far, small = distance(points), 1e-6 * reach
    slope = np.stack([distance(points + step) - distance(points - step) for step in small * np.eye(3)], 1) / (2 * small)
    feet = points - far[:, None] * slope
    on_it = np.abs(distance(feet)) < 1e-5 * reach
    assert on_it.mean() > 0.95  # but where two points of it are equally near
    assert (np.linalg.norm(points[:, None] - feet[on_it], axis=2) >= far[:, None] - 1e-5 * reach).all()


def triangles_face_outwards_within_their_bounds(subject: Subject) -> None:
    """Beyond the middle of a triangle it is outside, and before it inside; `a` and `b` hold all of a mesh; and a
    distance field is there what the triangles say, to its tolerance.
    """
    shape = shape_of(subject, False) or shape_of(subject, True)
    assert shape is not None
    tolerance = max((field.tolerance for field in shape.fields), default=0.0)
    exact, read, depth = Distance(shape, exact=True), Distance(shape, exact=False), DEPTH + 4.0 * tolerance
    for i in np.flatnonzero(np.isin(shape.kind, OF_TRIANGLES)):
        corners = shape.vertices[shape.faces[shape.owner == i]]
        assert (corners >= shape.a[i] - 1e-9).all()
        assert (corners <= shape.b[i] + 1e-9).all()
        out = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        out *= depth / np.linalg.norm(out, axis=1)[:, None]
        chosen = np.random.default_rng(4).choice(len(corners), min(200, len(corners)), replace=False)
        middle, out = corners[chosen].mean(axis=1), out[chosen]
        assert np.abs(read(middle) - exact(middle)).max() <= tolerance
        assert (read(middle - out) < 0.0).mean() > 0.98  # thin edges of a body have no inside so deep
        assert len(shape.kind) > 1 or (read(middle + out) > 0.0).mean() > 0.98


COLLIDERS = (
    it_stands_on_the_joints_of_its_motion,
    distances_are_those_to_points_of_its_surface,
    triangles_face_outwards_within_their_bounds,
)


def poses_depend_on_the_time_alone(subject: Subject) -> None:
    """Asked of another mover, and in another order, they are the same."""

    def ask(order: int) -> list[tuple[Float, Float]]:
        pose = subject.plugin.prepare(subject.config, subject.files).pose
        return [pose(t) for t in np.linspace(0.0, 3.0, 13)[::order].tolist()][::order]

    forth = made_twice(lambda: ask(1))
    assert all(
        np.array_equal(a, b) for one, other in zip(forth, ask(-1), strict=True) for a, b in zip(one, other, strict=True)
    )


def it_moves_without_jumps(subject: Subject) -> None:
    """What joints move and turn in a span of time shrinks with the span, wherever that begins."""
    mover = subject.plugin.prepare(subject.config, subject.files)
    poses = [mover.pose(0.005 * k) for k in range(805)]

    def change(k: int, steps: int) -> float:
        (one, here), (other, there) = poses[k], poses[k + steps]
        turn = np.minimum(np.abs(one - other).max(axis=1), np.abs(one + other).max(axis=1))
        return float(max(np.abs(here - there).max(), turn.max()))

    most = [max(change(k, steps) for k in range(801)) for steps in (4, 2, 1)]
    assert most[2] <= 0.7 * most[1] + 1e-12
    assert most[1] <= 0.7 * most[0] + 1e-12


def joints_are_where_their_parents_turn_them(subject: Subject) -> None:
    """A child's place is its parent's, and its offset turned as the parent is: bones keep their length."""
    mover = subject.plugin.prepare(subject.config, subject.files)
    child = np.flatnonzero(mover.parents >= 0)
    parent, offset = mover.parents[child], mover.offsets[child]
    for t in (0.0, 0.7, 2.9):
        rotation, place = mover.pose(t)
        w, axis = rotation[parent, :1], rotation[parent, 1:]
        turned = offset + 2.0 * (w * np.cross(axis, offset) + np.cross(axis, np.cross(axis, offset)))
        assert np.abs(place[parent] + turned - place[child]).max(initial=0.0) < 1e-9


MOTIONS = (poses_depend_on_the_time_alone, it_moves_without_jumps, joints_are_where_their_parents_turn_them)
