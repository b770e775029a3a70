"""Sliding contact: nothing enters a mesh; Coulomb's friction at any step; momentum is kept; steps of a frame."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import closed_meshes as meshes
import numpy as np
import pytest
import trimesh
import yaml
from scipy.spatial import Delaunay
from sliding_world import GAP, G, World, body, loose

from nuno.collision.distance import penetration, signed_distance
from nuno.scene.scene_file import read
from nuno.simulation.run import Simulation
from nuno.simulation.service import feel
from nuno_contact.sliding.grip import hold_forces
from nuno_contact.sliding.plugin import Sliding, SlidingBody, SlidingConfig, make_slides
from nuno_geometry.tree import build_tree
from nuno_schemas.bodies import FIELD, MESH, Poses
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Int, Springs


def turned(angle: float, axis: tuple[float, float, float]) -> Float:
    return np.array([[math.cos(0.5 * angle), *(math.sin(0.5 * angle) * np.asarray(axis))]])


METHODS = ["symplectic_euler", "respa", "leapfrog", "rk4", "dopri5", "implicit_euler", "tr_bdf2", "xpbd"]


@pytest.mark.quick(name=["symplectic_euler"])
@pytest.mark.parametrize("name", METHODS)
def test_sticks_and_slides_on_an_incline_as_coulomb_says(name: str) -> None:
    """None below tan alpha = mu, else g (sin alpha - mu cos alpha) t^2 / 2, at two steps."""
    mu = 0.4
    start = np.array([[-5.0, 1.0 + GAP, z] for z in (-0.4, 0.1, 0.3)])
    for share in (0.98, 1.5):
        alpha = math.atan(share * mu)
        gravity = G * np.array([math.sin(alpha), -math.cos(alpha), 0.0])
        for steps, dt in ((100, 2e-3), (10, 2e-2)):
            world = World(loose(start), body(meshes.box((20.0, 2.0, 2.0)), mu), gravity, name)
            world.go(steps, dt)
            t = steps * dt
            pull = G * (math.sin(alpha) - mu * math.cos(alpha))
            moved, expected = world.state.x[2] - start[2], max(0.0, 0.5 * pull * t * t)
            first_order = name in ("symplectic_euler", "respa", "implicit_euler", "xpbd")
            assert abs(moved[0] - expected) <= 1e-9 + (0.51 * max(pull, 0.0) * t * dt if first_order else 0.0)
            # No step falls through a part of the gap, in which it would feel no friction.
            assert abs(moved[1]) <= 1e-6 * GAP and abs(moved[2]) < 1e-12
            assert world.state.v[2] == pytest.approx([max(0.0, pull * t), 0.0, 0.0], abs=1e-9)


@pytest.mark.quick(name=["symplectic_euler"])
@pytest.mark.parametrize("name", ["symplectic_euler", "leapfrog", "rk4", "dopri5", "xpbd"])
def test_a_throw_up_an_incline_feels_friction_at_every_step_however_short(name: str) -> None:
    """Up at g (sin alpha + mu cos alpha), back at the difference: off by the step in which it turns round. In one of
    these it falls by 5e-10 m, a hundred-millionth of the gap, and no fall is so small that it is not pressed on.
    """
    mu, alpha, gap, speed, steps, dt = 0.3, math.radians(60.0), 0.05, 2.0, 30_000, 1e-5
    start = np.array([[3.0, 1.0 + gap, z] for z in (0.1, 0.3)])
    thrown = np.tile([-speed, 0.0, 0.0], (2, 1))
    gravity = G * np.array([math.sin(alpha), -math.cos(alpha), 0.0])
    world = World(loose(start, thrown), body(meshes.box((20.0, 2.0, 2.0)), mu), gravity, name, gap)
    world.go(steps, dt)
    rising, grip = speed / (G * (math.sin(alpha) + mu * math.cos(alpha))), mu * G * math.cos(alpha)
    expected = (G * math.sin(alpha) - grip) * (steps * dt - rising)
    assert np.abs(world.state.v[:, 0] - expected).max() < 2.01 * grip * dt
    assert np.abs(world.state.x[:, 1] - start[:, 1]).max() < 1e-12 and np.abs(world.state.v[:, 1]).max() < 1e-9


@pytest.mark.parametrize("share", [0.9, 0.99, 1.0, 1.01])
def test_friction_holds_a_force_by_what_presses_wherever_the_vertex_rests(share: float) -> None:
    """mu N of it, and not by more where it lies nearer than the gap, nor by less where it lies a little farther."""
    world = World(loose(np.array([[0.1, 1.0 + share * GAP, 0.2]])), body(meshes.box((2.0, 2.0, 2.0)), 0.4), np.zeros(3))
    world.go(0, 1e-3)
    for pull, left in ((0.3, 0.0), (0.5, 0.1)):
        force = np.array([[0.6 * pull], [-1.0], [0.8 * pull]])
        hold_forces(world.slides, world.memory.work.x, force)
        assert force[:, 0] == pytest.approx([0.6 * left, 0.0, 0.8 * left], abs=1e-5)


def net(n: int, size: float, at: Float, k: float) -> Fabric:
    """A square net of springs, flat, about `at`."""
    i, j = np.divmod(np.arange(n * n), n)
    x = np.stack([(j / (n - 1) - 0.5) * size, 0 * i, (i / (n - 1) - 0.5) * size], axis=-1) + at
    right, down = np.flatnonzero(j < n - 1), np.flatnonzero(i < n - 1)
    pairs = np.concatenate([np.stack([right, right + 1], 1), np.stack([down, down + n], 1)]).astype(np.int32)
    rest = np.full(len(pairs), size / (n - 1))
    springs = Springs.from_pairs(pairs, np.full(len(pairs), k), rest, np.full(len(pairs), 0.02))
    return replace(loose(x, mass=1e-3), springs=springs)


@pytest.mark.parametrize("damping", [0.0, 0.02])
def test_what_is_pressed_against_a_body_stands_still_and_so_does_what_presses(damping: float) -> None:
    """Held off after its step only, it would be inside where forces are found, and shake what hangs on it."""
    x = np.array([[0.0, 1.0 + GAP + height, 0.0] for height in (0.0, 0.02, 0.04)])
    pressed = Springs.from_pairs(
        np.array([[0, 1], [1, 2]], np.int32), np.full(2, 60.0), np.full(2, 0.03), np.full(2, damping)
    )
    cloth = replace(loose(x, mass=1e-4), springs=pressed, pinned=np.array([False, False, True]))
    world = World(cloth, body(meshes.box((2.0, 2.0, 2.0)), 0.4), np.zeros(3), "leapfrog")
    world.go(200, 3e-4)
    assert np.abs(world.state.v).max() < 1e-10 and np.abs(world.state.x - x).max() < 1e-12


@pytest.mark.quick(name=["symplectic_euler"])
@pytest.mark.parametrize("name", ["symplectic_euler", "implicit_euler"])
def test_cloth_never_enters_a_ring_that_turns_and_flies_up_through_it(name: str) -> None:
    mesh = meshes.torus(48, 20, 0.2, 0.07)
    world = World(net(24, 0.8, np.array([0.0, 0.15, 0.0]), 20.0), body(mesh, 0.2), np.array([0.0, -G, 0.0]), name)
    touched = 0
    for frame in range(30):
        at = [Poses(t, turned(9.0 * t, (0.6, 0.8, 0.0)), np.array([[0.0, 1.5 * t, 0.3 * t]])) for t in
              (frame / 60, (frame + 1) / 60)]  # fmt: skip
        world.go(8, 1 / 480, *at)
        assert penetration(world.state.x, world.geometry, at[1]).max() == 0.0
        assert signed_distance(world.state.x[::7], world.geometry, at[1]).min() > 0.5 * GAP
        touched = max(touched, int(world.slides.tally[:, 0].sum()))
    assert touched > 50


def test_fast_points_do_not_pass_through_a_thin_plate() -> None:
    """At 100 m/s a step is a thousand times the thickness; one in a corner between the plate and itself included."""
    rng = np.random.default_rng(0)
    plate = meshes.box((1.0, 1e-4, 1.0))
    x = rng.uniform(-0.45, 0.45, (300, 3)) * [1, 0, 1] + [0, 0.11, 0]
    v = np.tile([3.0, -100.0, 1.0], (300, 1)) + rng.normal(size=(300, 3))
    world = World(loose(x, v), body(plate), np.zeros(3))
    world.go(20, 1e-3)
    assert world.state.x[:, 1].min() >= 0.5e-4 + 0.5 * GAP
    assert np.abs(world.state.x[:, [0, 2]] - (x + 0.02 * v)[:, [0, 2]]).max() < 1e-12


def groove(half_angle: float) -> tuple[Float, Int]:
    """A block whose upper side is a valley along z."""
    x, faces = meshes.box((2.0, 4.0, 8.0))
    depth = 1.0 / math.tan(half_angle)
    rim = np.array([[0.0, 2.0 - depth, z] for z in (-4.0, 4.0)])
    outline = np.array([[-1.0, -2.0 - depth], [1.0, -2.0 - depth], [1.0, 2.0], [0.0, 2.0 - depth], [-1.0, 2.0]])
    x = np.concatenate([np.column_stack([outline, np.full(5, z)]) for z in (-4.0, 4.0)])
    sides = [[i, (i + 1) % 5, 5 + (i + 1) % 5, 5 + i] for i in range(5)]
    faces = [[q[0], q[1], q[2]] for q in sides] + [[q[0], q[2], q[3]] for q in sides]
    ends = [[0, 3, 4], [0, 1, 3], [1, 2, 3]]
    faces += [[c, b, a] for a, b, c in ends] + [[5 + a, 5 + b, 5 + c] for a, b, c in ends]
    assert np.allclose(x[[3, 8]], rim)
    return meshes.outward(x, np.array(faces, np.int32))


@pytest.mark.parametrize("half_angle", [0.2, 0.6, 1.2])
def test_slides_along_a_valley_on_both_of_its_sides(half_angle: float) -> None:
    """N = m g cos(alpha) / sin(half angle) in all, from both sides: friction is mu N against the fall along it."""
    mu, alpha = 0.1, 0.7
    x, faces = groove(half_angle)
    bottom = x[3, 1] + GAP / math.sin(half_angle)
    gravity = G * np.array([0.0, -math.cos(alpha), math.sin(alpha)])
    world = World(loose(np.array([[0.0, bottom, -3.0]])), body((x, faces), mu), gravity)
    world.go(500, 1e-3)
    pull = G * (math.sin(alpha) - mu * math.cos(alpha) / math.sin(half_angle))
    assert world.state.v[0, 2] == pytest.approx(0.5 * pull, rel=1e-6)
    assert np.abs(world.state.x[0, :2] - [0.0, bottom]).max() < 0.1 * GAP


def test_slides_down_a_finer_sphere_as_down_the_true_one() -> None:
    """The way is off by an edge's length (the distance by its square, tests of the closest point say): at every edge a
    landing loses the square of the angle that it turns by, and there are as many as edges are short.
    """
    errors = []
    for rings in (24, 48, 96):
        angle = 0.3 + 2 * np.pi * np.arange(40) / 40
        start = np.stack([math.sin(0.2) * np.cos(angle), np.full(40, math.cos(0.2)), math.sin(0.2) * np.sin(angle)], 1)
        ball = meshes.sphere(rings)
        world = World(loose(start * (1.0 + GAP)), body(ball), np.array([0.0, -G, 0.0]))
        world.go(600, 1e-3)
        theta = np.arctan2(np.hypot(*world.state.x[:, [0, 2]].T), world.state.x[:, 1])
        t, exact = 0.0, [0.2, 0.0]
        for _ in range(6000):
            exact[1] += 1e-4 * G * math.sin(exact[0])
            exact[0] += 1e-4 * exact[1]
            t += 1e-4
        errors.append(float(np.abs(theta - exact[0]).mean()))
    assert np.all(np.log2(np.array(errors[:-1]) / errors[1:]) > 0.7), errors


@pytest.mark.quick(name=["symplectic_euler"])
@pytest.mark.parametrize(("name", "left"), [("symplectic_euler", 1e-12), ("implicit_euler", 1e-3)])
def test_what_the_body_is_given_the_cloth_has_lost(name: str, left: float) -> None:
    """To rounding, or to the residual of an implicit step."""
    fabric = net(12, 0.6, np.array([0.02, 0.16, 0.01]), 10.0)
    world = World(fabric, body(meshes.sphere(16, 0.15), 0.3), np.array([0.0, -G, 0.0]), name)
    end = Poses(0.25, turned(2.0, (0.0, 0.6, 0.8)), np.array([[0.1, 0.2, 0.0]]))
    world.go(250, 1e-3, None, end)
    given = world.slides.impulse.sum(axis=(0, 1))
    weight = world.system.fabric.mass.sum() * world.system.gravity * 0.25
    assert np.abs(given).min() > 1e-3
    assert np.abs(1e-3 * world.state.v.sum(axis=0) - (weight - given)).max() < left * np.abs(weight).max()


@pytest.mark.full
def test_threads_and_frames_change_no_bit() -> None:
    fabric = net(80, 0.6, np.array([0.0, 0.17, 0.0]), 5.0)
    found = []
    for threads, pieces in ((1, 4), (2, 4), (1, 1)):
        world = World(fabric, body(meshes.sphere(24, 0.15), 0.3), np.array([0.0, -G, 0.0]))
        world.system = replace(world.system, threads=threads)
        world.memory = world.plugin.prepare(world.plugin.Config(), world.system, world.state)
        for _ in range(pieces):
            world.go(80 // pieces, 1e-3)
        found.append(world.state.x.tobytes() + world.state.v.tobytes())
    assert found[0] == found[1]
    assert np.frombuffer(found[0]) == pytest.approx(np.frombuffer(found[2]), abs=1e-9)


def test_each_of_several_bodies_keeps_a_tree_of_its_own() -> None:
    """A search goes up from where a vertex was nearest, and must not come to another body's root."""
    trees = [build_tree(*meshes.torus(9 * k, 7)) for k in (1, 4, 2)]
    slides = make_slides([SlidingBody(tree, 0, 0.0, GAP) for tree in trees], 1, np.ones(3))
    ends = [*slides.root[1:], len(slides.tree.child)]
    leaf = 0
    for tree, root, end in zip(trees, slides.root, ends, strict=True):
        for node in slides.tree.leaf_parent[leaf : leaf + len(tree.leaf_parent)]:
            while slides.tree.parent[node] >= 0:
                assert root <= node < end
                node = slides.tree.parent[node]
            assert node == root
        leaf += len(tree.leaf_parent)
    assert leaf == len(slides.tree.leaf_parent)


