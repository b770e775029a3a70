"""What a scene's author is told to write: it can be pasted, and is taken."""

from __future__ import annotations

import itertools
import shlex
from pathlib import Path
from typing import Any

import pytest
import trimesh
import yaml

from nuno.cli import main
from nuno.scene import scene_file
from nuno.scene.scene_file import Loaded
from nuno.scene.warnings import scene_warnings
from nuno_schemas.errors import BadInput

SCENE: dict[str, Any] = {
    "nuno": 1,
    "name": "cloth",
    "duration": "1 s",
    "frame_rate": "50 Hz",
    "solver": {"plugin": "respa", "dt": "auto"},
    "objects": [{"name": "sheet", "model": {"plugin": "sheet", "resolution": [4, 4], "fabric": "denim"}}],
    "bodies": [{"name": "me", "collider": {"plugin": "mesh", "file": "both.obj", "centre": [0, -2, 0]}}],
    "contact": {"plugin": "sliding", "gap": "2 mm"},
}


def read(folder: Path, *overrides: str, text: str = "") -> Loaded:
    path = folder / "scene.yaml"
    path.write_text(text or yaml.safe_dump(SCENE))
    return scene_file.read(path, overrides)


def refused(folder: Path, *overrides: str) -> BadInput:
    with pytest.raises(BadInput) as caught:
        read(folder, *overrides)
    return caught.value


def pasted(remedy: str | None) -> list[str]:
    """The overrides of a remedy."""
    words = shlex.split((remedy or "").replace(";", " "))
    return [value for flag, value in itertools.pairwise(words) if flag == "--set"]


def test_what_a_mesh_that_crosses_itself_is_met_by_can_be_pasted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, other = trimesh.creation.icosphere(2, 0.2), trimesh.creation.icosphere(2, 0.2)
    other.apply_translation([0.3, 0.03, 0.02])
    trimesh.util.concatenate([one, other]).export(tmp_path / "both.obj")
    scene = read(tmp_path).file
    assert main(["plan", scene]) == 2
    told = capsys.readouterr().err
    assert "passes through itself" in told and "mend" not in told
    first, *_ = pasted(told.partition("remedy:")[2])
    assert main(["plan", scene, "--set", first]) == 0


def test_fields_of_the_plugin_before_are_left_behind_as_told(tmp_path: Path) -> None:
    error = refused(tmp_path, "contact.plugin=penalty")
    assert error.field == "contact.gap"
    assert read(tmp_path, *pasted(error.remedy)).contacts[0].name == "penalty"


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("contact=penalty", "contact: {plugin: penalty}"),
        ("cloth_contact={plugin: offset, bodies: true}", "bodies: [wearer]"),
        ("bodies.me.collider.radius=3", "it is a field of capsule, sphere"),
        ("objects.sheet.model.fabric=jersey", "interlock"),
        ("objects.sheet.model.size=", "# begins a comment"),
    ],
)
def test_remedies_show_what_may_be_written(override: str, words: str, tmp_path: Path) -> None:
    assert words in (refused(tmp_path, override).remedy or "")


def test_a_part_that_is_wrong_as_a_whole_is_not_printed(tmp_path: Path) -> None:
    error = refused(tmp_path, "objects.sheet.model={plugin: skirt, cut: circle, columns: 64}")
    assert "leave columns out" in error.problem and error.value is None


def test_a_field_without_a_value_is_told_of_unless_it_is_null_on_purpose(tmp_path: Path) -> None:
    text = yaml.safe_dump(SCENE).replace("- model:", "- colour: VALUE\n  model:")
    for value, told in (("#8c2f39", True), ("null", False), ("'#8c2f39'", False)):
        loaded = read(tmp_path, text=text.replace("VALUE", value))
        assert any("objects[0].colour is empty" in one for one in scene_warnings(loaded)) == told
