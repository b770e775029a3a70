"""Cloth from a photograph: which layer shows where, what masks must be, and undyed cloth that is the photograph."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pydantic import ValidationError

from nuno.scene.files import SceneFiles
from nuno_dye.cloths.photograph_cloth import (
    Colours,
    PhotographCloth,
    PhotographConfig,
    PhotographPicture,
    PhotographPictureConfig,
    assign_rest,
    find_up,
    read_photograph,
    split_by_colour,
    to_oklab,
)
from nuno_schemas.colour import parse_hex, to_linear, to_srgb
from nuno_schemas.dyeing import DyeColour
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool
from nuno_schemas.pictures import Layers, Window

SCENES = Path(__file__).parents[2] / "scenes" / "dye"
HEIGHT, WIDTH = 12, 21
TAU3 = {"I": 0.1, "II": 0.1}
INDIGO = DyeColour(full=0.25)


@pytest.fixture(scope="module")
def maker() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_photograph", SCENES / "make_photograph.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def write(folder: Path, name: str, values: Any) -> str:
    Image.fromarray(np.asarray(values)).save(folder / name)
    return name


def pixels() -> np.ndarray:
    return np.random.default_rng(8).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)


def stripes() -> Bool:
    """(12, 21) warp in columns of three."""
    return np.broadcast_to(np.arange(WIDTH) // 3 % 2 == 0, (HEIGHT, WIDTH))


def config(folder: Path, **fields: Any) -> PhotographConfig:
    write(folder, "cloth.png", pixels())
    masks = {
        "warp": write(folder, "warp.png", stripes().astype(np.uint8) * 255),
        "weft": write(folder, "weft.png", (~stripes()).astype(np.uint8) * 255),
    }
    return PhotographConfig.model_validate({"file": "cloth.png", "masks": masks, "tau3": TAU3, **fields})


def build(folder: Path, **fields: Any) -> Any:
    return PhotographCloth().build(config(folder, **fields), SceneFiles(folder), 0, ["dye"])[0]


def test_masks_say_which_layer_is_up_and_both_are_fibre_all_over(tmp_path: Path) -> None:
    cells = build(tmp_path, weft={"porosity": 0.3}, warp={"porosity": 0.6, "twist": 0.5})
    assert cells.fibre.shape == (2, HEIGHT, WIDTH) and cells.fibre.all()
    assert np.array_equal(cells.up, np.stack([~stripes(), stripes()]))
    assert (cells.porosity[0] == 0.3).all() and (cells.porosity[1] == 0.6).all() and (cells.twist[1] == 0.5).all()
    assert PhotographCloth().count(config(tmp_path), SceneFiles(tmp_path)) == cells.fibre.size


def test_a_cell_of_several_pixels_goes_by_most_of_them(tmp_path: Path) -> None:
    """Of 12 x 21 pixels, 2 x 4 cells of 5 x 5; one column and two rows are left."""
    cells = build(tmp_path, pixels=5)
    assert cells.fibre.shape == (2, 2, 4)
    most = [stripes()[0, 5 * k : 5 * k + 5].mean() >= 0.5 for k in range(4)]
    assert cells.up[1].tolist() == [most, most]
    assert cells.photograph.light.shape == (10, 20, 3)
    half = np.array([[True, False], [False, True]])
    assert find_up(half, 2)[1].all(), "of two halves it is warp"


def test_what_no_mask_holds_goes_to_the_nearer_one() -> None:
    rng = np.random.default_rng(1)
    seeds = rng.random((30, 40)) > 0.985
    warp, weft = seeds & (rng.random((30, 40)) > 0.5), seeds.copy()
    weft &= ~warp
    found = assign_rest(warp, weft, {})
    y, x = np.mgrid[0:30, 0:40]

    def away(mask: Bool) -> np.ndarray:
        rows, columns = np.nonzero(mask)
        return np.maximum(abs(y[..., None] - rows), abs(x[..., None] - columns)).min(axis=-1)

    assert np.array_equal(found, away(warp) <= away(weft))


@pytest.mark.parametrize(
    ("masks", "words"),
    [
        ({"warp": np.zeros((HEIGHT, WIDTH + 1), np.uint8)}, ["22 x 12 pixels", "21 x 12 pixels", "photograph's size"]),
        (
            {"weft": np.full((HEIGHT, WIDTH), 255, np.uint8)},
            ["overlap in 144 pixels", "first at 0 to the right, 0 down"],
        ),
        ({"warp": np.zeros((HEIGHT, WIDTH), np.uint8)}, ["the mask is empty", "warp.png"]),
        ({"warp": pixels()}, ["in colour", "warp.png"]),
    ],
)
def test_masks_that_do_not_fit_are_refused(masks: dict[str, Any], words: list[str], tmp_path: Path) -> None:
    given = config(tmp_path)
    for name, values in masks.items():
        write(tmp_path, f"{name}.png", values)
    with pytest.raises(BadInput) as refused:
        PhotographCloth().build(given, SceneFiles(tmp_path), 0, ["dye"])
    assert all(word in str(refused.value) for word in words), refused.value


@pytest.mark.parametrize("fields", [{"masks": None}, {"colours": {"warp": "#000000", "weft": "#ffffff"}}])
def test_masks_or_colours_but_not_both(fields: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(ValidationError, match="give either masks or colours"):
        config(tmp_path, **fields)


@pytest.mark.parametrize(
    ("colours", "words"),
    [
        ({"weft": "#000000"}, ["colours.weft: warp and weft have one colour", "#000000 is the warp's", "lightness"]),
        ({"clean": 4}, ["even side", "write 3 or 5"]),
    ],
)
def test_colours_are_refused_with_their_limit(colours: dict[str, Any], words: list[str], tmp_path: Path) -> None:
    with pytest.raises((BadInput, ValidationError)) as refused:
        build(tmp_path, masks=None, colours={"warp": "#000000", "weft": "#ffffff"} | colours)
    assert all(word in str(refused.value) for word in words), refused.value


def test_what_is_no_photograph_is_refused(tmp_path: Path) -> None:
    given = config(tmp_path)
    (tmp_path / "cloth.png").write_text("a letter")
    for work in (PhotographCloth().count, lambda c, f: PhotographCloth().build(c, f, 0, ["dye"])):
        with pytest.raises(BadInput, match="cannot be read as PNG or JPEG"):
            work(given, SceneFiles(tmp_path))
    with pytest.raises(BadInput, match="a cell is larger than the photograph"):
        build(tmp_path, pixels=13)


def test_a_photograph_is_turned_upright(tmp_path: Path) -> None:
    image = Image.fromarray(pixels())
    turned = image.transpose(Image.Transpose.ROTATE_90)
    exif = Image.Exif()
    exif[0x0112] = 6
    turned.save(tmp_path / "turned.png", exif=exif)
    assert np.array_equal(read_photograph(tmp_path / "turned.png"), pixels())
    given = config(tmp_path, file="turned.png")
    assert PhotographCloth().count(given, SceneFiles(tmp_path)) == 2 * HEIGHT * WIDTH


def test_oklab_of_white_and_of_a_shaded_colour() -> None:
    assert to_oklab(np.ones(3)) == pytest.approx([1.0, 0.0, 0.0], abs=1e-7)
    colour = parse_hex("#c9a878")
    assert to_oklab(0.125 * colour) == pytest.approx(0.5 * to_oklab(colour), rel=1e-12)


@pytest.mark.full
def test_colours_find_the_layers_of_the_shipped_photograph(maker: ModuleType) -> None:
    """Its yarns are known. A pixel in fifty is wrong: those on the borders of yarns, where the lens mixes both."""
    photograph = read_photograph(SCENES / "photograph.jpg")
    again = np.asarray(maker.make_photograph(), float)
    assert np.abs(photograph - again).mean() < 4.0, "the shipped file is not what the script makes"
    truth = maker.weave()[0] == 1
    colours = Colours(warp=maker.WARP, weft=maker.WEFT)
    wrong = split_by_colour(colours, photograph) != truth
    raw = split_by_colour(colours.model_copy(update={"clean": 1}), photograph) != truth
    assert wrong.mean() < 0.05
    assert _specks(split_by_colour(colours, photograph)) < 0.2 * _specks(
        split_by_colour(colours.model_copy(update={"clean": 1}), photograph)
    )
    assert raw.mean() < 0.1


def _specks(mask: Bool) -> int:
    """Pixels none of whose four neighbours is as they are."""
    inner = mask[1:-1, 1:-1]
    alike = [mask[:-2, 1:-1], mask[2:, 1:-1], mask[1:-1, :-2], mask[1:-1, 2:]]
    return int((~np.any([inner == other for other in alike], axis=0)).sum())


def test_colours_that_tell_nothing_apart_are_refused() -> None:
    grey = Colours(warp="#808080", weft="#f0f0f0")
    light = np.where(stripes()[..., None], np.uint8(0x80), np.uint8(0xF0)) * np.ones(3, np.uint8)
    with pytest.raises(BadInput, match=r"one colour(?s:.)*lightness"):
        split_by_colour(grey, light)
    assert np.array_equal(split_by_colour(grey.model_copy(update={"lightness": 0.3, "clean": 1}), light), stripes())
    with pytest.raises(BadInput, match="the photograph shows no warp"):
        split_by_colour(Colours(warp="#ff0000", weft="#f0f0f0"), light)


def draw(cells: Any, amounts: np.ndarray, scale: int, window: Window | None = None, ground: str | None = None) -> Any:
    plugin, (ny, nx) = PhotographPicture(), cells.fibre.shape[1:]
    how = PhotographPictureConfig(ground=ground)
    shown = window or Window(0, ny, 0, nx)
    return plugin.draw(plugin.prepare(how, SceneFiles(Path()), cells, [INDIGO], shown, scale), amounts)


@pytest.mark.parametrize("size", [1, 3])
def test_undyed_cloth_is_the_photograph_to_the_byte(size: int, tmp_path: Path) -> None:
    cells = build(tmp_path, pixels=size)
    none = np.zeros((1, *cells.fibre.shape))
    assert np.array_equal(draw(cells, none, size), pixels())
    ny, nx = cells.fibre.shape[1:]
    part = draw(cells, none, size, Window(1, ny - 1, 2, nx - 1))
    assert np.array_equal(part, pixels()[size : -size or None, 2 * size : -size or None])


def test_dye_takes_its_share_of_the_photograph_s_light(tmp_path: Path) -> None:
    cells = build(tmp_path)
    amounts = np.zeros((1, *cells.fibre.shape))
    amounts[0, 1] = 0.25
    found = to_linear(draw(cells, amounts, 1) / 255.0)
    share = np.where(stripes()[..., None], parse_hex(INDIGO.dark) / parse_hex(INDIGO.light), 1.0)
    exact = to_srgb(to_linear(pixels() / 255.0) * share)
    assert np.abs(to_srgb(found) - exact).max() < 1.01 / 255.0


def test_a_ground_is_lit_as_the_photograph_is(tmp_path: Path) -> None:
    cells = build(tmp_path)
    found = to_linear(draw(cells, np.zeros((1, *cells.fibre.shape)), 1, ground="#ffffff") / 255.0)
    light = to_linear(pixels() / 255.0) @ [0.2126, 0.7152, 0.0722]
    assert (found[..., 0] == found[..., 1]).all() and (found[..., 0] == found[..., 2]).all()
    assert np.corrcoef(found[..., 0].ravel(), light.ravel())[0, 1] > 0.999
    assert found.max() == 1.0


def test_a_cloth_without_a_photograph_is_refused(tmp_path: Path) -> None:
    cells = build(tmp_path)
    bare = Layers(cells.fibre, cells.up)
    with pytest.raises(BadInput, match="the cloth has no photograph"):
        PhotographPicture().prepare(
            PhotographPictureConfig(), SceneFiles(tmp_path), bare, [INDIGO], Window(0, 2, 0, 2), 1
        )
