"""What plugins of other distributions hand over, held against its layout before compiled code sees it."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign_packages import Packages, packages
from scenes import BALL, write_scene

import nuno
from nuno.cli import main
from nuno.plugin_contract import registry
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Fabric, State
from nuno_schemas.plugin import Mover

__all__ = ["packages"]

GIVEN = """\
from dataclasses import replace
from nuno_kernels.terms import register
from typing import Annotated, NamedTuple
from nuno_schemas.bodies import *
from nuno_schemas.dye import *
from nuno_schemas.fabric import *
from nuno_schemas.operation import *
from nuno_schemas.plugin import *
from nuno_schemas.fabric import Yarns
class Typed(NamedTuple):
    at: Annotated[Float, "m", 3]
    k: float = 1.0
    of: Annotated[Int, "n"] | None = None
    also: Annotated[Float, "m"] = np.zeros(2)
register(Typed, name="typed", counts=lambda term: {{}})
class Unknown(NamedTuple):
    k: float
class Idle(NamedTuple):
    k: float
register(Idle, name="idle")
def cloth():
    x = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0, 0.1], [0.1, 0, 0.1]])
    pairs = np.array([[0, 1], [0, 2], [1, 3], [2, 3], [1, 2]], np.int32)
    springs = Springs.from_pairs(pairs, np.full(5, 10.0), np.full(5, 0.1), np.zeros(5))
    one = np.ones(1, np.int32)
    hinges = Hinges(np.array([[1, 2, 0, 3]], np.int32), one, one, np.ones(1), np.zeros(1))
    faces = np.array([[0, 1, 2], [1, 3, 2]], np.int32)
    pinned = np.array([True, False, False, False])
    return Fabric("own", x, np.zeros_like(x), np.full(4, 0.01), pinned, faces, springs, hinges)
def ball():
    at = np.zeros((1, 3))
    return BodyShape(("world",), np.zeros(1, np.int8), np.zeros(1, np.int32), at, at, np.full(1, 0.1))
def tetrahedron():
    x = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
    kind = np.full(1, MESH, np.int8)
    return replace(ball(), kind=kind, radius=np.zeros(1), vertices=x, faces=faces, owner=np.zeros(4, np.int32))
def mover():
    at = np.array([[1.0, 0, 0, 0]]), np.zeros((1, 3))
    return Mover(("a",), np.array([-1], np.int32), np.zeros((1, 3)), lambda t: at)
def yarns():
    return Yarns(np.array([0, 2], np.int32), np.array([0, 2], np.int32), np.full(1, 0.25), np.zeros(1, np.int8))
def cells():
    half, yes = np.full((2, 3, 4), 0.5), np.ones((2, 3, 4), bool)
    return Cells(yes, yes, half, half, 0 * half, 1e-4, Tortuosity(1, 1, 1, 1, 1, 1))
def amounts():
    return DyeState(np.zeros((1, 2, 3, 4)), np.zeros((1, 2, 3, 4)))
class Own:
    name = "own"
    Config = Config
    def {method}(self, *given):
        return {result}
