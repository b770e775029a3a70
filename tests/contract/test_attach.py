"""Cloth is attached only where it is worn: the distance is told where it is not."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from nuno.collision.bodies import build_bodies
from nuno.scene import scene_file, shipped
from nuno.simulation import cloth
from nuno.simulation.start_checks import check_worn
from nuno_schemas.bodies import BOX, CAPSULE, PLANE, Geometry, Poses
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Binding, Float


def body(kind: int, a: Float, b: Float, radius: float) -> tuple[Geometry, Poses]:
    """One primitive on the frame "ball/arm", which is turned by 90 degrees about z and 1 m up; the
    frame "ball/tip", 2 m up, carries none.
    """
    one = np.ones(1)
    geometry = Geometry(
        ("ball",), ("ball/arm", "ball/tip"), np.array([kind], np.int8), np.zeros(1, np.int32), np.zeros(1, np.int32),
        a[None], b[None], np.array([radius]), one, one, one,
    )  # fmt: skip
    half = np.sqrt(0.5)
    rotation = np.array([[half, 0.0, 0.0, half], [1.0, 0.0, 0.0, 0.0]])
    return geometry, Poses(0.0, rotation, np.array([[0.0, 1.0, 0.0], [0.0, 2.0, 0.0]]))


def ring(height: float, radius: float = 0.3, n: int = 12) -> Float:
    angle = np.arange(n) * 2 * np.pi / n
    return np.stack([radius * np.cos(angle), np.full(n, height), radius * np.sin(angle)], axis=1)


CAPSULE_UP = (CAPSULE, np.array([0.0, 0.0, 0.0]), np.array([0.5, 0.0, 0.0]), 0.1)
"""The frame's x points up in the world: from 1 to 1.5 m, caps apart."""


@pytest.mark.parametrize(("height", "worn"), [(1.0, True), (1.79, True), (1.81, False), (0.71, True), (0.69, False)])
def test_the_limit_is_twice_the_radius_from_the_surface(height: float, worn: bool) -> None:
    """On the axis, above and below: 3 radii from the capsule's ends. The ring is wider than that."""
    geometry, poses = body(*CAPSULE_UP)
    if worn:
        check_worn(ring(height, 0.5), geometry, poses, 0)
        return
    with pytest.raises(BadInput, match="far from") as caught:
        check_worn(ring(height, 0.5), geometry, poses, 0)
    assert caught.value.value == f"ball/arm: {0.21:.3g} m from the body's surface there"
    assert str(caught.value.limit).startswith("0.2 m")
    assert "[0, 1, 0] m" in str(caught.value.remedy)


def test_a_flag_is_held_at_one_end() -> None:
    geometry, poses = body(*CAPSULE_UP)
    flag = np.stack([np.linspace(0.1, 2.0, 9), np.full(9, 1.2), np.zeros(9)], axis=1)
    check_worn(flag, geometry, poses, 0)
    with pytest.raises(BadInput):
        check_worn(flag + np.array([0.5, 0.0, 0.0]), geometry, poses, 0)


def test_a_frame_without_shape_counts_as_thick_as_its_body() -> None:
    geometry, poses = body(*CAPSULE_UP)
    check_worn(ring(2.29, 0.5), geometry, poses, 1)
    with pytest.raises(BadInput, match="far from"):
        check_worn(ring(2.31, 0.5), geometry, poses, 1)


def test_boxes_reach_as_far_as_they_are_long_and_planes_without_end() -> None:
    geometry, poses = body(BOX, np.zeros(3), np.array([0.5, 0.2, 0.1]), 0.0)
    check_worn(ring(2.49), geometry, poses, 0)
    with pytest.raises(BadInput):
        check_worn(ring(2.51), geometry, poses, 0)
    geometry, poses = body(PLANE, np.zeros(3), np.array([1.0, 0.0, 0.0]), 0.0)
    check_worn(ring(100.0), geometry, poses, 0)


def system(folder: Path, **model: Any) -> None:
    data = yaml.safe_load(shipped.scenes("")["skirt-hula"].read_text())
    data["objects"][0]["model"] |= model
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    loaded = scene_file.read(path)
    bodies = build_bodies(loaded)
    cloth.build_system(loaded, *cloth.build_fabric(loaded), bodies.geometry, bodies.poses(0.0), 1)


def test_a_skirt_whose_centre_was_forgotten_is_refused_at_its_line(tmp_path: Path) -> None:
    system(tmp_path)
    with pytest.raises(BadInput, match="far from") as caught:
        system(tmp_path, centre=[0, 0, 0])
    assert caught.value.field == "objects[0].model.attach"
    assert caught.value.line is not None
    assert str(caught.value.value).startswith("dancer/hips: 0.7")


FRAMES = ("ball/world", "dancer/hips", "dancer/chest")
HELD = np.zeros(1, np.int32)


def test_a_frame_need_not_be_named_of_a_body_that_has_one() -> None:
    assert cloth.frame_of(Binding(HELD, "ball"), FRAMES) == cloth.frame_of(Binding(HELD, "ball", "world"), FRAMES) == 0
    assert cloth.frame_of(Binding(HELD, "dancer", "chest"), FRAMES) == 2


@pytest.mark.parametrize(
    ("body", "frame", "text"),
    [
        ("dancer", None, "several frames.*hips, chest.*attach: "),
        ("dancer", "hip", "dancer/hip.*did you mean 'dancer/hips'"),
        ("bal", None, "bal.*known: ball/world"),
    ],
)
def test_a_frame_that_there_is_not_is_answered_with_those_there_are(body: str, frame: str | None, text: str) -> None:
    with pytest.raises(BadInput) as caught:
        cloth.frame_of(Binding(HELD, body, frame), FRAMES)
    assert re.search(text, str(caught.value), re.DOTALL)


def test_a_skirt_is_attached_to_a_body_of_several_frames_by_name(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="several frames") as caught:
        system(tmp_path, attach={"body": "dancer"})
    assert caught.value.field == "objects[0].model.attach.body"
