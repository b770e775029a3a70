"""Colours of dyed cloth: mixing, what shows, the shade of yarns, pictures pixel by pixel."""

from __future__ import annotations

import colorsys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drawn_cloth import BYTE, FLAT, INK, by_layer, cloth, draw_cloth, spots, whole
from pydantic import ValidationError

from nuno.scene.files import SceneFiles
from nuno_dye import picture as module
from nuno_dye.cloths.cloth import Layout
from nuno_dye.cloths.woven_cloth import lay_evenly
from nuno_dye.picture import (
    Shades,
    TextureConfig,
    YarnsPicture,
    YarnsPictureConfig,
    colour_of,
    draw_noise,
    find_floats,
    find_layouts,
    look_across,
    mix,
    shade_yarn,
)
from nuno_dye.weaving_drafts.weaves import draw_plain, draw_satin, draw_twill
from nuno_schemas.colour import parse_hex, to_linear, to_srgb
from nuno_schemas.dyeing import DyeColour
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.pictures import Window, amount_seen

INDIGO, MADDER, WELD = (
    DyeColour(full=1.0),
    DyeColour(light="#f7eeee", mid="#d0605a", dark="#7a1518", full=1.0),
    DyeColour(light="#f6f4e4", mid="#e8c94a", dark="#c08a10", full=0.5),
)


@pytest.mark.parametrize("dye", [INDIGO, MADDER, WELD, DyeColour(light="#ffffff", mid="#808080", dark="#000000")])
def test_none_half_and_full_have_the_measured_colours(dye: DyeColour) -> None:
    found = colour_of(dye.full * np.array([0.0, 0.5, 1.0, 3.0]), dye)
    exact = [parse_hex(text) for text in (dye.light, dye.mid, dye.dark, dye.dark)]
    assert np.abs(found - exact).max() < 1e-14
    assert np.array_equal(colour_of(np.array([[0.3, 0.9]]), dye, 2.0), colour_of(np.array([[0.15, 0.45]]), dye))


def test_between_them_hue_saturation_and_value_are_linear() -> None:
    knots = [colorsys.rgb_to_hsv(*to_srgb(parse_hex(text))) for text in (MADDER.light, MADDER.mid, MADDER.dark)]
    for share in np.linspace(0.0, 1.0, 21):
        low = 0 if share <= 0.5 else 1
        within = 2.0 * share - low
        found = colorsys.rgb_to_hsv(*(float(c) for c in to_srgb(colour_of(np.array(share), MADDER))))
        for k, (a, b) in enumerate(zip(knots[low], knots[low + 1], strict=True)):
            far = b + np.round(a - b) if k == 0 else b
            # Hues are places on a circle; at the light end rounding of a pale colour moves them by little.
            away = (found[k] - (a + within * (far - a)) + 0.5) % 1.0 - 0.5
            assert abs(away) < 1e-9


def test_hues_go_the_short_way_and_grey_has_none() -> None:
    around = DyeColour(light="#ff0040", mid="#ff0010", dark="#ff2000")
    found = to_srgb(colour_of(np.linspace(0.0, 1.0, 50), around))
    assert (found[:, 0] > 0.999).all() and (found[:, 1:].min(axis=1) < 1e-9).all() and found[:, 1:].max() < 0.26
    for light, mid, dark in (("#ffffff", "#4060c0", "#000000"), ("#ffffff", "#aaaaaa", "#102040")):
        faded = to_srgb(colour_of(np.linspace(0.0, 1.0, 50), DyeColour(light=light, mid=mid, dark=dark)))
        assert (faded[:, 2] >= faded[:, 1] - 1e-12).all() and (faded[:, 1] >= faded[:, 0] - 1e-12).all()


def amounts(number: int) -> Float:
    return np.random.default_rng(2).random((number, 2, 5, 7))


def test_one_dye_keeps_its_colours_and_none_changes_nothing() -> None:
    a = amounts(1)
    assert np.abs(mix(a, [MADDER]) - colour_of(a[0], MADDER)).max() < 1e-14
    ground = to_linear(np.array([0.9, 0.85, 0.7]))
    assert np.abs(mix(0.0 * amounts(2), [INDIGO, WELD], ground=ground) - ground).max() < 1e-14


