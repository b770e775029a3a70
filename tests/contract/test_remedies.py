"""What a scene's author is told to write can be pasted; the JSON Schema for editors knows it too."""

from __future__ import annotations

import itertools
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import trimesh
import yaml

from nuno.cli import main
from nuno.plugin_contract import registry
from nuno.scene import scene_file, shipped
from nuno.scene.json_schema import scene_schema
from nuno.scene.scene_file import Loaded
from nuno.scene.warnings import scene_warnings
from nuno_schemas.errors import BadInput
from nuno_schemas.plugin import GROUPS

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


@pytest.fixture(scope="module")
def validator() -> Any:
    schema = scene_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


SHIPPED = shipped.scenes()


@pytest.mark.parametrize("name", sorted(SHIPPED))
def test_shipped_scenes_fit(validator: Any, name: str) -> None:
    validator.validate(yaml.safe_load(SHIPPED[name].read_text()))


@pytest.mark.parametrize("name", sorted(SHIPPED))
def test_shipped_scenes_say_what_they_show_in_whole_sentences(name: str) -> None:
    text = yaml.safe_load(SHIPPED[name].read_text())["description"]
    assert (text[0].isupper() or text[0].isdigit()) and text.endswith("."), text


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("durations", 1),
        ("solver", {"plugin": "rk5"}),
        ("solver", {"plugin": "rk4", "dt": "auto", "tolerance": 1}),
        ("objects", [{"name": "cloth", "model": {"plugin": "sheet", "resolutio": [2, 2]}}]),
        ("seed", -1),
    ],
)
def test_mistakes_do_not_fit(validator: Any, field: str, value: object) -> None:
    scene = yaml.safe_load(shipped.scenes("")["hanging-sheet"].read_text())
    assert validator.is_valid(scene)
    assert not validator.is_valid(scene | {field: value})


def fields(schema: Any, place: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Every field that a schema describes, with the path to it; a plugin's own name is none."""
    if isinstance(schema, dict):
        for name, field in schema.get("properties", {}).items():
            if isinstance(field, dict) and "const" not in field:
                yield f"{place}.{name}", field
        for name, part in schema.items():
            yield from fields(part, f"{place}.{name}")
    elif isinstance(schema, list):
        for i, part in enumerate(schema):
            yield from fields(part, f"{place}[{i}]")


def units(field: Any) -> set[str]:
    """Units of all quantities inside a field, other fields' left out."""
    if isinstance(field, list):
        return {unit for part in field for unit in units(part)}
    if not isinstance(field, dict):
        return set()
    own = {field["unit"]} if isinstance(field.get("unit"), str) else set()
    return own | {unit for key, part in field.items() if key != "properties" for unit in units(part)}


CONFIGS = {
    f"{group}.{name}": registry.load(group, name).Config
    for group in GROUPS
    for name in sorted(registry.installed(group))
    if registry.package_version(group, name).startswith("nuno ")
}


@pytest.mark.parametrize("what", ["scene", *CONFIGS])
def test_every_field_says_what_it_is_and_in_which_unit(what: str) -> None:
    """A field whose editor shows only a type sends its user to the source."""
    schema = scene_schema() if what == "scene" else CONFIGS[what].model_json_schema()
    found = dict(fields(schema))
    assert len(found) > (80 if what == "scene" else -1)
    for place, field in found.items():
        assert field.get("description"), f"{place} has no description"
        for unit in units(field) - {""}:
            assert f"[{unit}]" in field["description"], f"{place} does not say [{unit}]"
