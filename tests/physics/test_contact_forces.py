"""What bodies feel of cloth: its weight where it rests on them, whatever they are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml

from nuno.scene.scene_file import read
from nuno.simulation.run import Simulation
from nuno.simulation.service import feel
from nuno_schemas.messages import BodyContact

RADIUS, GRAVITY = 0.12, 9.81


def rest(folder: Path, solver: str | dict[str, Any], contact: str, shape: str = "sphere", **fields: Any) -> Simulation:
    """A square of 20 cm that lies on a body, after 2 s."""
    collider: dict[str, Any] = {"sphere": {"plugin": "sphere", "radius": RADIUS}}.get(shape, {"plugin": shape})
    if contact != "penalty":
        trimesh.creation.icosphere(3, RADIUS).export(folder / "ball.obj")
        collider = {"plugin": "mesh", "file": "ball.obj"}
    body = {"name": "ball", "collider": collider, "friction": 0.8}
    top = 0.0 if shape == "plane" else RADIUS
    model = {"plugin": "sheet", "size": [0.2, 0.2], "resolution": [9, 9], "plane": "xz", "centre": [0, top + 0.004, 0]}
    data = {
        "nuno": 1, "name": "rest", "duration": 2, "frame_rate": 30, "solver": solver, "damping": 4.0,
        "objects": [{"name": "cloth", "model": model | {"fabric": "interlock"}}],
        "bodies": [body | ({} if contact == "offset" else {"contact": {"plugin": contact}})],
    }  # fmt: skip
    if contact == "offset":
        data["cloth_contact"] = {"plugin": "offset", "bodies": ["ball"]}
    scene = folder / "rest.yaml"
    scene.write_text(yaml.safe_dump(data | fields))
    simulation = Simulation.with_bodies(read(scene), threads=1)
    while not simulation.finished:
        simulation.step()
    return simulation


def felt(simulation: Simulation) -> list[BodyContact]:
    return feel(simulation)[0].bodies


@pytest.mark.quick(solver=["symplectic_euler"])
@pytest.mark.parametrize(
    ("solver", "contact"),
    [
        ("symplectic_euler", "penalty"),
        ("symplectic_euler", "sliding"),
        ("symplectic_euler", "offset"),
        ("implicit_euler", "penalty"),
        ("implicit_euler", "sliding"),
        ("implicit_euler", "offset"),
        ("tr_bdf2", "sliding"),
        ("xpbd", "penalty"),
        ("xpbd", "sliding"),
        ("xpbd", "offset"),
        ("respa", "penalty"),
        ("respa", "offset"),
        ("respa", "sliding"),
        ("rk4", "penalty"),
    ],
)
def test_a_body_bears_the_weight_of_what_rests_on_it(tmp_path: Path, solver: str, contact: str) -> None:
    """Within 1 %, and its moment is that of the weight in the cloth's centre of mass."""
    simulation = rest(tmp_path, solver, contact)
    mass, x = simulation.fabric.mass, simulation.state.x
    weight = mass.sum() * np.array([0.0, -GRAVITY, 0.0])
    (ball,) = felt(simulation)
    assert np.abs(ball.force - weight).max() < 0.01 * np.abs(weight).max()
    moment = np.cross(x, mass[:, None] * np.array([0.0, -GRAVITY, 0.0])).sum(axis=0)
    assert np.abs(ball.torque - moment).max() < 0.01 * np.abs(weight).max() * RADIUS
    assert ball.attached == (0.0, 0.0, 0.0) and 0 < ball.vertices <= len(x)


@pytest.mark.quick(solver=["respa"])
@pytest.mark.parametrize("solver", ["symplectic_euler", "leapfrog", "respa"])
def test_what_hangs_from_a_body_by_impulses_presses_with_its_weight(tmp_path: Path, solver: str) -> None:
    """Over a thin rod each vertex bears that of 13, most of it by impulses."""
    turn = {"axis": [0, 0, 1], "angle": "90 deg"}
    collider = {"plugin": "mesh", "shape": "cylinder", "size": [0.03, 0.2, 0.03], "rounding": 0.01, "rotate": turn}
    fabric = {"density": 1.5, "warp": 100, "weft": 100, "shear": 10, "bend_warp": 1e-5, "bend_weft": 1e-5}
    strip = {"plugin": "sheet", "size": [0.06, 0.8], "resolution": [3, 27], "plane": "xz", "cells": "triangles"}
    model = strip | {"centre": [0, 0.02, 0], "fabric": fabric}
    simulation = rest(
        tmp_path, solver, "offset", objects=[{"name": "cloth", "model": model}], damping=8.0,
        bodies=[{"name": "ball", "collider": collider, "friction": 0.8}],
        cloth_contact={"plugin": "offset", "bodies": ["ball"], "thickness": 1e-3},
    )  # fmt: skip
    weight = simulation.fabric.mass.sum() * GRAVITY
    assert simulation.memory.arrays["push"].sum(axis=(0, 1))[1] > 0.5 * weight
    assert felt(simulation)[0].force[1] == pytest.approx(-weight, rel=0.01)


