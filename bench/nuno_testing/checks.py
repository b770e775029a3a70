"""The checks of each kind of plugin, by entry-point group: those of all kinds, and its own."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from trimesh.creation import box

from nuno.plugin_contract import registry
from nuno.runtime.stepper import check_kept
from nuno_schemas.bodies import BOX, MESH, Geometry, Poses, no_rows
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.operation import Beside, Outcome
from nuno_schemas.pictures import Mesh, frame
from nuno_schemas.system import System, Term
from nuno_testing import bodies, dye, forces, integrators, rides
from nuno_testing.subject import Subject, made_twice

# The contract of renderers.

FACES = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], np.int32)


def scene() -> list[Mesh]:
    """Return a tent over a block, as two meshes."""
    tent = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, 1]])
    colours = np.linspace(0, 1, 15).reshape(5, 3)
    return [Mesh(tent, FACES, colours=colours), Mesh(tent * 0.5, FACES, two_sided=False)]


def a_picture_has_the_size_asked_for(subject: Subject) -> None:
    """A picture has the size of the camera, down to a single pixel."""
    for size in ((64, 48), (31, 57), (1, 1)):
        picture = subject.plugin.render(subject.config, scene(), frame(scene(), size=size))
        assert picture.shape == (size[1], size[0], 3)


def the_same_scene_is_drawn_alike(subject: Subject) -> None:
    """Drawn twice, meshes give the same picture of more than one colour, and are not changed."""
    meshes = scene()
    camera = frame(meshes, size=(64, 48))
    picture = made_twice(lambda: subject.plugin.render(subject.config, meshes, camera), meshes, camera)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 20


def nothing_to_draw_is_a_picture_too(subject: Subject) -> None:
    """Without meshes, or with one without triangles, the picture is the empty background."""
    camera, no_triangles = frame(scene(), size=(64, 48)), Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    empty, bare = (subject.plugin.render(subject.config, meshes, camera) for meshes in ([], [no_triangles]))
    assert (empty == bare).all()


def a_face_of_vertices_that_are_not_there_is_refused(subject: Subject) -> None:
    """The error names the mesh of the face."""
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


# The contract of contacts, tested with single grains that fall on a block.

GRAVITY, STEP = np.array([0.0, -9.81, 0.0]), 2e-4
BOX_MESH = box((6.0, 1.0, 6.0))
CORNERS, SIDES = np.asarray(BOX_MESH.vertices) - [0.0, 0.5, 0.0], np.asarray(BOX_MESH.faces, np.int32)


def block(kind: int, friction: float) -> Geometry:
    """Return a body with its top at height 0: a box, or its triangles."""
    low, high = CORNERS.min(axis=0)[None], CORNERS.max(axis=0)[None]
    a, b = (0.5 * (low + high), 0.5 * (high - low)) if kind == BOX else (low, high)
    zero, one = np.zeros(1, np.int32), np.ones(1)
    triangles = (CORNERS, SIDES, np.zeros(len(SIDES), np.int32)) if kind == MESH else ()
    return Geometry(
        ("block",), ("block/world",), np.array([kind], np.int8), zero, zero, a, b, 0.0 * one, np.nan * one, 0.5 * one,
        friction * one, *triangles,
    )  # fmt: skip


def contact_term(subject: Subject, grains: Fabric, friction: float) -> Term:
    """Return the contact's term with a block of a kind that the contact supports."""
    try:
        term: Term = subject.plugin.prepare(subject.config, grains, block(BOX, friction), GRAVITY)
    except BadInput:
        term = subject.plugin.prepare(subject.config, grains, block(MESH, friction), GRAVITY)
    return term


def throw_grains(subject: Subject, x: Float, v: Float, friction: float, seconds: float) -> State:
    """Return the state, after some seconds, of grains of one gram that start at x, v (n, 3)."""
    grains = Fabric("grains", x, v, np.full(len(x), 1e-3), np.zeros(len(x), bool), no_rows(np.int32, 3))
    system, state = System(grains, GRAVITY, 0.0, (contact_term(subject, grains, friction),)), State(x.copy(), v.copy())
    solver, pose = registry.load("nuno.integrators", "symplectic_euler"), Poses(0.0, np.eye(4)[:1], np.zeros((1, 3)))
    memory = solver.prepare(solver.Config(), system, state)
    assert solver.advance(system, state, memory, (pose, pose), round(seconds / STEP), STEP).status == "ok"
    check_kept(memory, memory.arrays)
    return state


def what_falls_on_a_body_comes_to_rest_on_it(subject: Subject) -> None:
    """A grain rests on the surface to a millimetre; grains in the air or beside the body fall freely."""
    x = np.array([[0.0, 0.01, 0.0], [1.0, 1.0, 1.0], [4.0, 0.01, 0.0]])
    end = made_twice(lambda: throw_grains(subject, x, 0.0 * x, 0.3, 0.4), x)
    assert abs(end.x[0, 1]) < 1e-3
    assert np.abs(end.v[0]).max() < 1e-2
    assert np.abs(end.x[1:, 1] - (x[1:, 1] - 0.5 * 9.81 * 0.4**2)).max() < 1e-3
    assert (end.x[1:, [0, 2]] == x[1:, [0, 2]]).all()


def what_slides_is_slowed_as_coulomb_says(subject: Subject) -> None:
    """Friction decelerates a sliding grain by mu g, and without friction there is no force along the surface."""
    x, v = np.array([[-1.0, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0]])
    for friction in (0.0, 0.4):
        end = throw_grains(subject, x, v, friction, 0.2)
        assert abs(end.v[0, 0] - (1.0 - friction * 9.81 * 0.2)) < 0.03 * friction + 1e-9
        assert abs(end.v[0, 2]) < 1e-9