def test_a_distance_field_is_slid_on_by_its_triangles() -> None:
    found = []
    for kind in (MESH, FIELD):
        shape = replace(body(meshes.sphere(24, 0.15), 0.3), kind=np.array([kind], np.int8))
        world = World(net(24, 0.6, np.array([0.0, 0.17, 0.0]), 5.0), shape, np.array([0.0, -G, 0.0]))
        world.go(80, 1e-3)
        assert world.slides.tally[:, 0].sum() > 5
        found.append(world.state.x.tobytes() + world.state.v.tobytes())
    assert found[0] == found[1]


def test_what_is_no_closed_mesh_is_refused_by_name() -> None:
    whole = body(meshes.box((1, 1, 1)))
    refused = (
        (replace(whole, kind=np.zeros(1, np.int8)), "is with meshes", "penalty"),
        (replace(whole, kind=np.array([FIELD], np.int8), faces=whole.faces[1:], owner=whole.owner[1:]),
         "closed meshes, and the mesh has a hole", "bodies: [body]"),
    )  # fmt: skip
    for geometry, problem, remedy in refused:
        with pytest.raises(BadInput, match=problem) as error:
            Sliding().prepare(SlidingConfig(), loose(np.ones((1, 3))), geometry, np.zeros(3))
        assert error.value.field == "body" and remedy in str(error.value.remedy)


