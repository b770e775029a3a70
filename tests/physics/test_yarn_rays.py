"""Pictures of knits by rays: how much of a pixel yarns cover, and the light on them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from straight_yarns import BARE, above, curves, everywhere, joined, parallel, plane, shares, worn

from nuno_render.config import YarnsConfig
from nuno_render.rays.yarns import Lines, Yarns, radiance
from nuno_render.shading.fibre import NYLON, find_absorption, find_lobes, scatter
from nuno_render.shading.lighting import GROUND, KEY, SKY
from nuno_schemas.colour import to_linear
from nuno_schemas.errors import BadInput
from nuno_schemas.pictures import Camera, Mesh, axes

WIDE = 1.0 / 8.0
"""A pixel of `above` [m]."""


@pytest.mark.parametrize("share", [0.05, 0.31, 0.8])
@pytest.mark.parametrize("axis", [0, 1])
def test_yarns_finer_than_a_pixel_cover_their_width_over_their_spacing(share, axis):
    spacing = WIDE / 9.7
    found = shares(parallel(spacing, 0.5 * share * spacing, axis=axis), above(), samples=64)
    # 9.7 yarns a pixel: whole ones and parts, so that a single pixel may be off by the width of one.
    assert abs(found.mean() - share) < 0.01
    assert np.abs(found - share).max() < 0.13


def test_coverage_does_not_end_where_yarns_are_a_hundredth_of_a_pixel():
    spacing = 0.4 * WIDE
    found = shares(parallel(spacing, 0.005 * WIDE), above(), samples=256)
    assert abs(found.mean() / 0.025 - 1) < 0.1


def test_knit_grows_denser_toward_the_silhouette_as_its_spacing_shrinks():
    # Yarns along a cylinder, seen from afar: at x = R sin(phi) the spacing is foreshortened by cos(phi).
    count, r, columns = 6000, 2e-4, 41
    angle = 2 * np.pi * np.arange(count) / count
    ring = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
    long = np.array([0.0, 2.0, 0.0])
    lines = [np.stack([p - long, p + long]) for p in ring]
    around = 2 * np.pi * np.arange(400) / 400
    tube = np.stack([np.sin(around), 0 * around, np.cos(around)], axis=1) * 0.9999
    i, j = np.arange(400), (np.arange(400) + 1) % 400
    faces = np.concatenate([np.stack([i, i + 400, j], 1), np.stack([j, i + 400, j + 400], 1)]).astype(np.int32)
    body = Mesh(np.concatenate([tube - long, tube + long]), faces)
    found = shares(curves(lines, r), above(size=(columns, columns)), body, samples=400).mean(axis=0)
    edges = np.linspace(-1, 1, columns + 1)
    expected = 2 * r / (2 * np.pi / count) * np.diff(np.arcsin(edges)) / np.diff(edges)
    sure = expected < 0.9
    assert sure.sum() >= 37 and expected[sure].max() / expected.min() > 2.0
    assert np.abs(found / expected - 1)[sure].max() < 0.05


@pytest.mark.parametrize("translucency", [0.0, 0.4])
def test_each_crossing_lets_its_share_through_and_a_joint_is_none(translucency):
    # Two layers at right angles, each of yarns of many pieces: what is behind shows as the product of both.
    spacing, share = WIDE / 3.3, 0.4
    radius = 0.5 * share * spacing
    weft = parallel(spacing, radius, axis=0, pieces=150)
    warp = parallel(spacing, radius, axis=1, height=4 * radius, pieces=150)
    one = shares(weft, above(), samples=64, translucency=translucency).mean()
    both = shares(joined(weft, warp), above(), samples=64, translucency=translucency).mean()
    through = 1 - share * (1 - translucency)
    assert abs(1 - one - through) < 0.01
    assert abs(1 - both - through**2) < 0.01


def test_skin_in_the_shade_of_yarns_gets_what_they_let_through():
    # The yarns are behind the camera; the light's disc blurs their shadows into an even shade.
    spacing, share, translucency = 0.02, 0.4, 0.25
    yarns = parallel(spacing, 0.5 * share * spacing, half=4.0, height=3.0)
    camera = Camera(np.array([0.0, 0, 2]), np.zeros(3), np.array([0.0, 1, 0]), 0.3, (24, 24))
    base = {**BARE, "light": (0, 0, 1), "samples": 64, "translucency": translucency}
    lit = radiance(YarnsConfig(**base), worn(yarns, plane()), camera)[..., :3]
    dim = radiance(YarnsConfig(**{**base, "shadows": True}), worn(yarns, plane()), camera)[..., :3]
    dark = radiance(YarnsConfig(**{**base, "shadows": True}), worn(yarns, plane(), plane(4.0, 3.5)), camera)[..., :3]
    found = (dim - dark).mean() / (lit - dark).mean()
    assert abs(found - (1 - share * (1 - translucency))) < 0.01


def test_variance_falls_at_least_as_the_number_of_samples():
    spacing, share = WIDE / 2.3, 0.35
    yarns = parallel(spacing, 0.5 * share * spacing)
    # Turned, so that neither rows nor columns of samples lie along the yarns.
    c, s = np.cos(0.4), np.sin(0.4)
    yarns.points[:, :2] = yarns.points[:, :2] @ np.array([[c, s], [-s, c]])
    variance = {}
    for samples in (1, 4, 16, 64):
        seen = np.stack([shares(yarns, above(0.6), samples=samples, seed=seed) for seed in range(12)])
        variance[samples] = seen.var(axis=0, ddof=1).mean()
    # One sample alone is a coin with the pixel's share; more stand in a grid and do better than coins.
    assert abs(variance[1] / (share * (1 - share)) - 1) < 0.1
    for fewer, more in ((1, 4), (4, 16), (16, 64)):
        assert variance[more] < 1.1 * variance[fewer] / 4


def tangle():
    """A ball of skin in a tangle of yarns."""
    rng = np.random.default_rng(7)
    lines = [np.cumsum(rng.normal(size=(60, 3)) * 0.1, axis=0) for _ in range(12)]
    corners = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]) * 0.4
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]], np.int32)
    camera = Camera(np.array([0.0, -4, 1]), np.zeros(3), np.array([0.0, 0, 1]), 0.5, (48, 40))
    return worn(curves(lines, 0.02), Mesh(corners, faces, two_sided=False)), camera


def test_picture_is_the_same_by_any_number_of_threads_and_by_trying_everything(monkeypatch):
    from nuno_render.rays import hits as ray_tree
    from nuno_render.rays import worn as gathered

    scene, camera = tangle()
    config = YarnsConfig(samples=4)
    picture = radiance(config, scene, camera, threads=1)
    assert np.array_equal(picture, radiance(config, scene, camera, threads=3))
    assert 0.05 < picture[..., 3].mean() < 0.9
    for name in ("capsule_tree", "triangle_tree"):
        build = getattr(ray_tree, name)
        monkeypatch.setattr(gathered, name, lambda *items, build=build: everywhere(build(*items)))
    assert np.array_equal(picture, radiance(config, scene, camera))


def test_seeds_choose_other_samples_of_the_same_picture():
    scene, camera = tangle()
    one, other = (radiance(YarnsConfig(samples=16, seed=seed), scene, camera) for seed in (0, 1))
    assert not np.array_equal(one, other)
    assert abs(one.mean() - other.mean()) < 0.005


def test_lines_are_as_wide_as_they_say_whatever_the_yarns():
    # Grey skin: the shoulder that keeps highlights does not reach it.
    grey = replace(plane(), colours=np.full((4, 3), 0.2))
    scene = worn(parallel(3.0 * WIDE, 1e-6), grey)
    config = Lines.Config(**BARE, light=(0, 0, 1), width=0.5, samples=64, colour="#000000")
    picture = Lines().draw(config, scene, above()).astype(float)
    bare = picture.max(axis=(0, 1))
    light = to_linear(picture / 255.0) / to_linear(bare / 255.0)
    # Every third column, by half; the line's place in its pixel may spread it over two.
    assert abs(1 - light.mean() - 0.5 / 3.0) < 0.02
    assert np.ptp(light, axis=0).max() < 0.1


def test_what_cannot_be_drawn_is_refused():
    yarns, camera = parallel(0.2, 0.01), above()
    body = tangle()[0].bodies[0]
    bare = worn(curves([np.zeros((2, 3))], 0.0))
    with pytest.raises(BadInput, match="without thickness") as zero:
        Yarns().draw(YarnsConfig(), bare, camera)
    assert zero.value.field == "yarns.radius[0]"
    assert Yarns().draw(YarnsConfig(radius=0.01, samples=1), bare, camera).shape == (16, 16, 3)
    inside = Camera(np.array([0.05, 0.02, 0.03]), np.array([1.0, 0, 0]), np.array([0.0, 0, 1]), 0.5, (16, 16))
    with pytest.raises(BadInput, match="inside a body"):
        Yarns().draw(YarnsConfig(), worn(yarns, body), inside)
    none = worn(curves([np.zeros((0, 3))], 0.1))
    empty = none.yarns.__class__(
        np.zeros((0, 3)), np.zeros(1, np.int64), np.zeros(0), np.zeros(0, np.int32), (), np.zeros((0, 3))
    )
    with pytest.raises(BadInput, match="no yarns"):
        Yarns().draw(YarnsConfig(), worn(empty), camera)


def test_each_kind_covers_by_its_own_radius():
    spacing = WIDE / 3.3
    yarns = parallel(spacing, 0.3 * spacing)
    kinds = replace(yarns, kind=np.arange(yarns.number, dtype=np.int32) % 2, names=("thin", "thick"))
    found = shares(kinds, above(), samples=64, radius=(0.1 * spacing, 0.4 * spacing)).mean()
    assert abs(found - (0.2 + 0.8) / 2) < 0.01
    with pytest.raises(BadInput, match="one radius for each kind"):
        shares(kinds, above(), radius=(0.1, 0.2, 0.3))


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
    config = YarnsConfig(**BARE, light=tuple(light), colour="#000000", roughness=0.05, samples=9, translucency=0.0)
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


def scattered(roughness, colour, h, sin_o, lights):
    """Light that a fibre along x scatters toward a view, of each of the directions it comes from."""
    t, out, absorption = np.array([1.0, 0, 0]), np.empty(3), find_absorption(np.full(3, colour), roughness)
    view = np.array([sin_o, 0.0, np.sqrt(1 - sin_o**2)])
    n = np.array([0.0, h, np.sqrt(1 - h * h)])
    found = np.empty(len(lights))
    for i, light in enumerate(lights):
        scatter(t, n, light, view, absorption, find_lobes(roughness), out)
        found[i] = out[0]
    return found


def sphere(rows, columns):
    """Directions about x, each of the same solid angle."""
    sine, turn = np.meshgrid((np.arange(rows) + 0.5) / rows * 2 - 1, 2 * np.pi * (np.arange(columns) + 0.5) / columns)
    cosine = np.sqrt(1 - sine**2)
    return np.stack([sine, cosine * np.sin(turn), cosine * np.cos(turn)], axis=-1).reshape(-1, 3)


@pytest.mark.parametrize("colour", [1.0, 0.2])
@pytest.mark.parametrize(
    ("roughness", "h", "sin_o"), [(0.2, 0.0, 0.0), (0.3, 0.7, 0.4), (0.6, -0.95, -0.8), (1.0, 0.3, 0.2)]
)
def test_a_fibre_scatters_all_light_that_it_does_not_absorb(roughness, h, sin_o, colour):
    """With F reflected and T left of each passage F + (1 - F)^2 T (1 + F T + (F T)^2 ...) leaves it."""
    found = 4 * scattered(roughness, colour, h, sin_o, sphere(400, 120)).mean()
    cos_o, across = np.sqrt(1 - sin_o**2), np.sqrt(1 - sin_o**2) * np.sqrt(1 - h * h)
    inside = np.sqrt(1 - (1 - across**2) / NYLON**2)
    one, other = (
        (across - NYLON * inside) / (across + NYLON * inside),
        (NYLON * across - inside) / (NYLON * across + inside),
    )
    f = (one**2 + other**2) / 2
    bent = h * cos_o / np.sqrt(NYLON**2 - sin_o**2)
    way = 2 * np.sqrt(1 - bent**2) / np.sqrt(1 - (sin_o / NYLON) ** 2)
    t = np.exp(-find_absorption(np.array([colour]), roughness)[0] * way)
    assert found == pytest.approx(f + (1 - f) ** 2 * t / (1 - f * t), abs=0.002)


def test_a_smooth_fibre_mirrors_at_its_surface_and_lets_light_pass():
    """The brightest directions of a black fibre and of a clear one: a mirrored ray, and a refracted one."""
    h, lights = 0.6, sphere(41, 3600)
    level = lights[np.abs(lights[:, 0]) < 1e-9]
    turn = np.arctan2(level[:, 1], level[:, 2])
    mirrored = turn[np.argmax(scattered(0.05, 1e-4, h, 0.0, level))]
    passed = turn[np.argmax(scattered(0.05, 1.0, h, 0.0, level))]
    entry, inside = np.arcsin(h), np.arcsin(h / NYLON)
    for found, expected in ((mirrored, 2 * entry), (passed, np.pi + 2 * entry - 2 * inside)):
        assert abs((found - expected + np.pi) % (2 * np.pi) - np.pi) < 0.02


def test_skin_without_yarns_before_it_has_lamberts_radiance():
    # The yarn is out of sight; white skin that faces the light: key and sky, and its own small highlight.
    yarn = curves([np.array([[50.0, 50, 0], [51, 50, 0]])], 0.1)
    config = YarnsConfig(**{**BARE, "shadows": True, "occlusion": True}, light=(0, 0, 1), light_size=0.0, samples=4)
    picture = radiance(config, worn(yarn, plane()), above())
    sky = (SKY + GROUND) / 2 + (SKY - GROUND) / 3
    assert np.abs(picture[..., :3] / (KEY * 1.05 + sky) - 1).max() < 1e-3
    assert not picture[..., 3].any()
