"""Cloth that bodies carry, take hold of and let go of while it moves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from nets import make_fabric, make_system, random_net, start

from nuno.scene.scene_file import read
from nuno.simulation.run import Simulation
from nuno_integrators.explicit.fixed_step import Euler, Leapfrog, SymplecticEuler
from nuno_integrators.explicit.runge_kutta import RK4
from nuno_schemas.bodies import Poses, rotation_matrices
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Springs
from nuno_schemas.system import Carried

GRAVITY = np.array([0.0, -9.81, 0.0])


def hand(**fields: Any) -> Simulation:
    """A sheet of 10 cm, falling, over a ball that moves along x and turns about y, with any field replaced."""
    motion = {
        "plugin": "keyframes",
        "times": [0, 1],
        "positions": [[0, 0, 0], [0.5, 0, 0]],
        "rotations": [[0, 0, 0], [0, 2, 0]],
    }
    model = {
        "plugin": "sheet",
        "size": [0.1, 0.1],
        "resolution": [5, 5],
        "plane": "xz",
        "centre": [0, 0.06, 0],
        "pin": [],
    }
    data = {
        "nuno": 1, "name": "hand", "duration": 0.5, "frame_rate": 50, "solver": "symplectic_euler",
        "objects": [{"name": "cloth", "model": model | {"fabric": "interlock"}}],
        "bodies": [{"name": "ball", "collider": {"plugin": "sphere", "radius": 0.05}, "motion": motion}],
    }  # fmt: skip
    folder = Path(fields.pop("folder"))
    (folder / "hand.yaml").write_text(yaml.safe_dump(data | fields))
    return Simulation.with_bodies(read(folder / "hand.yaml"), threads=1)


def local(simulation: Simulation) -> np.ndarray:
    """Where the vertices are in the ball's frame [m]."""
    poses = simulation.poses
    assert poses is not None
    return np.asarray((simulation.state.x - poses.translation[0]) @ rotation_matrices(poses.rotation)[0])


@pytest.mark.quick(solver=["symplectic_euler"])
@pytest.mark.parametrize("solver", ["symplectic_euler", "implicit_euler", "xpbd", "rk4"])
def test_what_is_attached_keeps_its_place_in_the_frame(tmp_path: Path, solver: str) -> None:
    """From the moment on at which it is taken, however the body moves and turns; the rest moves in it."""
    simulation = hand(folder=tmp_path, solver=solver)
    for _ in range(3):
        simulation.step()
    simulation.add("attach: {body: ball, within: 2 cm}")
    taken, start = np.flatnonzero(simulation.fabric.pinned), local(simulation)
    assert 0 < len(taken) < simulation.fabric.number
    for _ in range(10):
        simulation.step()
        assert np.abs(local(simulation) - start)[taken].max() < 1e-12
    free = ~simulation.fabric.pinned
    assert np.abs(local(simulation) - start)[free].max() > 1e-4


def test_vertices_of_a_merged_mesh_are_the_files_numbers(tmp_path: Path) -> None:
    """Also after a wrinkle, whose vertices have the numbers after those of the file."""
    corners = 0.1 * np.array([[0, 0.5, 0], [1, 0.5, 0], [1, 0.5, -1], [0, 0.5, 0], [1, 0.5, -1], [0, 0.5, -1]])
    lines = ["v {} {} {}".format(*corner) for corner in corners.tolist()]
    (tmp_path / "two.obj").write_text("\n".join([*lines, "f 1 2 3", "f 4 5 6"]))
    model = {"plugin": "mesh", "file": "two.obj", "merge": True, "fabric": "interlock", "tension": "springs"}
    simulation = hand(folder=tmp_path, objects=[{"name": "cloth", "model": model}])
    assert simulation.fabric.number == 4
    simulation.add("wrinkle: {lines: [{points: [[0.06, 0.05, 0], [0.06, 0.05, -0.1]], height: 5 mm}]}")
    added = simulation.fabric.number - 4
    assert added > 0
    simulation.add(f"attach: {{body: ball, vertices: [0, 3, 5, {5 + added}]}}")
    held = simulation.state.x[simulation.fabric.pinned]
    assert held.tolist() == [*corners[[0, 5]].tolist(), simulation.state.x[-1].tolist()]
    with pytest.raises(BadInput, match="held already") as caught:
        simulation.add("attach: {body: ball, vertices: [4, 3]}")
    assert caught.value.value == 3
    with pytest.raises(BadInput, match="no such vertex") as caught:
        simulation.add(f"release: {{vertices: [{6 + added}]}}")
    assert caught.value.limit == f"0 to {5 + added}"
    simulation.add("release: {vertices: [3]}")
    assert not (simulation.state.x[simulation.fabric.pinned] == corners[0]).all(axis=1).any()


