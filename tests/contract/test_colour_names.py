"""Colours by name: CSS's own, the same scene as in numbers, and an editor's schema that knows both."""

from __future__ import annotations

import jsonschema
import matplotlib.colors
import pytest
import yaml
from pydantic import TypeAdapter, ValidationError

from nuno.scene import shipped
from nuno.scene.json_schema import scene_schema
from nuno_dye.picture import YarnsPictureConfig
from nuno_render.config import PictureConfig
from nuno_schemas.colour import as_hex, names
from nuno_schemas.parts import Colour
from nuno_schemas.scene import Scene

SCENE = shipped.scenes("")["drape-over-sphere"].read_text()


def coloured(colour: str) -> dict[str, object]:
    scene = yaml.safe_load(SCENE)
    scene["objects"][0]["colour"] = colour
    return dict(scene)


def test_the_names_are_those_of_css() -> None:
    assert names() == {name: written.lower() for name, written in matplotlib.colors.CSS4_COLORS.items()}
    assert len(names()) == 148


@pytest.mark.parametrize("written", ["indianred", "IndianRed", "INDIANRED"])
def test_a_scene_by_name_is_the_scene_in_numbers(written: str) -> None:
    assert Scene.model_validate(coloured(written)) == Scene.model_validate(coloured("#cd5c5c"))


def test_plugins_take_names_too() -> None:
    assert YarnsPictureConfig.model_validate({"ground": "linen"}).ground == "#faf0e6"
    config = PictureConfig.model_validate({"background": ["white", "#102030"], "ground_colour": "tan"})
    assert (config.background, config.ground_colour) == (("#ffffff", "#102030"), "#d2b48c")


@pytest.mark.parametrize("name", ["darkslategrey", "rebeccapurple", "tan"])
def test_a_letter_too_few_is_answered_with_the_name(name: str) -> None:
    with pytest.raises(ValueError, match=f"did you mean '{name}'"):
        as_hex(name[:-1])


@pytest.mark.parametrize("wrong", ["#12345", "#1234567", "#12345g", "#fff", "", "12345z", "#red"])
def test_what_is_near_no_name_is_told_how_colours_are_written(wrong: str) -> None:
    with pytest.raises(ValueError, match="not a colour; write red, green and blue as #rrggbb"):
        as_hex(wrong)
    with pytest.raises(ValidationError):
        TypeAdapter(Colour).validate_python(wrong)


def test_editors_know_names_and_numbers_and_no_others() -> None:
    validator = jsonschema.Draft202012Validator(scene_schema())
    assert all(validator.is_valid(coloured(good)) for good in ("indianred", "#cd5c5c", "#CD5C5C"))
    assert not any(validator.is_valid(coloured(bad)) for bad in ("indianrd", "#cd5c5", "cd5c5c"))
