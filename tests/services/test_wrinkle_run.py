"""Lines drawn on cloth that moves: the run, its recording, how high they are and stay."""

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
from nuno.exports.tables import export_csv
from nuno.recording.reader import control_events
from nuno.resimulation.verification import verify
from nuno.runtime import runs, supervisor
from nuno.runtime.service import Options
from nuno.scene import scene_file, shipped
from nuno.simulation.run import Simulation
from nuno_bench.gallery.wrinkle import (
    BEFORE_TURN,
    BLOOM,
    DEPTH,
    FIGURES,
    KEPT,
    LOBES,
    RADIUS,
    RIDGES,
    SHIRT,
    STAGES,
    STANDING,
    TURNING,
    WIDTH,
    Drawn,
    find_hem,
    measure_hem,
)
from nuno_bench.gallery.wrinkle import CUT as CUT_RADIUS
from nuno_contact.offset.contact_state import CUT
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Float, Int

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
        ({"plugin": "mesh", "file": "bare.obj", "tension": "membrane", "fabric": "silk"}, {}, "keep their triangles"),
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


FABRIC = {"density": 0.12, "structural": 60, "hinge": 2e-5, "damping_ratio": 0.05}
LINES = {
    "level": [[-0.15, -0.12, 0], [0.15, -0.1, 0]],
    "upright": [[0.02, -0.2, 0], [0.03, 0.15, 0]],
}
MOVED = ((0.0, 0.0, 0.0), (0.001, 0.0007, 0.001), (-0.001, -0.0007, -0.001))
"""Of the line [m], and of its second end: triangles are crossed elsewhere, and a line's end lies on a vertex or not."""


def hung(folder: Path, line: str, keep: bool, passes: int = 3, moved: tuple[float, float, float] = MOVED[0]) -> Path:
    """A cloth hung at its upper corners, with one line."""
    model = {"plugin": "sheet", "resolution": [21, 21], "size": [0.6, 0.6], "cells": "triangles", "fabric": FABRIC}
    drawn = {"plugin": "wrinkle", "keep": keep, "smoothing": {"passes": passes}}
    points = np.array(LINES[line]) + np.array([*moved[:2], 0.0])
    points[1, 0] += moved[2]
    return write_scene(
        folder,
        objects=[{"name": "cloth", "model": model | {"pin": ["top-corners"]}}],
        operations=[drawn | {"lines": [{"height": 0.03, "points": points.tolist()}]}],
        duration=2.0,
        damping=3,
        solver="leapfrog",
    )


def left_of(scene: Path) -> float:
    """The share of a wrinkle's height that is left at the end."""
    simulation = Simulation(scene_file.read(scene), None, None, 1)
    begin = simulation.heights(0)["height"]
    while not simulation.finished:
        assert simulation.advance(None, None).report.status == "ok"
    return simulation.heights(0)["height"] / begin


@pytest.mark.full
@pytest.mark.quick(line=["level"])
@pytest.mark.parametrize("line", LINES)
def test_a_kept_wrinkle_holds_four_fifths_of_its_height_and_others_fade_more(line: str, tmp_path: Path) -> None:
    kept = [left_of(hung(tmp_path, line, True, moved=moved)) for moved in MOVED]
    assert min(kept) >= 0.8 and kept[0] > left_of(hung(tmp_path, line, False)) + 0.03


def test_the_height_of_an_unsmoothed_ridge_is_the_one_asked_for(tmp_path: Path) -> None:
    simulation = Simulation(scene_file.read(hung(tmp_path, "level", False, passes=0)), None, None, 1)
    found = simulation.heights(0)
    assert found["height"] == pytest.approx(0.03, rel=1e-12) and 0.03 < found["width"] < 0.12
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    simulation.state.x[...] = simulation.state.x @ turn + [1.0, 2.0, 3.0]
    assert simulation.heights(0) == pytest.approx(found, rel=1e-9)


def test_heights_are_in_the_report_over_time_and_in_resumed_runs(tmp_path: Path) -> None:
    scene = hung(tmp_path, "level", True)
    whole = nuno.run(scene, "duration=0.2", record=tmp_path / "whole.mcap")
    begin, end = whole.report["changes"][0]["measured"]
    with nuno.open(whole.path) as recording:
        series = recording.series()
    assert series["wrinkles_0_height"][[0, -1]].tolist() == [begin["height"], end["height"]]
    export_csv(whole.path, tmp_path / "a.csv")
    assert "wrinkles_0_width [m]" in (tmp_path / "a.csv").read_text().splitlines()[0]
    nuno.run(scene, "duration=0.1", record=tmp_path / "part.mcap")
    options = Options(record=tmp_path / "on.mcap", resume=tmp_path / "part.mcap")
    resumed = supervisor.supervise(scene_file.read(scene, ("duration=0.2",)), options)
    assert resumed.summary["changes"][0]["measured"][-1] == end


def test_a_rehearsed_change_leaves_nothing_behind(tmp_path: Path) -> None:
    scene = hung(tmp_path, "level", True)
    later = ("operations[0].at=0.05", "duration=0.1")
    plain, rehearsed = (Simulation(scene_file.read(scene, later), None, None, 1) for _ in range(2))
    rehearsed.rehearse()
    assert rehearsed.changes == [] and rehearsed.applied == 0 and rehearsed.fabric.number == plain.fabric.number
    while not plain.finished:
        ours, theirs = plain.advance(None, None), rehearsed.advance(None, None)
        assert ours.digest == theirs.digest
    assert rehearsed.applied == 1 and rehearsed.dt == plain.dt


STEP = 0.005


