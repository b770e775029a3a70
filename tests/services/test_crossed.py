"""Cloth that meets cloth or bodies of triangles in a whole run: what is checked, told, untangled and refused."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import ipctk
import numpy as np
import pytest
import trimesh
import yaml
from scenes import write_scene
from sewing_patterns import back, front, pattern, stitch

import nuno
from nuno.cli import main
from nuno.collision.bodies import box_mesh
from nuno.recording.reader import open_recording
from nuno.report.run_report import lines
from nuno.scene import scene_file, shipped
from nuno.simulation import cloth
from nuno.simulation.cloth import build_start
from nuno.simulation.run import Simulation
from nuno_bench import piles
from nuno_bench.piles import Oracle, write_obj
from nuno_contact.offset.plugin import Offset, check_thickness
from nuno_geometry.normals import edge_numbers
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Int
from nuno_schemas.messages import PENETRATION
from nuno_schemas.system import Term

THICKNESS, FRAMES = 4e-3, 30


def sheet(name: str, height: float, tilt: str, *pinned: str) -> dict[str, Any]:
    model = {
        "plugin": "sheet", "size": [0.1, 0.1], "resolution": [7, 7], "plane": "xz", "centre": [0, height, 0],
        "rotate": {"axis": [1, 0, 0], "angle": tilt}, "fabric": "jacket", "pin": [*pinned],
    }  # fmt: skip
    return {"name": name, "model": model}


def run(folder: Path, **contact: Any) -> tuple[int, Path]:
    """A sheet falls on one that hangs at its edges, leaning, from above: exit code and recording."""
    scene = {
        "nuno": 1, "name": "fall", "duration": FRAMES / 100, "frame_rate": 100,
        "solver": {"plugin": "symplectic_euler", "dt": "0.2 ms"},
        "cloth_contact": {"plugin": "offset", "thickness": THICKNESS} | contact,
        "objects": [sheet("below", 0.0, "0 deg", "left-edge", "right-edge"), sheet("above", 0.05, "30 deg")],
    }  # fmt: skip
    path = folder / "fall.yaml"
    path.write_text(yaml.safe_dump(scene))
    record = folder / "fall.mcap"
    return main(["run", str(path), "--record", str(record), "--no-view"]), record


def read(record: Path) -> list[dict[str, Any]]:
    with open_recording(record) as recording:
        return [recording.json(message.payload) for message in recording.messages([PENETRATION.name])]


@pytest.fixture
def powerless(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cloth contact that does nothing."""
    monkeypatch.setattr(Offset, "prepare", lambda *args: Term("cloth_contact", ()))


def test_cloth_that_is_held_off_keeps_a_distance(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """More than the thickness at first, then less, and never none; and the run succeeds."""
    code, record = run(tmp_path)
    said = capsys.readouterr().out
    frames = read(record)
    found = [frame["distance"] for frame in frames]
    near = [distance for distance in found if distance is not None]
    assert (code, len(frames)) == (0, FRAMES + 1)
    assert all(frame["crossings"] == 0 and frame["places"] == [] for frame in frames)
    assert found[0] is None and 0.0 < min(near) <= max(near) <= THICKNESS
    least = f"{1e3 * min(near):.3g} mm"
    assert f"cloth is pressed to within {least} of cloth; it pushes back from 4 mm on" in said
    assert main(["info", str(record)]) == 0
    told = capsys.readouterr().out
    assert f"{least}, in frame {found.index(min(near))}" in told and "passes through cloth in 0 of 31 frames" in told
    with open_recording(record) as recording:
        series = recording.series()
    assert np.array_equal(series["distance"], [np.nan if d is None else d for d in found], equal_nan=True)


def test_cloth_that_passes_through_is_told_with_frame_place_and_objects(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], powerless: None
) -> None:
    code, record = run(tmp_path)
    report, problem = capsys.readouterr()
    frames = read(record)
    number = next(i for i, frame in enumerate(frames) if frame["crossings"])
    crossed = [frame for frame in frames if frame["crossings"]]
    first = crossed[0]
    assert code == 1
    assert all(frame["distance"] == 0.0 for frame in crossed)
    assert {name for pair in first["objects"] for name in pair} == {"above", "below"}
    x, y, z = first["places"][0]
    with open_recording(record) as recording:
        points = next(frame.x for frame in recording.frames() if frame.number == number)
    assert np.abs(points - first["places"][0]).max(axis=1).min() < 0.02
    where = f"first in frame {number} ({number / 100:.4g} s), {' through '.join(first['objects'][0])} at"
    where += f" [{x:.4g}, {y:.4g}, {z:.4g}] m"
    assert f"passes through cloth in {len(crossed)} of 31 frames" in report and where in report and where in problem
    assert main(["info", "--json", str(record)]) == 0
    spells = json.loads(capsys.readouterr().out)["crossings"]
    assert spells[0]["frames"][0] == number and spells[0]["place"] == [x, y, z]
    assert sum(b - a + 1 for a, b in (spell["frames"] for spell in spells)) == len(crossed)
    assert main(["info", str(record)]) == 0
    assert f"frames {number} to" in capsys.readouterr().out


