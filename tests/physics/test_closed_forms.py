"""Bodies whose distance is a formula: the contact of capsules and boxes, and what is sent of them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest

from nuno.collision.distance import signed_distance
from nuno_contact.colliders.sdf import SdfCollider
from nuno_contact.colliders.shapes import Box, BoxConfig, OnJoint, Sphere, SphereConfig, closed_form
from nuno_contact.penalty.contact import add_contact, commit_contact, make_contact, set_poses
from nuno_kernels.formula import formula
from nuno_schemas.bodies import FIELD, Geometry, Poses
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import BodyShape


@formula
class Ball(NamedTuple):
    radius: float

    def distance(self, x: float, y: float, z: float) -> float:
        return math.sqrt(x * x + y * y + z * z) - self.radius


@formula
class Block(NamedTuple):
    """A box, with its gradient."""

    a: float
    b: float
    c: float

    def distance(self, x: float, y: float, z: float) -> float:
        p, q, r = abs(x) - self.a, abs(y) - self.b, abs(z) - self.c
        d = max(p, q, r)
        return math.sqrt(max(p, 0.0) ** 2 + max(q, 0.0) ** 2 + max(r, 0.0) ** 2) if d > 0.0 else d

    def gradient(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        p, q, r = abs(x) - self.a, abs(y) - self.b, abs(z) - self.c
        d = max(p, q, r)
        if d > 0.0:
            p, q, r = max(p, 0.0), max(q, 0.0), max(r, 0.0)
            d = math.sqrt(p * p + q * q + r * r)
            return math.copysign(p / d, x), math.copysign(q / d, y), math.copysign(r / d, z)
        if p == d:
            return math.copysign(1.0, x), 0.0, 0.0
        return (0.0, math.copysign(1.0, y), 0.0) if q == d else (0.0, 0.0, math.copysign(1.0, z))


HALF = (0.1, 0.06, 0.08)
SHAPES: dict[str, tuple[BodyShape, BodyShape]] = {
    "ball": (
        closed_form(OnJoint(), None, Ball(0.1), (0.1, 0.1, 0.1)),
        Sphere().build(SphereConfig(radius=0.1), None, None),  # type: ignore[arg-type]
    ),
    "block": (
        closed_form(OnJoint(), None, Block(*HALF), HALF),
        Box().build(BoxConfig(size=(0.2, 0.12, 0.16)), None, None),  # type: ignore[arg-type]
    ),
}
"""As a closed form, and as one of nuno's shapes."""


def joined(*shapes: BodyShape) -> Geometry:
    """Bodies, each on a frame of its own."""
    n = len(shapes)
    each, one = np.arange(n, dtype=np.int32), np.ones(n)
    rows = {
        name: np.concatenate([getattr(s, name) for s in shapes]) for name in ("kind", "a", "b", "radius", "vertices")
    }
    before = np.cumsum([0, *(len(s.vertices) for s in shapes)])
    faces = np.concatenate([s.faces + at for s, at in zip(shapes, before, strict=False)]).astype(np.int32)
    owner = np.repeat(each, [len(s.faces) for s in shapes])
    fields = tuple(field for s in shapes for field in s.fields)
    names = tuple(map(str, range(n)))
    return Geometry(
        names, names, rows["kind"], each, each, rows["a"], rows["b"], rows["radius"], np.nan * one, 0.5 * one,
        0.4 * one, rows["vertices"], faces, owner, fields,
    )  # fmt: skip


def pose(t: float, place: Float) -> Poses:
    """Frames that turn and go, each about a place of its own."""
    turn = np.array([math.cos(0.2 + t), 0.3, math.sin(0.2 + t), -0.2])
    return Poses(t, np.tile(turn / np.linalg.norm(turn), (len(place), 1)), place + t * np.array([0.02, -0.01, 0.03]))


def pushed(geometry: Geometry, place: Float) -> Float:
    """Forces (3, n) on vertices near all bodies, also by friction on anchors of a step before."""
    rng, n = np.random.default_rng(5), 600 * len(place)
    x = np.ascontiguousarray((place[np.arange(n) % len(place)] + rng.uniform(-0.11, 0.11, (n, 3))).T)
    v, force = rng.standard_normal((3, n)), np.zeros((3, n))
    shape = (len(geometry.bodies), n)
    contact = make_contact(geometry, np.full(shape, 40.0), np.full(shape, 0.05), margin=1e-3)
    set_poses(contact, pose(0.0, place), pose(0.02, place))
    add_contact(contact, x, v, 0.3, force, None)
    commit_contact(contact, x, v, 0.3, None)
    force[:] = 0.0
    add_contact(contact, x + 1e-3 * v, v, 0.6, force, None)
    return force


