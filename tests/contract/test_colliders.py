"""Colliders: what they build lies in Geometry's layout, and bad input is refused by name."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from nuno_contact.colliders.body_parts import PELVIS_HALF_WIDTH, default_radius
from nuno_contact.colliders.shapes import (
    Box,
    BoxConfig,
    Capsule,
    CapsuleConfig,
    Plane,
    PlaneConfig,
    Sphere,
    SphereConfig,
)
from nuno_contact.colliders.skeleton import Skeleton, SkeletonConfig, find_height
from nuno_contact.motions.bvh import BVH, BvhConfig
from nuno_contact.motions.hula import Hula, HulaConfig
from nuno_contact.penalty.plugin import PenaltyConfig
from nuno_schemas.bodies import BOX, CAPSULE, PLANE
from nuno_schemas.errors import BadInput
from nuno_schemas.plugin import Mover

DATA = Path(__file__).parents[3] / "shared" / "data"
WALK = DATA / "cmu_12_01_walk.bvh"


class Anywhere:
    def resolve(self, name):
        return Path(name)


@pytest.fixture(scope="module")
def dancer():
    return Hula().prepare(HulaConfig(height=1.7), Anywhere())


@pytest.fixture(scope="module")
def walker():
    if not WALK.exists():
        pytest.skip("shared data cmu_12_01_walk.bvh is not there")
    return BVH().prepare(BvhConfig(file=str(WALK), height=1.7), Anywhere())


def skeleton(mover, **config):
    return Skeleton().build(SkeletonConfig(**config), mover, Anywhere())


def pieces_of(shape, mover, joint):
    rows = [i for i, f in enumerate(shape.frame) if mover.joints[f] == joint]
    return [(shape.a[i], shape.b[i], shape.radius[i]) for i in rows]


@pytest.mark.parametrize(
    ("collider", "config", "kind", "a", "b", "radius"),
    [
        (Capsule, CapsuleConfig(a=(0, 0, 0), b=("10 cm", 0, 0), radius="3 cm"), CAPSULE, (0, 0, 0), (0.1, 0, 0), 0.03),
        (Sphere, SphereConfig(centre=(0, 1, 0), radius=0.3), CAPSULE, (0, 1, 0), (0, 1, 0), 0.3),
        (Plane, PlaneConfig(point=(0, "1 mm", 0), normal=(0, 3, 4)), PLANE, (0, 0.001, 0), (0, 0.6, 0.8), 0.0),
        (Box, BoxConfig(centre=(1, 0, 0), size=(1, "20 cm", 3)), BOX, (1, 0, 0), (0.5, 0.1, 1.5), 0.0),
    ],
)
def test_single_shapes_follow_the_layout(collider, config, kind, a, b, radius, dancer):
    for mover, frames in ((None, ("world",)), (dancer, dancer.joints)):
        shape = collider().build(config, mover, Anywhere())
        assert shape.frames == frames
        assert shape.kind.tolist() == [kind]
        np.testing.assert_allclose([*shape.a[0], *shape.b[0], shape.radius[0]], [*a, *b, radius], rtol=1e-15)


def test_a_shape_rides_on_the_joint_that_is_named(dancer):
    config = SphereConfig(radius=0.1, joint="head")
    assert dancer.joints[Sphere().build(config, dancer, Anywhere()).frame[0]] == "head"
    with pytest.raises(BadInput, match="no such joint") as caught:
        Sphere().build(SphereConfig(radius=0.1, joint="hed"), dancer, Anywhere())
    assert "'head'" in str(caught.value)


@pytest.mark.parametrize(
    ("model", "values", "field"),
    [
        (SphereConfig, {"radius": 0}, "radius"),
        (CapsuleConfig, {"a": (0, 0, 0), "b": (0, 0, 1), "radius": "-1 cm"}, "radius"),
        (SphereConfig, {"radius": float("nan")}, "radius"),
        (BoxConfig, {"size": (1, 0, 1)}, "size"),
        (SphereConfig, {"radius": 1, "center": (0, 0, 0)}, "center"),
        (PenaltyConfig, {"friction": -0.1}, "friction"),
        (PenaltyConfig, {"damping": -1}, "damping"),
        (PenaltyConfig, {"stiffness": "0 N/m"}, "stiffness"),
        (PenaltyConfig, {"stiffness": "3 kg"}, "stiffness"),
        (SkeletonConfig, {"radii": {"thigh": 0}}, "radii"),
        (SkeletonConfig, {"radii": {"thigh": []}}, "radii"),
        (HulaConfig, {"tempo": -1}, "tempo"),
        (BvhConfig, {"file": "x.bvh", "height": 0}, "height"),
    ],
)
def test_bad_values_are_refused_by_field(model, values, field):
    with pytest.raises(ValidationError) as caught:
        model(**values)
    assert field in {error["loc"][0] for error in caught.value.errors()}


def test_a_plane_needs_a_direction():
    with pytest.raises(BadInput, match="normal"):
        Plane().build(PlaneConfig(normal=(0, 0, 0)), None, Anywhere())


def test_the_dancer_has_the_papers_pieces(dancer):
    shape = skeleton(dancer, bones=("pelvis", "back", "thigh", "shin"))
    assert len(pieces_of(shape, dancer, "spine")) + len(pieces_of(shape, dancer, "chest")) == 2
    for side in ("left", "right"):
        assert len(pieces_of(shape, dancer, f"{side}_thigh")) == 3
        assert len(pieces_of(shape, dancer, f"{side}_shin")) == 2
    whole = skeleton(dancer, bones=("thigh", "shin"), split=False)
    assert len(whole.radius) == 4


@pytest.mark.parametrize("split", [True, False])
@pytest.mark.parametrize("body", ["dancer", "walker"])
def test_pieces_cover_their_bone_end_to_end(body, split, request):
    """Every point of a bone is inside a piece; pieces join; only a last cap is drawn in."""
    mover = request.getfixturevalue(body)
    shape = skeleton(mover, split=split)
    covered = 0
    for child, parent in enumerate(mover.parents):
        pieces = pieces_of(shape, mover, mover.joints[parent])
        bone = mover.offsets[child]
        if parent < 0 or not bone.any() or not pieces or "hip" in mover.joints[parent].lower():
            continue
        for s in np.linspace(0.0, 1.0, 21):
            depth = max(radius - segment_distance(s * bone, a, b) for a, b, radius in pieces)
            assert depth > -1e-12, (mover.joints[parent], s)
        along = [(a, b) for a, b, _ in pieces if np.linalg.norm(np.cross(b - a, bone)) < 1e-12]
        for (_, b), (a, _) in itertools.pairwise(along):
            np.testing.assert_allclose(a if a.any() else b, b, atol=1e-14)
        covered += 1
    assert covered >= 8


def segment_distance(x, a, b):
    d = b - a
    s = np.clip((x - a) @ d / (d @ d), 0.0, 1.0) if d.any() else 0.0
    return np.linalg.norm(x - a - s * d)


@pytest.mark.parametrize("body", ["dancer", "walker"])
def test_the_pelvis_is_as_wide_as_measured(body, request):
    mover = request.getfixturevalue(body)
    shape = skeleton(mover, bones=("pelvis",))
    height = find_height(mover)
    a, b, radius = shape.a[0], shape.b[0], shape.radius[0]
    assert radius == pytest.approx(height * default_radius("pelvis", 0.0, 1.0))
    assert 0.5 * np.linalg.norm(b - a) + radius <= PELVIS_HALF_WIDTH * height * (1.0 + 1e-12)
    assert abs((b - a)[0]) > 0.99 * np.linalg.norm(b - a)


def test_radii_of_bones_and_parts_can_be_given(dancer):
    shape = skeleton(dancer, radii={"thigh": ["9 cm", "8 cm"], "left_thigh": 0.07, "shin": 0.04})
    assert [r for *_, r in pieces_of(shape, dancer, "left_thigh")] == [0.07]
    assert [r for *_, r in pieces_of(shape, dancer, "right_thigh")] == [0.09, 0.08]
    assert [r for *_, r in pieces_of(shape, dancer, "left_shin")] == [0.04]
    doubled = skeleton(dancer, height=2.0 * find_height(dancer), bones=("shin",))
    np.testing.assert_allclose(doubled.radius, 2.0 * skeleton(dancer, bones=("shin",)).radius, rtol=1e-14)


@pytest.mark.parametrize(
    ("config", "offered"), [({"radii": {"left_tigh": 0.1}}, "left_thigh"), ({"bones": ("bak",)}, "back")]
)
def test_unknown_bones_are_refused_with_the_nearest_name(dancer, config, offered):
    with pytest.raises(BadInput, match="no such bone") as caught:
        skeleton(dancer, **config)
    assert f"did you mean '{offered}'" in str(caught.value)


def mover_of(joints, parents, offsets):
    still = np.tile([1.0, 0.0, 0.0, 0.0], (len(joints), 1))
    offsets = np.array(offsets, np.float64)
    return Mover(tuple(joints), np.array(parents, np.int32), offsets, lambda t: (still, offsets))


def test_a_skeleton_without_sense_is_refused():
    with pytest.raises(BadInput, match="needs a motion"):
        skeleton(None)
    with pytest.raises(BadInput, match="no bone of nonzero length"):
        skeleton(mover_of(["hips", "spine"], [-1, 0], np.zeros((2, 3))))
    odd = mover_of(["hips", "gizmo", "gizmo_end"], [-1, 0, 1], [(0, 1, 0), (0, 0.1, 0), (0, 0.2, 0)])
    with pytest.raises(BadInput, match="which part") as caught:
        skeleton(odd)
    assert caught.value.value == "gizmo"
    assert len(skeleton(odd, radii={"gizmo": "3 cm"}).radius) == 2


def test_zero_length_bones_are_skipped(walker):
    assert "LHipJoint" in walker.joints
    shape = skeleton(walker)
    lengths = np.linalg.norm(shape.b - shape.a, axis=1) + shape.radius
    assert lengths.min() > 0.01


@pytest.mark.skipif(not (DATA / "body.obj").exists(), reason="shared data body.obj is not there")
@pytest.mark.parametrize("level", [0.10, 0.20, 0.32, 0.38, 0.44])
def test_leg_radii_are_those_of_a_real_body(level):
    """Girth / 2 pi of a horizontal section through one leg, against the default at that height."""
    import trimesh

    mesh = trimesh.load(DATA / "body.obj", process=False)
    height = mesh.bounds[1, 1]
    lines = trimesh.intersections.mesh_plane(mesh, [0, 1, 0], [0, level * height, 0])
    leg = lines[(lines[:, :, 0] > 0.0).all(axis=1) & (np.abs(lines[:, :, 0]) < 0.2 * height).all(axis=1)]
    girth = np.linalg.norm(leg[:, 1] - leg[:, 0], axis=1).sum() / (2.0 * np.pi)
    part, top, bottom = ("shin", 0.285, 0.045) if level < 0.285 else ("thigh", 0.52, 0.285)
    where = (top - level) / (top - bottom)
    assert height * default_radius(part, where, where) == pytest.approx(girth, rel=0.06)