def test_what_may_pass_through_is_told_once(
    tmp_path: Path, powerless: None, capsys: pytest.CaptureFixture[str]
) -> None:
    code, record = run(tmp_path, allow=[["above", "below"]])
    assert "in 0 of 31 frames, but for below and above, which may" in capsys.readouterr().out
    assert code == 0
    assert {(frame["crossings"], frame["distance"]) for frame in read(record)} == {(0, None)}


BODY_FRAMES = 20
TURN = {"plugin": "keyframes", "times": [0, 1], "positions": [[0, 0, 0], [0, 0, 0]],
        "rotations": [[0, 0, 0], [0, 0, "180 deg"]]}  # fmt: skip


def cube() -> tuple[Float, Int]:
    """Of 4 cm."""
    x, faces = box_mesh(np.zeros(3), np.full(3, 0.02))
    return x, faces


def scene(height: float = 0.03, size: float = 0.1, **fields: Any) -> dict[str, Any]:
    """A coarse sheet falls on a cube whose corners turn under it."""
    model = {"plugin": "sheet", "size": [size, size], "resolution": [7, 7], "plane": "xz",
             "centre": [0.003, height, 0.002], "fabric": "jacket"}  # fmt: skip
    return {
        "nuno": 1, "name": "turn", "duration": BODY_FRAMES / 100, "frame_rate": 100,
        "solver": {"plugin": "symplectic_euler", "dt": "0.2 ms"},
        "cloth_contact": {"plugin": "offset", "thickness": "1 mm", "bodies": ["cube"]},
        "objects": [{"name": "sheet", "model": model}],
        "bodies": [{"name": "cube", "collider": {"plugin": "mesh", "file": "cube.obj"}, "motion": TURN}],
    } | fields  # fmt: skip


def run_on_body(folder: Path, **fields: Any) -> tuple[int, Path]:
    """Exit code and recording."""
    write_obj(folder / "cube.obj", *cube())
    (folder / "turn.yaml").write_text(yaml.safe_dump(scene(**fields)))
    record = folder / "turn.mcap"
    return main(["run", str(folder / "turn.yaml"), "--record", str(record), "--no-view"]), record


def judged(record: Path) -> list[tuple[bool, dict[str, Any]]]:
    """Of each frame whether anything passes through anything, as ipctk sees it, and what the service has found."""
    (corners, body), found = cube(), []
    with open_recording(record) as recording:
        reports = [recording.json(message.payload) for message in recording.messages([PENETRATION.name])]
        faces = np.concatenate([recording.fabric()[0]["faces"], body + np.int32(49)])
        for frame, report in zip(recording.frames(), reports, strict=True):
            c, s = np.cos(np.pi * frame.t), np.sin(np.pi * frame.t)
            places = corners @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
            x = np.concatenate([np.asarray(frame.x, np.float64), places])
            found.append((Oracle(x, faces).crossed(x), report))
    return found


