"""Light on yarns: the place of the highlight, flat normals, skin as it is without a knit."""

from __future__ import annotations

import math

import numpy as np
import pytest
from straight_yarns import BARE, above, curves, parallel, plane, worn

from nuno_render.config import YarnsConfig
from nuno_render.light.lighting import GROUND, KEY, SKY
from nuno_render.rays.surfaces import fibre_highlight
from nuno_render.rays.yarns import radiance
from nuno_schemas.pictures import Camera, axes


def unit(*v):
    return np.array(v) / np.linalg.norm(v)


def hoop(count=360):
    angle = 2 * np.pi * np.arange(count + 1) / count
    return angle, np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)


@pytest.mark.parametrize("azimuth", [0.3, 1.1, -0.8])
def test_highlight_of_a_hoop_is_where_its_normal_plane_holds_the_half_vector(azimuth):
    # T . (L + V) = 0 with T = (-sin a, cos a, 0): the half vector's azimuth, or the opposite one.
    view = unit(0.0, -1.0, 0.8)
    light = unit(math.sin(azimuth), -math.cos(azimuth), 0.9)
    half = light + view
    expected = math.atan2(half[1], half[0])
    camera = Camera(60 * view, np.zeros(3), np.array([0.0, 0, 1]), 0.04, (240, 240))
    config = YarnsConfig(**BARE, light=tuple(light), colour="#000000", sharpness=3000, samples=9, translucency=0.0)
    picture = radiance(config, worn(curves([hoop()[1]], 0.01)), camera)
    shine = np.where(picture[..., 3] > 0.99, picture[..., 0], 0.0)
    angle, points = hoop(3600)
    right, up, _ = axes(camera)
    scale = 120 / (60 * math.tan(0.02))
    column = np.clip(np.rint(119.5 + scale * points @ right).astype(int), 0, 239)
    row = np.clip(np.rint(119.5 - scale * points @ up).astype(int), 0, 239)
    near = np.max([shine[np.clip(row + i, 0, 239), np.clip(column + j, 0, 239)]
                   for i in (-1, 0, 1) for j in (-1, 0, 1)], axis=0)  # fmt: skip
    brightest = angle[near > 0.9 * near.max()]
    off = np.abs((brightest - expected + np.pi / 2) % np.pi - np.pi / 2)
    assert near.max() > 0.05
    assert off.max() < math.radians(4.0)


def test_highlight_is_kajiya_and_kay_and_none_from_behind():
    rng = np.random.default_rng(0)
    for t, light, view in rng.normal(size=(200, 3, 3)):
        t, light, view = unit(*t), unit(*light), unit(*view)
        # The cone about T that holds the mirrored light is as steep as the light; V's angle from it.
        steep = math.acos(np.clip(-(t @ light), -1, 1)) - math.acos(np.clip(t @ view, -1, 1))
        across = [v - (t @ v) * t for v in (light, view)]
        about = math.acos(np.clip(unit(*across[0]) @ unit(*across[1]), -1, 1))
        expected = max(math.cos(steep), 0.0) ** 12 * math.cos(about / 2)
        assert fibre_highlight(t, light, view, 12.0) == pytest.approx(expected, abs=1e-7)
    t = np.array([1.0, 0, 0])
    assert fibre_highlight(t, np.array([0.0, 0, 1]), np.array([0.0, 0, -1]), 12.0) < 1e-7


def test_skin_without_yarns_before_it_has_lamberts_radiance():
    # The yarn is out of sight; white skin that faces the light: key and sky, and its own small highlight.
    yarn = curves([np.array([[50.0, 50, 0], [51, 50, 0]])], 0.1)
    config = YarnsConfig(**{**BARE, "shadows": True, "occlusion": True}, light=(0, 0, 1), light_size=0.0, samples=4)
    picture = radiance(config, worn(yarn, plane()), above())
    sky = (SKY + GROUND) / 2 + (SKY - GROUND) / 3
    assert np.abs(picture[..., :3] / (KEY * 1.05 + sky) - 1).max() < 1e-3
    assert not picture[..., 3].any()


def test_mean_of_a_round_yarn_is_lamberts_law_over_its_width():
    # Opaque yarns side by side lit along the view: n.L = sqrt(1 - x^2), wrapped, over the width.
    x = (np.arange(4000) + 0.5) / 4000
    wrap = 0.45
    expected = KEY * ((np.sqrt(1 - x * x) + wrap) / (1 + wrap)).mean()
    config = YarnsConfig(
        **BARE, light=(0, 0, 1), colour="#ffffff", highlight=0.0, translucency=0.0, samples=64
    )  # fmt: skip
    yarns = parallel(0.02, 0.0101)
    picture = radiance(config, worn(yarns), above())
    sky = np.stack([(SKY + GROUND) / 2 + (SKY - GROUND) * up / 3 for up in np.sqrt(1 - x * x)]).mean(axis=0)
    assert np.abs(picture[..., :3].mean(axis=(0, 1)) / (expected + sky) - 1).max() < 0.01