APART = np.array([[0.0, 0.0, 0.0], [0.5, 0.1, 0.0], [-0.2, 0.6, 0.1]])


@pytest.mark.quick(name=["block"])
@pytest.mark.parametrize("name", SHAPES)
def test_a_closed_form_pushes_and_rubs_as_the_shape_that_it_is(name: str) -> None:
    own, known = (pushed(joined(shape), APART[:1]) for shape in SHAPES[name])
    assert (np.abs(known).sum(axis=0) > 0.0).mean() > 0.2
    assert np.abs(own - known).max() < 1e-8 * np.abs(known).max()


@pytest.mark.full
def test_closed_forms_and_sampled_fields_are_met_in_one_scene() -> None:
    """Each as by itself: apart from each other no vertex is near two of them."""
    solid, config = SHAPES["ball"][0], SdfCollider.Config.model_validate({"shape": "box", "size": [0.2, 0.1, 0.2]})
    sampled = SdfCollider().build(config, None, None)  # type: ignore[arg-type]
    together = pushed(joined(SHAPES["block"][0], sampled, solid), APART)
    known = pushed(joined(SHAPES["block"][1], sampled, SHAPES["ball"][1]), APART)
    assert np.abs(together - known).max() < 1e-8 * np.abs(known).max()


def test_the_service_measures_the_distances_of_primitives() -> None:
    geometry = joined(SHAPES["ball"][0], SHAPES["block"][0])
    points = np.random.default_rng(1).uniform(-0.2, 0.2, (500, 3))
    places = pose(0.5, APART[:2])
    known = joined(SHAPES["ball"][1], SHAPES["block"][1])
    assert np.abs(signed_distance(points, geometry, places) - signed_distance(points, known, places)).max() < 1e-15


BAD: dict[str, tuple[Any, tuple[float, float, float]]] = {
    "beyond its bounds": (Ball(0.2), (0.1, 0.1, 0.1)),
    "beyond one bound": (Ball(0.1), (0.1, 0.08, 0.1)),
    "inside out": (Block(-0.1, 0.1, 0.1), (0.1, 0.1, 0.1)),
    "nothing": (Ball(-1.0), (0.1, 0.1, 0.1)),
}


@pytest.mark.parametrize("fault", BAD)
def test_a_form_that_is_not_within_its_bounds_is_refused(fault: str) -> None:
    where = "nowhere within" if fault in ("inside out", "nothing") else "beyond"
    with pytest.raises(BadInput, match=f"distance is negative {where} these bounds"):
        closed_form(OnJoint(), None, *BAD[fault])


@pytest.mark.parametrize("name", SHAPES)
def test_its_mesh_is_closed_and_on_the_surface(name: str) -> None:
    """By Euler's formula, V - E + F = 2, each edge of two triangles; and its volume is the shape's."""
    shape = SHAPES[name][0]
    edges = np.sort(np.stack([shape.faces, np.roll(shape.faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    pairs, count = np.unique(edges, axis=0, return_counts=True)
    assert (count == 2).all() and len(shape.vertices) - len(pairs) + len(shape.faces) == 2
    assert np.abs(shape.fields[0].distance(*shape.vertices.T)).max() < 1e-5  # type: ignore[union-attr]
    a, b, c = (shape.vertices[shape.faces[:, k]] for k in range(3))
    volume = (a * np.cross(b, c)).sum() / 6.0
    assert volume == pytest.approx({"ball": 4.0 / 3.0 * math.pi * 1e-3, "block": 0.2 * 0.12 * 0.16}[name], rel=5e-3)


def test_contact_with_triangles_takes_its_mesh() -> None:
    shape = SHAPES["ball"][0]
    assert (shape.kind == FIELD).all() and len(shape.faces) > 1000
    geometry = replace(joined(shape), fields=(None,))
    inside = signed_distance(np.zeros((1, 3)), geometry, pose(0.0, APART[:1]))
    assert inside == pytest.approx(-0.1, abs=1e-4)
