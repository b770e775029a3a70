"""The JSON Schema for editors: shipped scenes fit it, and what it knows to be wrong does not."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import jsonschema
import pytest
import yaml

from nuno.plugin_contract import registry
from nuno.scene import shipped
from nuno.scene.json_schema import scene_schema
from nuno_schemas.plugin import GROUPS


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