def test_mixing_is_a_product_in_any_order_and_only_takes_light() -> None:
    a = amounts(3)
    dyes, ground = [INDIGO, MADDER, WELD], np.ones(3)
    mixed = mix(a, dyes, ground=ground)
    product = np.prod([colour_of(x, dye) / parse_hex(dye.light) for x, dye in zip(a, dyes, strict=True)], axis=0)
    assert np.abs(mixed - product).max() < 1e-14
    assert np.abs(mixed - mix(a[::-1], dyes[::-1], ground=ground)).max() < 1e-14
    for k in range(3):
        assert (mixed <= mix(a[k : k + 1], dyes[k : k + 1], ground=ground) + 1e-14).all()


def test_blue_and_yellow_are_green() -> None:
    half = np.array([0.5, 0.25])[:, None, None, None]
    r, g, b = to_srgb(mix(half, [INDIGO, WELD], ground=np.ones(3)))[0, 0, 0]
    assert g > r and g > b


def test_views_show_what_fibre_has_taken_what_it_has_not_and_both() -> None:
    phi, fixed = amounts(2)
    assert np.array_equal(amount_seen(phi, fixed, "fixed"), fixed)
    assert np.array_equal(amount_seen(phi, fixed, "mobile"), phi)
    assert np.array_equal(amount_seen(phi, fixed), phi + fixed)