"""

FABRIC = ("nuno.models", "build")
SPRINGS = "replace(cloth(), springs=replace(cloth().springs, {}))"
HINGES = "replace(cloth(), hinges=replace(cloth().hinges, {}))"
BODY, DRAWN = ("nuno.colliders", "build"), "replace(tetrahedron(), {})"
MOTION, FORCE, CLOTH = ("nuno.motions", "prepare"), ("nuno.forces", "prepare"), ("nuno.dye_cloths", "build")
TYPED = "Term('own', (Typed({}),))"
FAULTS: list[tuple[tuple[str, str], str, str]] = [
    (FABRIC, "None", "it is NoneType, not Fabric"),
    (FABRIC, SPRINGS.format("first=np.array([[0, 1], [0, 2], [1, 4], [2, 3], [1, 2]], np.int32)"),
     "springs.first is 4 at row 2, outside 0 to 3"),
    (FABRIC, SPRINGS.format("first=cloth().springs.first - 1"), "springs.first is -1 at row 0, outside 0 to 3"),
    (FABRIC, SPRINGS.format("count=np.array([1, 1, 1, 3, 1], np.int32)"), "springs of run 3 go on to vertex 4"),
    (FABRIC, SPRINGS.format("first=np.zeros((5, 2), np.int32)"), "springs.first names a vertex twice at row 0"),
    (FABRIC, SPRINGS.format("first=cloth().springs.first.astype(int)"),
     "springs.first is int64 (5, 2), not int32 (n, 2)"),
    (FABRIC, SPRINGS.format("k=np.array([1.0, 1, -1, 1, 1])"), "springs.k is -1.0 at row 2, less than 0"),
    (FABRIC, SPRINGS.format("k=np.full(5, np.nan)"), "springs.k is nan at row 0"),
    (FABRIC, SPRINGS.format("k=np.ones(3)"), "springs.k is float64 (3,), not float64 (5,)"),
    (FABRIC, SPRINGS.format("c=np.ones(10)[::2]"), "springs.c is not C-contiguous: give numpy.ascontiguousarray of it"),
    (FABRIC, SPRINGS.format("lock=np.ones(5)"), "springs.lock and springs.k_lock are not both given"),
    (FABRIC, SPRINGS.format("lock=np.ones(5), k_lock=np.ones(5)"),
     "springs.k_lock is 1.0 at spring 0, less than its k"),
    (FABRIC, HINGES.format("first=np.array([[1, 2, 0, -1]], np.int32)"), "hinges.first is -1 at row 0, outside 0 to 3"),
    (FABRIC, HINGES.format("k=np.full(1, -1.0)"), "hinges.k is -1.0 at row 0, less than 0"),
    (FABRIC, "replace(cloth(), faces=cloth().faces + 1)", "faces is 4 at row 1, outside 0 to 3"),
    (FABRIC, "replace(cloth(), cells=np.array([[0, 1, 3, 7]], np.int32))", "cells is 7 at row 0, outside 0 to 3"),
    (FABRIC, "replace(cloth(), mass=np.zeros(4))", "mass is 0.0 at row 0, not above 0"),
    (FABRIC, "replace(cloth(), position=np.zeros((3, 4)).T)", "position is not C-contiguous"),
    (FABRIC, "replace(cloth(), velocity=np.full((4, 3), np.inf))", "velocity is inf at row 0"),
    (FABRIC, "replace(cloth(), pinned=np.zeros(4))", "pinned is float64 (4,), not bool (4,)"),
    (FABRIC, "replace(cloth(), uv=np.zeros((4, 2)))", "uv is float64 (4, 2), not float32 (4, 2)"),
    (FABRIC, "replace(cloth(), bindings=(Binding(np.array([9], np.int32), 'b', 'f'),))",
     "bindings[0].vertices is 9 at row 0, outside 0 to 3"),
    (FABRIC, "replace(cloth(), bindings=(Binding(np.array([1], np.int32), 'b', 'f'),))", "some that are not pinned"),
    (FABRIC, "replace(cloth(), yarns=replace(yarns(), links=np.array([0, 5], np.int32)))",
     "yarns.links is 5 at row 1, outside 0 to 4"),
    (FABRIC, "replace(cloth(), yarns=replace(yarns(), mu=np.full(1, 0.5)))", "yarns.mu is 0.5 at row 0, outside 0"),
    (BODY, "replace(ball(), radius=np.full(1, np.nan))", "radius is nan at row 0"),
    (BODY, "replace(ball(), radius=np.zeros(1))", "radius is not above 0 at row 0"),
    (BODY, "replace(ball(), frame=np.ones(1, np.int32))", "frame is 1 at row 0, outside 0 to 0"),
    (BODY, "replace(ball(), frames=('world', 'hips'))", "frames are 2, of a motion of 1"),
    (BODY, "replace(ball(), kind=np.full(1, 9, np.int8))", "kind is 9 at row 0, outside 0 to 5"),
    (BODY, "replace(ball(), kind=np.full(1, SKIN, np.int8))", "skins are 0, of 1 primitives that have one"),
    (BODY, "replace(ball(), pose=print)", "pose is one of a body without a motion"),
    (BODY, "replace(ball(), kind=np.full(1, PLANE, np.int8))", "b is no unit normal at row 0"),
    (BODY, "replace(ball(), kind=np.full(1, FIELD, np.int8))", "fields are 0, of 1 primitives that have one"),
    (BODY, DRAWN.format("faces=tetrahedron().faces + 1"), "faces is 4 at row 1, outside 0 to 3"),
    (BODY, DRAWN.format("owner=np.ones(4, np.int32)"), "owner is 1 at row 0, outside 0 to 0"),
    (MOTION, "replace(mover(), parents=np.zeros(1, np.int32))", "parents is 0 at row 0, which does not come before it"),
    (FORCE, "Term('python', add, omega_squared=np.nan) if (add := print) else 0", "omega_squared is nan"),
    (FORCE, "Term('python', add, damping_rate=-1.0) if (add := print) else 0", "damping_rate is -1.0, less than 0"),
    (FORCE, "Term('python', 3)", "data is int, neither a tuple of named tuples nor a function f(x, v, t, out)"),
    (FORCE, "Term('wind', (np.zeros(3),))", "data is tuple, neither a tuple of named tuples"),
    (FORCE, TYPED.format("np.zeros(3)"), "data[0].at is float64 (3,), not float64 (n, 3)"),
    (FORCE, TYPED.format("np.zeros((2, 3), int)"), "data[0].at is int64 (2, 3), not float64 (n, 3)"),
    (FORCE, TYPED.format("np.array([[0, 0, 0], [0, np.nan, 0]])"), "data[0].at is nan at row 1"),
    (FORCE, TYPED.format("np.zeros((2, 3)), np.inf"), "data[0].k is inf"),
    (FORCE, TYPED.format("np.zeros((2, 3)), 1.0, np.zeros(3, np.int32)"), "data[0].of is int32 (3,), not int32 (4,)"),
    (FORCE, TYPED.format("np.zeros((2, 3)), (1.0, 2.0)"), "data[0].k is tuple, no number"),
    (FORCE, "Term('own', (Unknown(1.0),))", "data[0] is of type Unknown, which has no kernels"),
    (FORCE, "Term('own', (Idle(1.0),))", "data[0] is of type Idle, which has no kernels, and so does nothing"),
    (CLOTH, "(replace(cells(), porosity=2 * np.ones((2, 3, 4))), amounts())",
     "cells.porosity is 2.0 at row 0, outside 0 to 1"),
    (CLOTH, "(cells(), DyeState(np.zeros((2, 3, 4)), np.zeros((2, 3, 4))))",
     "phi is float64 (2, 3, 4), not float64 (1, 2, 3, 4)"),
    (("nuno.integrators", "limit"), "StepLimit(np.nan, 1.0, 0.0)", "dt is nan"),
    (("nuno.integrators", "advance"), "StepReport('fine', 1)",
     "status is 'fine', not ok, diverged, unconverged or left"),
    (("nuno.renderers", "render"), "np.zeros((4, 5, 3))", "it is float64 (4, 5, 3), not uint8 (n, n, 3)"),
    (("nuno.isotherms", "prepare"), "Isotherm('partition', -1.0)", "first is -1.0, less than 0"),
]  # fmt: skip
GOOD = [
    (FABRIC, "cloth()"),
    (FABRIC, "replace(cloth(), yarns=yarns(), bindings=(Binding(np.zeros(1, np.int32), 'b', 'f'),))"),
    (BODY, "ball()"),
    (BODY, "tetrahedron()"),
    (MOTION, "mover()"),
    (FORCE, "Term('python', print)"),
    (FORCE, TYPED.format("np.zeros((2, 3)), 2, np.zeros(4, np.int32)")),
    (CLOTH, "(cells(), amounts())"),
    (("nuno.integrators", "limit"), "StepLimit(np.inf, 1.0, 0.0)"),
    (("nuno.isotherms", "prepare"), "Isotherm('partition', 1.0)"),
]


def give(packages: Packages, place: tuple[str, str], result: str) -> Any:
    """What a foreign plugin's method gives."""
    group, method = place
    packages.add("given", GIVEN.format(method=method, result=result), "own = given:Own", group=group)
    x = np.zeros((4, 3))
    fabric = Fabric("own", x, x, np.ones(4), np.zeros(4, bool), np.zeros((0, 3), np.int32))
    arguments = {
        "nuno.dye_cloths": (None, None, 0, ["dye"]),
        "nuno.colliders": (None, None, None),
        "nuno.forces": (None, fabric, 0),
    }.get(group, (None, None, 0))
    return getattr(registry.load(group, "own"), method)(*arguments)