GRAVITY, WIDE_GAP, MU = 9.81, 1e-3, 0.5
FRAME, QUARTER = "16.6666667 ms", "4.1666667 ms"


def made(folder: Path, shape: trimesh.Trimesh, solver: dict[str, Any], cloth: dict[str, Any], **fields: Any) -> Any:
    """A cloth and a body of a triangle mesh, before the first frame."""
    shape.export(folder / "body.obj")
    own = {"name": "body", "collider": {"plugin": "mesh", "file": "body.obj"}, "friction": MU}
    own |= {"contact": {"plugin": "sliding", "gap": WIDE_GAP}} | fields.pop("body", {})
    data = {"nuno": 1, "name": "rest", "duration": 3, "frame_rate": 60, "solver": solver, "bodies": [own]}
    scene = folder / "scene.yaml"
    scene.write_text(yaml.safe_dump(data | {"objects": [{"name": "cloth", "model": cloth}]} | fields))
    return Simulation.with_bodies(read(scene), threads=1)


def sheet(size: float, points: int, height: float, **more: Any) -> dict[str, Any]:
    grid = {"plugin": "sheet", "size": [size, size], "resolution": [points, points], "plane": "xz"}
    return grid | {"centre": [0.003, height, 0.002], "fabric": "interlock"} | more


