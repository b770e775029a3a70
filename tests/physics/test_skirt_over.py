"""A skirt on a body: its waist is as long as a tape and the ease, it starts outside, and what does not fit is told."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial import ConvexHull

from nuno.collision.bodies import build_bodies
from nuno.collision.distance import penetration
from nuno.scene import scene_file
from nuno.scene.files import SceneFiles
from nuno.simulation import cloth
from nuno_cloth.models.skirt import Skirt, SkirtConfig
from nuno_cloth.models.skirt_over import find_height
from nuno_contact.body_shapes.leg import leg_mesh
from nuno_contact.body_shapes.person import HEIGHTS, torso_mesh
from nuno_geometry.mesh_files.mesh import read_closed
from nuno_geometry.sections import cut_mesh
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Int
from nuno_schemas.plugin import Files

Body = tuple[Float, Int]
PERSON = {"plugin": "mesh", "shape": "person", "resolution": 64}
TORSO = {"plugin": "mesh", "shape": "torso", "resolution": 48, "arms": "55 deg"}


class NoFiles:
    """A skirt needs none."""

    def resolve(self, name: str) -> Any:
        raise AssertionError(name)


@pytest.fixture(scope="module")
def torso() -> Body:
    return torso_mesh(48, arms=np.radians(55.0))


def skirt(body: Body, over: dict[str, object] | None = None, **fields: object) -> Fabric:
    config = SkirtConfig.model_validate({"over": {"body": "b", **(over or {})}, **fields})
    files: Files = NoFiles()  # type: ignore[assignment]
    return Skirt().build_over(config, files, 0, *body)


def girth(x: Float) -> float:
    """Length of a closed chain of points (n, 3) [m]."""
    return float(np.linalg.norm(x - np.roll(x, 1, axis=0), axis=1).sum())


def tape(body: Body, height: float) -> float:
    """Round the trunk: the perimeter of its section's convex hull [m]."""
    x, faces = body
    loops = cut_mesh(x, faces, x[:, 1] - height)
    trunk = max((loop for loop in loops if abs(float(loop.centroid()[0])) < 0.05), key=lambda loop: loop.girth)
    return float(ConvexHull(trunk.points[:, [0, 2]]).area)


def load(folder: Path, model: dict[str, object], collider: dict[str, object]) -> scene_file.Loaded:
    coarse: dict[str, object] = {"edge": "3 cm"} if "cut" in model else {"columns": 64, "rows": 24, "pleats": 8}
    data: dict[str, Any] = {
        "nuno": 1, "name": "worn", "duration": 1, "contact": {"plugin": "sliding"},
        "objects": [{"name": "skirt", "model": {"plugin": "skirt", **coarse, **model}}],
        "bodies": [{"name": "b", "collider": collider}],
    }  # fmt: skip
    return scene_file.load(data, {}, "worn", SceneFiles(folder))


@pytest.mark.quick(ease=[0.01], fields=[{"cut": "half", "edge": 0.03}])
@pytest.mark.parametrize("fields", [{"rows": 24}, {"fullness": 1.6, "rows": 24}, {"cut": "half", "edge": 0.03}])
@pytest.mark.parametrize(("at", "ease"), [("waist", 0.01), ("waist", 0.04), ("hips", 0.02), (1.0, 0.03)])
def test_the_waist_is_a_tape_and_the_ease(at: str | float, ease: float, fields: dict[str, object], torso: Body) -> None:
    fabric = skirt(torso, {"at": at, "ease": ease}, **fields)
    height = find_height(at, *torso)
    waist = fabric.position[fabric.pinned]
    assert waist[:, 1] == pytest.approx(np.full(len(waist), height), abs=1e-12)
    # A ring's waist is as long as its circle; between its vertices, which are on the curve, chords are shorter.
    short = 1.0 if fields.get("cut") else 0.0
    chords = short * (1.0 + np.pi**2) / len(waist) ** 2
    assert tape(torso, height) + ease == pytest.approx(girth(waist), rel=chords + 1e-5)


def test_the_waist_is_the_narrowest_and_the_hips_the_widest_below_it(torso: Body) -> None:
    waist, hips = (find_height(name, *torso) for name in ("waist", "hips"))
    assert waist == pytest.approx(HEIGHTS["waist"], abs=0.01) and hips == pytest.approx(HEIGHTS["hip"], abs=0.01)
    levels = np.arange(torso[0][:, 1].min() + 0.03, 1.2, 0.01)
    tapes = np.array([tape(torso, float(level)) for level in levels])
    assert tape(torso, waist) <= tapes.min() + 1e-4
    assert tape(torso, hips) >= tapes[levels < waist].max() - 1e-4


