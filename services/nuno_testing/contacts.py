"""What contacts owe: measured on single grains that fall on a block."""

from __future__ import annotations

import numpy as np
from trimesh.creation import box

from nuno import registry
from nuno.stepping.stepped import check_kept
from nuno_schemas.bodies import BOX, MESH, Geometry, Poses, no_rows
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.system import System, Term
from nuno_testing.subject import Subject, made_twice

GRAVITY, STEP = np.array([0.0, -9.81, 0.0]), 2e-4
BOX_MESH = box((6.0, 1.0, 6.0))
CORNERS, SIDES = np.asarray(BOX_MESH.vertices) - [0.0, 0.5, 0.0], np.asarray(BOX_MESH.faces, np.int32)


def block(kind: int, friction: float) -> Geometry:
    """A body whose top is at height 0: a box, or its triangles."""
    low, high = CORNERS.min(axis=0)[None], CORNERS.max(axis=0)[None]
    a, b = (0.5 * (low + high), 0.5 * (high - low)) if kind == BOX else (low, high)
    zero, one = np.zeros(1, np.int32), np.ones(1)
    triangles = (CORNERS, SIDES, np.zeros(len(SIDES), np.int32)) if kind == MESH else ()
    return Geometry(
        ("block",), ("block/world",), np.array([kind], np.int8), zero, zero, a, b, 0.0 * one, np.nan * one, 0.5 * one,
        friction * one, *triangles,
    )  # fmt: skip


def term_of(subject: Subject, grains: Fabric, friction: float) -> Term:
    """The contact's term, with the kind of block that it can meet."""
    try:
        found: Term = subject.plugin.prepare(subject.config, grains, block(BOX, friction), GRAVITY)
    except BadInput:
        found = subject.plugin.prepare(subject.config, grains, block(MESH, friction), GRAVITY)
    return found


def thrown(subject: Subject, x: Float, v: Float, friction: float, seconds: float) -> State:
    """Where grains of a gram end up that start at x, v (n, 3)."""
    grains = Fabric("grains", x, v, np.full(len(x), 1e-3), np.zeros(len(x), bool), no_rows(np.int32, 3))
    system, state = System(grains, GRAVITY, 0.0, (term_of(subject, grains, friction),)), State(x.copy(), v.copy())
    solver, pose = registry.load("nuno.integrators", "symplectic_euler"), Poses(0.0, np.eye(4)[:1], np.zeros((1, 3)))
    memory = solver.prepare(solver.Config(), system, state)
    assert solver.advance(system, state, memory, (pose, pose), round(seconds / STEP), STEP).status == "ok"
    check_kept(memory, memory.arrays)
    return state


def what_falls_on_a_body_comes_to_rest_on_it(subject: Subject) -> None:
    """Within a millimetre; what is still in the air, or falls beside it, does as if there were none."""
    x = np.array([[0.0, 0.01, 0.0], [1.0, 1.0, 1.0], [4.0, 0.01, 0.0]])
    end = made_twice(lambda: thrown(subject, x, 0.0 * x, 0.3, 0.4), x)
    assert abs(end.x[0, 1]) < 1e-3
    assert np.abs(end.v[0]).max() < 1e-2
    assert np.abs(end.x[1:, 1] - (x[1:, 1] - 0.5 * 9.81 * 0.4**2)).max() < 1e-3
    assert (end.x[1:, [0, 2]] == x[1:, [0, 2]]).all()


def what_slides_is_slowed_as_coulomb_says(subject: Subject) -> None:
    """By mu g, or not at all: no force is along the surface but friction."""
    x, v = np.array([[-1.0, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0]])
    for friction in (0.0, 0.4):
        end = thrown(subject, x, v, friction, 0.2)
        assert abs(end.v[0, 0] - (1.0 - friction * 9.81 * 0.2)) < 0.03 * friction + 1e-9
        assert abs(end.v[0, 2]) < 1e-9


CONTACTS = (what_falls_on_a_body_comes_to_rest_on_it, what_slides_is_slowed_as_coulomb_says)