def triangles(folder: Path, size: float, points: int, height: float) -> dict[str, Any]:
    """The same of triangles in no order."""
    random = np.random.default_rng(7)
    edge = np.linspace(-0.5, 0.5, points)
    x = np.stack(np.meshgrid(edge, edge), axis=-1).reshape(-1, 2)
    inner = (np.abs(x) < 0.49).all(axis=1)
    x[inner] += random.uniform(-0.3, 0.3, (int(inner.sum()), 2)) / (points - 1)
    places = np.insert(size * x, 1, height, axis=1)
    trimesh.Trimesh(places, Delaunay(x).simplices, process=False).export(folder / "cloth.obj")
    return {"plugin": "mesh", "file": "cloth.obj", "fabric": "interlock"}


def kinetic(simulation: Simulation) -> float:
    return float(0.5 * (simulation.fabric.mass[:, None] * simulation.state.v**2).sum())


@pytest.mark.full
@pytest.mark.parametrize("kind", ["grid", "triangles"])
@pytest.mark.parametrize("dt", [FRAME, QUARTER])
@pytest.mark.parametrize("name", ["implicit_euler", "tr_bdf2"])
def test_a_sheet_comes_to_rest_on_a_ball(tmp_path: Path, name: str, dt: str, kind: str) -> None:
    """It stays there, its motion dies away, and the ball feels its weight within 1 %."""
    radius = 0.1
    cloth = sheet(0.3, 13, radius + 0.004) if kind == "grid" else triangles(tmp_path, 0.3, 13, radius + 0.004)
    ball = trimesh.creation.icosphere(3, radius)
    simulation = made(tmp_path, ball, {"plugin": name, "dt": dt}, cloth, damping=2.0)
    mass = simulation.fabric.mass
    weight, moving = float(mass.sum()) * GRAVITY, []
    while not simulation.finished:
        simulation.step()
        moving.append(kinetic(simulation))
        assert np.linalg.norm(simulation.state.x, axis=1).min() > 0.98 * radius, "facets lie inside of the ball"
    # A thousandth of the energy of a fall by a millimetre.
    assert max(moving[-30:]) < 1e-3 * weight * 1e-3
    middle = (mass[:, None] * simulation.state.x).sum(axis=0) / mass.sum()
    assert np.hypot(middle[0], middle[2]) < 0.1 * radius and middle[1] > 0.0
    (felt,) = feel(simulation)[0].bodies
    assert felt.force == pytest.approx((0.0, -weight, 0.0), abs=0.01 * weight)


