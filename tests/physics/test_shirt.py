"""A shirt is one sewn surface that lies flat at rest, and starts clear of the body that it is cut to."""

from __future__ import annotations

from typing import Any

import ipctk
import numpy as np
import pytest

from nuno.simulation.yarns import structural_edges
from nuno_cloth.models.delaunay import fill_outline, triangulate
from nuno_cloth.models.membrane import open_spans
from nuno_cloth.models.shirt import STANDARD, Shirt, ShirtConfig, sewn_for, take_measures
from nuno_cloth.models.shirt_pattern import outline_of
from nuno_cloth.models.triangles import find_edges
from nuno_cloth.models.wearer import find_wearer
from nuno_contact.body_shapes.leg import leg_mesh
from nuno_contact.body_shapes.person import torso_mesh
from nuno_geometry.closest_point import closest_points
from nuno_geometry.tree import build_tree
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Int
from nuno_schemas.vectors import face_areas

Body = tuple[Float, Int]


class NoFiles:
    """A shirt needs none."""

    def resolve(self, name: str) -> Any:
        raise AssertionError(name)


@pytest.fixture(scope="module")
def body() -> Body:
    return torso_mesh(32, arms=np.radians(55.0))


def config(**fields: object) -> ShirtConfig:
    return ShirtConfig.model_validate({"over": {"body": "b"}, "around": 40, **fields})


def shirt(body: Body, **fields: object) -> Fabric:
    return Shirt().build_over(config(**fields), NoFiles(), 0, *body)


def stretch(fabric: Fabric) -> Float:
    """Of all springs, or of the sides of the membrane's triangles."""
    pairs, rest = structural_edges(fabric)
    if fabric.springs is not None:
        pairs, rest = fabric.springs.pairs(), fabric.springs.per_spring(fabric.springs.rest)
    length = np.linalg.norm(np.diff(fabric.position[pairs], axis=1)[:, 0], axis=1)
    return np.asarray(length / rest - 1.0)


def test_spans_across_a_fold_do_not_depend_on_its_angle() -> None:
    """In the plane they are distances."""
    draws = np.random.default_rng(5).uniform(0.2, 1.0, (20, 5))
    quads = np.array([[0, 1, 2, 3]], np.int32)
    for one, high, other, low, length in draws:
        for angle in (0.0, 1.0, np.pi):
            right = [other, -low * np.cos(angle), low * np.sin(angle)]
            x = np.array([[0.0, 0.0, 0.0], [length, 0.0, 0.0], [one, high, 0.0], right])
            assert open_spans(x, quads) == pytest.approx([np.hypot(one - other, high + low)], rel=1e-14)


def test_springs_across_seams_are_as_long_as_the_seam_laid_open(body: Body) -> None:
    """Front and back lie on each other as they are cut; and a fold only brings a spring's ends closer."""
    made = shirt(body, fabric={"structural": "100 N/m", "bending": "2 N/m", "density": 0.2})
    edges = len(find_edges(made.faces).pairs)
    stretched = stretch(made)
    assert len(stretched) > edges and stretched[edges:].max() < stretched[:edges].max() < 0.2


