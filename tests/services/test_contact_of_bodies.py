"""Contact is each body's own: meshes that cloth slides on, beside planes and distance fields that push it out."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml
from cloth_in_bodies import meeting
from refusals import Refused
from scenes import write_scene

import nuno
from nuno.bus.encodings import decode_arrays, decode_points
from nuno.cli import main
from nuno.collision.bodies import build_bodies
from nuno.collision.distance import signed_distance
from nuno.recording.reader import open_recording
from nuno.resimulation.verification import Verification, verify
from nuno.runtime import supervisor
from nuno.runtime.service import Options
from nuno.scene import scene_file
from nuno_cloth.models.delaunay import triangulate
from nuno_geometry.closest_point import closest_points
from nuno_geometry.tree import build_tree
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import FABRIC, PENETRATION, STATE

G = 9.81
CUBE = """v -1 -1 -1
v 1 -1 -1
v 1 1 -1
v -1 1 -1
v -1 -1 1
v 1 -1 1
v 1 1 1
v -1 1 1
f 1 4 3 2
f 5 6 7 8
f 1 2 6 5
f 4 8 7 3
f 1 5 8 4
f 2 3 7 6
"""
SLIDING = {"plugin": "sliding", "gap": "1 mm"}


def cube(name: str, x: float, **fields: Any) -> dict[str, Any]:
    """A cube of 20 cm from x, whose upper side is at 30 cm."""
    return {
        "name": name,
        "collider": {"plugin": "mesh", "file": "cube.obj", "scale": 0.1, "centre": [x, 0.2, 0]},
        **fields,
    }


BODIES = [
    cube("block", 0.0, contact=SLIDING),
    {"name": "floor", "collider": {"plugin": "plane", "normal": [0, 1, 0]}, "stiffness": 100, "friction": 0.4},
    cube("step", 1.0, contact={"plugin": "sliding", "gap": "3 mm"}, friction=0.1),
]


def write(folder: Path, **fields: Any) -> Path:
    """Points of 10 g that fall 1 cm onto each body, gravity leaning by a fifth towards x."""
    (folder / "cube.obj").write_text(CUBE)
    x = np.array([[0.0, 0.31, 0.0], [0.5, 0.01, 0.0], [0.95, 0.31, 0.0]])
    none = np.zeros(0)
    np.savez(
        folder / "points.npz", x=x, v=np.zeros_like(x), m=np.full(3, 0.01), pinned=np.zeros(3, bool),
        springs=np.zeros((0, 2), np.int64), k=none, rest=none, c=none,
    )  # fmt: skip
    scene = {
        "nuno": 1, "name": "points", "duration": 0.5, "frame_rate": 50,
        "solver": {"plugin": "symplectic_euler", "dt": "1 ms"}, "gravity": [G / 5, -G, 0], "bodies": BODIES,
        "objects": [{"name": "points", "model": {"plugin": "net", "file": "points.npz"}}],
    }  # fmt: skip
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump(scene | fields))
    return path


@pytest.mark.quick(name=["symplectic_euler"])
@pytest.mark.parametrize("name", ["symplectic_euler", "leapfrog", "implicit_euler", "tr_bdf2", "xpbd"])
def test_each_point_rests_or_slides_as_its_body_says(name: str, tmp_path: Path) -> None:
    """Held by friction 0.3 at the gap of the block, by 0.4 in the floor at m g / k, and let go by 0.1 at the step's
    gap; the same again from the middle on, and once more to compare.
    """
    solver = {"plugin": name, "dt": "1 ms"}
    whole = nuno.run(write(tmp_path, solver=solver, record={"checkpoint_every": 0.1}), record=tmp_path / "whole.mcap")
    assert whole.x[:, 1] == pytest.approx([0.301, -0.01 * G / 100.0, 0.303], abs=1e-6)
    assert whole.v[:, 0] == pytest.approx([0.0, 0.0, 0.1 * G * 0.5], abs=5e-3)
    assert whole.report["counts"]["touching"] == 3
    with whole.recording as recording:
        assert verify(recording) == Verification(26, published=26, kept=5)
        early = nuno.run(tmp_path / "scene.yaml", "duration=0.2", record=tmp_path / "early.mcap")
    resumed = supervisor.supervise(scene_file.read(tmp_path / "scene.yaml"), Options(resume=early.path))
    assert resumed.summary["digest"] == whole.digest


def test_bodies_out_of_reach_change_no_bit(tmp_path: Path) -> None:
    """What a point does on its body, it does with that body alone, whichever way the body came by its contact."""
    whole = nuno.run(write(tmp_path))
    for number, body in enumerate(BODIES):
        plain = {name: value for name, value in body.items() if name != "contact"}
        alone = nuno.run(write(tmp_path, bodies=[plain], contact=body.get("contact", {"plugin": "penalty"})))
        assert (alone.x[number].tobytes(), alone.v[number].tobytes()) == (
            whole.x[number].tobytes(), whole.v[number].tobytes()
        )  # fmt: skip


@pytest.mark.full
def test_a_point_between_two_kinds_of_contact_enters_neither(tmp_path: Path) -> None:
    """Gravity leans it against a block, which it slides down until it is in the floor by what it weighs."""
    block = cube("block", 0.611, contact=SLIDING, friction=0.0)
    block["collider"]["centre"][1] = 0.0
    found = nuno.run(write(tmp_path, bodies=[block, BODIES[1] | {"friction": 0.0}], duration=1.0))
    assert found.x[1, :2] == pytest.approx([0.51, -0.01 * G / 100.0], abs=1e-6)


@pytest.mark.full
def test_what_a_mesh_presses_into_a_floor_stays_off_the_mesh(tmp_path: Path) -> None:
    """The floor gives way: the cube's lower side ends 5 mm inside of it, and the point its gap lower."""
    down = {"plugin": "keyframes", "times": [0.1, 0.3], "positions": [[0, 0, 0], [0, -0.105, 0]]}
    found = nuno.run(write(tmp_path, bodies=[BODIES[1], cube("press", 0.5, contact=SLIDING, motion=down)]))
    assert found.x[1, 1] == pytest.approx(-0.006, abs=1e-7)


