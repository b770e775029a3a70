"""A person's skin that is drawn in the place of capsules: it lies in them where cloth may be, and changes nothing."""

from __future__ import annotations

import numpy as np
import pytest

from nuno.collision.bodies import build_bodies, surface
from nuno.collision.distance import signed_distance
from nuno.plugin_contract import registry
from nuno.scene import scene_file, shipped
from nuno.simulation.cloth import build_fabrics
from nuno_contact.skinning.drawn_person import COVERED, read_person
from nuno_geometry.closest_point import closest_points
from nuno_geometry.tree import build_tree
from nuno_schemas.bodies import CAPSULE, SKIN, rotation_matrices
from nuno_schemas.errors import BadInput
from nuno_schemas.plugin import Mover

SCENES = ["skirt-hula", "skirt-walk"]
NEAR = 4e-3
"""How far the skin may stick out between the times at which it was drawn in [m]: half of the least margin."""
CLOSED = 0.012
"""How far a waistband may be from the skin [m]; contact keeps cloth about as far off the capsules."""


@pytest.mark.parametrize("name", SCENES)
def test_the_skin_is_in_the_capsules_where_cloth_hangs_over_it(name: str) -> None:
    bodies = build_bodies(scene_file.read(shipped.scenes()[name]))
    person, shown = read_person(), surface(bodies.drawn)
    covered = np.isin(person.part[:, 0], [person.parts.index(part) for part in COVERED])
    covered &= (person.weight * np.isin(person.part, person.part[covered])).sum(axis=1) > 0.99
    for t in np.arange(0.0, 5.0, 0.17):
        poses = bodies.poses(t)
        depth = signed_distance(shown.at(poses)[covered], bodies.geometry, poses)
        assert depth.max() < NEAR


@pytest.mark.parametrize("name", [*SCENES, "contact/two-garments"])
def test_the_waistband_closes_on_the_skin(name: str) -> None:
    """At any time: the trunk fills the capsules that the waistband goes round."""
    loaded = scene_file.read(shipped.scenes()[name])
    bodies, skirt = build_bodies(loaded), build_fabrics(loaded)[0]
    (binding,) = skirt.bindings
    start, shown = bodies.poses(0.0), surface(bodies.drawn)
    place = bodies.drawn.frames.index(f"{binding.body}/{binding.frame}")
    held = (skirt.position[binding.vertices] - start.translation[place]) @ rotation_matrices(start.rotation)[place]
    for t in np.arange(0.0, 4.0, 0.31):
        poses = bodies.poses(t)
        waist = held @ rotation_matrices(poses.rotation)[place].T + poses.translation[place]
        skin = build_tree(shown.at(poses), shown.faces)
        away = closest_points(skin, waist).distance
        assert away.min() > 0.0 and away.max() < CLOSED


@pytest.mark.parametrize("name", SCENES)
def test_cloth_meets_capsules_and_a_person_is_shown_on_the_same_frames(name: str) -> None:
    path = shipped.scenes()[name]
    drawn, plain = (
        build_bodies(scene_file.read(path, (f"bodies.0.collider.drawn={look}",))) for look in ("person", "capsules")
    )
    assert (drawn.geometry.kind == CAPSULE).all() and drawn.drawn.kind.tolist() == [SKIN]
    for field in ("kind", "frame", "a", "b", "radius"):
        assert np.array_equal(getattr(drawn.geometry, field), getattr(plain.geometry, field))
    assert plain.drawn.frames == drawn.drawn.frames == drawn.geometry.frames
    assert np.array_equal(plain.drawn.a, plain.geometry.a)


def test_the_skin_is_closed_and_stands_as_the_skeleton_at_rest() -> None:
    """Its hands are where the hands of the skeleton are, its head above the neck, its soles near the floor."""
    person = read_person()
    sides = np.sort(np.concatenate([person.faces[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    assert (np.unique(sides, axis=0, return_counts=True)[1] == 2).all()
    assert person.weight.sum(axis=1) == pytest.approx(1.0)
    bodies = build_bodies(scene_file.read(shipped.scenes()["skirt-hula"]))
    poses = bodies.poses(0.0)
    x, names = surface(bodies.drawn).at(poses), [frame.split("/")[1] for frame in bodies.drawn.frames]
    for part in ("left_hand", "right_hand", "left_foot", "right_foot", "head"):
        mine = x[person.part[:, 0] == person.parts.index(part)]
        assert np.linalg.norm(mine - poses.translation[names.index(part)], axis=1).min() < 0.05
    assert abs(x[:, 1].min()) < 0.03


def test_a_skeleton_that_is_no_person_is_refused() -> None:
    joints = ("pelvis", "back", "head")
    offsets = np.array([[0.0, 0.9, 0.0], [0.0, 0.3, 0.0], [0.0, 0.3, 0.0]])
    still = np.tile([1.0, 0.0, 0.0, 0.0], (3, 1)), np.cumsum(offsets, axis=0)
    mover = Mover(joints, np.array([-1, 0, 1], np.int32), offsets, lambda t: still)
    skeleton = registry.load("nuno.colliders", "skeleton")
    config = skeleton.Config.model_validate({"drawn": "person"})
    with pytest.raises(BadInput):
        skeleton.build(config, mover, None)


def test_a_person_on_some_bones_is_refused() -> None:
    scene = scene_file.read(shipped.scenes()["skirt-hula"], ("bodies.0.collider.bones=[left_arm]",))
    with pytest.raises(BadInput, match="all bones"):
        build_bodies(scene)