def test_nothing_passes_through_a_body_that_is_met_as_cloth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, record = run_on_body(tmp_path)
    said = capsys.readouterr().out
    frames = judged(record)
    assert (code, len(frames)) == (0, BODY_FRAMES + 1)
    assert all(not crossed and report["crossings"] == 0 for crossed, report in frames)
    assert f"cloth passes through cloth or cube in 0 of {BODY_FRAMES + 1} frames" in said
    with open_recording(record) as recording:
        x = list(recording.frames())[-1].x
    assert x[:, 1].max() > 0.015 > x[:, 1].min()


def test_cloth_that_passes_through_a_body_is_told_with_place_and_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where contact knows nothing of the body; in just the frames in which ipctk sees it."""
    prepare = Offset.prepare
    monkeypatch.setattr(Offset, "prepare", lambda *given: prepare(*given[:6]))
    code, record = run_on_body(tmp_path)
    said, problem = capsys.readouterr()
    frames = judged(record)
    crossed = [report for seen, report in frames if seen]
    assert code == 1 and 0 < len(crossed) < len(frames)
    assert all(seen == (report["crossings"] > 0) for seen, report in frames)
    assert {tuple(pair) for report in crossed for pair in report["objects"]} == {("sheet", "cube"), ("cube", "sheet")}
    assert all(np.linalg.norm(place) < 0.06 for report in crossed for place in report["places"])
    words = f"cloth passes through cloth or cube in {len(crossed)}"
    assert words in said and words in problem


FAULTS: dict[str, tuple[dict[str, Any], str, str]] = {
    "of no body": (
        {"cloth_contact": {"plugin": "offset", "bodies": ["cub"]}}, "cloth_contact.bodies[0]", "did you mean 'cube'?",
    ),
    "twice": (
        {"cloth_contact": {"plugin": "offset", "bodies": ["cube", "cube"]}}, "cloth_contact.bodies[1]", "named twice",
    ),
    "with another contact": (
        {"bodies": [scene()["bodies"][0] | {"contact": {"plugin": "sliding"}}]},
        "cloth_contact.bodies[0]", "contact of its own",
    ),
    "not of triangles": (
        {"bodies": [{"name": "cube", "collider": {"plugin": "sphere", "radius": "1 cm"}}]},
        "cloth_contact.bodies", "meets bodies of triangles",
    ),
    "through it": ({"height": 0.01}, "cloth_contact.bodies", "sheet passes through cube where it starts"),
    "through it for good": (
        {"height": 0.01, "operations": [{"plugin": "untangle", "iterations": 5}]}, "operations[0]",
        "cloth still passes through a body after 5 iterations",
    ),
    "inside": ({"height": 0.0, "size": 0.02}, "cloth_contact.bodies", "starts inside of cube (49 of 49 vertices)"),
    "touching": ({"height": 0.02 + 5e-9}, "cloth_contact", "sheet touches cube where it starts"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_bodies_that_cannot_be_met(fault: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    change, field, words = FAULTS[fault]
    code, record = run_on_body(tmp_path, **change)
    said = capfd.readouterr().err
    assert code == 2 and not record.exists()
    assert f"{tmp_path / 'turn.yaml'}:" in said and field in said and words in said and "Traceback" not in said


@pytest.mark.parametrize("other", ["cube", "sheet"])
def test_what_starts_nearer_than_the_thickness_is_pushed_apart(other: str, tmp_path: Path) -> None:
    """From 0.3 mm on: contact gives what it has stored, and no more, until little of it is left."""
    given = scene(0.0203, bodies=[{"name": "cube", "collider": {"plugin": "mesh", "file": "cube.obj"}}], duration=0.4)
    write_obj(tmp_path / "cube.obj", *cube())
    if other == "sheet":
        below = given["objects"][0]["model"] | {"centre": [0.003, 0.02, 0.002]}
        given["objects"].append({"name": "below", "model": below})
        given |= {"gravity": [0.0, 0.0, 0.0], "bodies": [], "cloth_contact": {"plugin": "offset", "thickness": "1 mm"}}
    (tmp_path / "pressed.yaml").write_text(yaml.safe_dump(given))
    run_on_body = Simulation.with_bodies(scene_file.read(tmp_path / "pressed.yaml"), 1)
    reports = [run_on_body.present().report] + [run_on_body.step().report for _ in range(40)]
    total = [sum(report.energy.values()) for report in reports]
    stored = reports[0].energy["cloth_contact"]
    assert stored > 0.0 and max(total) <= total[0] + 1e-3 * stored
    assert reports[-1].energy["cloth_contact"] < 0.1 * stored


@pytest.mark.parametrize("deep", [1e-4, 1e-3, 4e-3])
@pytest.mark.parametrize("across", [7, 25])
def test_cloth_that_starts_in_a_body_is_untangled_from_it(deep: float, across: int, tmp_path: Path) -> None:
    """A ball reaches through a sheet, as ipctk sees it, and does so no more; what is some edges from it stays."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    ball.export(tmp_path / "cube.obj")
    given = scene(0.03 - deep, bodies=[{"name": "cube", "collider": {"plugin": "mesh", "file": "cube.obj"}}])
    given["objects"][0]["model"]["resolution"] = [across, across]
    (tmp_path / "in.yaml").write_text(yaml.safe_dump(given))
    plain = scene_file.read(tmp_path / "in.yaml")
    (tmp_path / "out.yaml").write_text(yaml.safe_dump(given | {"operations": [{"plugin": "untangle"}]}))
    start, freed = (build_start(loaded) for loaded in (plain, scene_file.read(tmp_path / "out.yaml")))
    faces = np.concatenate([start.fabrics[0].faces, ball.faces + np.int32(across**2)])
    for made, through in ((start, True), (freed, False)):
        x = np.concatenate([made.fabrics[0].position, ball.vertices])
        assert bool(Oracle(x, faces, len(ball.vertices)).crossed(x)) == through
    moved = np.linalg.norm(freed.fabrics[0].position - start.fabrics[0].position, axis=1)
    far = np.linalg.norm(start.fabrics[0].position[:, [0, 2]], axis=1) > 0.045
    assert moved.max() < 4.0 * deep + 4e-3 and (across == 7 or not moved[far].any())
    assert freed.facts[0]["facts"]["crossings"] > 0.0


