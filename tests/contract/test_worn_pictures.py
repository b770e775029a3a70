"""What every installed plugin that draws knits on bodies promises."""

from __future__ import annotations

import copy
from importlib.metadata import entry_points

import numpy as np
import pytest

from nuno_schemas.errors import BadInput
from nuno_schemas.operation import YarnCurves
from nuno_schemas.pictures import Camera, Mesh, SurfaceValues, Worn, frame

PLUGINS = sorted(entry_points(group="nuno.yarn_pictures"), key=lambda entry: entry.name)


@pytest.fixture(params=PLUGINS, ids=lambda entry: entry.name)
def plugin(request):
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


def test_it_says_what_it_takes(plugin):
    assert isinstance(plugin.curves, bool) and isinstance(plugin.shows, bool)


def test_same_input_gives_the_same_bytes_and_is_left_alone(plugin):
    given, steps = worn(), []
    before = copy.deepcopy(given)
    config = plugin.Config(samples=4)
    first = plugin.draw(config, given, camera(), lambda done, total: steps.append((done, total)))
    assert first.shape == (32, 40, 3) and first.dtype == np.uint8
    assert (plugin.draw(config, given, camera()) == first).all()
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 20
    assert steps[-1] == (32, 32) and [done for done, _ in steps] == sorted(done for done, _ in steps)
    assert np.array_equal(given.points, before.points) and np.array_equal(given.links, before.links)
    assert np.array_equal(given.yarns.points, before.yarns.points)
    assert np.array_equal(given.bodies[0].vertices, before.bodies[0].vertices)


def test_place_in_the_world_does_not_matter(plugin):
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
    config = plugin.Config(samples=4)
    one, other = plugin.draw(config, here, eye).astype(int), plugin.draw(config, there, away).astype(int)
    assert np.mean(np.abs(one - other) > 2) < 0.01


def test_impossible_cameras_are_refused(plugin):
    inside = Camera(np.array([0.1, 0.05, 0.02]), np.array([2.0, 0, 0]), np.array([0.0, 0, 1]), 0.5, (16, 16))
    with pytest.raises(BadInput, match="inside a body"):
        plugin.draw(plugin.Config(samples=1), worn(), inside)
    blind = Camera(inside.target, inside.target, inside.up, 0.5, (16, 16))
    with pytest.raises(BadInput, match="apart"):
        plugin.draw(plugin.Config(samples=1), worn(), blind)
