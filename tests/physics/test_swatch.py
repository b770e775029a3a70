"""Flat pieces: as large as they are cut, in triangles of one size."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from nuno_cloth.models.skirt import Skirt
from nuno_cloth.models.swatch import Swatch, SwatchConfig, lay
from nuno_contact.body_shapes.person import torso_mesh
from nuno_geometry.closest_point import closest_points
from nuno_geometry.sections import section_about
from nuno_geometry.tree import build_tree
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Int


def corners(seed: int = 0, **fields: Any) -> Float:
    """(f, 3, 2) of a piece's triangles [m]."""
    points, faces = lay(SwatchConfig.model_validate(fields), seed)
    return np.asarray(points[faces])


def area_of(flat: Float) -> float:
    one, other = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    return 0.5 * float((one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]).sum())


def polygon(radius: float, edge: float) -> float:
    """Area of as many corners on a circle as edges of this length go round it [m^2]."""
    around = max(12, round(2.0 * np.pi * radius / edge))
    return 0.5 * around * radius**2 * float(np.sin(2.0 * np.pi / around))


@pytest.mark.parametrize("layout", ["irregular", "aligned", "crossed"])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_disc_is_filled_with_triangles_of_one_size(seed: int, layout: str) -> None:
    """Up to its rim all round: no side is much longer than others."""
    flat = corners(seed, radius=0.3, edge=0.02, layout=layout)
    sides = np.linalg.norm(flat - np.roll(flat, 1, axis=1), axis=2)
    assert sides.max() < 2.2 * 0.02
    assert area_of(flat) == pytest.approx(polygon(0.3, 0.02), rel=1e-12) == pytest.approx(np.pi * 0.3**2, rel=1e-3)


@pytest.mark.parametrize("layout", ["irregular", "aligned"])
@pytest.mark.parametrize("shape", [{"radius": 0.3}, {"size": (0.7, 0.5)}])
def test_a_hole_takes_its_area_out_of_the_middle(shape: dict[str, Any], layout: str) -> None:
    """pi r^2, but for the chords of its rim, and nothing else: with one border more, and all triangles of one size."""
    fields = {**shape, "edge": 0.02, "layout": layout}
    whole = polygon(0.3, 0.02) if "radius" in shape else 0.35
    flat = corners(**fields, hole=0.1)
    assert area_of(flat) == pytest.approx(whole - polygon(0.1, 0.02), rel=1e-12)
    assert polygon(0.1, 0.02) == pytest.approx(np.pi * 0.1**2, rel=1e-2)
    points, faces = lay(SwatchConfig.model_validate({**fields, "hole": 0.1}), 0)
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    pairs, count = np.unique(sides, axis=0, return_counts=True)
    rims = pairs[count == 1]
    assert len(np.unique(faces)) == len(points) and count.max() == 2
    # Corners less sides and triangles of a ring are none.
    assert len(points) - len(pairs) + len(faces) == 0
    inner = np.linalg.norm(points[rims], axis=2).max(axis=1) < 0.1 + 1e-9
    assert inner.sum() == round(2.0 * np.pi * 0.1 / 0.02)
    assert np.linalg.norm(flat - np.roll(flat, 1, axis=1), axis=2).max() < 2.5 * 0.02


@pytest.fixture(scope="module")
def torso() -> tuple[Float, Int]:
    return torso_mesh(48, arms=np.radians(55.0))


def poncho(body: tuple[Float, Int], worn: tuple[Fabric, ...] = (), **fields: Any) -> Fabric:
    config = SwatchConfig.model_validate({"radius": 0.5, "hole": 0.11, "edge": 0.03, "over": {"body": "b"}, **fields})
    return Swatch().build_over(config, None, 0, *body, worn=worn)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "fields", [{}, {"radius": None, "size": (0.9, 0.9)}, {"over": {"body": "b", "clearance": 0.01}}]
)
def test_a_poncho_begins_level_as_low_on_the_shoulders_as_it_can(
    fields: dict[str, Any], torso: tuple[Float, Int]
) -> None:
    """It is as flat as it is cut, outside of the body, its hole round the neck; and any lower it would touch."""
    fabric = poncho(torso, **fields)
    x, clearance = fabric.position, fields.get("over", {}).get("clearance", 0.005)
    assert np.ptp(x[:, 1]) == 0.0
    away = closest_points(build_tree(*torso), x).distance
    assert away.min() > 0.5 * clearance
    level = float(x[0, 1])
    middle = np.array([0.0, level, x[np.hypot(*x[:, [0, 2]].T) < 0.15, 2].mean()])
    neck = section_about(*torso, middle, np.array([0.0, 1.0, 0.0]))
    assert neck is not None and np.linalg.norm(neck.points - middle, axis=1).max() < 0.11
    lower = np.column_stack([torso[0][:, 0], torso[0][:, 2]])
    beyond = np.linalg.norm(lower - middle[[0, 2]], axis=1) > 0.12
    assert (
        torso[0][beyond, 1].max()
        < level
        < torso[0][np.linalg.norm(lower - middle[[0, 2]], axis=1) > 0.1, 1].max() + 0.02
    )
    assert fabric.membrane is not None and not fabric.pinned.any()
    assert fabric.membrane.area.sum() == pytest.approx(area_of(x[fabric.faces][..., [0, 2]][:, ::-1]), rel=1e-9)


def test_it_lies_above_what_is_worn(torso: tuple[Float, Int]) -> None:
    config = Skirt.Config.model_validate({"over": {"body": "b"}, "columns": 48, "rows": 12, "pleats": 6})
    skirt = Skirt().build_over(config, None, 0, *torso)  # type: ignore[arg-type]
    bare, over = poncho(torso), poncho(torso, worn=(skirt,))
    assert over.position[0, 1] == bare.position[0, 1]
    lifted = skirt.position + np.array([0.0, float(bare.position[0, 1] - skirt.position[:, 1].max()), 0.0])
    raised = poncho(torso, worn=(replace(skirt, position=lifted),))
    assert raised.position[0, 1] == pytest.approx(bare.position[0, 1] + 0.005, abs=1e-12)


def test_a_hole_too_narrow_for_the_neck_is_refused_with_one_that_is_not(torso: tuple[Float, Int]) -> None:
    with pytest.raises(BadInput, match="too narrow") as caught:
        poncho(torso, hole=0.05)
    assert caught.value.field == "hole"
    enough = float(str(caught.value.remedy).removeprefix("hole: ").removesuffix(" cm")) / 100.0
    assert poncho(torso, hole=enough).number > 0
    with pytest.raises(BadInput, match="too narrow"):
        poncho(torso, hole=enough - 0.002)


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"radius": 0.3, "hole": 0.1, "hold": 0.1}, "leave hold or hole out"),
        ({"radius": 0.3, "hole": 0.295}, "leaves no edge round it"),
        ({"radius": 0.3, "over": {"body": "b"}}, "hole for its head"),
        ({"radius": 0.3, "hole": 0.1, "over": {"body": "b"}, "centre": [0, 1, 0]}, "leave centre out"),
        (
            {"radius": 0.3, "hole": 0.1, "over": {"body": "b"}, "rotate": {"axis": [1, 0, 0], "angle": 1}},
            "begins level",
        ),
    ],
)
def test_what_makes_no_piece_is_refused_in_words(fields: dict[str, Any], text: str) -> None:
    with pytest.raises(ValidationError, match=text):
        SwatchConfig.model_validate(fields)