def test_triangles_are_delaunay() -> None:
    points = np.random.default_rng(3).random((150, 2))
    faces = triangulate(points)
    a, b, c = (points[faces[:, k]] for k in range(3))
    one, other = b - a, c - a
    area = 0.5 * (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
    assert (area > 0.0).all()
    # No point lies in any triangle's circumcircle; together they fill the convex hull: 2 n - 2 - h triangles.
    d = 2.0 * (2.0 * area)
    bb, cc = ((b - a) ** 2).sum(1), ((c - a) ** 2).sum(1)
    middle = a + np.stack(
        [((c - a)[:, 1] * bb - (b - a)[:, 1] * cc) / d, ((b - a)[:, 0] * cc - (c - a)[:, 0] * bb) / d], 1
    )
    radius = np.linalg.norm(middle - a, axis=1)
    distance = np.linalg.norm(points[None] - middle[:, None], axis=2)
    assert (distance > radius[:, None] * (1.0 - 1e-9)).all()
    rim = (find_edges(faces).count == 1).sum()
    assert len(faces) == 2 * len(points) - 2 - rim


def test_outlines_are_filled_evenly() -> None:
    turn = 2.0 * np.pi * np.arange(62) / 62
    points, faces = fill_outline(np.stack([np.cos(turn), np.sin(turn)], axis=1), 0.1)
    flat = np.concatenate([points, np.zeros((len(points), 1))], axis=1)
    assert face_areas(flat[faces]).sum() == pytest.approx(31.0 * np.sin(turn[1]), rel=1e-12)
    sides = np.linalg.norm(flat[faces] - flat[np.roll(faces, 1, axis=1)], axis=2)
    assert sides.min() > 0.05 and sides.max() < 0.17


def test_a_shirt_is_a_tube_with_four_holes(body: Body) -> None:
    fabric = shirt(body)
    assert fabric.number == Shirt().count(config(), NoFiles())
    edges = find_edges(fabric.faces)
    assert edges.count.max() == 2
    assert len(edges.inner) == (edges.count == 2).sum(), "neighbours face the same way"
    assert fabric.number - len(edges.pairs) + len(fabric.faces) == 2 - 4, "a sphere less hem, neck and two cuffs"
    rim = edges.pairs[edges.count == 1]
    assert (np.bincount(rim.reshape(-1))[np.unique(rim)] == 2).all()
    assert face_areas(fabric.position[fabric.faces]).min() > 1e-6
    # All face alike; so outwards all over, if they do so about the trunk's lower part together.
    corners = fabric.position[fabric.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middle = corners.mean(axis=1)
    outwards = (normal * middle * [1.0, 0.0, 1.0]).sum(axis=1)[middle[:, 1] < 1.1]
    assert (outwards > 0.0).mean() > 0.98


@pytest.mark.quick(around=[40])
@pytest.mark.parametrize("around", [40, 64])
def test_it_does_not_start_in_itself(body: Body, around: int) -> None:
    """Below the arms, where there is more cloth than room, it folds: no edge goes through a triangle, by ipctk."""
    fabric = shirt(body, around=around)
    mesh = ipctk.CollisionMesh(fabric.position, find_edges(fabric.faces).pairs, fabric.faces)
    assert not ipctk.has_intersections(mesh, fabric.position)


def test_at_rest_it_lies_flat(body: Body) -> None:
    fabric = shirt(body)
    cut, sewn = sewn_for(STANDARD, config())
    outline = np.concatenate([line[:-1] for line in outline_of(cut, cut.front)])
    x, y = outline.T
    front = x @ np.roll(y, -1) - y @ np.roll(x, -1)
    neck = 0.25 * np.pi * cut.neck * (cut.front - cut.back)
    # Front and back, two halves each; the back has what the front's deeper neck takes away.
    assert face_areas(sewn.flat[sewn.faces]).sum() == pytest.approx(2.0 * (front + neck), rel=5e-3)
    assert fabric.mass.sum() == pytest.approx(0.187 * face_areas(sewn.flat[sewn.faces]).sum(), rel=0.05)
    assert fabric.membrane is not None and fabric.bending is not None and fabric.hinges is None
    own = sewn_for(take_measures(find_wearer(*body), config())[0], config())[1]
    flat = own.flat[own.faces]
    sides = np.linalg.norm(flat - np.roll(flat, -1, axis=1), axis=2)
    np.testing.assert_allclose(fabric.membrane.sides(), sides, rtol=1e-12)
    assert fabric.uv is not None and fabric.uv.min() >= 0.0 and fabric.uv.max() <= 1.0


@pytest.mark.parametrize("fields", [{"sleeve": 0.25, "slope": 0.45}, {"length": 0.4, "ease": 0.3, "cuff": 0.15}])
def test_it_starts_clear_and_hardly_stretched(body: Body, fields: dict[str, float]) -> None:
    fabric = shirt(body, **fields)
    distance = closest_points(build_tree(*body), fabric.position).distance
    assert distance.min() > 4.9e-3
    off = stretch(fabric)
    assert np.abs(np.quantile(off, [0.02, 0.98])).max() < 0.15 and off.max() < 0.25


def test_it_is_cut_to_the_body_wherever_that_stands(body: Body) -> None:
    x, faces = body
    sizes, _ = take_measures(find_wearer(x, faces), config())
    away = np.array([0.3, 0.5, -0.2])
    moved, _ = take_measures(find_wearer(x + away, faces), config())
    np.testing.assert_allclose(moved, sizes, rtol=1e-6)
    wider = torso_mesh(48, {"bust": 0.98, "arm": 0.31}, np.radians(55.0))
    more, _ = take_measures(find_wearer(*wider), config())
    # Below the armpits trunks are a little narrower than at the bust.
    assert more.chest - sizes.chest == pytest.approx(0.07, abs=0.01)
    assert more.arm - sizes.arm > 0.02
    np.testing.assert_array_equal(sewn_for(more, config())[1].faces, sewn_for(sizes, config())[1].faces)


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"ease": 0.01}, "the shirt would start inside of the body, or too near to it"),
        ({"cuff": 0.005}, "the shirt would start inside of the body, or too near to it"),
        ({"slope": 0.9}, "no shirt is cut with such an overarm"),
    ],
)
def test_what_cannot_be_worn_is_refused_by_name(body: Body, fields: dict[str, float], problem: str) -> None:
    with pytest.raises(BadInput, match=problem):
        shirt(body, **fields)


def test_bodies_that_wear_no_shirt_are_refused() -> None:
    with pytest.raises(BadInput, match="no armpits are found on this body"):
        shirt(leg_mesh(24))


def test_bodies_that_lie_tilted_are_refused_with_what_turns_them(body: Body) -> None:
    """About 60 degrees: something like armpits is found, and no arm that goes on from them."""
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.5, -np.sqrt(0.75)], [0.0, np.sqrt(0.75), 0.5]])
    tilted = np.ascontiguousarray(body[0] @ turn.T), body[1]
    for put_on, problem in (
        (shirt, "the body lies"),
        (lambda b: take_measures(find_wearer(*b), config()), "no trunk and arms"),
    ):
        with pytest.raises(BadInput, match=problem) as refused:
            put_on(tilted)
        assert refused.value.remedy is not None and "up: z" in refused.value.remedy and "scale" in refused.value.remedy
