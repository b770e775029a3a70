"""Cloth that meets a body of triangles as it meets cloth, in a whole run: what is checked of it, told, and refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml

from nuno.cli import main
from nuno.collision.surfaces import box_mesh
from nuno.recording.reader import open_recording
from nuno.scene import scene_file
from nuno.simulation.cloth.build import build_start
from nuno.simulation.run import Simulation
from nuno_bench import piles
from nuno_bench.piles import Oracle, write_obj
from nuno_contact.offset.plugin import Offset, check_thickness
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.messages import PENETRATION

FRAMES = 20
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
        "nuno": 1, "name": "turn", "duration": FRAMES / 100, "frame_rate": 100,
        "solver": {"plugin": "symplectic_euler", "dt": "0.2 ms"},
        "cloth_contact": {"plugin": "offset", "thickness": "1 mm", "bodies": ["cube"]},
        "objects": [{"name": "sheet", "model": model}],
        "bodies": [{"name": "cube", "collider": {"plugin": "mesh", "file": "cube.obj"}, "motion": TURN}],
    } | fields  # fmt: skip


def run(folder: Path, **fields: Any) -> tuple[int, Path]:
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
    code, record = run(tmp_path)
    said = capsys.readouterr().out
    frames = judged(record)
    assert (code, len(frames)) == (0, FRAMES + 1)
    assert all(not crossed and report["crossings"] == 0 for crossed, report in frames)
    assert f"cloth passes through cloth or cube in 0 of {FRAMES + 1} frames" in said
    with open_recording(record) as recording:
        x = list(recording.frames())[-1].x
    assert x[:, 1].max() > 0.015 > x[:, 1].min()


def test_cloth_that_passes_through_a_body_is_told_with_place_and_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where contact knows nothing of the body; in just the frames in which ipctk sees it."""
    prepare = Offset.prepare
    monkeypatch.setattr(Offset, "prepare", lambda *given: prepare(*given[:6]))
    code, record = run(tmp_path)
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
    code, record = run(tmp_path, **change)
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
    run = Simulation.with_bodies(scene_file.read(tmp_path / "pressed.yaml"), 1)
    reports = [run.present().report] + [run.step().report for _ in range(40)]
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
    code, _ = run(tmp_path, objects=[{"name": "net", "model": {"plugin": "net", "file": "net.npz"}}])
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