def sheet(rows: int, columns: int) -> tuple[Float, Int]:
    """A level sheet of cells STEP wide, facing up, its middle line along x at z = 0."""
    z, x = np.meshgrid(STEP * (np.arange(rows) - rows // 2), STEP * np.arange(columns), indexing="ij")
    row, column = np.divmod(np.arange((rows - 1) * (columns - 1)), columns - 1)
    a = row * columns + column
    b, c, d = a + 1, a + columns, a + columns + 1
    faces = np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)]).astype(np.int32)
    return np.stack([x.reshape(-1), 0.0 * x.reshape(-1), z.reshape(-1)], axis=1), faces


@pytest.mark.parametrize(("height", "base"), [(0.004, 0.02), (-0.002, 0.03)])
def test_a_roof_is_as_high_and_half_as_wide_at_half_its_height(height: float, base: float) -> None:
    """A roof of slopes from z = -base to base is `base` wide at half its height, sunk, tilted and shifted or not."""
    flat, faces = sheet(41, 61)
    own = 20 * 61 + np.arange(5, 56)
    crests = np.stack([own, own - 10 * 61, own + 10 * 61, own - 1, own + 1]).astype(np.int32)
    drawn = Drawn(flat, faces, crests, [flat[own]])
    x = flat.copy()
    x[:, 1] = height * np.maximum(1.0 - np.abs(x[:, 2]) / base, 0.0)
    turn = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    for places in (x, x @ turn.T - [0.0, 0.01, 0.0]):
        (found,) = drawn.measure(places)
        assert found.height == pytest.approx(abs(height), rel=1e-9)
        assert found.width == pytest.approx(base, rel=1e-9)


def test_crests_belong_to_the_nearest_line_and_a_line_without_any_has_no_height() -> None:
    flat, faces = sheet(41, 61)
    own = 20 * 61 + np.arange(5, 56)
    crests = np.stack([own, own - 10 * 61, own + 10 * 61, own - 1, own + 1]).astype(np.int32)
    x = flat + [0.0, 0.01, 0.0] * (np.abs(flat[:, 2:]) < 0.001)
    there, none = Drawn(flat, faces, crests, [flat[own], flat[own] + [0.0, 0.0, 0.2]]).measure(x)
    assert there.height == pytest.approx(0.01)
    assert there.width == pytest.approx(STEP)
    assert np.isnan(none).all()


@pytest.mark.parametrize(("width", "left", "right", "holds"), [
    (0.6, 0.5, 0.1, True), (0.9, 0.5, 0.1, False), (0.6, 0.1, 0.1, False), (0.6, 0.5, 0.4, False),
])  # fmt: skip
def test_a_shirt_is_the_papers_where_the_left_line_thins_and_the_right_disappears(
    width: float, left: float, right: float, holds: bool
) -> None:
    measured = {WIDTH.format(1, STAGES[1]): 50.0, WIDTH.format(1, STAGES[3]): 50.0 * width}
    measured |= {KEPT.format(1): left, KEPT.format(2): right}
    (figure,) = (one for one in FIGURES if one.scenes == (SHIRT,))
    assert figure.judge({SHIRT: measured}).holds is holds


@pytest.mark.parametrize("lobes", [2, 7, 10])
def test_a_wavy_hem_has_its_lobes_and_their_amplitude(lobes: int) -> None:
    """Of r = R + a cos(n theta), wherever its points lie; a fold that runs back and forth on itself adds nothing."""
    angle = np.sort(np.random.default_rng(1).uniform(-np.pi, np.pi, 2000))[::-1]
    angle = np.concatenate([angle[:900], angle[600:900][::-1], angle[600:]])
    radius = 0.24 + 0.02 * np.cos(lobes * angle)
    points = np.stack([radius * np.cos(angle), 0.5 + 0.0 * angle, radius * np.sin(angle)], axis=1)
    hem = measure_hem(points + np.array([1.0, 2.0, 3.0]), np.array([1.0, 0.0, 3.0]))
    assert hem.lobes == lobes
    assert hem.radius == pytest.approx(0.24, rel=1e-4) and hem.amplitude == pytest.approx(0.02, rel=1e-3)


@pytest.mark.full
@pytest.mark.parametrize(("amplitude", "holds"), [(1e-5, False), (9e-3, True)])
def test_a_bare_cone_is_no_bloom_skirt_though_its_largest_harmonic_be_the_ridges(amplitude: float, holds: bool) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    measured = {RIDGES: 10.0, CUT_RADIUS: 240.0, RADIUS.format(STAGES[1]): 240.0}
    for stage, radius in ((STANDING, 0.25), (TURNING, 0.28)):
        r = radius + amplitude * np.cos(10.0 * angle)
        hem = measure_hem(np.stack([r * np.cos(angle), 0.0 * r, r * np.sin(angle)], axis=1), np.zeros(3))
        measured |= {RADIUS.format(stage): 1e3 * hem.radius, LOBES.format(stage): float(hem.lobes),
                     DEPTH.format(stage): 1e3 * hem.amplitude}  # fmt: skip
    judges = [figure.judge for figure in FIGURES if figure.number in ("5", "6")]
    assert [judge({BLOOM: measured}).holds for judge in judges] == [holds, holds]


@pytest.mark.full
def test_a_bloom_skirt_stands_as_wide_as_it_was_cut_in_as_many_lobes_as_ridges_were_drawn() -> None:
    simulation = Simulation.with_bodies(scene_file.read(shipped.find("bloom-skirt")), 1)
    hem = find_hem(simulation.fabric.faces, simulation.state.x)
    while simulation.t < BEFORE_TURN - 1e-9:
        assert simulation.step().report.status == "ok"
    found = measure_hem(simulation.state.x[hem], np.array([0.0, 0.9, 0.0]))
    assert found.lobes == 10 and found.radius >= 0.240
