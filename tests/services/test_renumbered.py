"""Renumbered cloth as its user and plugins have it: by the numbers of its file, in the same bits however it is run."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pydantic import BaseModel
from scattered_meshes import BALL, DOWN, SIDE, irregular, mesh, shuffled, simulated
from scenes import write_scene

import nuno
from nuno.exports.meshes import export_mesh
from nuno.replay.verification import Verification, verify
from nuno.runtime import supervisor
from nuno.runtime.service import Options
from nuno.scene import scene_file
from nuno.simulation.cloth import numbering
from nuno.simulation.cloth.numbering import invert
from nuno.simulation.run import Simulation
from nuno_cloth.wind import Wind
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.system import Term


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
    monkeypatch.setattr(numbering, "FEWEST", 10_000)
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
    monkeypatch.setattr(numbering, "FEWEST", 9)
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