@pytest.mark.full
@pytest.mark.parametrize(("dt", "iterations"), [("auto", 3), ("1 ms", 1), ("4 ms", 1), ("4 ms", 5)])
def test_sweeps_that_end_before_springs_are_at_their_law_leave_the_weight(
    tmp_path: Path, dt: str, iterations: int
) -> None:
    """Whatever xpbd's step, 1 % of the weight: springs alone would say 3.6 times of it at 4 ms."""
    simulation = rest(tmp_path, {"plugin": "xpbd", "dt": dt, "iterations": iterations}, "sliding")
    weight = simulation.fabric.mass.sum() * np.array([0.0, -GRAVITY, 0.0])
    assert np.abs(np.array(felt(simulation)[0].force) - weight).max() < 0.01 * np.abs(weight).max()


def test_an_incline_is_pushed_and_dragged(tmp_path: Path) -> None:
    """Of cloth that sticks to a plane of 20 degrees: the weight as a whole, m g cos along the normal as pressure on
    its whole area, and no touch pulls.
    """
    slope = np.radians(20.0)
    gravity = [float(-GRAVITY * np.sin(slope)), float(-GRAVITY * np.cos(slope)), 0.0]
    simulation = rest(tmp_path, "symplectic_euler", "penalty", "plane", gravity=gravity)
    contact, touches = feel(simulation)
    (plane,), mass = contact.bodies, simulation.fabric.mass.sum()
    assert np.abs(plane.force - mass * np.array(gravity)).max() < 0.01 * mass * GRAVITY
    assert plane.vertices == simulation.fabric.number and plane.area == pytest.approx(0.04, rel=1e-3)
    assert plane.mean_pressure == pytest.approx(mass * GRAVITY * np.cos(slope) / 0.04, rel=0.01)
    assert plane.pressure == pytest.approx(touches["pressure"].max(), rel=1e-6)
    assert (touches["force"][:, 1] < 0.0).all()


def test_two_bodies_share_a_weight_and_each_has_its_own(tmp_path: Path) -> None:
    """A sheet across two balls: half of it each, of whatever kinds of contact; nothing on a third one far away."""
    trimesh.creation.icosphere(3, 0.05).export(tmp_path / "small.obj")
    mesh = {"plugin": "mesh", "file": "small.obj"}

    def ball(name: str, x: float, collider: dict[str, Any], contact: str | None) -> dict[str, Any]:
        motion = {"plugin": "keyframes", "times": [0], "positions": [[x, 0, 0]]}
        own = {} if contact is None else {"contact": {"plugin": contact}}
        return {"name": name, "collider": collider, "motion": motion, "friction": 0.8} | own

    sphere = {"plugin": "sphere", "radius": 0.05}
    kinds: list[list[tuple[dict[str, Any], str | None]]] = [
        [(sphere, "penalty"), (sphere, "penalty")],
        [(mesh, None), (mesh, None)],
        [(mesh, "sliding"), (mesh, "sliding")],
    ]  # fmt: skip
    for (left, one), (right, two) in kinds:
        bodies = [ball("left", -0.06, left, one), ball("right", 0.06, right, two), ball("far", 9.0, right, two)]
        met = [body["name"] for body in bodies if "contact" not in body]
        scene: dict[str, Any] = {"bodies": bodies, "duration": 1.5}
        if met:
            scene["cloth_contact"] = {"plugin": "offset", "bodies": met}
        model = {"plugin": "sheet", "size": [0.2, 0.2], "resolution": [11, 11], "plane": "xz", "centre": [0, 0.054, 0]}
        scene["objects"] = [{"name": "cloth", "model": model | {"fabric": "interlock"}}]
        simulation = rest(tmp_path, "symplectic_euler", "penalty", **scene)
        weight = simulation.fabric.mass.sum() * GRAVITY
        a, b, c = felt(simulation)
        assert a.force[1] + b.force[1] == pytest.approx(-weight, rel=0.01)
        assert a.force[1] == pytest.approx(b.force[1], rel=0.02)
        assert c.force == (0.0, 0.0, 0.0) and c.vertices == 0


