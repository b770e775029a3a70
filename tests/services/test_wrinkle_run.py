"""Lines drawn on cloth that moves: the run, its recording, and what comes of it."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_run import Run, start_long, wait_until
from scenes import write_scene

import nuno
from nuno.cli import main
from nuno.exports.cloth import Pieces
from nuno.recording.restore import control_events
from nuno.replay.verification import verify
from nuno.runtime import runs, supervisor
from nuno.runtime.service import Options
from nuno.scene import scene_file, shipped
from nuno.simulation.run import Simulation
from nuno_contact.offset.contact_state import CUT
from nuno_schemas.errors import BadInput, RunFailed

INTEGRATORS = ("dopri5", "implicit_euler", "leapfrog", "xpbd")
"""One of each kind: chosen steps, implicit, explicit, constraints."""
SHEET = {
    "plugin": "sheet",
    "resolution": [10, 10],
    "size": [0.3, 0.3],
    "plane": "xz",
    "cells": "triangles",
    "pin": ["top-left"],
    "fabric": {"density": 0.2, "structural": 20.0, "bending": 1.0, "hinge": 1e-5, "damping_ratio": 0.05},
}
BALL = {"name": "ball", "collider": {"plugin": "sphere", "radius": 0.1, "centre": [0, -0.11, 0]}}
LINE = {"on_faces": [{"face": 20, "at": [0.3, 0.3, 0.4]}, {"face": 112, "at": [0.3, 0.3, 0.4]}], "height": 0.01}


def cloths(folder: Path, **fields: Any) -> Path:
    """A sheet that falls onto a ball beside a small net, the first line drawn on it at 0.1 s."""
    net = {"plugin": "sheet", "resolution": [3, 3], "size": [0.1, 0.1], "centre": [0, 0.3, 0]}
    given = {
        "objects": [{"name": "sheet", "model": SHEET}, {"name": "other", "model": net}],
        "bodies": [BALL],
        "duration": 0.3,
        "operations": [{"plugin": "wrinkle", "at": 0.1, "object": "sheet", "lines": [LINE]}],
        "solver": "leapfrog",
    }
    return write_scene(folder, **given | fields)


PLAIN = {**SHEET, "cells": "quads"}
NO_HINGES = {**SHEET, "fabric": {"density": 0.2, "structural": 20.0, "bending": 1.0}}


@pytest.mark.parametrize(
    ("model", "more", "problem"),
    [
        (PLAIN, {}, "no spring along an edge"),
        (NO_HINGES, {"keep": True}, "this cloth has no hinges"),
        ({"plugin": "net", "file": "net.npz"}, {}, "cloth of triangles, which this is not"),
        ({"plugin": "mesh", "file": "bare.obj", "tension": "springs", "fabric": "silk"},
         {"lines": [{"texture": [[0.2, 0.4], [0.8, 0.5]], "height": 0.01}]}, "no texture coordinates"),
        ({"plugin": "mesh", "file": "bare.obj", "tension": "membrane", "fabric": "silk"}, {}, "no structural springs"),
    ],
)  # fmt: skip
def test_a_later_line_is_refused_before_the_run_where_the_cloth_can_never_have_it(
    model: dict[str, Any], more: dict[str, Any], problem: str, tmp_path: Path
) -> None:
    shutil.copyfile(shipped.folder() / "pendulum.npz", tmp_path / "net.npz")
    (tmp_path / "bare.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 0 1\nv 0 0 1\nf 1 2 3\nf 1 3 4\n")
    operation = {"plugin": "wrinkle", "at": 0.1, "object": "sheet", "lines": [LINE], **more}
    scene = cloths(tmp_path, objects=[{"name": "sheet", "model": model}], operations=[operation], bodies=[])
    with pytest.raises(BadInput, match=problem) as refused:
        Simulation(scene_file.read(scene), None, None, 1)
    assert str(refused.value.field).startswith("operations[0]")


def test_a_run_changes_its_cloth_at_its_frame_and_is_replayed_to_the_last_bit(tmp_path: Path) -> None:
    whole = nuno.run(cloths(tmp_path), record=tmp_path / "whole.mcap")
    change = whole.report["changes"][0]
    split = int(change["facts"]["vertices"])
    assert (change["frame"], change["object"], change["operation"]) == (5, "sheet", "wrinkle") and split > 5
    with nuno.open(whole.path) as recording:
        pieces, sizes = Pieces(recording), []
        for frame in recording.frames():
            sheet, other = pieces.at(frame.t)
            sizes.append(len(frame.x))
            assert other.stop == len(frame.x) and other.stop - other.start == 9
            assert sheet.faces.max() == sheet.stop - 1 and sheet.stretch(frame.x[: sheet.stop]).max() < 0.5
        assert sizes == [109] * 6 + [109 + split] * 10
        assert verify(recording).frame is None and verify(recording).compared == 16
    for frame in (5, 6):
        assert main(["export", str(whole.path), "--obj", str(tmp_path / f"{frame}.obj"), "--frame", str(frame)]) == 0
        text = (tmp_path / f"{frame}.obj").read_text()
        assert sum(line.startswith("v ") for line in text.splitlines()) == sizes[frame]
    assert main(["export", str(whole.path), "--gif", str(tmp_path / "a.gif"), "--size", "64x48"]) == 0
    assert main(["export", str(whole.path), "--rrd", str(tmp_path / "a.rrd")]) == 0


@pytest.mark.quick(name=["symplectic_euler"])
@pytest.mark.parametrize("name", INTEGRATORS)
def test_a_run_resumed_after_a_change_ends_in_the_same_bits(name: str, tmp_path: Path) -> None:
    scene = cloths(tmp_path, solver={"plugin": name}, allow_unstable=True, duration=0.2)
    whole = nuno.run(scene, record=tmp_path / "whole.mcap")
    assert whole.report["changes"] and np.isfinite(whole.x).all()
    for cut in (0.1, 0.15):
        part = nuno.run(scene, f"duration={cut}", record=tmp_path / "part.mcap")
        options = Options(record=tmp_path / "resumed.mcap", resume=part.path)
        resumed = supervisor.supervise(scene_file.read(scene), options)
        assert (resumed.state, resumed.summary["digest"]) == ("done", whole.digest)
        assert len(resumed.summary["changes"]) == 1
        with nuno.open(tmp_path / "resumed.mcap") as ours, nuno.open(whole.path) as reference:
            assert [f.digest for f in ours.frames()] == [f.digest for f in reference.frames()]


def test_lines_are_added_to_a_run_that_goes_on_as_often_as_wanted(tmp_path: Path) -> None:
    run = start_long(tmp_path, objects=[{"name": "sheet", "model": SHEET}], bodies=[BALL], solver="leapfrog")
    run.control("pause")
    run.wait_until_paused()
    sizes = [100]
    for item in (f"wrinkle: {{lines: [{LINE}]}}", f"wrinkle: {{lines: [{LINE}], springs: physical}}"):
        answer = run.control("add", item=item.replace("'", '"'))
        assert answer["ok"], answer
        assert answer["field"] == "sheet"
        sizes.append(sizes[-1] + int(answer["new"]["vertices"]))
        run.control("step", frames=3)
        run.wait_until_paused()
    for item, problem in (
        ("wrinkle: {lines: [{points: [[9, 9, 9], [8, 8, 8]], height: 0.01}]}", "off the cloth"),
        ("wrinkle: {lines: []}", "lines"),
        ("wrinkle: {lines: [{file: none.obj, height: 0.01}]}", "no such file"),
        ("smooth: {}", "does not change cloth"),
        ("wrinkel: {}", "did you mean 'wrinkle'"),
        ("wrinkle: {object: shirt, lines: [{points: [[0, 0, 0], [1, 0, 0]], height: 0.01}]}", "sheet"),
    ):
        answer = run.control("add", item=item)
        assert not answer["ok"] and problem in answer["error"], answer
    run.control("step", frames=2)
    run.wait_until_paused()
    assert run.stop().state == "stopped"
    with nuno.open(run.record) as recording:
        found = {len(frame.x) for frame in recording.frames()}
        assert found == set(sizes) and len(sizes) == 3
        assert [event.text for event in control_events(recording)].count("add") == 2
        assert verify(recording).frame is None


def test_a_line_added_before_the_first_frame_acts_from_the_start(tmp_path: Path) -> None:
    scene = cloths(tmp_path, operations=[], objects=[{"name": "sheet", "model": SHEET}], duration=0.1)
    run = Run(scene, tmp_path / "paused.mcap", paused=True)
    wait_until(lambda: run.run in runs.running())
    answer: dict[str, Any] = {}

    def added() -> bool:
        try:
            answer.update(run.control("add", item=f"wrinkle: {{lines: [{LINE}]}}".replace("'", '"')))
        except (BadInput, RunFailed):
            return False
        return bool(answer)

    wait_until(added)
    assert answer["ok"], answer
    run.control("resume")
    assert run.join().state == "done"
    with nuno.open(run.record) as recording:
        assert {len(frame.x) for frame in recording.frames()} == {100 + int(answer["new"]["vertices"])}
        assert verify(recording).frame is None
        point = recording.last_checkpoint()
    options = Options(record=tmp_path / "resumed.mcap", resume=run.record)
    assert supervisor.supervise(scene_file.read(scene, ("duration=0.2",)), options).state == "done"
    assert point.frame == 5
    with nuno.open(tmp_path / "resumed.mcap") as recording:
        assert verify(recording).frame is None


def test_a_scene_says_which_object_and_when(tmp_path: Path) -> None:
    for applied, field in (
        ({"plugin": "wrinkle", "lines": [LINE]}, "object"),
        ({"plugin": "wrinkle", "lines": [LINE], "object": "shirt"}, "object"),
        ({"plugin": "wrinkle", "lines": [LINE], "object": "sheet", "at": 5}, "at"),
        ({"plugin": "smooth", "object": "sheet"}, "plugin"),
        ({"plugin": "wrinkle", "lines": [LINE | {"height": 0}], "object": "sheet"}, "lines[0].height"),
    ):
        with pytest.raises(BadInput) as caught:
            scene_file.read(cloths(tmp_path, operations=[applied]))
        assert caught.value.field == f"operations[0].{field}"


def test_a_change_that_a_solver_refuses_says_its_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = Simulation(scene_file.read(cloths(tmp_path, operations=[])), None, None, 0)
    before, digest = simulation.fabric.number, simulation.state.x.tobytes()

    def refuse(*_: object) -> None:
        raise BadInput("no more than this fits", remedy="fewer lines")

    monkeypatch.setattr(type(simulation.loaded.integrator.plugin), "prepare", refuse)
    with pytest.raises(BadInput, match="no more than this fits"):
        simulation.add(f"wrinkle: {{object: sheet, lines: [{LINE}]}}".replace("'", '"'))
    assert (simulation.fabric.number, simulation.state.x.tobytes()) == (before, digest)


def test_what_contact_has_counted_is_not_lost_by_a_change_nor_by_a_checkpoint(tmp_path: Path) -> None:
    path = cloths(tmp_path, operations=[], cloth_contact={"plugin": "offset", "thickness": 1e-3})

    def begun() -> Simulation:
        return Simulation(scene_file.read(path), None, None, 1)

    simulation = begun()
    simulation.memory.arrays["so_far"][CUT] = 7
    assert simulation.step().report.counts["cut_short"] == 7
    simulation.add(f"wrinkle: {{object: sheet, lines: [{LINE}]}}".replace("'", '"'))
    assert simulation.step().report.counts["cut_short"] == 7
    resumed = begun()
    resumed.resume(simulation.keep())
    assert resumed.step().report.counts["cut_short"] == 7
