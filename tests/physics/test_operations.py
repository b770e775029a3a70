"""Every operation on skin: the same from the same, arguments left alone, curves that hold together."""

from __future__ import annotations

import numpy as np
import pytest
from knit_bodies import knit, wrapped

from nuno.plugin_contract import registry
from nuno_contact.body_shapes.leg import leg_mesh
from nuno_schemas.fabric import State
from nuno_schemas.operation import Outcome, Surface

INSTALLED = sorted(registry.installed("nuno.operations"))
OPERATIONS = [name for name in INSTALLED if name in ("pressure", "repair", "smooth", "untangle")]
"""Those that need no settings; lines are drawn in test_wrinkle.py, cloth is held in test_holding.py."""
X, FACES = leg_mesh(24)


def apply(name: str) -> tuple[Outcome, list[bytes], list[bytes]]:
    """An operation's outcome on a knit, and the bytes of its arguments before and after."""
    operation = registry.load("nuno.operations", name)
    fabric = knit("tube", 8, 15)
    points = wrapped(X, FACES, 16, 16, 0.1, 0.7, 0.13)
    state, skin = State(points.copy(), 0.0 * points, 0.0), Surface(X.copy(), FACES.copy())
    arrays = [state.x, state.v, skin.vertices, skin.faces, fabric.position]
    before = [array.tobytes() for array in arrays]
    made = operation.apply(operation.Config(), fabric, state, skin)
    return made, before, [array.tobytes() for array in arrays]


@pytest.mark.parametrize("name", OPERATIONS)
def test_arguments_are_left_alone_and_the_same_is_made_again(name: str) -> None:
    (first, before, after), (second, _, _) = apply(name), apply(name)
    assert before == after
    assert dict(first.facts) == dict(second.facts)
    if first.curves is not None and second.curves is not None:
        assert first.curves.points.tobytes() == second.curves.points.tobytes()


@pytest.mark.parametrize("name", OPERATIONS)
def test_curves_hold_together(name: str) -> None:
    made = apply(name)[0]
    curves = made.curves
    if curves is None:
        return
    n = len(curves.points)
    assert curves.points.shape == curves.normal.shape == (n, 3)
    assert np.isfinite(curves.points).all()
    assert curves.ptr[0] == 0 and curves.ptr[-1] == n and (np.diff(curves.ptr) >= 2).all()
    assert len(curves.radius) == len(curves.kind) == curves.number == len(curves.ptr) - 1
    assert set(curves.kind.tolist()) <= set(range(len(curves.names)))
    length = np.linalg.norm(curves.normal, axis=1)
    assert np.allclose(length, 1.0, atol=1e-12)
    assert all(len(values) == n for values in made.arrays.values())
    assert all(np.isfinite(value) for value in made.facts.values())
