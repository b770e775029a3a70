"""What renderers owe."""

from __future__ import annotations

import numpy as np
import pytest

from nuno_schemas.camera import frame
from nuno_schemas.drawing import Mesh
from nuno_schemas.errors import BadInput
from nuno_testing.subject import Subject, made_twice

FACES = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], np.int32)


def scene() -> list[Mesh]:
    """A tent over a block, in two meshes."""
    tent = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, 1]])
    colours = np.linspace(0, 1, 15).reshape(5, 3)
    return [Mesh(tent, FACES, colours=colours), Mesh(tent * 0.5, FACES, two_sided=False)]


def a_picture_has_the_size_asked_for(subject: Subject) -> None:
    """Down to a single pixel."""
    for size in ((64, 48), (31, 57), (1, 1)):
        picture = subject.plugin.render(subject.config, scene(), frame(scene(), size=size))
        assert picture.shape == (size[1], size[0], 3)


def the_same_scene_is_drawn_alike(subject: Subject) -> None:
    """And is left alone; there is more to see than a single colour."""
    meshes = scene()
    camera = frame(meshes, size=(64, 48))
    picture = made_twice(lambda: subject.plugin.render(subject.config, meshes, camera), meshes, camera)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 20


def nothing_to_draw_is_a_picture_too(subject: Subject) -> None:
    """No meshes, or one without triangles."""
    camera, hollow = frame(scene(), size=(64, 48)), Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    empty, bare = (subject.plugin.render(subject.config, meshes, camera) for meshes in ([], [hollow]))
    assert (empty == bare).all()


def a_face_of_vertices_that_are_not_there_is_refused(subject: Subject) -> None:
    """By the name of its mesh."""
    tent = scene()[0]
    for index in (-1, 5):
        bad = Mesh(tent.vertices, np.array([[0, 1, index]], np.int32))
        with pytest.raises(BadInput, match=r"meshes\[0\]\.faces"):
            subject.plugin.render(subject.config, [bad], frame([tent], size=(16, 12)))


RENDERERS = (
    a_picture_has_the_size_asked_for,
    the_same_scene_is_drawn_alike,
    nothing_to_draw_is_a_picture_too,
    a_face_of_vertices_that_are_not_there_is_refused,
)
