"""The JSON Schema for editors: shipped scenes fit it, and what it knows to be wrong does not."""

from __future__ import annotations

from typing import Any

import jsonschema
import pytest
import yaml

from nuno import scene_file
from nuno.json_schema import scene_schema


@pytest.fixture(scope="module")
def validator() -> Any:
    schema = scene_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize("name", sorted(scene_file.shipped()))
def test_shipped_scenes_fit(validator: Any, name: str) -> None:
    validator.validate(yaml.safe_load(scene_file.shipped()[name].read_text()))


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
    scene = yaml.safe_load(scene_file.shipped()["hanging-sheet"].read_text())
    assert validator.is_valid(scene)
    assert not validator.is_valid(scene | {field: value})