@pytest.mark.parametrize(
    "drawdown", [draw_plain(), draw_twill(2, 1), draw_satin(5, 2)], ids=["plain", "twill", "satin"]
)
@pytest.mark.parametrize("scale", [1, 3])
def test_the_upper_yarn_shows_the_lower_one_in_its_gaps(drawdown: np.ndarray, scale: int) -> None:
    """Without shade a picture of black weft and white warp is the drawdown, pick by pick and end by end."""
    cells = cloth(drawdown)
    picture = draw_cloth(cells, by_layer(cells), scale, texture=FLAT)
    assert picture.shape == (40 * scale, 60 * scale, 3) and picture.dtype == np.uint8
    assert np.array_equal(
        picture, np.repeat(np.repeat(draw_cloth(cells, by_layer(cells), 1, texture=FLAT), scale, 0), scale, 1)
    )
    picks, ends = drawdown.shape
    for y, x in np.ndindex(40, 60):
        up = drawdown[y // 10 % picks, x // 10 % ends]
        weft, warp = 1 <= y % 10 < 9, 1 <= x % 10 < 9
        shows = up if weft == warp else warp
        assert (picture[y * scale, x * scale] == 255 * shows).all()


@pytest.mark.parametrize("scale", [1, 2, 5])
def test_a_picture_is_the_same_however_its_rows_are_cut(scale: int, monkeypatch: pytest.MonkeyPatch) -> None:
    cells = cloth(draw_twill(2, 2), ny=150)
    picture = draw_cloth(cells, spots(cells), scale)
    for block in (1, 7000, 10**9):
        monkeypatch.setattr(module, "BLOCK", block)
        assert np.array_equal(draw_cloth(cells, spots(cells), scale), picture)
    assert len(np.unique(picture)) > 50


@pytest.mark.parametrize("scale", [1, 4])
def test_a_part_is_cut_from_the_whole_picture(scale: int) -> None:
    cells = cloth(draw_twill(2, 1))
    picture = draw_cloth(cells, spots(cells), scale)
    for window in (Window(0, 40, 0, 60), Window(3, 29, 11, 12), Window(39, 40, 59, 60), Window(0, 1, 0, 60)):
        part = draw_cloth(cells, spots(cells), scale, window=window)
        top, bottom, left, right = (scale * side for side in window)
        assert np.array_equal(part, picture[top:bottom, left:right])


def test_colour_goes_over_from_cell_to_cell_within_a_yarn_and_ends_at_its_rim() -> None:
    """Along a weft yarn light is linear between the middles of cells; across it no pixel mixes in another yarn's."""
    cells, scale = cloth(draw_plain()), 6
    amounts = np.zeros((1, *cells.fibre.shape))
    amounts[0, 0, 10:20] = np.linspace(0.2, 0.9, 60)
    picture = draw_cloth(replace(cells, up=np.stack([cells.fibre[0], ~cells.fibre[0]])), amounts, scale, FLAT)
    row = picture[14 * scale + 2]
    middles = mix(amounts, [INK])[0, 14, :, 0]
    place = (np.arange(60 * scale) + 0.5) / scale - 0.5
    exact = 255.0 * to_srgb(np.interp(place, np.arange(60), middles))
    assert np.abs(row[:, 0] - exact).max() <= BYTE and len(np.unique(row)) > 100
    yarn = picture[11 * scale : 19 * scale]
    assert (yarn == yarn[0]).all(), "nothing of the yarns above and below, which hold none"
    assert (picture[21 * scale : 29 * scale] == 255).all()


def test_a_scale_of_one_shows_every_cell_as_it_is() -> None:
    cells = cloth(draw_plain())
    seen = spots(cells)
    light = mix(seen, [INK])
    layer, _ = Shades(cells, 1, FLAT).find(whole(cells))
    exact = np.where(layer[..., None] == 1, light[1], light[0])
    found = draw_cloth(cells, seen, texture=FLAT).astype(float)
    assert np.abs(found - 255.0 * to_srgb(exact)).max() <= BYTE


def test_cells_without_any_fibre_are_a_hole_s_picture() -> None:
    cells = cloth(draw_plain())
    bare = replace(cells, fibre=np.zeros_like(cells.fibre))
    assert not draw_cloth(
        bare, 0.0 * spots(cells), texture=TextureConfig(depth=0, fibres=0, relief=0, bend=0, hole=0.0)
    ).any()


def test_amounts_that_are_no_numbers_are_drawn_as_none() -> None:
    cells = cloth(draw_plain())
    lost = np.full((1, *cells.fibre.shape), np.nan)
    assert np.array_equal(draw_cloth(cells, lost), draw_cloth(cells, 0.0 * spots(cells)))


def test_colours_that_are_none_are_refused() -> None:
    with pytest.raises(BadInput, match=r"(?s)one colour a dye.*1\n.*2 dyes"):
        mix(amounts(2), [INDIGO])
    for wrong in ({"light": "whit"}, {"dark": "#12345"}, {"full": 0.0}, {"hue": 3}):
        with pytest.raises(ValidationError):
            DyeColour.model_validate(wrong)
    assert isinstance(find_layouts(cloth(draw_plain()))[0], Layout)


def test_no_texture_is_colours_alone() -> None:
    cells = cloth(draw_twill(2, 1))
    plugin, seen = YarnsPicture(), spots(cells)
    how = YarnsPictureConfig(texture=None)
    prepared = plugin.prepare(how, SceneFiles(Path()), cells, [INK], whole(cells), 2)
    assert np.array_equal(plugin.draw(prepared, seen), draw_cloth(cells, seen, 2, FLAT))
    assert (plugin.draw(prepared, 0.0 * seen) == 255).all()


def test_shadow_and_holes_are_where_they_should_be() -> None:
    cells = cloth(draw_plain())
    texture = TextureConfig(depth=0, fibres=0, relief=0, bend=0, shadow=0.5, hole=0.25)
    _, shade = Shades(cells, 2, texture).find(whole(cells))
    up = np.where(cells.up[1], cells.fibre[1], cells.fibre[0])
    expected = np.where(up, 1.0, np.where(cells.fibre.any(axis=0), 0.5, 0.25))
    assert np.array_equal(shade, np.repeat(np.repeat(expected, 2, 0), 2, 1))
    assert len(np.unique(expected)) == 3


def test_twist_is_a_helix_seen_from_above() -> None:
    """At v the line of a fibre lies arctan(v / sqrt(1 - v^2)) / 2 pi of a turn further on than in the middle."""
    texture = TextureConfig(turn=1.7, plies=3, depth=0.3, fibres=0.0, relief=0.0, bend=0.0)
    v, along = np.linspace(-0.999, 0.999, 41), np.linspace(0.0, 5.0, 300)[:, None]
    shade = shade_yarn(v, along, np.array(9.0), texture)
    angle = np.arctan(v / np.sqrt(1.0 - v * v))
    middle = shade_yarn(np.zeros(1), along - 1.7 * angle / (2 * np.pi), np.array(9.0), texture)
    assert np.abs(shade - middle).max() < 1e-12
    assert np.abs(shade - shade_yarn(v, along + 1.7 / 3, np.array(9.0), texture)).max() < 1e-12
    assert np.abs(shade - shade_yarn(-v, -along, np.array(9.0), texture)).max() < 1e-12
    assert shade.max() == pytest.approx(1.0, abs=1e-3) and shade.min() == pytest.approx(0.7, abs=1e-3)


def test_fibres_lie_along_the_helix_and_differ_from_yarn_to_yarn() -> None:
    texture = TextureConfig(turn=1.7, plies=3, depth=0.0, fibres=0.4, relief=0.0, bend=0.0)
    v, along = np.linspace(-0.999, 0.999, 41), np.linspace(0.0, 40.0, 2000)[:, None]
    shade = shade_yarn(v, along, np.array(9.0), texture, 7)
    angle = np.arctan(v / np.sqrt(1.0 - v * v))
    middle = shade_yarn(np.zeros(1), along - 1.7 * angle / (2 * np.pi), np.array(9.0), texture, 7)
    assert np.abs(shade - middle).max() < 1e-9
    assert shade.max() <= 1.0 and shade.min() >= 0.6 and shade.std() > 0.03
    others = [shade_yarn(np.zeros(1), along, np.array(9.0), texture, yarn)[:, 0] for yarn in range(20)]
    correlations = np.corrcoef(others)[~np.eye(20, dtype=bool)]
    assert np.abs(correlations).max() < 0.3, "1700 numbers: 0.05 is by chance"


def test_noise_is_even_and_smooth() -> None:
    numbers = draw_noise(np.arange(100_000.0), 3)
    assert numbers.mean() == pytest.approx(0.5, abs=0.005) and numbers.var() == pytest.approx(1 / 12, abs=0.002)
    assert abs(np.corrcoef(numbers[1:], numbers[:-1])[0, 1]) < 0.02
    x = np.linspace(-5.0, 5.0, 10_001)
    assert np.abs(np.diff(draw_noise(x, 3))).max() <= 1.5 * 1.001e-3, "the steepest cubic"


def test_rims_and_ends_of_floats_are_darker() -> None:
    texture = TextureConfig(depth=0.0, fibres=0.0, relief=0.5, bend=0.4)
    v = np.linspace(0.0, 1.0, 30)
    assert (np.diff(shade_yarn(v, np.array(0.0), np.array(9.0), texture)) < 0.0).all()
    near = np.linspace(0.0, 0.5, 30)
    assert (np.diff(shade_yarn(np.array(0.0), np.array(0.0), near, texture)) > 0.0).all()
    assert shade_yarn(np.array(1.0), np.array(0.0), np.array(0.0), texture) == pytest.approx(0.5 * 0.6)


def test_floats_are_the_runs_of_a_yarn() -> None:
    up = np.random.default_rng(4).random((9, 14)) > 0.5
    for axis in (0, 1):
        first, after = find_floats(up, axis)
        for y, x in np.ndindex(*up.shape):
            line, at = (up[:, x], y) if axis == 0 else (up[y], x)
            low, high = at, at + 1
            while low and line[low - 1] == line[at]:
                low -= 1
            while high < len(line) and line[high] == line[at]:
                high += 1
            assert (first[y, x], after[y, x]) == (low, high)


def test_yarns_without_gaps_are_told_apart_by_their_lays() -> None:
    cells, lay = cloth(draw_plain(), 6, 0), lay_evenly(6, 0, 60)
    across = look_across(lay, 4)
    assert (across.width == 6.0).all()
    one = across.v.reshape(10, 24)
    assert (
        (one == one[0]).all()
        and np.array_equal(one[0], -one[0][::-1])
        and np.abs(one[0]).max() == pytest.approx(23 / 24)
    )
    assert (look_across(find_layouts(replace(cells, yarns=None))[1], 4).width == 60.0).all()
    gapped = cloth(draw_plain(), 8, 2)
    for found, exact in zip(
        find_layouts(replace(gapped, yarns=None)), (lay_evenly(8, 2, 40), lay_evenly(8, 2, 60)), strict=True
    ):
        assert np.array_equal(found.fibre, exact.fibre)
        assert np.array_equal(found.yarn[found.fibre], exact.yarn[exact.fibre])
