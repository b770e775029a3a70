"""What every installed plugin that draws dyed cloth or knits on bodies promises; yarns as curves."""

from __future__ import annotations

import copy
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nuno.scene.files import SceneFiles
from nuno_schemas.dyeing import DyeColour
from nuno_schemas.errors import BadInput
from nuno_schemas.operation import YarnCurves
from nuno_schemas.pictures import Camera, Layers, Mesh, Photograph, SurfaceValues, Window, Worn, frame

PLUGINS = sorted(entry_points(group="nuno.dye_pictures"), key=lambda entry: entry.name)
NY, NX = 24, 30


@pytest.fixture(params=PLUGINS, ids=lambda entry: entry.name)
def plugin(request: pytest.FixtureRequest) -> Any:
    found = request.param.load()()
    return found


def cloth() -> Layers:
    """Fibre and gaps, above and below, at random, and a photograph: any arrays are a cloth."""
    rng = np.random.default_rng(5)
    up = rng.random((NY, NX)) > 0.5
    photograph = Photograph(
        rng.integers(90, 255, (2 * NY, 2 * NX, 3), np.uint8), np.repeat(np.repeat(up, 2, axis=0), 2, axis=1)
    )
    return Layers(rng.random((2, NY, NX)) > 0.2, np.stack([~up, up]), photograph=photograph)


def amounts(dyes: int) -> np.ndarray:
    return np.random.default_rng(6).random((dyes, 2, NY, NX)).astype(np.float32) * 0.2


def colours(dyes: int) -> list[DyeColour]:
    return [DyeColour(), DyeColour(light="#f7eeee", mid="#d0605a", dark="#7a1518")][:dyes]


@pytest.mark.parametrize("scale", [1, 3, 8])
@pytest.mark.parametrize("dyes", [1, 2])
def test_a_picture_has_its_window_s_size_and_the_same_bytes_every_time(plugin: Any, scale: int, dyes: int) -> None:
    window, seen = Window(3, 20, 1, 30), amounts(dyes)
    prepared = plugin.prepare(plugin.Config(), SceneFiles(Path()), cloth(), colours(dyes), window, scale)
    first = plugin.draw(prepared, seen)
    assert first.shape == (17 * scale, 29 * scale, 3) and first.dtype == np.uint8
    plugin.draw(prepared, 0.0 * seen)
    assert np.array_equal(plugin.draw(prepared, seen), first)
    assert np.array_equal(seen, amounts(dyes))


def test_dye_shows_where_it_is_and_nowhere_else(plugin: Any) -> None:
    seen, window = np.zeros((1, 2, NY, NX)), Window(0, NY, 0, NX)
    prepared = plugin.prepare(plugin.Config(), SceneFiles(Path()), cloth(), colours(1), window, 4)
    bare = plugin.draw(prepared, seen).astype(int)
    seen[:, :, 8:16, 8:16] = 0.2
    changed = np.abs(plugin.draw(prepared, seen) - bare).max(axis=2) > 0
    near = np.zeros((NY * 4, NX * 4), bool)
    near[28:68, 28:68] = True
    assert not changed[~near].any()
    assert changed[32:64, 32:64].mean() > 0.9


KNIT_PLUGINS = sorted(entry_points(group="nuno.yarn_pictures"), key=lambda entry: entry.name)


@pytest.fixture(params=KNIT_PLUGINS, ids=lambda entry: entry.name)
def knit_plugin(request):
    found = request.param.load()()
    return found


def worn():
    """A double tent with a yarn around it."""
    corners = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    sides = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    angle = 2 * np.pi * np.arange(33) / 32
    points = 1.05 * np.stack([np.cos(angle), np.sin(angle), 0.2 * np.sin(4 * angle)], axis=1)
    yarns = YarnCurves(points, np.array([0, 33]), np.array([0.05]), np.zeros(1, np.int32), ("yarn",), np.zeros((33, 3)))
    links = np.stack([np.arange(32), np.arange(1, 33)], axis=1).astype(np.int32)
    body = Mesh(corners, np.array(sides, np.int32), two_sided=False)
    return Worn((body,), points, links, yarns, SurfaceValues("points", points[:, 2], "height [m]"))


def camera(size=(40, 32)):
    return frame(worn().points, size=size)


def test_it_says_what_it_takes(knit_plugin):
    assert isinstance(knit_plugin.curves, bool) and isinstance(knit_plugin.shows, bool)


def test_same_input_gives_the_same_bytes_and_is_left_alone(knit_plugin):
    given, steps = worn(), []
    before = copy.deepcopy(given)
    config = knit_plugin.Config(samples=4)
    first = knit_plugin.draw(config, given, camera(), lambda done, total: steps.append((done, total)))
    assert first.shape == (32, 40, 3) and first.dtype == np.uint8
    assert (knit_plugin.draw(config, given, camera()) == first).all()
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 20
    assert steps[-1] == (32, 32) and [done for done, _ in steps] == sorted(done for done, _ in steps)
    assert np.array_equal(given.points, before.points) and np.array_equal(given.links, before.links)
    assert np.array_equal(given.yarns.points, before.yarns.points)
    assert np.array_equal(given.bodies[0].vertices, before.bodies[0].vertices)


def test_place_in_the_world_does_not_matter(knit_plugin):
    far, here = np.array([3e4, -2e4, 1e4]), worn()
    body, yarns = here.bodies[0], here.yarns
    there = Worn(
        (Mesh(body.vertices + far, body.faces, two_sided=False),),
        here.points + far,
        here.links,
        YarnCurves(yarns.points + far, yarns.ptr, yarns.radius, yarns.kind, yarns.names, yarns.normal),
        here.values,
    )
    eye = camera()
    away = Camera(eye.eye + far, eye.target + far, eye.up, eye.fov, eye.size)
    config = knit_plugin.Config(samples=4)
    one, other = knit_plugin.draw(config, here, eye).astype(int), knit_plugin.draw(config, there, away).astype(int)
    assert np.mean(np.abs(one - other) > 2) < 0.01


def test_impossible_cameras_are_refused(knit_plugin):
    inside = Camera(np.array([0.1, 0.05, 0.02]), np.array([2.0, 0, 0]), np.array([0.0, 0, 1]), 0.5, (16, 16))
    with pytest.raises(BadInput, match="inside a body"):
        knit_plugin.draw(knit_plugin.Config(samples=1), worn(), inside)
    blind = Camera(inside.target, inside.target, inside.up, 0.5, (16, 16))
    with pytest.raises(BadInput, match="apart"):
        knit_plugin.draw(knit_plugin.Config(samples=1), worn(), blind)


def make_curves(sizes):
    n = sum(sizes)
    ptr = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    return YarnCurves(
        np.zeros((n, 3)), ptr, np.zeros(len(sizes)), np.zeros(len(sizes), np.int32), ("yarn",), np.zeros((n, 3))
    )


def test_segments_stay_within_their_yarn():
    curves = make_curves([3, 1, 0, 2])
    assert curves.number == 4
    assert curves.segments().tolist() == [0, 1, 4]
    assert curves.yarn().tolist() == [0, 0, 0, 1, 3, 3]


def test_no_yarns_have_no_segments():
    assert len(make_curves([]).segments()) == 0
