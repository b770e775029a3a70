"""The contract of colliders and motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from nuno.collision.bodies import box_mesh
from nuno.collision.distance import signed_distance
from nuno_schemas.bodies import OF_TRIANGLES, SKIN, DistanceField, Geometry, Poses
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import BodyShape, Mover
from nuno_testing.subject import Subject, made_twice

PLACES = np.array([[0.0, 1.0, 0.0], [0.0, 0.4, 0.0]])
DEPTH = 1e-3
MESHED = 0.03
"""Largest distance of a closed form's mesh from its surface, as a share of the body's shortest extent."""
PERSON: dict[str, tuple[str, tuple[float, float, float]]] = {
    "hips": ("", (0.0, 0.9, 0.0)), "spine": ("hips", (0.0, 0.1, 0.0)), "chest": ("spine", (0.0, 0.2, 0.0)),
    "head": ("chest", (0.0, 0.3, 0.0)),
    **{f"{side}_{name}": (parent.format(side), (sign * x, y, 0.0)) for side, sign in (("left", 1.0), ("right", -1.0))
       for name, parent, x, y in (
        ("arm", "chest", 0.2, 0.1), ("forearm", "{}_arm", 0.3, 0.0), ("hand", "{}_forearm", 0.25, 0.0),
        ("thigh", "hips", 0.1, -0.05), ("shin", "{}_thigh", 0.0, -0.4), ("foot", "{}_shin", 0.0, -0.4))},
}  # fmt: skip
"""Joints of a person in a T-pose: the parent of each, and the offset from it [m]."""


def still_mover(joints: Sequence[str], parents: Sequence[int], offsets: Float) -> Mover:
    """Return a motion that stands still."""
    places = offsets.copy()
    for joint, parent in enumerate(parents):
        places[joint] += places[parent] if parent >= 0 else 0.0
    turn = np.eye(4)[np.zeros(len(joints), int)]
    return Mover(tuple(joints), np.array(parents, np.int32), offsets, lambda t: (turn, places))


def movers() -> list[Mover]:
    """Return a motion of two joints, one of a person's, and one that brings a surface."""
    names = list(PERSON)
    parents = [names.index(parent) if parent else -1 for parent, _ in PERSON.values()]
    person = still_mover(names, parents, np.array([offset for _, offset in PERSON.values()]))
    x, faces = box_mesh(PLACES[1], np.array([0.1, 0.2, 0.3]))
    surface = replace(still_mover(list("abcdefgh"), [-1] * len(x), x), surface=faces)
    return [still_mover(("hips", "spine"), (-1, 0), PLACES), person, surface]


def build_shape(subject: Subject, moves: bool) -> BodyShape | None:
    """Return the shape on two joints that stand still, or on a person's if it needs them; with `moves` false the shape
    without a motion, None if it needs one.
    """
    for mover in movers() if moves else [None]:
        try:
            shape: BodyShape = made_twice(partial(subject.plugin.build, subject.config, mover, subject.files))
        except BadInput:
            continue
        assert mover is None or shape.frames == mover.joints
        return shape
    assert not moves, "it stands neither by itself nor on two joints, on a person's or on a surface"
    return None


class Distance:
    """Signed distances [m] of points (n, 3) from a shape with all frames at the origin, or in the bind pose of its
    skin: by its distance fields, or, with `exact`, by the triangles from which the fields were made.
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
    """The shape's frames are its motion's joints, or the world without a motion; built twice, it is the same."""
    moved, alone = build_shape(subject, True), build_shape(subject, False)
    assert moved is not None
    assert alone is None or alone.frames == ("world",)


def distances_are_those_to_points_of_its_surface(subject: Subject) -> None:
    """From any point outside, the step back along the distance's gradient ends on the surface, and no other sampled
    point of the surface is nearer.
    """
    shape = build_shape(subject, False) or build_shape(subject, True)
    assert shape is not None
    distance = Distance(shape, exact=all(isinstance(field, DistanceField) for field in shape.fields))
    reach = np.abs(np.concatenate([shape.a, shape.b])).max() + shape.radius.max() + 0.1
    points = reach * np.random.default_rng(3).uniform(-1.0, 1.0, (300, 3))
    points = points[distance(points) > 1e-2 * reach]
    far, small = distance(points), 1e-6 * reach
    slope = np.stack([distance(points + step) - distance(points - step) for step in small * np.eye(3)], 1) / (2 * small)
    forms = shape.fields if len(shape.kind) == 1 else ()
    for gradient in filter(None, (getattr(form, "gradient", None) for form in forms)):
        assert np.abs([gradient(*point) for point in points] - slope).max() < 1e-5
    feet = points - far[:, None] * slope
    on_it = np.abs(distance(feet)) < 1e-5 * reach
    assert on_it.mean() > 0.95  # except for points with two equally near points of the surface
    assert (np.linalg.norm(points[:, None] - feet[on_it], axis=2) >= far[:, None] - 1e-5 * reach).all()


def triangles_face_outwards_within_their_bounds(subject: Subject) -> None:
    """A point in front of a triangle's middle is outside, one behind it inside; `a` and `b` bound the whole mesh; a
    distance field agrees with the triangles to its tolerance.
    """
    shape = build_shape(subject, False) or build_shape(subject, True)
    assert shape is not None
    mesh = MESHED * float(np.ptp(np.stack([shape.a, shape.b]), axis=0).min())
    tolerance = max((getattr(field, "tolerance", mesh) for field in shape.fields), default=0.0)
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
    """Another mover, asked for the same times in another order, returns the same poses."""

    def sample(order: int) -> list[tuple[Float, Float]]:
        pose = subject.plugin.prepare(subject.config, subject.files).pose
        return [pose(t) for t in np.linspace(0.0, 3.0, 13)[::order].tolist()][::order]

    forward = made_twice(lambda: sample(1))
    pairs = zip(forward, sample(-1), strict=True)
    assert all(np.array_equal(a, b) for one, other in pairs for a, b in zip(one, other, strict=True))


def it_moves_without_jumps(subject: Subject) -> None:
    """The translation and rotation of joints within a span of time shrink with the span, wherever it begins."""
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
    """A child's position is its parent's plus its offset in the parent's rotation: bones keep their length."""
    mover = subject.plugin.prepare(subject.config, subject.files)
    child = np.flatnonzero(mover.parents >= 0)
    parent, offset = mover.parents[child], mover.offsets[child]
    for t in (0.0, 0.7, 2.9):
        rotation, place = mover.pose(t)
        w, axis = rotation[parent, :1], rotation[parent, 1:]
        turned = offset + 2.0 * (w * np.cross(axis, offset) + np.cross(axis, np.cross(axis, offset)))
        assert np.abs(place[parent] + turned - place[child]).max(initial=0.0) < 1e-9


MOTIONS = (poses_depend_on_the_time_alone, it_moves_without_jumps, joints_are_where_their_parents_turn_them)