@pytest.mark.parametrize(("place", "result", "words"), FAULTS)
def test_what_is_amiss_is_named_with_plugin_and_field(
    packages: Packages, place: tuple[str, str], result: str, words: str
) -> None:
    with pytest.raises(RunFailed) as failure:
        give(packages, place, result)
    said = str(failure.value)
    assert said.startswith(f"the plugin 'own' of given 1.2 in {place[0]}: {place[1]} gives ")
    assert words in said


@pytest.mark.parametrize(("place", "result"), GOOD)
def test_what_is_right_is_taken(packages: Packages, place: tuple[str, str], result: str) -> None:
    assert give(packages, place, result) is not None


def test_a_turn_that_is_no_rotation_is_named(packages: Packages) -> None:
    wrong = "replace(mover(), pose=lambda t: (np.array([[1.0, t, 0, 0]]), np.zeros((1, 3))))"
    found: Mover = give(packages, MOTION, wrong)
    found.pose(0.0)
    with pytest.raises(
        RunFailed, match=r"the plugin 'own' of given 1\.2.*at 1 s: rotation has length 1.41421 at row 0"
    ):
        found.pose(1.0)


def test_an_operation_that_loses_the_order_of_vertices_is_named(packages: Packages) -> None:
    made = "Outcome({}, changed=Changed(given[1], given[2], np.array([0, 2, 1, 3], np.int32)))"
    code = GIVEN.format(method="apply", result=made)
    packages.add("given", code, "own = given:Own", group="nuno.operations")
    plugin = registry.load("nuno.operations", "own")
    import given  # type: ignore[import-not-found]

    fabric: Fabric = given.cloth()
    with pytest.raises(RunFailed, match=r"changed\.source does not keep the order of the old vertices"):
        plugin.apply(None, fabric, State(fabric.position, fabric.velocity), None)