CONTACTS = (what_falls_on_a_body_comes_to_rest_on_it, what_slides_is_slowed_as_coulomb_says)


# The contract of models and operations.


def torso() -> tuple[Any, Any]:
    """Return vertices and faces of nuno's own body, for models that are drawn over a body."""
    collider = registry.load("nuno.colliders", "mesh")
    shape = collider.build(collider.Config(shape="torso", resolution=48), None, None)
    return shape.vertices, shape.faces


def build_fabric(subject: Subject) -> Fabric:
    """Build the fabric; a model that is drawn over a body gets nuno's own."""
    model, over = subject.plugin, getattr(type(subject.plugin._plugin), "over", None)
    if over is None or model.over(subject.config) is None:
        fabric: Fabric = model.build(subject.config, subject.files, 0)
        return fabric
    drawn: Fabric = model.build_over(subject.config, subject.files, 0, *torso())
    return drawn


def it_is_built_the_same_again(subject: Subject) -> None:
    """Built twice, the fabric is the same, with the number of vertices that `count` returns."""
    fabric = made_twice(lambda: build_fabric(subject))
    assert fabric.number == subject.plugin.count(subject.config, subject.files)


def each_spring_and_hinge_is_there_once(subject: Subject) -> None:
    """No two springs join the same vertices, and no two hinges."""
    fabric = build_fabric(subject)
    springs = [] if fabric.springs is None else [np.sort(fabric.springs.pairs(), axis=1)]
    hinges = [] if fabric.hinges is None else [np.sort(fabric.hinges.quads(), axis=1)]
    for corners in (*springs, *hinges):
        assert len(np.unique(corners, axis=0)) == len(corners)


def triangles_face_one_way(subject: Subject) -> None:
    """Each triangle has an area, and neighbours run along their common edge in opposite directions."""
    fabric = build_fabric(subject)
    x, faces = fabric.position, fabric.faces
    area = np.linalg.norm(np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]]), axis=1)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    assert (area > 0.0).all()
    assert len(np.unique(edges, axis=0)) == len(edges)


MODELS = (it_is_built_the_same_again, each_spring_and_hinge_is_there_once, triangles_face_one_way)


def apply_operation(subject: Subject, fabric: Fabric) -> Outcome:
    """Apply an operation to a fabric at rest, without bodies, or on the surface of a body if it needs one."""
    state = State(fabric.position.copy(), 0.0 * fabric.position)

    def make() -> Outcome:
        if not hasattr(subject.plugin, "apply_beside"):
            made: Outcome = subject.plugin.apply(subject.config, fabric, state, None)
            return made
        pose = np.array([[1.0, 0.0, 0.0, 0.0]]), np.zeros((1, 3)), np.zeros((1, fabric.number))
        on_body: Outcome = subject.plugin.apply_beside(subject.config, fabric, state, Beside(("body",), *pose))
        return on_body

    made: Outcome = made_twice(make, fabric, state)
    return made


def it_makes_the_same_again_and_leaves_its_arguments_alone(subject: Subject) -> None:
    """Applied twice to a knitted tube or a sheet of triangles, it makes the same finite numbers and sound curves."""
    knit, sheet = (registry.load("nuno.models", name) for name in ("knit", "sheet"))
    try:
        made = apply_operation(subject, knit.build(knit.Config(form="tube", wales=8, courses=15), None, 0))
    except BadInput:
        made = apply_operation(subject, sheet.build(sheet.Config(cells="triangles", pin=("top-left",)), None, 0))
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


def answers_to_its_entry_point(subject: Subject) -> None:
    """The plugin has the name under which it is installed, and holds no state."""
    plugin = registry.installed(subject.group)[subject.name].load()()
    assert plugin.name == subject.name
    assert vars(plugin) == {}


def refuses_unknown_fields_by_name(subject: Subject) -> None:
    """An unknown field is refused by its name; the configuration has a JSON Schema, and can be written as JSON."""
    config = subject.plugin.Config
    with pytest.raises(ValidationError, match="no_such_field"):
        config.model_validate(subject.config.model_dump(exclude_unset=True) | {"no_such_field": 1})
    schema = json.loads(json.dumps(config.model_json_schema()))
    assert schema["additionalProperties"] is False
    assert set(schema.get("properties", {})) == set(config.model_fields)
    assert config.model_validate_json(subject.config.model_dump_json(exclude_unset=True)) == subject.config


ALL = (answers_to_its_entry_point, refuses_unknown_fields_by_name)
OWN: Mapping[str, tuple[Callable[[Subject], None], ...]] = {
    "nuno.models": MODELS,
    "nuno.operations": OPERATIONS,
    "nuno.forces": forces.FORCES,
    "nuno.integrators": integrators.INTEGRATORS + rides.RIDES,
    "nuno.colliders": bodies.COLLIDERS,
    "nuno.motions": bodies.MOTIONS,
    "nuno.contacts": CONTACTS,
    "nuno.renderers": RENDERERS,
    "nuno.dye_solvers": dye.SOLVERS,
    "nuno.isotherms": dye.ISOTHERMS,
}
"""Checks of each kind; other kinds have only those of all kinds."""


def checks_of(group: str) -> tuple[Callable[[Subject], None], ...]:
    """Return the checks of a kind of plugin."""
    return ALL + OWN.get(group, ())