def test_plan_says_which_contact_is_with_which_bodies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bodies = [BODIES[0], BODIES[1], cube("twin", 1.0, contact=SLIDING)]
    assert main(["plan", str(write(tmp_path, bodies=bodies))]) == 0
    plan = capsys.readouterr().out
    assert re.search(r"^contact +sliding with block, twin; penalty with floor$", plan, re.MULTILINE)
    sizes = dict(re.findall(r"^bodies +(\w+): (.*) m \(x, y, z\) at the start$", plan, re.MULTILINE))
    assert sizes == dict.fromkeys(("block", "twin"), "0.2 x 0.2 x 0.2")  # a plane has none


def test_each_distance_field_is_read_where_its_body_is_met_by_it(tmp_path: Path) -> None:
    """Sent and measured by where contact is penalty; where it is sliding, the triangles are."""
    fields = {"plugin": "sdf", "file": "cube.obj", "scale": 0.1, "tolerance": "5 mm"}
    bodies = [
        {"name": "first", "collider": fields, "contact": SLIDING},
        {"name": "second", "collider": fields | {"centre": [1, 0, 0]}},
    ]
    found = build_bodies(scene_file.read(write(tmp_path, bodies=bodies)))
    first, second = found.geometry.fields
    assert first is None and second is not None
    edge = np.array([[0.0999, 0.0999, 0.0]])
    depths = [-signed_distance(edge + np.array([x, 0.0, 0.0]), found.geometry, found.poses(0.0))[0] for x in (0.0, 1.0)]
    assert depths[0] == pytest.approx(1e-4, abs=1e-12) and abs(depths[1] - 1e-4) > 1e-5


