"""Images keep their light and lie as a viewer shows them; colours by name."""

from __future__ import annotations

from pathlib import Path

import jsonschema
import matplotlib.colors
import numpy as np
import pytest
import yaml
from model_files import Folder
from PIL import Image
from pydantic import TypeAdapter, ValidationError

from nuno.scene import shipped
from nuno.scene.json_schema import scene_schema
from nuno_cloth.models.placement import find_texture
from nuno_dye.cloths.photograph_cloth import read_photograph
from nuno_dye.picture import YarnsPictureConfig
from nuno_dye.supplies.resist import read_image
from nuno_render.config import PictureConfig
from nuno_schemas.colour import as_hex, names, read_rgb
from nuno_schemas.errors import BadInput
from nuno_schemas.parts import Colour
from nuno_schemas.scene import Scene

TURN = 0x112
"""EXIF's orientation."""


def picture() -> Image.Image:
    """Three by two pixels, of which no turn or mirror is another."""
    return Image.fromarray(np.array([[0, 50, 100], [150, 200, 250]], np.uint8))


def written_with(turn: int, path: Path) -> Path:
    """The picture as a camera that was held so writes it: what undoes the turn is applied to its pixels."""
    undo = {3: Image.Transpose.ROTATE_180, 6: Image.Transpose.ROTATE_90, 8: Image.Transpose.ROTATE_270,
            2: Image.Transpose.FLIP_LEFT_RIGHT}  # fmt: skip
    exif = Image.Exif()
    exif[TURN] = turn
    picture().transpose(undo[turn]).save(path, exif=exif)
    return path


@pytest.mark.parametrize("turn", [2, 3, 6, 8])
def test_every_reader_turns_an_image_as_its_exif_says(turn: int, tmp_path: Path) -> None:
    path, right = written_with(turn, tmp_path / "a.png"), np.asarray(picture())
    np.testing.assert_array_equal(read_rgb(path)[..., 0], right)
    np.testing.assert_array_equal(read_photograph(path)[..., 1], right)
    np.testing.assert_allclose(read_image(path, (2, 3)), right / 255.0)
    np.testing.assert_allclose(read_image(path, None), right / 255.0)


def test_sixteen_bits_are_as_light_as_eight(tmp_path: Path) -> None:
    """For each reader, of each of 256 greys, and rounded to the nearest between them."""
    grey = np.arange(256, dtype=np.uint16).reshape(8, 32)
    for name, values in (("exact", grey * 257), ("near", grey * 256 + 100)):
        Image.fromarray(values).save(tmp_path / f"{name}.png")
        expected = np.round(values / 257.0)
        for read in (read_rgb, read_photograph):
            found = read(tmp_path / f"{name}.png")
            np.testing.assert_array_equal(found, np.repeat(expected[..., None], 3, axis=2))


def test_shared_images_look_alike(shared_data: Path) -> None:
    folder = shared_data / "cases" / "09-texture-exif"
    if not folder.is_dir():
        pytest.skip("shared data cases/09-texture-exif is not there")
    files = Folder(folder)
    up = read_rgb(files.resolve("up.jpg")).astype(int)
    for name in ("exif3.jpg", "exif6.jpg"):
        turned = read_rgb(files.resolve(name)).astype(int)
        assert turned.shape == up.shape and np.abs(turned - up).mean() < 8.0
    grey = read_rgb(files.resolve("grey16.png"))
    assert grey.min() == 0 and grey.max() == 255 and 100 < grey.mean() < 155


@pytest.mark.parametrize("mode", ["RGBA", "LA", "P", "PA"])
def test_what_is_transparent_is_white(mode: str, tmp_path: Path) -> None:
    """As it lies on a page; what a program leaves in hidden pixels is often black."""
    pixels = np.zeros((2, 2, 4), np.uint8)
    pixels[0] = (90, 90, 90, 255)
    pixels[1, 1] = (0, 0, 0, 51)
    image = Image.fromarray(pixels)
    image = image.quantize(4) if mode in ("P", "PA") else image.convert(mode)
    (image.convert(mode)).save(tmp_path / ("a.tif" if mode == "PA" else "a.png"))
    found = read_rgb(tmp_path / ("a.tif" if mode == "PA" else "a.png"))
    np.testing.assert_array_equal(found[..., 0], [[90, 90], [255, 204]])


def test_cmyk_and_palettes_have_their_colours(tmp_path: Path) -> None:
    colours = Image.fromarray(np.array([[[200, 40, 90], [20, 180, 60]]], np.uint8))
    colours.convert("CMYK").save(tmp_path / "a.tif")
    colours.quantize(2).save(tmp_path / "a.png")
    for name in ("a.tif", "a.png"):
        np.testing.assert_array_equal(read_rgb(tmp_path / name), np.asarray(colours))


@pytest.mark.parametrize("name", ["floats.tif", "page.pdf", "cut.png"])
def test_a_texture_that_cannot_be_read_is_refused_before_anything_starts(name: str, tmp_path: Path) -> None:
    """Floats were black cloth, and what is no image was left out of the viewer."""
    if name == "floats.tif":
        Image.fromarray(np.full((2, 2), 0.5, np.float32)).save(tmp_path / name)
    elif name == "cut.png":
        picture().resize((64, 64)).save(tmp_path / name)
        (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:120])
    else:
        (tmp_path / name).write_text("%PDF-1.4")
    with pytest.raises(BadInput, match="cannot be read as an image") as caught:
        find_texture(name, Folder(tmp_path))
    assert (caught.value.field, caught.value.value) == ("texture", name)


SCENE = shipped.scenes("")["drape-over-sphere"].read_text()


def coloured(colour: str) -> dict[str, object]:
    scene = yaml.safe_load(SCENE)
    scene["objects"][0]["colour"] = colour
    return dict(scene)


def test_the_names_are_those_of_css() -> None:
    """Also once Pillow has parsed one of them."""
    Image.new("RGB", (1, 1), "white")
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


def test_a_picture_of_too_many_pixels_gets_a_remedy_that_helps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is a PNG already: only its size is refused."""
    Image.new("1", (20, 20)).save(tmp_path / "huge.png")
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)
    with pytest.raises(BadInput, match="pixels") as refused:
        find_texture("huge.png", Folder(tmp_path))
    assert refused.value.remedy == "scale it down"
