"""What models and operations owe."""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno import registry
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, State
from nuno_schemas.operation import Beside, Outcome
from nuno_testing.subject import Subject, made_twice


def torso() -> tuple[Any, Any]:
    """Vertices and faces of the body that comes with nuno, for models that are drawn over one."""
    collider = registry.load("nuno.colliders", "mesh")
    shape = collider.build(collider.Config(shape="torso", resolution=48), None, None)
    return shape.vertices, shape.faces


def built(subject: Subject) -> Fabric:
    """The fabric; of a model that is drawn over a body, over one that comes with nuno."""
    model, over = subject.plugin, getattr(type(subject.plugin._plugin), "over", None)
    if over is None or model.over(subject.config) is None:
        fabric: Fabric = model.build(subject.config, subject.files, 0)
        return fabric
    drawn: Fabric = model.build_over(subject.config, subject.files, 0, *torso())
    return drawn


def it_is_built_the_same_again(subject: Subject) -> None:
    """With as many vertices as it says before it is built."""
    fabric = made_twice(lambda: built(subject))
    assert fabric.number == subject.plugin.count(subject.config, subject.files)


def each_spring_and_hinge_is_there_once(subject: Subject) -> None:
    """No two springs join the same vertices, and no two hinges."""
    fabric = built(subject)
    springs = [] if fabric.springs is None else [np.sort(fabric.springs.pairs(), axis=1)]
    hinges = [] if fabric.hinges is None else [np.sort(fabric.hinges.quads(), axis=1)]
    for corners in (*springs, *hinges):
        assert len(np.unique(corners, axis=0)) == len(corners)


def triangles_face_one_way(subject: Subject) -> None:
    """Each has an area, and neighbours run along their common edge in opposite directions."""
    fabric = built(subject)
    x, faces = fabric.position, fabric.faces
    area = np.linalg.norm(np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]]), axis=1)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    assert (area > 0.0).all()
    assert len(np.unique(edges, axis=0)) == len(edges)


MODELS = (it_is_built_the_same_again, each_spring_and_hinge_is_there_once, triangles_face_one_way)


def applied(subject: Subject, fabric: Fabric) -> Outcome:
    """What is made of a fabric at rest, without bodies, or on the surface of the one that it is made beside."""
    state = State(fabric.position.copy(), 0.0 * fabric.position)

    def make() -> Outcome:
        if not hasattr(subject.plugin, "apply_beside"):
            made: Outcome = subject.plugin.apply(subject.config, fabric, state, None)
            return made
        still = np.array([[1.0, 0.0, 0.0, 0.0]]), np.zeros((1, 3)), np.zeros((1, fabric.number))
        beside: Outcome = subject.plugin.apply_beside(subject.config, fabric, state, Beside(("body",), *still))
        return beside

    made: Outcome = made_twice(make, fabric, state)
    return made


def it_makes_the_same_again_and_leaves_its_arguments_alone(subject: Subject) -> None:
    """Of a knitted tube, or else of a sheet of triangles; numbers are finite, and curves hold together."""
    knit, sheet = (registry.load("nuno.models", name) for name in ("knit", "sheet"))
    try:
        made = applied(subject, knit.build(knit.Config(form="tube", wales=8, courses=15), None, 0))
    except BadInput:
        made = applied(subject, sheet.build(sheet.Config(cells="triangles", pin=("top-left",)), None, 0))
    assert np.isfinite(list(made.facts.values())).all()
    if (curves := made.curves) is None:
        return
    n = len(curves.points)
    assert curves.points.shape == curves.normal.shape == (n, 3) and np.isfinite(curves.points).all()
    assert curves.ptr[0] == 0 and curves.ptr[-1] == n and (np.diff(curves.ptr) >= 2).all()
    assert len(curves.radius) == len(curves.kind) == len(curves.ptr) - 1
    assert set(curves.kind.tolist()) <= set(range(len(curves.names)))
    assert np.isin(np.round(np.linalg.norm(curves.normal, axis=1), 12), (0.0, 1.0)).all()
    assert all(len(values) == n for values in made.arrays.values())


OPERATIONS = (it_makes_the_same_again_and_leaves_its_arguments_alone,)
