"""Lines with a width in runs: on measured and sewn cloth, by any solver, resumed, taken back, under refinement."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_run import start_long
from matplotlib.tri import LinearTriInterpolator, Triangulation
from scattered_meshes import irregular, shuffled
from scenes import write_scene
from sewing_patterns import column, tube

import nuno
from nuno.resimulation.verification import verify
from nuno.runtime import supervisor
from nuno.runtime.service import Options
from nuno.scene import scene_file
from nuno.simulation.cloth import build_fabrics, start_state
from nuno.simulation.run import Simulation
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int

SIZE = 0.4
LINE = {"points": [[-0.1, -0.05, 0.0], [0.1, -0.02, 0.0]], "height": 0.04, "width": 0.24}


def write_mesh(path: Path, x: Float, faces: Int) -> None:
    rows = [f"v {a!r} {b!r} {c!r}" for a, b, c in x.tolist()]
    path.write_text("\n".join([*rows, *(f"f {i} {j} {k}" for i, j, k in (faces + 1).tolist())]) + "\n")


def hung(folder: Path, n: int, *operations: dict[str, Any], **fields: Any) -> Path:
    """A measured piece, of triangles of any shape and n vertices a side, hung by its upper edge."""
    points, faces = irregular(n)
    write_mesh(folder / "piece.obj", SIZE * (points - [0.5, 0.5, 0.0]), faces)
    top = {"low": [-1, 0.5 * SIZE - 1e-3, -1], "high": [1, 1, 1]}
    model = {"plugin": "mesh", "file": "piece.obj", "warp": [0, 1, 0], "pin": [top], "fabric": "interlock"}
    given = {"objects": [{"name": "cloth", "model": model}], "damping": 8, "solver": "leapfrog"}
    drawn = [{"plugin": "wrinkle", "tolerance": 0.1} | operation for operation in operations]
    return write_scene(folder, operations=drawn, **given | fields)


def finished(scene: Path, *overrides: str) -> Simulation:
    simulation = Simulation(scene_file.read(scene, overrides), None, None, 1)
    while not simulation.finished:
        report = simulation.advance(None, None).report
        assert report.status == "ok", report
    return simulation


def crest(simulation: Simulation) -> tuple[float, float]:
    """Mean height of the crest over the feet on both sides, and its roughness over an edge, both at the places of the
    cloth where the line was drawn.
    """
    start, end = np.array(LINE["points"])[:, :2]
    along = (end - start) / np.linalg.norm(end - start)
    foot = 0.5 * LINE["width"] * np.array([-along[1], along[0]])
    place = start + np.linspace(0.1, 0.9, 161)[:, None] * (end - start)
    at = Triangulation(*simulation.fabric.position[:, :2].T, simulation.fabric.faces)
    z = LinearTriInterpolator(at, simulation.state.x[:, 2])
    height = np.asarray(z(*place.T) - 0.5 * (z(*(place + foot).T) + z(*(place - foot).T)))
    smooth = np.polyval(np.polyfit(np.arange(161), height, 4), np.arange(161))
    return float(height.mean()), float(np.std(height - smooth))


@pytest.mark.full
def test_the_height_of_a_ridge_converges_under_refinement_and_its_crest_is_smooth(tmp_path: Path) -> None:
    found = [crest(finished(hung(tmp_path, n, {"lines": [LINE], "keep": True}, duration=1.5))) for n in (9, 17, 33)]
    (first, rough), (second, finer), (third, finest) = found
    assert abs(third - second) < 0.25 * abs(second - first)
    assert third > 0.8 * LINE["height"]
    assert rough > finer > finest and finest < 0.005 * LINE["height"]


def test_cloth_with_a_line_drawn_and_taken_back_comes_to_the_rest_of_undrawn_cloth(tmp_path: Path) -> None:
    drawn = {"lines": [LINE], "at": 0.1}, {"take_back": [1], "at": 0.3}
    ends = [finished(hung(tmp_path, 13, *some, duration=3.0, solver="implicit_euler")) for some in ((), drawn)]
    assert [change["facts"]["taken_back"] for change in ends[1].changes] == [0.0, 1.0]
    assert np.abs(ends[0].state.x - ends[1].state.x).max() < 1e-4
    still = finished(hung(tmp_path, 13, drawn[0], duration=3.0, solver="implicit_euler"))
    assert np.abs(ends[0].state.x - still.state.x).max() > 5e-3


def sewn(folder: Path, *operations: dict[str, Any], **fields: Any) -> Path:
    """A tube of two panels that falls along a column, in contact with it."""
    (folder / "tube.json").write_text(json.dumps(tube()))
    write_mesh(folder / "wearer.obj", *column((0.08, 0.08), (0.6, 1.4), around=32))
    model = {"plugin": "pattern", "file": "tube.json", "edge": 0.02, "fabric": "interlock", "over": {"body": "wearer"}}
    given = {
        "objects": [{"name": "tube", "model": model}],
        "bodies": [{"name": "wearer", "collider": {"plugin": "mesh", "file": "wearer.obj"}, "friction": 0.4}],
        "cloth_contact": {"plugin": "offset", "thickness": 1e-3, "bodies": ["wearer"]},
        "duration": 0.2, "damping": 5, "record": {"checkpoint_every": 0.06},
    }  # fmt: skip
    drawn = [{"plugin": "wrinkle", "tolerance": 0.1} | operation for operation in operations]
    return write_scene(folder, operations=drawn, **given | fields)


AROUND = {
    "points": [[-0.03, 1.1, 0.1], [0.06, 1.1, 0.08], [0.1, 1.12, 0.0], [0.06, 1.12, -0.08]],
    "height": 0.02,
    "width": 0.1,
}
"""Across the front, over the seam, and onto the back."""


@pytest.mark.full
@pytest.mark.quick(solver=["respa"])
@pytest.mark.parametrize("solver", ["implicit_euler", "xpbd", "respa", "symplectic_euler"])
def test_a_line_over_a_seam_is_replayed_and_resumed_in_the_same_bits_by_any_solver(tmp_path: Path, solver: str) -> None:
    kept, gone = {"lines": [AROUND], "keep": True, "at": 0.04}, {"take_back": [1], "at": 0.12}
    scene = sewn(tmp_path, kept, gone, solver=solver)
    whole = nuno.run(scene, record=tmp_path / "whole.mcap")
    drawn, taken = (change["facts"] for change in whole.report["changes"])
    assert drawn["mass"] > 0.0 and taken["mass"] == pytest.approx(-drawn["mass"], rel=1e-9)
    with nuno.open(whole.path) as recording:
        assert verify(recording).frame is None
    for cut in (0.12, 0.16):
        part = nuno.run(scene, f"duration={cut}", record=tmp_path / "part.mcap")
        options = Options(record=tmp_path / "on.mcap", resume=part.path)
        assert supervisor.supervise(scene_file.read(scene), options).summary["digest"] == whole.digest


@pytest.mark.full
@pytest.mark.parametrize("cloth", ["renumbered", "quads", "triangles"])
def test_lines_on_the_second_of_two_objects_are_replayed_and_resumed_in_the_same_bits(
    tmp_path: Path, cloth: str
) -> None:
    """On a membrane that steps with other numbers, and on springs in runs."""
    model = {"plugin": "sheet", "resolution": [50, 50], "size": [SIZE, SIZE], "pin": ["top-corners"], "fabric": "denim"}
    other = {"plugin": "sheet", "resolution": [5, 5], "size": [0.1, 0.1], "centre": [0, 1, 0], "fabric": "denim"}
    if cloth == "renumbered":
        x, faces, _ = shuffled(*irregular(46))
        write_mesh(tmp_path / "piece.obj", SIZE * (x - [0.5, 0.5, 0.0]), faces)
        model = {"plugin": "mesh", "file": "piece.obj", "warp": [0, 1, 0], "pin": [0], "fabric": "interlock"}
    else:
        model |= {"cells": cloth}
    first, second = LINE | {"height": 0.02, "width": 0.12}, LINE | {"height": -0.02, "width": 0.12}
    steps = {"at": 0.04, "keep": True, "lines": [first, second]}, {"at": 0.1, "take_back": [1], "lines": [first]}
    scene = write_scene(
        tmp_path, duration=0.2, solver="leapfrog", damping=3, record={"checkpoint_every": 0.06},
        objects=[{"name": "other", "model": other}, {"name": "cloth", "model": model}],
        operations=[{"plugin": "wrinkle", "object": "cloth", "tolerance": 0.2} | step for step in steps],
    )  # fmt: skip
    assert (Simulation(scene_file.read(scene), None, None, 1).numbers is not None) == (cloth == "renumbered")
    whole = nuno.run(scene, record=tmp_path / "whole.mcap")
    assert [change["facts"]["first"] for change in whole.report["changes"]] == [1.0, 3.0]
    with nuno.open(whole.path) as recording:
        assert verify(recording).frame is None
    part = nuno.run(scene, "duration=0.14", record=tmp_path / "part.mcap")
    options = Options(record=tmp_path / "on.mcap", resume=part.path)
    assert supervisor.supervise(scene_file.read(scene), options).summary["digest"] == whole.digest


def test_lines_on_a_garment_follow_its_panels_and_its_sewn_surface(tmp_path: Path) -> None:
    loaded = scene_file.read(sewn(tmp_path))
    plugin = scene_file.read(sewn(tmp_path, {"lines": [AROUND]})).operations[0].plugin
    (flat,) = build_fabrics(loaded)

    def drawn(*lines: dict[str, Any]) -> Any:
        config = plugin.Config.model_validate({"lines": list(lines), "tolerance": 0.1})
        return plugin.apply(config, flat, start_state(flat), None).changed.fabric

    corners = flat.corners
    assert corners is not None and corners.panels is not None
    over = drawn(AROUND).relief
    faces = np.isin(flat.faces, over.vertex).any(axis=1)
    assert set(corners.panels.of[faces]) == {0, 1}
    middle = [corners.points[corners.faces[corners.panels.of == panel]].mean(axis=(0, 1)) for panel in (0, 1)]
    along = {"texture": [(middle[0] - [0.02, 0.0]).tolist(), (middle[0] + [0.02, 0.0]).tolist()]}
    front = drawn(along | {"height": 0.02, "width": 0.09}).relief
    assert set(corners.panels.of[np.isin(flat.faces, front.vertex).all(axis=1)]) == {0}
    for texture, field in (
        ([middle[0].tolist(), [5.0, 5.0]], "lines[0].texture[1]"),
        ([middle[0].tolist(), middle[1].tolist()], "lines[0]"),
    ):
        with pytest.raises(BadInput) as refused:
            drawn({"texture": texture, "height": 0.02, "width": 0.09})
        assert refused.value.field == field and refused.value.remedy


def test_a_line_through_a_body_or_other_cloth_is_refused_and_changes_nothing(tmp_path: Path) -> None:
    valley = AROUND | {"height": -0.05}
    simulation = Simulation.with_bodies(scene_file.read(sewn(tmp_path, solver="respa")))
    before = simulation.state.x.tobytes(), simulation.fabric
    with pytest.raises(BadInput, match="pass through"):
        simulation.add(f"wrinkle: {json.dumps({'lines': [valley], 'tolerance': 0.1})}")
    assert simulation.state.x.tobytes() == before[0] and simulation.fabric is before[1]
    simulation.add(f"wrinkle: {json.dumps({'lines': [AROUND], 'tolerance': 0.1})}")
    assert simulation.state.x.tobytes() != before[0]


@pytest.mark.parametrize(
    ("operations", "field"),
    [
        (({"take_back": [1]},), "operations[0].take_back[0]"),
        (({"lines": [LINE], "at": 0.2}, {"take_back": [1], "at": 0.1}), "operations[1].take_back[0]"),
        (({"lines": [LINE]}, {"take_back": [1, 2]}), "operations[1].take_back[1]"),
        (({"lines": [LINE]}, {"take_back": [1]}, {"take_back": [1], "at": 0.1}), "operations[2].take_back[0]"),
        (({"lines": [{**LINE, "width": None}]},), "operations[0].lines[0].width"),
        (({"take_back": [0]},), "operations[0].take_back[0]"),
        (({"lines": [LINE | {"width": -1}]},), "operations[0].lines[0].width"),
    ],
)
def test_what_cannot_be_is_refused_before_the_run_by_its_line(
    tmp_path: Path, operations: tuple[dict[str, Any], ...], field: str
) -> None:
    with pytest.raises(BadInput) as refused:
        Simulation(scene_file.read(hung(tmp_path, 9, *operations)), None, None, 1)
    assert refused.value.field == field and refused.value.line is not None


def test_lines_are_drawn_and_taken_back_while_a_run_goes_on(tmp_path: Path) -> None:
    path = hung(tmp_path, 17)
    data = scene_file.read(path).data
    run = start_long(tmp_path, objects=data["objects"], bodies=[], solver="leapfrog", damping=8)
    run.control("pause")
    run.wait_until_paused()
    line = f"wrinkle: {json.dumps({'lines': [LINE], 'keep': True, 'tolerance': 0.5})}"
    for item, facts in (
        (line, {"first": 1.0}),
        (line, {"first": 2.0}),
        ("wrinkle: {take_back: [1]}", {"taken_back": 1.0}),
    ):
        answer = run.control("add", item=item)
        assert answer["ok"] and answer["new"].items() >= facts.items(), answer
        run.control("step", frames=3)
        run.wait_until_paused()
    for number in (1, 3):
        answer = run.control("add", item=f"wrinkle: {{object: cloth, take_back: [{number}]}}")
        assert not answer["ok"] and "take_back[0]" in answer["error"], answer
    assert run.stop().state == "stopped"
    with nuno.open(run.record) as recording:
        assert verify(recording).frame is None
