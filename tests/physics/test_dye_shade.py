"""The shade of yarns: shadow and holes, twist and fibres, rims, floats and lays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drawn_cloth import cloth, whole

from nuno_dye.cloths.woven_cloth import lay_evenly
from nuno_dye.drafts.weaves import draw_plain
from nuno_dye.picture import (
    Shades,
    TextureConfig,
    draw_noise,
    find_floats,
    find_layouts,
    look_across,
    shade_yarn,
)


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