FLAT = {"contact": {"plugin": "sliding", "gap": WIDE_GAP, "margin": 0}}
"""Contact with a slab, whose edges cloth does not reach."""


def on_slab(folder: Path, name: str, dt: str, gravity: Float, path: list[list[float]] | None = None) -> Any:
    """A sheet after half a second on a slab that stands or goes along a path, and how far it has moved."""
    slab = trimesh.creation.box((4.0, 0.1, 1.0))
    motion = {"plugin": "keyframes", "times": np.linspace(0.0, 0.5, 31).tolist(), "positions": path}
    fields: dict[str, Any] = {"body": FLAT | ({"motion": motion} if path else {})}
    solver, cloth = {"plugin": name, "dt": dt, "residual": 1e-6}, sheet(0.2, 6, 0.05 + WIDE_GAP)
    simulation = made(folder, slab, solver, cloth, damping=0.0, gravity=gravity.tolist(), duration=0.5, **fields)
    x = simulation.state.x.copy()
    while not simulation.finished:
        simulation.step()
    return simulation, simulation.state.x - x


@pytest.mark.full
@pytest.mark.parametrize("dt", [FRAME, QUARTER])
@pytest.mark.parametrize("name", ["implicit_euler", "tr_bdf2"])
def test_a_sheet_on_a_slab_sticks_slides_and_is_carried(tmp_path: Path, name: str, dt: str) -> None:
    """None below tan alpha = mu, else at g (sin alpha - mu cos alpha); up with a lift; sideways with what friction can
    bear of 2 m/s^2, and with mu g where it cannot, of 6.5 m/s^2.
    """
    for share in (0.98, 1.5):
        alpha = math.atan(share * MU)
        simulation, moved = on_slab(tmp_path, name, dt, GRAVITY * np.array([math.sin(alpha), -math.cos(alpha), 0.0]))
        pull = max(0.0, GRAVITY * (math.sin(alpha) - MU * math.cos(alpha)))
        assert np.abs(moved[:, 0]).max() == pytest.approx(0.5 * pull * 0.25, rel=0.05, abs=1e-9)
        assert simulation.state.v == pytest.approx(np.tile([0.5 * pull, 0.0, 0.0], (36, 1)), rel=0.01, abs=1e-6)
        assert np.abs(moved[:, 1]).max() < 1e-9
    down, times = np.array([0.0, -GRAVITY, 0.0]), np.linspace(0.0, 0.5, 31)
    _, moved = on_slab(tmp_path, name, dt, down, [[0.0, 0.4 * float(t), 0.0] for t in times])
    assert moved == pytest.approx(np.tile([0.0, 0.2, 0.0], (36, 1)), abs=1e-6)
    for given, had in ((2.0, 2.0), (6.5, MU * GRAVITY)):
        simulation, _ = on_slab(tmp_path, name, dt, down, [[0.5 * given * float(t * t), 0.0, 0.0] for t in times])
        # A body's velocity in a frame is that of its middle.
        assert simulation.state.v[:, 0] == pytest.approx(np.full(36, had * (0.5 - 1.0 / 120.0)), rel=0.02)


@pytest.mark.full
def test_a_run_goes_on_from_a_checkpoint_in_the_same_bits(tmp_path: Path) -> None:
    """What is held, and what rubs, is part of the state."""
    slab = trimesh.creation.box((4.0, 0.1, 1.0))
    parts = slab, {"plugin": "implicit_euler", "dt": FRAME}, sheet(0.2, 6, 0.05 + WIDE_GAP)
    fields = {"damping": 0.0, "gravity": [5.0, -8.0, 0.0], "duration": 0.2, "body": FLAT}
    one, other = (made(tmp_path, *parts, **fields) for _ in range(2))
    for _ in range(6):
        one.step()
    other.resume(one.keep())
    for simulation in (one, other):
        while not simulation.finished:
            simulation.step()
    assert one.digest() == other.digest()
    assert one.state.v[:, 0].min() > 0.1, "it slides"
