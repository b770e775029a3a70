"""What every installed renderer promises."""

from __future__ import annotations

from importlib.metadata import entry_points

import numpy as np
import pytest
from pydantic import ValidationError

from nuno_schemas.camera import frame
from nuno_schemas.drawing import Mesh
from nuno_schemas.errors import BadInput

RENDERERS = sorted(entry_points(group="nuno.renderers"), key=lambda entry: entry.name)


@pytest.fixture(params=RENDERERS, ids=lambda entry: entry.name)
def renderer(request):
    plugin = request.param.load()()
    assert plugin.name == request.param.name
    return plugin


def scene():
    """A tent over a block, in two meshes."""
    tent = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], np.int32)
    colour = np.linspace(0, 1, 15).reshape(5, 3)
    return [Mesh(tent, faces, colours=colour), Mesh(tent * 0.5, faces, two_sided=False)]


def test_picture_has_the_size_asked_for(renderer):
    for size in ((64, 48), (31, 57), (1, 1)):
        picture = renderer.render(renderer.Config(), scene(), frame(scene(), size=size))
        assert picture.shape == (size[1], size[0], 3)
        assert picture.dtype == np.uint8


def test_same_input_gives_the_same_bytes_and_is_left_alone(renderer):
    meshes = scene()
    camera = frame(meshes, size=(64, 48))
    first = renderer.render(renderer.Config(), meshes, camera)
    assert (renderer.render(renderer.Config(), meshes, camera) == first).all()
    for mesh, fresh in zip(meshes, scene(), strict=True):
        assert np.array_equal(mesh.vertices, fresh.vertices)
        assert np.array_equal(mesh.faces, fresh.faces)
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 20


def test_nothing_to_draw_is_a_picture_too(renderer):
    camera = frame(scene(), size=(64, 48))
    empty = renderer.render(renderer.Config(), [], camera)
    hollow = renderer.render(renderer.Config(), [Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))], camera)
    assert (empty == hollow).all()


def test_unknown_field_is_refused_by_name(renderer):
    with pytest.raises(ValidationError, match="no_such_field"):
        renderer.Config(no_such_field=1)


@pytest.mark.parametrize("index", [-1, 5])
def test_face_index_out_of_range_is_refused_by_name(renderer, index):
    tent = scene()[0]
    bad = Mesh(tent.vertices, np.array([[0, 1, index]], np.int32))
    with pytest.raises(BadInput, match=r"meshes\[0\]\.faces"):
        renderer.render(renderer.Config(), [bad], frame([tent], size=(16, 12)))