def test_cloth_without_triangles_cannot_meet_them(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    np.savez(
        tmp_path / "net.npz", x=np.arange(3)[:, None] * np.eye(3)[:1], v=np.zeros((3, 3)), m=np.ones(3),
        pinned=np.arange(3) == 0, springs=np.array([[0, 1], [1, 2]]), k=np.ones(2), rest=np.ones(2), c=np.zeros(2),
    )  # fmt: skip
    code, _ = run_on_body(tmp_path, objects=[{"name": "net", "model": {"plugin": "net", "file": "net.npz"}}])
    assert code == 2 and "only cloth of triangles" in capfd.readouterr().err


@pytest.mark.parametrize("size", [0.1, 0.005])
def test_cloth_is_no_thicker_than_its_edges_are_cut(size: float, tmp_path: Path) -> None:
    """Edges of 17 mm that start pressed to 0.8 may be; of 0.8 mm they may not."""
    sheet = piles.sheet(7, size)
    write_obj(tmp_path / "sheet.obj", sheet.position, sheet.faces)
    objects = [{"name": "sheet", "model": {"plugin": "mesh", "file": "sheet.obj", "fabric": "denim"}}]
    (tmp_path / "small.yaml").write_text(yaml.safe_dump(scene(objects=objects, bodies=[], cloth_contact="none")))
    fabric = build_start(scene_file.read(tmp_path / "small.yaml")).fabrics[0]
    assert fabric.membrane is not None
    middle = fabric.position.mean(axis=0)
    pressed = replace(fabric, position=middle + 0.005 / size * (fabric.position - middle))
    if size == 0.1:
        check_thickness(pressed, 1e-3)
        return
    with pytest.raises(BadInput, match="thicker than its shortest edge is long"):
        check_thickness(pressed, 1e-3)


JACKET = {"plugin": "sheet", "resolution": [12, 12], "size": [0.12, 0.12], "plane": "xz", "fabric": "jacket"}
LEANS = JACKET | {"rotate": {"axis": [1, 0.3, 0], "angle": "25 deg"}, "centre": [0, 0.01, 0], "pin": ["top-row"]}
CONTACT = {"plugin": "offset", "thickness": "2 mm"}
UNTANGLE: list[dict[str, Any]] = [{"plugin": "untangle"}]


def two_sheets(folder: Path, **fields: Any) -> Path:
    """A sheet that leans through a level one."""
    objects = [{"name": "level", "model": JACKET}, {"name": "leaning", "model": LEANS}]
    given: dict[str, Any] = {"objects": objects, "solver": {"plugin": "symplectic_euler", "dt": "auto"}}
    return write_scene(folder, **given | {"cloth_contact": CONTACT, "duration": 0.1} | fields)


def crosses(fabric: Fabric, x: Float) -> bool:
    mesh = ipctk.CollisionMesh(fabric.position, edge_numbers(fabric.faces)[1], fabric.faces)
    return bool(ipctk.has_intersections(mesh, x))


def start(path: Path, *overrides: str) -> Fabric:
    """The cloth where a scene starts."""
    return cloth.build_fabric(scene_file.read(path, overrides))[0]


def test_a_tangled_start_is_refused_and_names_what_untangles_it(tmp_path: Path) -> None:
    with pytest.raises(BadInput) as caught:
        Simulation(scene_file.read(two_sheets(tmp_path)), None, None, 1)
    assert "operations: [{plugin: untangle}]" in (caught.value.remedy or "")
    assert "edges through triangles" in caught.value.problem


def test_an_untangled_start_stays_so_and_is_the_same_over_threads(tmp_path: Path) -> None:
    """In every frame; pins where they were, to the bit."""
    path = two_sheets(tmp_path, operations=UNTANGLE)
    before, digests = start(path, "operations=[]"), []
    assert crosses(before, before.position)
    for threads in (1, 2):
        simulation = Simulation(scene_file.read(path), None, None, threads)
        fabric = simulation.fabric
        assert fabric.position[fabric.pinned].tobytes() == before.position[before.pinned].tobytes()
        for _ in range(5):
            assert not crosses(fabric, simulation.state.x)
            assert simulation.advance(None, None).report.status == "ok"
        digests.append(simulation.digest())
    assert digests[0] == digests[1]


def test_the_report_tells_what_was_moved(tmp_path: Path) -> None:
    path = two_sheets(tmp_path, operations=UNTANGLE)
    whole = nuno.run(path, record=tmp_path / "whole.mcap")
    told = whole.report["arranged"]
    assert [(one["operation"], one["object"]) for one in told] == [("untangle", "")]
    assert told[0]["facts"]["crossings"] > 20 and 0.0 < told[0]["facts"]["mean"] < told[0]["facts"]["largest"] < 0.02
    assert whole.report["cloth_contact"]["crossed"] == 0
    rows = dict(lines(whole.report))
    assert "edges went through triangles at the start" in rows["untangle"]


def test_a_run_goes_on_from_a_checkpoint_in_the_same_bits(tmp_path: Path) -> None:
    """What is not kept in it is untangled again."""
    loaded = scene_file.read(two_sheets(tmp_path, operations=UNTANGLE))
    whole = Simulation(loaded, None, None, 1)
    whole.advance(None, None)
    point, resumed = whole.keep(), Simulation(loaded, None, None, 1)
    resumed.resume(point)
    for _ in range(2):
        assert whole.advance(None, None).digest == resumed.advance(None, None).digest


def test_one_object_is_moved_alone_and_those_that_may_meet_are_left(tmp_path: Path) -> None:
    path = two_sheets(tmp_path)
    before = start(path)
    alone = start(path, "operations=[{plugin: untangle, object: leaning}]")
    assert alone.position[:144].tobytes() == before.position[:144].tobytes()
    assert not crosses(alone, alone.position)
    free = start(path, "operations=[{plugin: untangle}]", "cloth_contact.allow=[[level, leaning]]")
    assert free.position.tobytes() == before.position.tobytes()


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"operations": [{"plugin": "untangle", "at": 0.05}]}, "operations[0].at: this operation is for the start"),
        ({"operations": [{"plugin": "untangle", "object": "shirt"}]}, "no object has this name"),
        ({"operations": [{"plugin": "untangle", "gap": -1}]}, "operations[0].gap"),
        ({"operations": [{"plugin": "untangle", "iterations": 1}]}, "still passes through cloth after 1 iterations"),
    ],
)
def test_what_cannot_be_is_said(tmp_path: Path, fields: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInput) as caught:
        start(two_sheets(tmp_path, **fields))
    assert said in str(caught.value)


