"""Cloth whose vertices stand in no order: stepped in another, told by its user's numbers, in the same bits."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from pydantic import BaseModel
from scattered_meshes import BALL, DOWN, SIDE, irregular, mesh, shuffled, simulated
from scenes import write_scene

import nuno
from nuno.exports.meshes import export_mesh
from nuno.resimulation.verification import Verification, verify
from nuno.runtime import supervisor
from nuno.runtime.service import Options
from nuno.scene import scene_file, shipped
from nuno.simulation import cloth as build
from nuno.simulation import renumbering
from nuno.simulation.renumbering import find_numbers, invert, keep_numbers, renumber
from nuno.simulation.run import Simulation
from nuno_cloth.wind import Wind
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.system import Term


@pytest.mark.quick(solver=["symplectic_euler"], tension=["membrane"])
@pytest.mark.parametrize(
    ("tension", "solver"),
    [("springs", "symplectic_euler"), ("membrane", "symplectic_euler"), ("membrane", "implicit_euler")],
)
def test_a_shuffled_mesh_moves_as_it_would_in_near_order(tension: str, solver: str, tmp_path: Path) -> None:
    x, faces = irregular(SIDE)
    mixed, corners, old = shuffled(x, faces)
    pins = [0, SIDE - 1]
    fields: dict[str, Any] = {"solver": {"plugin": solver, "dt": "0.1 ms"}, "bodies": [BALL], "frame_rate": 100}
    near = simulated(tmp_path, mesh(tmp_path, "near.obj", x, faces, tension=tension, pin=pins), **fields)
    pinned = np.sort(invert(old)[pins]).tolist()
    far = simulated(tmp_path, mesh(tmp_path, "far.obj", mixed, corners, tension=tension, pin=pinned), **fields)
    assert near.numbers is None and far.numbers is not None
    assert np.array_equal(far.fabric.faces, corners) and np.array_equal(far.fabric.position, mixed)
    for _ in range(3):
        one, other = near.step(), far.step()
    assert one.report.status == other.report.status == "ok"
    moved = np.abs(near.state.x - x).max()
    assert moved > 1e-3 and np.abs(far.state.x - near.state.x[old]).max() < 1e-9 * moved
    assert np.array_equal(far.state.x[pinned], mixed[pinned])
    assert np.flatnonzero((far.state.x == mixed).all(axis=1)).tolist() == pinned
    ours, theirs = far.present_forces(), near.present_forces()
    assert set(ours.parts) == set(theirs.parts)
    for kind, force in ours.parts.items():
        assert np.abs(force - theirs.parts[kind][old]).max() < 1e-6 * np.abs(force).max()
    scale = np.abs(theirs.acceleration).max()
    assert np.abs(ours.acceleration - theirs.acceleration[old]).max() < 1e-6 * scale
    assert near.measure(near.poses).stretch == pytest.approx(far.measure(far.poses).stretch, rel=1e-9)


def test_a_file_in_the_order_of_the_steps_moves_to_the_same_bits(tmp_path: Path) -> None:
    """Its sums are the same sums."""
    mixed, corners, _ = shuffled(*irregular(SIDE))
    far = simulated(tmp_path, mesh(tmp_path, "far.obj", mixed, corners))
    numbers = far.numbers
    assert numbers is not None
    near = simulated(tmp_path, mesh(tmp_path, "near.obj", mixed[numbers], invert(numbers)[corners]))
    assert near.numbers is None
    for _ in range(2):
        far.step(), near.step()
    assert far.state.x[numbers].tobytes() == near.state.x.tobytes()
    assert far.state.v[numbers].tobytes() == near.state.v.tobytes()


def test_every_part_of_a_fabric_is_renumbered(tmp_path: Path) -> None:
    """Springs in runs, too: all keep their order, and join the same places by the same laws."""
    fabric = simulated(tmp_path, {"plugin": "sheet", "resolution": [9, 7], "pin": ["top-corners"]}).fabric
    numbers = np.random.default_rng(3).permutation(fabric.number).astype(np.int32)
    other = renumber(fabric, numbers)
    assert fabric.springs and fabric.hinges and other.springs and other.hinges and other.uv is not None
    assert np.array_equal(numbers[other.springs.pairs()], fabric.springs.pairs())
    assert np.array_equal(numbers[other.hinges.quads()], fabric.hinges.quads())
    assert np.array_equal(numbers[other.faces], fabric.faces)
    for name in ("k", "rest", "c"):
        values = getattr(fabric.springs, name)
        assert np.array_equal(other.springs.per_spring(getattr(other.springs, name)), fabric.springs.per_spring(values))
    assert all(np.array_equal(other.springs.of_kind(kind), fabric.springs.of_kind(kind)) for kind in range(3))
    for name in ("position", "velocity", "mass", "pinned", "uv"):
        assert np.array_equal(getattr(other, name), getattr(fabric, name)[numbers])
    assert [other.told(place) for place in range(fabric.number)] == numbers.tolist()
    assert [fabric.told(vertex) for vertex in range(3)] == [0, 1, 2]


@pytest.mark.parametrize("around", [False, True])
def test_rows_and_rings_are_found_again(around: bool, tmp_path: Path) -> None:
    """A grid that is shuffled has its rows back, one after the other, and a tube its rings, up to where each begins."""
    side = 48
    i, j = np.divmod(np.arange(side * side), side)
    turn = 2.0 * np.pi * (j + 0.5) / side
    size = 0.02 * side / (2.0 * np.pi)
    flat, tube = (0.01 * j, 0.0 * j), (size * np.cos(turn), size * np.sin(turn))
    x = np.column_stack([(tube if around else flat)[0], 0.02 * i, (tube if around else flat)[1]])
    wraps = side if around else side - 1
    corner, beside = (
        (i * side + j)[(i < side - 1) & (j < wraps)],
        (i * side + (j + 1) % side)[(i < side - 1) & (j < wraps)],
    )
    faces = np.concatenate(
        [np.stack(f, 1) for f in ((corner, beside, corner + side), (beside, beside + side, corner + side))]
    )
    mixed, corners, old = shuffled(x, faces.astype(np.int32))
    numbers = simulated(tmp_path, mesh(tmp_path, "far.obj", mixed, corners)).numbers
    assert numbers is not None
    row, column = np.divmod(old[numbers], side)
    assert np.array_equal(row, i)
    steps = np.diff(column.reshape(side, side), axis=1) % side
    assert ((steps == 1).all() or (steps == side - 1).all()) if around else np.array_equal(column, j)


def test_old_vertices_of_changed_cloth_keep_their_places_and_new_ones_come_last() -> None:
    """Of two objects, wherever an operation has put the new ones."""
    numbers = np.array([2, 0, 3, 1, 5, 4], np.int32)
    source = np.array([-1, 0, 1, -1, 2, 3, 4, -1, 5], np.int32)
    pieces = [build.Piece("one", 0, 6), build.Piece("other", 6, 9)]
    kept = keep_numbers(numbers, source, pieces)
    assert kept.tolist() == [4, 1, 5, 2, 0, 3, 8, 6, 7]
    assert source[kept].tolist() == [2, 0, 3, 1, -1, -1, 5, 4, -1]


@pytest.mark.quick(name=["skirt-hula"])
@pytest.mark.parametrize("name", ["skirt-hula", "shirt-on-mannequin", "drape-over-sphere", "stiff-sheet"])
def test_what_stands_in_good_order_is_left_alone(name: str) -> None:
    loaded = scene_file.read(shipped.find(name))
    fabric, pieces = build.build_fabric(loaded)
    assert fabric.number > renumbering.FEWEST and find_numbers(fabric, pieces) is None


def test_an_object_in_good_order_is_left_alone_beside_one_in_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It moves in the same bits as beside one that is not renumbered, and a sheet's springs stay runs."""
    x, faces = irregular(SIDE)
    beside = np.array([2.0, 0.0, 0.0])
    mixed, corners, old = shuffled(x + beside, faces)
    objects = [
        {"name": "near", "model": mesh(tmp_path, "near.obj", x, faces)},
        {"name": "far", "model": mesh(tmp_path, "far.obj", mixed, corners)},
    ]
    objects.insert(0, {"name": "sheet", "model": {"plugin": "sheet", "resolution": [48, 48]}})
    simulation = simulated(tmp_path, {}, objects=objects)
    start, numbers = 48 * 48, simulation.numbers
    n = start + len(x)
    assert numbers is not None and np.array_equal(numbers[:n], np.arange(n))
    assert np.array_equal(np.sort(numbers[n:]), np.arange(n, n + len(x)))
    assert not np.array_equal(numbers, np.sort(numbers))
    simulation.step()
    x_end = simulation.state.x
    assert np.abs(x_end[start:n][old] + beside - x_end[n:]).max() < 1e-12
    monkeypatch.setattr(renumbering, "FEWEST", 10_000)
    plain = simulated(tmp_path, {}, objects=objects)
    plain.step()
    assert plain.numbers is None and plain.state.x[:n].tobytes() == x_end[:n].tobytes()