FLOOR = BODIES[1]
FAULTS: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
    "a mesh that is left to penalty": (
        {"bodies": [FLOOR, cube("block", 0.0)]},
        ("penalty contact knows no meshes", "block", "contact: {plugin: sliding}"),
    ),
    "a plane to slide on": (
        {"bodies": [BODIES[0], FLOOR | {"contact": SLIDING}]},
        ("is with meshes", "bodies[1].contact", "{plugin: penalty}"),
    ),
    "no such contact": (
        {"bodies": [FLOOR | {"contact": {"plugin": "slidng"}}]}, ("bodies[0].contact.plugin", "'sliding'"),
    ),
    "a field that the body's contact has not": (
        {"bodies": [FLOOR | {"contact": {"plugin": "penalty", "gap": 1}}]}, ("bodies[0].contact.gap",),
    ),
    "the scene's, though no body takes it": (
        {"bodies": [BODIES[0]], "contact": {"plugin": "slidng"}}, ("contact.plugin", "'sliding'"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_contacts_that_cannot_be_are_refused_where_they_stand(fault: str, refused: Refused, tmp_path: Path) -> None:
    fields, words = FAULTS[fault]
    said = refused("run", write(tmp_path, **fields), "--no-view", "--no-record")
    for word in words:
        assert word in said


TOLERANCE = 2e-3


@pytest.mark.full
def test_an_open_body_is_told_of_by_name_and_measured_by_its_winding_number(tmp_path: Path) -> None:
    """A piece of cloth is put 1 cm into a ball with a hole below: its depth is that below the triangles."""
    ball = trimesh.creation.icosphere(3, 0.3)
    kept = ball.faces[ball.triangles_center[:, 1] > -0.25]
    holed = trimesh.Trimesh(ball.vertices, kept, process=False)
    holed.export(tmp_path / "open.ply")
    cloth = {"plugin": "sheet", "size": [0.04, 0.04], "resolution": [4, 4], "plane": "xz", "centre": [0, 0.29, 0]}
    scene = write_scene(
        tmp_path, duration=0.02, solver={"plugin": "symplectic_euler", "dt": "auto"},
        objects=[{"name": "cloth", "model": cloth}],
        bodies=[{"name": "ball", "collider": {"plugin": "sdf", "file": "open.ply", "tolerance": TOLERANCE}}],
    )  # fmt: skip
    recorded = tmp_path / "run.mcap"
    nuno.run(scene, record=recorded)
    with open_recording(recorded) as recording:
        (warning,) = [json.loads(m.payload)["text"] for m in recording.messages(["run/event/collision"])]
        x = decode_points(next(iter(recording.messages([STATE.name]))).payload)
        depth = json.loads(next(iter(recording.messages([PENETRATION.name]))).payload)["depth"]
    rim = len(trimesh.grouping.group_rows(holed.edges_sorted, require_count=1))
    assert warning.startswith(f"ball: the mesh has a hole: edges with one triangle ({rim}): edge ")
    assert warning.endswith("inside is where its winding number says")
    below = np.abs(closest_points(build_tree(ball.vertices, kept.astype(np.int32)), x).distance).max()
    assert depth == pytest.approx(below, abs=TOLERANCE) and depth > 2.0 * TOLERANCE


def draped(folder: Path, kind: str, **contact: Any) -> dict[str, Any]:
    """The report of coarse cloth that falls over a thin limb: a square, scattered triangles, a ribbon of one cell."""
    model: dict[str, Any] = {"plugin": "sheet", "size": [0.48, 0.48], "resolution": [9, 9], "plane": "xz"}
    if kind == "ribbon":
        model |= {"size": [0.48, 0.06], "resolution": [9, 2]}
    if kind == "mesh":
        inside = np.random.default_rng(0).uniform(-0.22, 0.22, (60, 2))
        side = np.linspace(-0.24, 0.24, 9)
        border = [np.stack(pair, 1) for t in (-0.24, 0.24) for pair in ((side, 0 * side + t), (0 * side + t, side))]
        flat = np.unique(np.concatenate([inside, *border]), axis=0)
        faces = triangulate(flat)
        sheet = trimesh.Trimesh(np.stack([flat[:, 0], 0 * flat[:, 0], flat[:, 1]], 1), faces, process=False)
        sheet.export(folder / "cloth.obj")
        model = {"plugin": "mesh", "file": "cloth.obj", "warp": [1, 0, 0]}
    model["centre"] = [0, 0.6, 0]
    limb = {"plugin": "capsule", "a": [0, 0.55, -1], "b": [0, 0.55, 1], "radius": 0.04}
    scene = {
        "nuno": 1, "name": "drape", "duration": 0.8, "frame_rate": 60, "damping": 0.5,
        "solver": {"plugin": "symplectic_euler", "dt": "auto"}, "contact": {"plugin": "penalty", **contact},
        "objects": [{"name": "cloth", "model": model | {"fabric": "jacket"}}],
        "bodies": [{"name": "limb", "collider": limb}],
    }  # fmt: skip
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump(scene))
    report = nuno.run(path, record=folder / "run.mcap").report
    series = nuno.open(folder / "run.mcap").series()
    assert (report["area"], report["area_depth"]) == (series["area"].max(), series["area_depth"].max())
    bodies = build_bodies(scene_file.read(path))
    with open_recording(folder / "run.mcap") as recording:
        faces = decode_arrays(next(iter(recording.messages([FABRIC.name]))).payload)[0]["faces"]
        cloth = [decode_points(message.payload) for message in recording.messages([STATE.name])]
    met = [meeting(x, faces, bodies.geometry, bodies.poses(0.0)).any() for x in cloth]
    return report | {"met": sum(met)}


@pytest.mark.parametrize("kind", ["sheet", "mesh", "ribbon"])
def test_cloth_rests_on_a_limb_with_no_part_inside(kind: str, tmp_path: Path) -> None:
    """Without a margin triangles cut through it between vertices that stay outside."""
    report = draped(tmp_path, kind)
    assert report["area"] == report["area_depth"] == report["penetration"] == report["met"] == 0
    bare = draped(tmp_path, kind, margin=0.0)
    assert bare["area"] > 1e-4 and bare["area_depth"] > bare["penetration"] and bare["met"] > 10


@pytest.mark.parametrize(("margin", "limit"), [("40 mm", "0.04 m"), ("5 cm", "0.04 m"), ("-1 mm", "0")])
def test_a_margin_below_zero_or_as_thick_as_a_limb_is_refused(margin: str, limit: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput) as error:
        draped(tmp_path, "sheet", margin=margin)
    assert ": contact.margin:" in str(error.value) and limit in str(error.value)