def test_what_stays_tangled_of_a_sewn_garment_is_named_by_its_panels(tmp_path: Path) -> None:
    """Two tubes that go through each other, of panels with names of their own."""
    objects = []
    for name, aside in (("inner", 0.0), ("outer", 7.0)):
        parts = {f"{name}-{part['translation'][2]:+d}": part for part in (front(), back())}
        for part in parts.values():
            part["translation"][0] += aside
        one, two = parts
        sewn = pattern(parts, stitch(f"{one}[1]", f"{two}[2]"), stitch(f"{one}[3]", f"{two}[0]"))
        (tmp_path / f"{name}.json").write_text(json.dumps(sewn))
        model = {"plugin": "pattern", "file": f"{name}.json", "edge": "3 cm", "fabric": "denim"}
        objects.append({"name": name, "model": model})
    with pytest.raises(BadInput) as caught:
        start(write_scene(tmp_path, objects=objects, operations=[{"plugin": "untangle", "iterations": 1}]))
    said, first = str(caught.value.value), ("inner", "outer")
    assert "cut panels" in (caught.value.remedy or "")
    assert any(re.match(rf"{i}-[+-]15 of {i} through {j}-[+-]15 of {j}, at ", said) for i, j in (first, first[::-1]))


def test_cloth_that_moves_is_not_untangled(tmp_path: Path) -> None:
    """That is for the start."""
    path = two_sheets(tmp_path, operations=UNTANGLE)
    simulation = Simulation(scene_file.read(path), None, None, 1)
    with pytest.raises(BadInput, match="for the start"):
        simulation.add("untangle: {object: level}")
    assert np.isfinite(simulation.state.x).all()


@pytest.mark.full
def test_a_garment_that_starts_in_itself_is_untangled() -> None:
    """A shirt with wide sleeves, whose underarms pass through each other on a mannequin with low arms.

    By 72 edges: with few it begins in itself or not by a machine's last digits.
    """
    low = ["bodies.mannequin.collider.arms=40 deg", "cloth_contact=none", "objects.shirt.model.around=100",
           "objects.shirt.model.cuff=15cm"]  # fmt: skip
    path = shipped.find("shirt-on-mannequin")
    before = start(path, *low)
    after = cloth.build_start(scene_file.read(path, [*low, "operations=[{plugin: untangle}]"]))
    assert crosses(before, before.position)
    assert not crosses(before, after.fabrics[0].position)
    assert after.facts[0]["facts"]["largest"] < 0.03