def test_what_is_attached_pulls_at_its_body(tmp_path: Path) -> None:
    """A skirt on its body: its weight, all of it by the waist; what is held by nothing moves is felt by no body."""
    waist = {"plugin": "skirt", "waist_radius": 0.1, "hem_radius": 0.15, "length": 0.2, "columns": 32, "rows": 9,
             "attach": {"body": "ball", "frame": "body"}, "fabric": "interlock"}  # fmt: skip
    motion = {"plugin": "keyframes", "times": [0], "positions": [[0, 0, 0]]}
    ball = {"name": "ball", "collider": {"plugin": "sphere", "radius": 0.05}, "motion": motion}
    scene: dict[str, Any] = {"objects": [{"name": "skirt", "model": waist}], "bodies": [ball], "duration": 4}
    simulation = rest(tmp_path, "symplectic_euler", "penalty", **scene)
    (body,) = felt(simulation)
    weight = simulation.fabric.mass.sum() * GRAVITY
    assert body.vertices == 0 and body.attached == body.force
    assert body.force[1] == pytest.approx(-weight, rel=0.01) and abs(body.torque[0]) < 0.01 * weight * 0.1


@pytest.mark.quick(solver=["symplectic_euler"])
@pytest.mark.parametrize("solver", ["symplectic_euler", "implicit_euler", "respa", "xpbd"])
@pytest.mark.parametrize("contact", ["penalty", "sliding", "offset"])
def test_looking_changes_nothing(tmp_path: Path, solver: str, contact: str) -> None:
    """A run whose contact forces are found in each frame goes on in the same bits."""
    ends = []
    for looks in (False, True):
        simulation = rest(tmp_path, solver, contact, duration=0.1)
        for _ in range(3):
            if looks:
                feel(simulation)
            simulation.step()
        ends.append((simulation.digest(), [values.tobytes() for values in simulation.memory.arrays.values()]))
    assert ends[0] == ends[1]


@pytest.mark.quick(solver=["symplectic_euler"])
@pytest.mark.parametrize(
    ("solver", "contact"),
    [
        ("symplectic_euler", "penalty"),
        ("symplectic_euler", "sliding"),
        ("symplectic_euler", "offset"),
        ("implicit_euler", "sliding"),
        ("xpbd", "sliding"),
    ],
)
def test_the_same_is_felt_after_a_change_and_from_a_checkpoint(tmp_path: Path, solver: str, contact: str) -> None:
    """Whatever has been made anew: nothing of it has had a step yet."""
    simulation = rest(tmp_path, solver, contact, duration=0.5)
    before = felt(simulation)[0]
    assert before.force[1] < -0.01
    simulation.set("damping=4.0")
    point = simulation.keep()
    resumed = rest(tmp_path, solver, contact, duration=0.01)
    resumed.resume(point)
    for one in (simulation, resumed):
        assert np.abs(np.array(felt(one)[0].force) - before.force).max() < 1e-9


@pytest.mark.full
def test_a_knit_presses_on_its_cells_and_a_bare_net_on_nothing(tmp_path: Path) -> None:
    """Areas are a knit's cells; of points and springs alone no pressure is told."""
    knit = {"plugin": "knit", "form": "panel", "wales": 8, "courses": 8, "centre": [0, 0, RADIUS + 1e-4]}
    scene: dict[str, Any] = {"objects": [{"name": "knit", "model": knit}], "gravity": [0, 0, -GRAVITY], "duration": 0.1}
    simulation = rest(tmp_path, "symplectic_euler", "penalty", **scene)
    (ball,) = felt(simulation)
    assert ball.vertices and ball.area is not None and 0.0 < ball.area < 1.0
    assert ball.pressure is not None and ball.pressure > 0.0
    bare = replace(simulation.fabric, cells=None)
    simulation.fabric = bare
    (ball,) = felt(simulation)
    assert ball.vertices and ball.area is ball.pressure is ball.mean_pressure is None