@pytest.mark.parametrize(
    ("place", "result", "words"),
    [
        (FABRIC, "replace(cloth(), position=1000.0 * cloth().position)", "position comes to 141 m, 0.001 to 100 m"),
        (FABRIC, "replace(cloth(), mass=np.full(4, 1e4))", "mass comes to 4e+04 kg"),
        (BODY, "replace(ball(), radius=np.full(1, 100.0))", "radius comes to 200 m"),
        (CLOTH, "(replace(cells(), size=0.5), amounts())", "cells.size"),
    ],
)
def test_a_size_in_another_unit_is_doubted(
    packages: Packages, caplog: pytest.LogCaptureFixture, place: tuple[str, str], result: str, words: str
) -> None:
    with caplog.at_level(logging.WARNING, "nuno.plugins"):
        give(packages, place, result)
    (said,) = (record.getMessage() for record in caplog.records)
    assert "the plugin 'own' of given 1.2" in said and words in said


def test_a_run_is_refused_before_compiled_code_reads_beyond_an_array(
    packages: Packages, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = SPRINGS.format("first=cloth().springs.first + np.int32(10**8)")
    code = GIVEN.format(method="build", result=wrong) + "    def count(self, *given):\n        return 4\n"
    packages.add("given", code, "own = given:Own", group="nuno.models")
    scene = write_scene(tmp_path, objects=[{"name": "net", "model": {"plugin": "own"}}], duration=0.1)
    assert main(["run", str(scene), "--no-view", "--record", str(tmp_path / "run.mcap")]) == 1
    assert "springs.first is 100000000 at row 0, outside 0 to 3" in capsys.readouterr().err


def test_the_projects_own_plugins_hand_over_what_they_owe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All of them looked at as foreign ones are, to the same bits."""
    scene = write_scene(tmp_path, bodies=BALL, forces=[{"plugin": "particle_wind", "strength": 1e-3}], duration=0.1)
    digest = nuno.run(scene).digest
    monkeypatch.setattr(registry, "is_own", lambda point: False)
    assert nuno.run(scene).digest == digest
