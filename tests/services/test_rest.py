"""What need not be done is not: frames without change and what comes after rest; cloth that starts uneven."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scenes import write_chain

import nuno
from nuno.scene import scene_file, shipped
from nuno.simulation import cloth as build
from nuno.simulation.relax import REST_TIME, Stillness
from nuno.simulation.run import Simulation
from nuno_schemas.bodies import Poses
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float

PLUGINS = entry_points(group="nuno.integrators")
SOLVERS = sorted(PLUGINS.names)
EXPLICIT = {point.name for point in PLUGINS if point.load().explicit}


def net(folder: Path, x: Any, pairs: Any, rest: Any, c: float = 0.0, k: float = 40.0) -> None:
    x, pairs = np.asarray(x, float), np.asarray(pairs)
    n, s = len(x), len(pairs)
    pinned = np.arange(n) == 0
    np.savez(
        folder / "net.npz", x=x, v=np.zeros((n, 3)), m=np.ones(n), pinned=pinned, springs=pairs,
        k=np.full(s, k), rest=np.asarray(rest, float), c=np.full(s, c),
    )  # fmt: skip


def simulation(folder: Path, *overrides: str) -> Simulation:
    path = folder / "scene.yaml"
    path.write_text(
        "nuno: 1\nname: rest\nduration: 20 s\nsolver: {plugin: symplectic_euler, dt: auto}\n"
        "objects: [{name: cloth, model: {plugin: net, file: net.npz}}]\n"
    )
    return Simulation(scene_file.read(path, overrides), None, None, 1)


@pytest.mark.quick(solver=["symplectic_euler", "implicit_euler", "xpbd"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_net_at_rest_without_gravity_is_stepped_once(tmp_path: Path, solver: str) -> None:
    net(tmp_path, [[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 1], [1, 2]], [1, 1])
    run = simulation(
        tmp_path,
        "gravity=[0,0,0]",
        f"solver.plugin={solver}",
        "frame_rate=50 Hz",
        "solver.dt=2 ms",
        "allow_unstable=true",
    )
    start = run.state.x.tobytes(), run.state.v.tobytes()
    reports = [run.advance(None, None).report for _ in range(30)]
    assert (run.state.x.tobytes(), run.state.v.tobytes()) == start
    # An adaptive method's first frame sets the step of the second.
    assert run.idle >= 28
    assert sum(report.steps for report in reports[2:]) == 0


def test_what_moves_is_never_idle_and_a_change_wakes_it(tmp_path: Path) -> None:
    net(tmp_path, [[0, 0, 0], [1, 0, 0]], [[0, 1]], [1])
    moving = simulation(tmp_path)
    for _ in range(30):
        moving.advance(None, None)
    assert moving.idle == 0
    still = simulation(tmp_path, "gravity=[0,0,0]")
    for _ in range(3):
        still.advance(None, None)
    assert still.idle == 2
    still.set("gravity=[0, -1, 0]")
    still.advance(None, None)
    assert still.state.v[1, 1] < 0.0


def test_bodies_that_move_keep_it_awake(tmp_path: Path) -> None:
    net(tmp_path, [[0, 0, 0], [1, 0, 0]], [[0, 1]], [1])
    run = simulation(tmp_path, "gravity=[0,0,0]")
    one = np.array([[1.0, 0.0, 0.0, 0.0]])
    for frame in range(3):
        run.advance(*(Poses(t, one, np.array([[0.1 * t, 0.0, 0.0]])) for t in (frame / 60, (frame + 1) / 60)))
    assert run.idle == 0


def finish(run: Simulation) -> None:
    while not run.finished:
        run.advance(None, None)


def test_a_damped_pendulum_ends_at_rest_and_not_where_it_turns(tmp_path: Path) -> None:
    net(tmp_path, [[0, 0, 0], [1, 0, 0]], [[0, 1]], [1], k=4000.0)
    run = simulation(tmp_path, "until=rest", "damping=1.5")
    finish(run)
    assert 3.0 < run.t < 20.0
    assert np.abs(run.state.v).max() <= 1e-3
    # At rest it hangs below its pin, stretched by m g / k; the law of its decay leaves what the speed leaves.
    np.testing.assert_allclose(run.state.x[1], [0.0, -1.0 - 9.81 / 4000.0, 0.0], atol=2e-3)
    free = simulation(tmp_path, "until=rest", "duration=5 s")
    finish(free)
    assert free.t == 5.0, "an undamped pendulum stands still only where it turns"


def test_a_resumed_run_comes_to_rest_in_the_same_frame(tmp_path: Path) -> None:
    net(tmp_path, [[0, 0, 0], [1, 0, 0]], [[0, 1]], [1], k=4000.0)
    whole = simulation(tmp_path, "until=rest", "damping=1.5")
    finish(whole)
    first = simulation(tmp_path, "until=rest", "damping=1.5")
    while first.frame < whole.frame - 2:
        first.advance(None, None)
    assert not first.finished
    again = simulation(tmp_path, "until=rest", "damping=1.5")
    again.resume(first.keep())
    finish(again)
    assert again.frame == whole.frame
    assert again.digest() == whole.digest()


@pytest.mark.parametrize("speed", [0.9, 1.1])
def test_rest_is_where_vertices_are_not_how_fast_they_are_said_to_be(speed: float) -> None:
    """What trembles by several times what it may stray rests after a while; what creeps by nearly as much as it may in
    that time does, what creeps farther does not.
    """
    rate, least, x = 60.0, 4e-4, np.zeros((3, 3))
    trembles, creeps, rested = Stillness(rate, 3, least), Stillness(rate, 3, least), False
    for frame in range(90):
        trembles.after(x + (-1) ** frame * 3.0 * least * REST_TIME)
        creeps.after(x + frame * speed * least / rate)
        rested = rested or (creeps.rests and frame > 30)  # by then the mean creeps as fast
    assert trembles.rests and rested == (speed < 1.0)


def test_damping_that_fades_takes_what_its_law_says(tmp_path: Path) -> None:
    """Of a free vertex's velocity there remains exp(-(last t + (first - last) over t / (over + t))), to the step's
    order; a run that is resumed goes on as it would have, to the bit.
    """
    net(tmp_path, [[0, 0, 0], [1, 0, 0]], [[0, 1]], [1], k=0.0)
    fades = ("damping={first: 40, over: 50 ms, last: 2}", "gravity=[0,0,0]", "frame_rate=50 Hz", "allow_unstable=true")
    off = []
    for steps in (20, 40):
        run = simulation(tmp_path, *fades, f"solver.dt={1000 / 50 / steps} ms")
        run.state.v[1] = 0.0, 1.0, 0.0
        for frame in range(1, 26):
            run.advance(None, None)
            t = frame / 50.0
            off.append(run.state.v[1, 1] / np.exp(-(2.0 * t + 38.0 * 0.05 * t / (0.05 + t))) - 1.0)
    first, second = np.abs(off[:25]).max(), np.abs(off[25:]).max()
    assert second < 0.02 and 1.8 < first / second < 2.2
    whole, again = (simulation(tmp_path, *fades, "gravity=[0,-1,0]", "solver.dt=1 ms") for _ in range(2))
    for _ in range(5):
        whole.advance(None, None)
    again.resume(whole.keep())
    for run in (whole, again):
        for _ in range(5):
            run.advance(None, None)
    assert again.digest() == whole.digest()


def test_a_field_of_fading_damping_is_named(tmp_path: Path) -> None:
    net(tmp_path, [[0, 0, 0], [1, 0, 0]], [[0, 1]], [1])
    for given, field in (("{frist: 4, over: 1 s}", "frist"), ("{first: 4, over: 0 s}", "over"), ("{first: 4}", "over")):
        with pytest.raises(BadInput) as told:
            simulation(tmp_path, f"damping={given}")
        assert told.value.field == f"damping.{field}"


STILL = ("until=balance", "gravity=[0,0,0]", "frame_rate=50 Hz", "solver.dt=2 ms")


def test_cloth_without_load_is_in_balance_at_once(tmp_path: Path) -> None:
    x = np.array([[0.1, 0.2, 0.3], [1.1, 0.7, 0.3], [0.4, 1.9, 3.3]])
    pairs = [[0, 1], [1, 2]]
    net(tmp_path, x, pairs, [np.linalg.norm(x[j] - x[i]) for i, j in pairs])
    run = simulation(tmp_path, *STILL)
    run.advance(None, None)
    assert run.balanced and run.finished


def test_what_swings_is_as_far_from_rest_in_the_middle_as_at_its_ends(tmp_path: Path) -> None:
    """1 kg between two springs of 40 N/m under 20 N: 2 k A at an end of the swing, A sqrt(2 k / m) between."""
    net(tmp_path, [[0, 0, 0], [1.5, 0, 0], [3, 0, 0]], [[0, 1], [1, 2]], [1, 1])
    run = simulation(tmp_path, *STILL)
    run.fabric.pinned[2] = True
    plugin, amplitude = run.loaded.integrator.plugin, 1e-3
    for along, speed in ((amplitude, 0.0), (0.0, amplitude * np.sqrt(80.0))):
        run.state.x[1, 0], run.state.v[1, 0] = 1.5 + along, speed
        share = plugin.unbalance(run.system, run.state, run.memory, None)
        assert share == pytest.approx([0.0, 80.0 * amplitude / 20.0, 0.0], rel=1e-9)


def test_balance_of_cloth_without_springs_is_refused(tmp_path: Path) -> None:
    net(tmp_path, [[0, 0, 0], [1, 0, 0]], np.zeros((0, 2), np.int32), [])
    with pytest.raises(BadInput, match="without springs"):
        simulation(tmp_path, *STILL)


@pytest.mark.quick(solver=["symplectic_euler"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_damping_that_changes_acts_as_if_it_had_been_so_from_the_start(tmp_path: Path, solver: str) -> None:
    """Implicit methods beside wind, so that they measure what acts on single vertices."""
    net(tmp_path, [[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 1], [1, 2]], [1, 1.2])
    wind = () if solver in EXPLICIT else ("forces=[{plugin: particle_wind, strength: 3 N}]",)
    common = (f"solver.plugin={solver}", "frame_rate=50 Hz", "solver.dt=2 ms", "allow_unstable=true", *wind)
    runs = [simulation(tmp_path, *common, f"damping={damping}") for damping in (40, 1)]
    runs[1].system = replace(runs[1].system, damping=40.0)
    assert runs[0].advance(None, None).digest == runs[1].advance(None, None).digest


def test_a_number_may_take_the_place_of_damping_that_finds_its_own(tmp_path: Path) -> None:
    net(tmp_path, [[0, 0, 0], [1, 0, 0]], [[0, 1]], [1])
    run = simulation(tmp_path, "until=balance", "damping=auto")
    run.advance(None, None)
    run.set("damping=2")
    run.advance(None, None)
    assert run.system.damping == 2.0
    run.set("damping=auto")
    assert run.advance(None, None).report.status == "ok" and run.system.damping == 3.0 * 60.0


def test_how_still_cloth_has_to_be_is_the_scene_s_to_say(tmp_path: Path) -> None:
    """A pendulum's swings fade by exp(-0.75 t): ten times the speed is there ln 10 / 0.75 = 3.07 s sooner, give or take
    half a swing of 1.0 s, since it is at its turning points that it moves least.
    """
    net(tmp_path, [[0, 0, 0], [1, 0, 0]], [[0, 1]], [1], k=4000.0)
    ends = []
    for speed in (1e-3, 1e-2):
        run = simulation(tmp_path, "until=rest", "damping=1.5", f"rest_speed={speed} m/s")
        finish(run)
        ends.append(run.t)
    assert ends[0] - ends[1] == pytest.approx(np.log(10.0) / 0.75, abs=1.0)
    with pytest.raises(BadInput) as told:
        simulation(tmp_path, "rest_speed=1 mm/s")
    assert told.value.field == "rest_speed"


HEIGHT = 1e-4
SHEET = {
    "plugin": "sheet",
    "size": [0.5, 0.4],
    "resolution": [17, 13],
    "pin": ["top-corners"],
    "rotate": {"angle": 0.5},
}
SKIRT = {"plugin": "skirt", "columns": 32, "rows": 12}
MESH = {"plugin": "mesh", "file": "cloth.obj"}
MODELS = {"sheet": SHEET, "triangles": SHEET | {"cells": "triangles"}, "skirt": SKIRT, "mesh": MESH}


def made(folder: Path, model: dict[str, Any], height: float, seed: int = 0) -> Fabric:
    """The cloth of a scene with one object so rough [m]; cloth.obj is two triangles with a fold between them."""
    (folder / "cloth.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 1\nf 1 2 3\nf 1 3 4\n")
    write_chain(folder)
    cloth = {"name": "cloth", "model": model} | ({"roughness": height} if height else {})
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump({"nuno": 1, "name": "rough", "duration": 1, "seed": seed, "objects": [cloth]}))
    return build.build_fabric(scene_file.read(path))[0]


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_only_the_start_is_rough_and_along_the_normals(model: dict[str, Any], tmp_path: Path) -> None:
    flat, rough = (made(tmp_path, model, height) for height in (0.0, HEIGHT))
    parts = [part for part in ("springs", "hinges", "membrane", "bending") if getattr(flat, part) is not None]
    assert len(parts) == 2
    for part in parts:
        for field in fields(getattr(flat, part)):
            np.testing.assert_array_equal(
                getattr(getattr(flat, part), field.name), getattr(getattr(rough, part), field.name)
            )
    np.testing.assert_array_equal(flat.mass, rough.mass)
    moved = rough.position - flat.position
    assert not moved[flat.pinned].any() and moved[~flat.pinned].any(axis=1).all()
    a, b, c = (flat.position[flat.faces[:, k]] for k in range(3))
    normal = np.zeros_like(moved)
    np.add.at(normal, flat.faces, np.cross(b - a, c - a)[:, None])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    along = (moved * normal).sum(axis=1)
    np.testing.assert_allclose(moved, along[:, None] * normal, atol=1e-15)


def test_the_height_is_the_root_mean_square_and_the_seed_chooses(tmp_path: Path) -> None:
    flat = made(tmp_path, SHEET, 0.0).position
    moved = [made(tmp_path, SHEET, HEIGHT, seed).position - flat for seed in range(40)]
    assert np.sqrt(np.mean([np.square(one).sum(axis=1).mean() for one in moved])) == pytest.approx(HEIGHT, rel=0.1)
    np.testing.assert_array_equal(moved[3], made(tmp_path, SHEET, HEIGHT, 3).position - flat)
    assert min(np.abs(one - moved[0]).max() for one in moved[1:]) > 0.5 * HEIGHT


def test_a_finer_mesh_is_rough_in_the_same_places(tmp_path: Path) -> None:
    coarse, fine = (made(tmp_path, SHEET | {"resolution": n}, HEIGHT).position for n in ([9, 7], [17, 13]))
    shared = fine.reshape(13, 17, 3)[::2, ::2].reshape(-1, 3)
    np.testing.assert_allclose(coarse, shared, atol=1e-12)


def test_a_net_without_faces_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="only cloth with triangles") as error:
        made(tmp_path, {"plugin": "net", "file": "chain.npz"}, HEIGHT)
    assert error.value.field == "objects[0].roughness" and error.value.line is not None


CRITICAL = 12.8538 * math.sqrt(2.0)
"""w L^3 / B at which a strip clamped at one end, its width vertical, tips over (Michell; Poisson's ratio 0)."""


def strip(gamma: float, roughness: float) -> Float:
    """Distances from its plane (n,) [m] that such a strip ends with."""
    columns, rows, length, density, gravity = 17, 3, 0.2, 0.05, 9.81
    step = length / (columns - 1.5)  # the clamp holds the direction of the first step
    rigidity = density * gravity * length**3 / gamma
    fabric = {"density": density, "warp": 400, "weft": 400, "shear": 100, "bend_warp": rigidity, "bend_weft": rigidity}
    pins = [row * columns + column for row in range(rows) for column in (0, 1)]
    model = {"plugin": "sheet", "size": [step * (columns - 1), step * (rows - 1)], "resolution": [columns, rows]}
    cloth = {"name": "strip", "roughness": roughness, "model": model | {"pin": pins, "fabric": fabric}}
    scene = {"nuno": 1, "name": "strip", "duration": 5, "frame_rate": 20, "damping": 3, "objects": [cloth]}
    result = nuno.run(scene | {"solver": "symplectic_euler"})
    return np.abs(result.x[:, 2])


def test_a_strip_on_its_edge_tips_over_where_it_must() -> None:
    assert strip(1.3 * CRITICAL, 0.0).max() == 0.0  # in a plane nothing pushes it over
    assert strip(1.3 * CRITICAL, HEIGHT).max() > 0.02  # of a length of 0.2 m
    assert strip(0.9 * CRITICAL, HEIGHT).max() < 0.1 * HEIGHT


@pytest.mark.parametrize("name", ["hanging-sheet", "hung-cloth-wrinkle"])
def test_shipped_cloth_that_hangs_leaves_its_plane(name: str) -> None:
    loaded = scene_file.read(shipped.find(name))
    assert loaded.scene.objects[0].roughness > 0.0
    start = build.build_fabric(loaded)[0].position[:, 2]
    assert 0.0 < np.abs(start).max() < 5.0 * loaded.scene.objects[0].roughness
    if name == "hanging-sheet":
        assert np.abs(nuno.run(name, "duration=0.5").x[:, 2]).max() > 10.0 * np.abs(start).max()