def test_a_lost_vertex_is_named_by_the_users_number(tmp_path: Path) -> None:
    mixed, corners, _ = shuffled(*irregular(SIDE))
    far = simulated(tmp_path, mesh(tmp_path, "far.obj", mixed, corners))
    far.state.v[1234] = 1e200
    report = far.step().report
    assert report.status == "diverged" and "vertex 1234, at 1.73e+200 m/s before" in report.message


def test_a_force_that_knows_vertices_by_number_has_the_users(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mixed, corners, _ = shuffled(*irregular(SIDE))
    model, wind = mesh(tmp_path, "far.obj", mixed, corners), {"plugin": "wind", "velocity": [1, 0, 0]}
    assert simulated(tmp_path, model, forces=[wind]).numbers is not None
    running = simulated(tmp_path, model)
    running.set("forces=[{plugin: wind, velocity: [1, 0, 0]}]")
    running.set("forces=[]")
    monkeypatch.setattr(Wind, "any_numbering", False)
    assert simulated(tmp_path, model, forces=[wind]).numbers is None
    with pytest.raises(BadInput, match="knows vertices by number"):
        running.set("forces=[{plugin: wind, velocity: [1, 0, 0]}]")
    assert running.numbers is not None and not running.system.terms


@pytest.mark.parametrize("any_numbering", [False, True])
def test_a_force_is_handed_fabric_and_positions_in_one_order(
    any_numbering: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One in Python, which pushes the vertex that the user calls 7, by the user's number or by what it was told."""
    mixed, corners, _ = shuffled(*irregular(SIDE))

    def prepare(self: Wind, config: BaseModel, fabric: Fabric, seed: int) -> Term:
        own = next(place for place in range(fabric.number) if fabric.told(place) == 7) if any_numbering else 7

        def push(x: Float, v: Float, t: float, out: Float) -> None:
            assert np.abs(x - fabric.position).max() < 1e-3
            out[own, 2] += 1e-3

        return Term("wind", push)

    monkeypatch.setattr(Wind, "prepare", prepare)
    monkeypatch.setattr(Wind, "any_numbering", any_numbering)
    wind = {"plugin": "wind", "velocity": [1, 0, 0]}
    run = simulated(tmp_path, mesh(tmp_path, "far.obj", mixed, corners), forces=[wind], gravity=[0, 0, 0])
    assert (run.numbers is not None) == any_numbering
    run.step()
    assert int(np.argmax(run.state.x[:, 2])) == 7 and run.state.x[7, 2] > 0.0


def test_the_bits_of_renumbered_cloth_do_not_depend_on_threads(tmp_path: Path) -> None:
    mixed, corners, _ = shuffled(*irregular(SIDE))
    model, ends = mesh(tmp_path, "far.obj", mixed, corners), []
    for threads in (1, 2):
        run = simulated(tmp_path, model, threads, bodies=[BALL])
        run.step()
        ends.append(run.digest())
    assert ends[0] == ends[1]


def test_a_recording_of_cloth_that_was_not_renumbered_goes_on_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As from before cloth was renumbered: what friction remembers is then in the user's order."""
    mixed, corners, _ = shuffled(*irregular(SIDE))
    model = mesh(tmp_path, "far.obj", mixed, corners)
    monkeypatch.setattr(renumbering, "FEWEST", 10_000)
    plain = simulated(tmp_path, model, bodies=[BALL])
    for _ in range(2):
        plain.step()
    point = plain.keep()
    plain.step()
    monkeypatch.undo()
    other = simulated(tmp_path, model, bodies=[BALL])
    assert other.numbers is not None and "numbers" not in point.arrays
    other.resume(point)
    assert other.step().digest == plain.digest()


@pytest.mark.parametrize("drawn", [False, True])
def test_a_recording_is_in_the_users_order_and_goes_on_in_the_same_bits(
    drawn: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of cloth that lies on a ball which rubs, also where a line of wrinkles has been drawn on it meanwhile: what
    friction remembers goes with the vertices.
    """
    monkeypatch.setattr(renumbering, "FEWEST", 9)
    x, faces = irregular(12)
    mixed, corners, old = shuffled(x, faces)
    cloth = {"fabric": {"density": 0.2, "structural": 20.0, "hinge": 1e-5}}
    line = {"on_faces": [{"face": f, "at": [0.3, 0.3, 0.4]} for f in (20, 110)], "height": 0.01}
    fields = {"solver": "leapfrog", "duration": 0.3, "bodies": [BALL], **DOWN}
    fields |= {"operations": [{"plugin": "wrinkle", "at": 0.1, "lines": [line]}]} if drawn else {}
    runs, pin = [], int(invert(old)[0])
    for name, model in {
        "near": mesh(tmp_path, "near.obj", x, faces, pin=[0], **cloth),
        "far": mesh(tmp_path, "far.obj", mixed, corners, pin=[pin], **cloth),
    }.items():
        scene = write_scene(tmp_path, objects=[{"name": "cloth", "model": model}], **fields)
        runs.append(nuno.run(scene, record=tmp_path / f"{name}.mcap"))
        assert (Simulation.with_bodies(scene_file.read(scene)).numbers is None) == (name == "near")
    near, far = runs
    part = nuno.run(scene, "duration=0.2", record=tmp_path / "part.mcap")
    options = Options(record=tmp_path / "on.mcap", resume=part.path)
    assert supervisor.supervise(scene_file.read(scene), options).summary["digest"] == far.digest
    with nuno.open(far.path) as recording:
        assert verify(recording) == Verification(16, published=16, kept=3)
        first = next(iter(recording.frames()))
    assert np.abs(first.x - mixed).max() < 1e-6
    assert (len(far.x) > len(x)) == drawn and np.array_equal(far.x[pin], mixed[pin])
    assert np.abs(near.x[: len(x)] - x).max() > 0.05
    assert np.abs(far.x[: len(x)] - near.x[: len(x)][old]).max() < 1e-9
    export_mesh(far.path, tmp_path / "out.ply", 0)
    exported = trimesh.load(tmp_path / "out.ply", process=False)
    assert np.abs(exported.vertices - mixed).max() < 1e-6 and np.array_equal(exported.faces, corners)


def test_cloth_that_passes_through_cloth_is_told_of_by_the_users_numbers(tmp_path: Path) -> None:
    x, faces = irregular(SIDE)
    mixed, corners, old = shuffled(x, faces)
    up = np.column_stack([x[:, 0], np.full(len(x), 0.51), x[:, 1] - 0.5])
    other = {"name": "other", "model": mesh(tmp_path, "up.obj", up, faces)}
    edges = []
    for name, v, f in (("near.obj", x, faces), ("far.obj", mixed, corners)):
        objects = [{"name": "cloth", "model": mesh(tmp_path, name, v, f)}, other]
        with pytest.raises(BadInput, match="passes through") as crossed:
            simulated(tmp_path, {}, objects=objects, cloth_contact={"plugin": "offset", "thickness": "2 mm"})
        found = re.match(r"edge (\d+)-(\d+) ", str(crossed.value.value))
        assert found is not None
        edges.append([int(number) for number in found.groups()])
    near, far = edges
    assert max(near) < len(x) and sorted(old[far]) == near