def test_what_is_released_goes_on_as_it_was_carried_and_falls(tmp_path: Path) -> None:
    """Its centre of mass: in symplectic Euler's free fall, from the velocity that it had."""
    bodies = [{"name": "far", "collider": {"plugin": "sphere", "centre": [0, 9, 0], "radius": 0.1}}]
    simulation = hand(folder=tmp_path, bodies=bodies)
    for _ in range(2):
        simulation.step()
    simulation.add("attach: {body: far, vertices: [0, 1, 2]}")
    for _ in range(5):
        simulation.step()
    simulation.add("release: {body: far}")
    mass = simulation.fabric.mass / simulation.fabric.mass.sum()
    x, v = mass @ simulation.state.x, mass @ simulation.state.v
    for _ in range(5):
        simulation.step()
    steps, dt = 5 * simulation.steps, simulation.dt
    fallen = x + steps * dt * v + GRAVITY * dt**2 * steps * (steps + 1) / 2
    assert np.abs(mass @ simulation.state.x - fallen).max() < 1e-12


def test_a_scene_takes_and_lets_go_by_itself(tmp_path: Path) -> None:
    """At the times that it says, as is told; a checkpoint in between holds what is carried, and where."""
    operations = [
        {"plugin": "attach", "at": 0.1, "body": "ball", "within": 0.02},
        {"plugin": "release", "at": 0.3, "body": "ball"},
    ]
    simulation = hand(folder=tmp_path, operations=operations)
    held = []
    while not simulation.finished:
        simulation.step()
        held.append(int(simulation.fabric.pinned.sum()))
        if simulation.frame == 10:
            point = simulation.keep()
    assert held[4] == 0 and min(held[5:15]) > 0 and held[15:] == [0] * 10
    assert [(c["operation"], c["frame"]) for c in simulation.changes] == [("attach", 5), ("release", 15)]
    assert simulation.changes[0]["facts"]["vertices"] == held[5]
    resumed = hand(folder=tmp_path, operations=operations)
    resumed.resume(point)
    while not resumed.finished:
        resumed.step()
    assert resumed.digest() == simulation.digest()


@pytest.mark.parametrize(
    ("item", "message"),
    [
        ("attach: {body: bal}", "there is no such body.*\n.*bal.*\n.*did you mean 'ball'"),
        ("attach: {body: ball, frame: palm}", "ball has no such frame.*\n.*palm.*\n.*known: body"),
        ("attach: {body: ball, within: 1 km}", "within: out of range"),
        ("attach: {body: ball, within: 1 um}", "nothing of the cloth is within reach of ball"),
        ("attach: {body: ball, vertices: [3, 3]}", "named twice"),
        ("attach: {body: ball, vertices: [25]}", "no such vertex.*\n.*25.*\n.*0 to 24"),
        ("attach: {body: ball, vertices: []}", "no vertex is named"),
        ("attach: {body: ball, within: far}", "within: not a quantity"),
        ("attach: {body: ball, at: 1 s}", "applied at once"),
        ("release: {body: ball}", "nothing is attached to this body"),
        ("release: {vertices: [0]}", "this vertex is not held"),
        ("release: {}", "say what is let go of"),
        ("release: {body: null}", "say what is let go of"),
    ],
)  # fmt: skip
def test_what_cannot_be_held_or_let_go_of_is_named(tmp_path: Path, item: str, message: str) -> None:
    """And nothing is changed."""
    simulation = hand(folder=tmp_path)
    simulation.step()
    before = simulation.digest(), simulation.fabric
    with pytest.raises(BadInput, match=message):
        simulation.add(item)
    assert (simulation.digest(), simulation.fabric) == before


def test_what_is_held_is_not_taken_again(tmp_path: Path) -> None:
    """Not by another body either, whether it is named or within reach; reaching farther takes what is free."""
    simulation = hand(folder=tmp_path)
    simulation.add("attach: {body: ball, within: 2 cm}")
    first = simulation.fabric.pinned.copy()
    taken = int(np.flatnonzero(first)[0])
    with pytest.raises(BadInput, match=rf"held already\n *value: *{taken}\b"):
        simulation.add(f"attach: {{body: ball, vertices: [{taken}]}}")
    with pytest.raises(BadInput, match="all that is within reach of ball is held already"):
        simulation.add("attach: {body: ball, within: 2 cm}")
    simulation.add("attach: {body: ball, within: 4 cm}")
    assert simulation.fabric.pinned.sum() > first.sum() and len(simulation.fabric.bindings) == 2
    simulation.add(f"release: {{body: ball, vertices: [{taken}]}}")
    assert not simulation.fabric.pinned[taken] and simulation.fabric.pinned[first].sum() == first.sum() - 1


