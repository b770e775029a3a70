"""Pictures by paths of light: the raster renderer's view, light by known laws, noise that falls as it must."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import binary_dilation
from straight_yarns import above, curves, shares

from nuno_render.config import PathsConfig, RasterConfig
from nuno_render.paths_of_light import ROUGH, Paths, load_mitsuba, yarn_shapes
from nuno_render.raster import Raster
from nuno_render.shading.fibre import find_absorption, find_energies
from nuno_schemas.colour import to_linear
from nuno_schemas.pictures import Camera, Mesh, axes, frame

pytest.importorskip("mitsuba")
SIZE = (120, 90)


def sheet(n: int = 13, material: str = "", turned: bool = False, wave: float = 0.1, **how: Any) -> Mesh:
    """A metre of upright cloth with waves, z up, seen from -y; `turned`: warp and weft change places."""
    s, t = (a.ravel() for a in np.meshgrid(np.linspace(0.0, 1.0, n), np.linspace(0.0, 1.0, n)))
    x = np.stack([s, wave * np.sin(7.0 * s + 3.0 * t), 0.3 + t], axis=1)
    index = np.arange(n * n).reshape(n, n)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.concatenate([np.stack(one, -1).reshape(-1, 3) for one in ((a, b, c), (b, d, c))]).astype(np.int32)
    uv = np.stack([t, s] if turned else [s, 1.0 - t], axis=1).astype(np.float32)
    return Mesh(x, faces, uv=uv, material=material, **how)


def block() -> Mesh:
    x = np.array([[i, j, k] for i in (0.0, 0.4) for j in (0.0, 0.4) for k in (0.0, 0.6)]) + np.array([0.8, -0.8, 0.0])
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6],
             [0, 6, 4], [1, 5, 7], [1, 7, 3]]  # fmt: skip
    return Mesh(x, np.array(faces, np.int32), two_sided=False)


def draw(meshes: list[Mesh], camera: Camera | None = None, **how: Any) -> np.ndarray:
    config = PathsConfig(**{"samples": 4, "denoise": False, **how})
    return Paths().render(config, meshes, camera or frame(meshes, 0.3, 0.2, SIZE))


def light(picture: np.ndarray) -> np.ndarray:
    return np.asarray(to_linear(picture / 255.0))


@pytest.mark.parametrize("azimuth", [0.3, 2.0])
def test_silhouettes_are_the_rasters_within_a_pixel(azimuth: float) -> None:
    """What a black and a white background change alike is not covered by anything."""
    meshes = [sheet(), block()]
    camera = frame(meshes, azimuth, 0.2, SIZE)
    black, white = ({"ground": "none", "background": (one, one)} for one in ("#000000", "#ffffff"))
    mine, raster = (
        light(render(white)) - light(render(black))
        for render in (
            lambda how: draw(meshes, camera, samples=16, **how),
            lambda how: Raster().render(RasterConfig(**how), meshes, camera),
        )
    )
    masks = [apart[..., 1] < 0.5 * raster.max() for apart in (mine, raster)]
    assert 0.1 < masks[0].mean() < 0.6
    for mine, other in (masks, masks[::-1]):
        assert not (mine & ~binary_dilation(other, np.ones((3, 3)))).any()


def test_a_seed_gives_the_same_bytes_and_another_gives_others() -> None:
    meshes = [sheet(), block()]
    first, again, other = (draw(meshes, seed=seed, denoise=True) for seed in (3, 3, 4))
    assert first.tobytes() == again.tobytes() != other.tobytes()


@pytest.mark.full
def test_noise_falls_as_the_root_of_the_samples() -> None:
    meshes = [sheet(), block()]
    camera = frame(meshes, 0.3, 0.2, (60, 45))
    noise = []
    for samples in (64, 256):
        *parts, last = Paths().passes(PathsConfig(samples=samples, denoise=False), meshes, camera)
        assert [part.done for part in parts] == list(range(parts[0].total + 1)) and parts[0].left > 0.0
        noise.append(last.noise)
    assert noise[0] / noise[1] == pytest.approx(2.0, rel=0.25)


def test_floor_and_background_are_the_rasters_where_nothing_is_near() -> None:
    """The floor's light is the closed form that the rasteriser has; with distance both take the background's."""
    meshes = [replace(block(), vertices=0.2 * block().vertices)]
    middle = np.array([0.2, -0.12, 0.0])
    camera = Camera(middle + np.array([0.0, -3.0, 1.0]), middle, np.array([0.0, 0.0, 1.0]), 0.9, SIZE)
    mine, raster = draw(meshes, camera, samples=64), Raster().render(RasterConfig(), meshes, camera)
    away = np.ones((SIZE[1], SIZE[0]), bool)
    away[35:62, 40:110] = False
    assert np.abs(light(mine) - light(raster))[away].mean() < 0.02
    assert axes(camera)[2][2] < 0.0


def test_a_print_lies_as_the_raster_draws_it() -> None:
    image = np.zeros((64, 64, 3), np.uint8)
    image[:32, :32], image[:32, 32:], image[32:, :32] = (255, 40, 40), (40, 255, 40), (40, 40, 255)
    image.flags.writeable = False  # as decoded files are
    meshes = [sheet(image=image, wave=0.0)]
    camera = frame(meshes, 0.0, 0.0, SIZE)
    mine, raster = draw(meshes, camera, samples=16), Raster().render(RasterConfig(), meshes, camera)
    for row in (30, 60):
        for column in (45, 75):
            a, b = (
                light(picture[row - 5 : row + 5, column - 5 : column + 5]).mean(axis=(0, 1))
                for picture in (mine, raster)
            )
            assert np.argmax(a) == np.argmax(b)
            assert (a / a.max() > 0.5).tolist() == (b / b.max() > 0.5).tolist()


def test_thin_cloth_lets_light_through_and_denim_does_not() -> None:
    """Seen from the side that the light does not reach, chiffon is far brighter than denim of the same colour."""
    grey = np.full((13 * 13, 3), 0.4)
    camera = frame([sheet()], 0.0, 0.1, SIZE)
    dark, bright = (
        light(draw([sheet(material=name, colours=grey, wave=0.0)], camera, samples=16, light=(0.0, 1.0, 0.5)))[
            30:60, 45:75
        ]
        for name in ("denim", "chiffon")
    )
    assert bright.mean() > 1.3 * dark.mean()


def cloth_light(name: str, size: float, turned: bool = False) -> np.ndarray:
    """Return the light (36, 36) in the middle of grey cloth of a size [m]."""
    mesh = sheet(material=name, colours=np.full((13 * 13, 3), 0.2), turned=turned)
    mesh = replace(mesh, vertices=size * mesh.vertices)
    return light(draw([mesh], frame([mesh], 0.3, 0.2, SIZE), samples=64))[27:63, 42:78].mean(axis=2)


@pytest.mark.full
def test_satin_shines_along_its_yarns() -> None:
    """Satin turned by a right angle shines elsewhere; jersey does not."""
    changes = {}
    for name in ("silk", "interlock"):
        first, second = (
            cloth_light(name, 1.0, turned).reshape(6, 6, 6, 6).mean(axis=(1, 3)) for turned in (False, True)
        )
        changes[name] = np.abs(second - first).mean()
    assert changes["silk"] > 3.0 * changes["interlock"]


@pytest.mark.full
def test_denim_shows_its_twill_from_near_where_satin_is_smooth() -> None:
    def grain(name: str) -> float:
        near = cloth_light(name, 0.03)
        return float(np.abs(np.diff(near, axis=1)).mean() / near.mean())

    assert grain("denim") > 3.0 * grain("silk")


RADIUS = 0.05
ALONG = np.linspace(-1.5, 1.5, 49)
BENT = np.stack([ALONG, 0.4 * np.sin(2.0 * ALONG), 0.3 * np.cos(3.0 * ALONG)], axis=1)
TURN = np.linspace(0.0, 2.0 * np.pi, 49)
RING = np.stack([0.6 * np.cos(TURN), 0.6 * np.sin(TURN), 0.0 * TURN], axis=1)
RING[-1] = RING[0]


def knitted(lines: list[np.ndarray], colour: np.ndarray) -> Mesh:
    yarns = curves(lines, RADIUS)
    colours = np.tile(colour, (len(yarns.points), 1))
    return Mesh(yarns.points, np.zeros((0, 3), np.int32), colours, two_sided=False, yarns=yarns)


def test_a_fibre_in_even_light_is_as_bright_as_its_energies_say() -> None:
    """In the closed form of Fresnel's and Beer's laws; a clear one cannot be seen."""
    mi, _ = load_mitsuba()
    line = np.stack([ALONG, 0.0 * ALONG, 0.0 * ALONG], axis=1)
    above = mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]).scale([RADIUS] * 3)
    look = {
        "type": "orthographic", "to_world": above,
        "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
    }  # fmt: skip
    for colour in (np.ones(3), np.array([0.6, 0.2, 0.05])):
        (fibre,) = yarn_shapes(mi, knitted([line], colour), np.zeros(3))
        parts = {"fibre": fibre, "light": {"type": "constant"}, "look": look, "by": {"type": "path"}}
        scene = mi.load_dict({"type": "scene", **parts})
        seen = np.array(mi.render(scene, spp=256, seed=1))[..., :3].mean(axis=(0, 1))
        assert seen == pytest.approx(sum(find_energies(find_absorption(colour, ROUGH))), rel=0.005)


def test_yarns_cover_what_rays_find_of_them_within_a_pixel() -> None:
    """A bent yarn reaches its ends, and a ring has no gap."""
    mesh, camera = knitted([BENT, RING], np.full(3, 0.01)), above(1.8, (60, 60), 20.0)
    black, white = (
        light(draw([mesh], camera, samples=16, ground="none", background=(one, one))) for one in ("#000000", "#ffffff")
    )
    mine, other = (white - black)[..., 1] < 0.5, shares(mesh.yarns, camera) > 0.5
    assert 0.03 < mine.mean() < 0.3
    for one, two in ((mine, other), (other, mine)):
        assert not (one & ~binary_dilation(two, np.ones((3, 3)))).any()


def test_skin_shows_through_a_clear_yarn_and_not_through_a_dark_one() -> None:
    """Yarns side by side over red skin: clear ones pass its colour."""
    lines = [np.stack([ALONG, 0.0 * ALONG + y, 0.0 * ALONG], axis=1) for y in np.arange(-1.5, 1.5, 2.0 * RADIUS)]
    x = np.array([[-3.0, -3, -0.3], [3, -3, -0.3], [3, 3, -0.3], [-3, 3, -0.3]])
    skin = Mesh(x, np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.tile([0.8, 0.1, 0.1], (4, 1)), two_sided=False)
    camera, redness = above(0.5, (24, 24), 20.0), []
    for colour in (1.0, 0.01):
        seen = light(draw([knitted(lines, np.full(3, colour)), skin], camera, samples=64, ground="none"))
        redness.append(float((seen[..., 0] - seen[..., 2]).mean()))
    assert redness[0] > 5.0 * max(redness[1], 0.0) and redness[0] > 0.05