MORE: list[dict[str, object]] = [
    {}, {"length": "90 cm"}, {"fullness": 1.8, "pleats": 8}, {"cut": "half", "length": "80 cm"},
    {"cut": "quarter", "over": {"body": "b", "ease": "5 cm"}}, {"over": {"body": "b", "at": "hips"}, "length": "30 cm"},
]  # fmt: skip
CUTS = [{"cut": "circle"}, *(pytest.param(fields, marks=pytest.mark.full) for fields in MORE)]


def starts_outside(loaded: scene_file.Loaded) -> None:
    """By the measure that runs report; and its waist goes with the body."""
    bodies = build_bodies(loaded)
    poses = bodies.poses(0.0)
    fabric, pieces = cloth.build_fabric(loaded, bodies.geometry, poses)
    assert penetration(fabric.position, bodies.geometry, poses).max() == 0.0
    (carried,) = cloth.bind(loaded, fabric, pieces, bodies.geometry, poses)
    assert carried.vertices.tolist() == np.flatnonzero(fabric.pinned).tolist()
    assert carried.local == pytest.approx(fabric.position[fabric.pinned], abs=1e-12)


@pytest.mark.full
@pytest.mark.parametrize("fields", CUTS, ids=str)
def test_it_starts_outside_of_a_mannequin_and_goes_with_it(fields: dict[str, object], tmp_path: Path) -> None:
    """Arms too: they hang where the widest ones would begin."""
    starts_outside(load(tmp_path, {"over": {"body": "b"}, **fields}, PERSON))


@pytest.mark.full
@pytest.mark.parametrize("fields", CUTS, ids=str)
def test_it_starts_outside_of_a_measured_body(fields: dict[str, object], shared_data: Path) -> None:
    loaded = load(shared_data, {"over": {"body": "b"}, **fields}, {"plugin": "mesh", "file": "body-mean.obj"})
    starts_outside(loaded)
    body = read_closed(shared_data / "body-mean.obj")
    if not fields:  # body-mean.yaml has 84.3 cm where its maker sees the waist, a little above the narrowest
        assert tape(body, find_height("waist", *body)) == pytest.approx(0.843, abs=0.01)


def test_it_stands_by_itself_if_that_is_said(tmp_path: Path) -> None:
    loaded = load(tmp_path, {"over": {"body": "b"}, "attach": None}, TORSO)
    assert cloth.build_fabric(loaded)[0].bindings == ()


@pytest.mark.full
def test_the_ease_that_is_told_is_enough_and_no_less_is(torso: Body) -> None:
    with pytest.raises(BadInput, match="too narrow") as caught:
        skirt(torso, cut="quarter")
    ease = float(re.findall(r"ease: ([\d.]+) cm", str(caught.value.remedy))[0])
    skirt(torso, {"ease": 0.01 * ease}, cut="quarter")
    with pytest.raises(BadInput, match="too narrow"):
        skirt(torso, {"ease": 0.01 * ease - 0.002}, cut="quarter")


def test_a_hem_that_is_too_narrow_for_the_hips_is_refused(torso: Body) -> None:
    with pytest.raises(BadInput, match="too narrow") as caught:
        skirt(torso, hem_radius=0.14)
    assert caught.value.field == "hem_radius"


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"over": {"body": "b"}, "waist_radius": 0.1}, "leave waist_radius out"),
        ({"over": {"body": "b"}, "ratio": 0.8, "centre": [0, 1, 0]}, "leave centre, ratio out"),
        ({"cut": "half", "columns": 64, "fullness": 2}, "leave columns, fullness out"),
        ({"edge": 0.01}, "leave edge out"),
    ],
)
def test_what_follows_from_the_body_or_the_cut_is_refused_by_name(fields: dict[str, object], text: str) -> None:
    with pytest.raises(ValidationError, match=text):
        SkirtConfig.model_validate(fields)


def test_bodies_without_a_trunk_are_refused(torso: Body) -> None:
    with pytest.raises(BadInput, match="no armpits"):
        skirt(leg_mesh(48))
    with pytest.raises(BadInput, match="no trunk at this height") as caught:
        skirt(torso, {"at": 3.0})
    assert caught.value.field == "over.at"
    config, worn = SkirtConfig.model_validate({"over": {"body": "b"}}), skirt(torso)
    with pytest.raises(BadInput, match="bare body"):
        Skirt().build_over(config, NoFiles(), 0, *torso, worn=[worn])  # type: ignore[arg-type]
