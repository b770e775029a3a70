"""A user's own leg, from a file of any kind, and what is said of one that cannot wear a stocking."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
import yaml

from nuno.cli.common import load_scene
from nuno.scene import shipped
from nuno.scene.scene_file import Loaded
from nuno.simulation import cloth
from nuno_contact.body_shapes.leg import leg_mesh
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float

AROUND = 24
SMALL = (
    "objects.stocking.model.wales=12",
    "objects.stocking.model.courses=39",
    f"bodies.leg.collider.resolution={AROUND}",
)
FILE = "bodies.leg.collider.file"


def load(*overrides: str) -> Loaded:
    return load_scene(SimpleNamespace(scene="knit/stocking-leg", overrides=[*SMALL, *overrides], root=[]))  # type: ignore[arg-type]


def fabric(*overrides: str) -> Fabric:
    return cloth.build_fabric(load(*overrides))[0]


def save(path: Path, turned: bool = False, unit: float = 1.0) -> Path:
    x, faces = leg_mesh(AROUND)
    y_to_z: Float = x[:, [0, 2, 1]] * np.array([1.0, -1.0, 1.0])
    trimesh.Trimesh((y_to_z if turned else x) / unit, faces, process=False).export(path)
    return path


@pytest.fixture(scope="module")
def built_in() -> Fabric:
    return fabric()


@pytest.mark.quick(kind=["stl"])
@pytest.mark.parametrize("kind", ["obj", "ply", "stl", "glb"])
def test_a_leg_from_any_file_is_fitted_as_the_one_that_comes_along(
    kind: str, built_in: Fabric, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By its bare name, from the folder it lies in. Files keep about seven digits."""
    save(tmp_path / f"mine.{kind}")
    monkeypatch.chdir(tmp_path)
    same(fabric(f"{FILE}=mine.{kind}"), built_in)


def test_millimetres_and_another_axis_up_make_no_difference(built_in: Fabric, tmp_path: Path) -> None:
    path = save(tmp_path / "scan.stl", turned=True, unit=1e-3)
    collider = "bodies.leg.collider"
    same(fabric(f"{FILE}={path}", f"{collider}.scale=1mm", f"{collider}.up=z"), built_in)


def same(found: Fabric, expected: Fabric) -> None:
    assert found.springs is not None and expected.springs is not None
    off = np.abs(found.position - expected.position).max(axis=1).reshape(40, 24)
    # Towards the tip of the toes rows are short, and which points of theirs are corners of a hull hangs on last digits.
    assert off[2:].max() < 5e-6 and off.max() < 5e-4
    assert np.abs(found.springs.rest / expected.springs.rest - 1.0).max() < 1e-5


@pytest.mark.parametrize(
    ("unit", "scale", "remedy"),
    [
        (1e-3, "1m", "scale=1mm"),
        (1e-2, "1m", "scale=1cm if it is 0.792 m long, 1inch if it is 2.01 m long"),
        (1e3, "1m", "scale=1km"),
        (1e-3, "1inch", "scale=1mm"),
        (1.0, "1mm", "scale=1m"),
        (1.0, "1km", "scale=1m"),
    ],
)
def test_another_unit_is_said_whatever_was_said_before(unit: float, scale: str, remedy: str, tmp_path: Path) -> None:
    path = save(tmp_path / "mine.ply", unit=unit)
    with pytest.raises(BadInput, match="in another unit") as refused:
        fabric(f"{FILE}={path}", f"bodies.leg.collider.scale={scale}")
    assert refused.value.remedy is not None and refused.value.remedy.endswith(remedy)


@pytest.mark.parametrize(
    ("override", "problem", "field"),
    [
        ("objects.stocking.model.over.between=[[0, 0.1, 0], [0, 3, 0]]", "outside of the mesh", "over.between"),
        ("objects.stocking.model.over.between=[[0, 0.5, 0], [0, 0.5, 0]]", "in the same place", "over.between"),
        ("objects.stocking.model.over.between=[0.14, 0.2]", "do not take one tube", "over.between"),
        ("objects.stocking.model.over.girth=1.5", "too wide to hold", "over.girth"),
        ("objects.stocking.model.spacing=[3 cm, 1 cm]", "too wide to hold", "spacing"),
        ("objects.stocking.model.over.clearance=0.5 m", "too far from the limb", "over.clearance"),
        ("objects.stocking.model.wales=1", "one wale", "wales"),
        ("bodies.arm.collider.file=mine.obj", "no such field", "bodies.arm.collider.file"),
    ],
)
def test_what_cannot_be_worn_is_said_with_its_field(override: str, problem: str, field: str) -> None:
    with pytest.raises(BadInput, match=problem) as refused:
        fabric(override)
    assert str(refused.value.field).endswith(field)


def test_a_file_may_not_go_by_the_name_of_one_beside_the_scene(tmp_path: Path) -> None:
    path = tmp_path / "stocking-leg.yaml"
    path.write_text("mine")
    with pytest.raises(BadInput, match="lies beside the scene"):
        load(f"{FILE}={path}")


def test_only_what_the_user_names_is_read_from_outside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the user names in a whole collider is found too; what the scene's own text names, beside it alone."""
    save(tmp_path / "mine.obj")
    monkeypatch.chdir(tmp_path)
    fabric("bodies.leg.collider={plugin: mesh, file: mine.obj}")
    scene = tmp_path / "scene" / "own.yaml"
    scene.parent.mkdir()
    data = yaml.safe_load(shipped.find("knit/stocking-leg").read_text())
    data["bodies"][0]["collider"] = {"plugin": "mesh", "file": "mine.obj"}
    scene.write_text(yaml.safe_dump(data))
    with pytest.raises(BadInput, match="no such file"):
        cloth.build_fabric(load_scene(SimpleNamespace(scene=str(scene), overrides=[], root=[])))  # type: ignore[arg-type]