def test_lines_are_drawn_on_cloth_that_is_held(tmp_path: Path) -> None:
    """New vertices between held ones are held with them, between them; a checkpoint has them, too."""
    fabric = {"density": 0.2, "structural": 20.0, "bending": 1.0, "hinge": 1e-5, "damping_ratio": 0.05}
    model = {"plugin": "sheet", "size": [0.1, 0.1], "resolution": [7, 7], "plane": "xz", "centre": [0, 0.06, 0]}
    sheet = [{"name": "cloth", "model": model | {"cells": "triangles", "fabric": fabric}}]
    simulation = hand(folder=tmp_path, objects=sheet)
    simulation.add("attach: {body: ball, within: 3 cm}")
    simulation.step()
    before = simulation.fabric.number
    simulation.add("wrinkle: {lines: [{texture: [[0.2, 0.45], [0.8, 0.55]], height: 3 mm}]}")
    new = np.arange(before, simulation.fabric.number)
    held = new[simulation.fabric.pinned[new]]
    simulation.step()
    point, start = simulation.keep(), local(simulation)
    assert len(held) and np.abs(start[held, 1] - start[simulation.fabric.pinned, 1].mean()).max() < 0.02
    for _ in range(3):
        simulation.step()
    assert np.abs(local(simulation) - start)[held].max() < 1e-12
    resumed = hand(folder=tmp_path, objects=sheet)
    resumed.resume(point)
    for _ in range(3):
        resumed.step()
    assert resumed.digest() == simulation.digest()


@pytest.mark.full
def test_a_checkpoint_of_held_cloth_has_all_that_its_springs_have(tmp_path: Path) -> None:
    """Yarns that lock go on locking."""
    knit = {
        "plugin": "knit",
        "form": "panel",
        "wales": 6,
        "courses": 6,
        "yarns": [{"lock": 0.2, "ea": 5.0, "ea_lock": 50.0}],
        "centre": [0, 0.07, 0],
    }
    objects = [{"name": "cloth", "model": knit}]
    simulation = hand(folder=tmp_path, objects=objects, gravity=[0, 0, 0])
    assert simulation.fabric.springs is not None and simulation.fabric.springs.lock is not None
    simulation.add("attach: {body: ball, vertices: [0, 1]}")
    simulation.step()
    point = simulation.keep()
    resumed = hand(folder=tmp_path, objects=objects, gravity=[0, 0, 0])
    resumed.resume(point)
    for one in (simulation, resumed):
        for _ in range(3):
            one.step()
    assert resumed.digest() == simulation.digest()


METHODS = [Euler(), SymplecticEuler(), Leapfrog(), RK4()]


def about(axis: Float, angle: float) -> Float:
    unit = axis / np.linalg.norm(axis)
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * unit])


def spinning(t: float, rate: float, axis: Float, speed: Float) -> Poses:
    rotation = np.stack([about(np.array([0.0, 0.0, 1.0]), 0.0), about(axis, rate * t)])
    return Poses(t, rotation, np.stack([np.zeros(3), speed * t]))


@pytest.mark.quick(plugin=["symplectic_euler"])
@pytest.mark.parametrize("plugin", METHODS, ids=lambda p: p.name)
def test_bound_vertices_follow_their_frame(plugin: Any) -> None:
    axis, speed, rate = np.array([1.0, 2.0, -0.5]), np.array([0.3, 0.0, -0.2]), 1.7
    local = np.random.default_rng(1).standard_normal((3, 3))
    vertices = np.array([4, 0, 2], np.int32)
    position, springs = random_net(6, 12, 2)
    position[vertices] = local
    pinned = np.zeros(6, bool)
    pinned[vertices] = True
    carried = Carried(vertices, local, np.ones(3, np.int32))
    system = make_system(make_fabric(position, springs, mass=1.0, pinned=pinned), damping=0.5, carried=(carried,))
    state = start(system)
    memory = plugin.prepare(plugin.Config(), system, state)
    for frame in range(3):
        poses = spinning(0.2 * frame, rate, axis, speed), spinning(0.2 * (frame + 1), rate, axis, speed)
        plugin.advance(system, state, memory, poses, 20, 0.01)
        turned = local @ rotation_matrices(poses[1].rotation)[1].T
        spin = rate * axis / np.linalg.norm(axis)
        assert np.abs(state.x[vertices] - turned - poses[1].translation[1]).max() < 1e-13
        assert np.abs(state.v[vertices] - np.cross(spin, turned) - speed).max() < 1e-12


def test_stages_see_the_frame_where_it_is() -> None:
    """A mass on a spring whose other end moves at constant speed: order 4 survives."""
    omega, speed, duration, errors, counts = 3.0, 0.7, 1.0, [], (10, 20, 40, 80)
    springs = Springs.from_pairs(np.array([[0, 1]], np.int32), np.array([omega**2]), np.zeros(1), np.zeros(1))
    for count in counts:
        carried = Carried(np.array([0], np.int32), np.zeros((1, 3)), np.array([1], np.int32))
        fabric = make_fabric(np.zeros((2, 3)), springs, mass=1.0, pinned=np.array([True, False]))
        system = make_system(fabric, carried=(carried,))
        state, plugin = start(system), RK4()
        memory = plugin.prepare(plugin.Config(), system, state)
        still, move = np.array([0.0, 0.0, 1.0]), np.array([speed, 0.0, 0.0])
        poses = spinning(0.0, 0.0, still, move), spinning(duration, 0.0, still, move)
        plugin.advance(system, state, memory, poses, count, duration / count)
        errors.append(abs(state.x[1, 0] - speed * (duration - np.sin(omega * duration) / omega)))
    assert abs(-np.polyfit(np.log(counts), np.log(errors), 1)[0] - 4.0) < 0.1
