"""Garments that come to rest on coarser triangles before their first frame."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
import yaml
from sewing_patterns import column, tube

from nuno.cli import main
from nuno.recording.reader import open_recording
from nuno.scene import scene_file
from nuno.scene.recorded_scene import restored_scene
from nuno.simulation.run import Simulation
from nuno_bench.piles import Oracle
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.system import StepReport

FINE, COARSE = "1.6 cm", "3 cm"
GROWTH = 0.9
"""Of the column's girth, from its top down [1/m]."""
SHEET = {"plugin": "sheet", "size": [0.06, 0.06], "resolution": [4, 4], "plane": "xz", "centre": [0.0, 1.403, 0.0],
         "fabric": "interlock"}  # fmt: skip


def write(folder: Path, *models: dict[str, object], around: int = 64, **fields: object) -> Path:
    """Tubes of 60 cm on a column of 44 at the top that grows to 64 at its foot, with so many sides; other objects by
    their models.
    """
    (folder / "tube.json").write_text(json.dumps(tube()))
    x, faces = column((0.08, 0.06), (0.9, 1.4), around)
    x[:, [0, 2]] *= (1.0 + GROWTH * (1.4 - x[:, 1]))[:, None]
    trimesh.Trimesh(x, faces, process=False).export(folder / "column.obj")
    worn = {"plugin": "pattern", "file": "tube.json", "edge": FINE, "coarse": COARSE, "over": {"body": "wearer"}}
    objects = [
        {"name": f"one-{i}", "model": worn | model if "plugin" not in model else model}
        for i, model in enumerate(models)
    ]
    scene = {
        "nuno": 1, "name": "settled", "duration": 3, "until": "rest", "rest_speed": "2 mm/s", "frame_rate": 60,
        "solver": {"plugin": "respa", "dt": "auto"}, "damping": {"first": 400, "over": "50 ms", "last": 8},
        "objects": objects, "operations": [{"plugin": "untangle"}],
        "bodies": [{"name": "wearer", "collider": {"plugin": "mesh", "file": "column.obj"}, "friction": 0.4}],
        "cloth_contact": {"plugin": "offset", "thickness": "1.5 mm", "bodies": ["wearer"]},
    }  # fmt: skip
    (folder / "settled.yaml").write_text(yaml.safe_dump(scene | fields))
    return folder / "settled.yaml"


def begin(scene: Path, *overrides: str, threads: int = 1) -> Simulation:
    return Simulation.with_bodies(scene_file.read(scene, overrides), threads)


def crossed(run: Simulation) -> bool:
    """Whether anything passes through anything now, as ipctk sees it."""
    assert run.geometry is not None and run.poses is not None
    body, faces = run.geometry.placed(0, run.poses)
    x, n = np.concatenate([run.state.x, body]), run.fabric.number
    return bool(Oracle(x, np.concatenate([run.fabric.faces, faces + np.int32(n)]), len(body)).crossed(x))


@pytest.mark.full
def test_what_has_settled_begins_near_its_rest_and_meets_nothing(tmp_path: Path) -> None:
    """In height within a millimetre, where without it falls a way; and rests earlier, hanging the same."""
    frames, fallen, ends = [], [], []
    scene = write(tmp_path, {})
    for override in ("objects.0.model.coarse=3 cm", "objects.0.model.coarse=null"):
        run = begin(scene, override)
        height = run.state.x[:, 1].mean()
        assert not crossed(run)
        while not run.finished:
            run.step()
        assert run.frame < run.loaded.scene.frames and not crossed(run)
        frames.append(run.frame)
        fallen.append(height - run.state.x[:, 1].mean())
        ends.append(run.state.x[:, 1].mean())
    assert frames[0] < 0.6 * frames[1] and abs(fallen[0]) < 1e-3 < abs(fallen[1])
    assert abs(ends[0] - ends[1]) < 5e-3
    (told,) = [one["facts"] for one in begin(scene).arranged if one["operation"] == "coarse"]
    assert told["rested"] == 1.0 and told["vertices"] < 0.5 * run.fabric.number


@pytest.mark.full
def test_it_has_the_same_bits_on_any_threads_and_when_it_goes_on(tmp_path: Path) -> None:
    scene = write(tmp_path, {})
    one, two, again = begin(scene), begin(scene, threads=2), begin(scene)
    for _ in range(3):
        assert one.step().digest == two.step().digest
    again.resume(one.keep())
    assert [one.step().digest for _ in range(3)] == [again.step().digest for _ in range(3)]


@pytest.mark.full
def test_a_recording_has_what_came_to_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What is made of it again begins with the same bits, without coming to rest anew; verify starts from the scene."""
    record, resumed = tmp_path / "run.mcap", tmp_path / "on.mcap"
    scene = write(tmp_path, {}, duration=0.1)
    assert main(["run", str(scene), "--record", str(record), "--no-view"]) == 0
    assert main(["verify", str(record)]) == 0
    again = ["run", "--resume", str(record), "--set", "duration=0.15", "--record", str(resumed), "--no-view"]
    assert main(again) == 0
    start = begin(scene)
    for path in (record, resumed):
        with open_recording(path) as recording, restored_scene(recording) as loaded:
            with monkeypatch.context() as patch:
                patch.setattr(Simulation, "step", lambda run: pytest.fail("came to rest anew"))
                made = Simulation.with_bodies(loaded)
            np.testing.assert_array_equal(made.state.x, start.state.x)
    assert main(["verify", str(resumed)]) == 0
    assert "came to rest" in capsys.readouterr().out


@pytest.mark.full
@pytest.mark.quick(coarse=["1 cm"])
@pytest.mark.parametrize("coarse", ["1.6 cm", "1 cm"])
def test_triangles_that_are_no_coarser_change_nothing(tmp_path: Path, coarse: str) -> None:
    scene = write(tmp_path, {"coarse": coarse})
    run, plain = begin(scene), begin(scene, "objects.0.model.coarse=null")
    np.testing.assert_array_equal(run.state.x, plain.state.x)
    assert [one["operation"] for one in run.arranged] == ["untangle"]


@pytest.mark.full
def test_all_of_a_scene_settles_together(tmp_path: Path) -> None:
    """A layer over another, only one of them on finer triangles after, and a sheet that has none, on the column."""
    run = begin(write(tmp_path, {}, {"edge": COARSE}, SHEET))
    assert not crossed(run)
    heights = [run.state.x[piece.start : piece.stop, 1].mean() for piece in run.pieces]
    for _ in range(12):
        run.step()
    assert not crossed(run)
    after = [run.state.x[piece.start : piece.stop, 1].mean() for piece in run.pieces]
    np.testing.assert_allclose(after, heights, atol=2e-3)


def test_what_is_wrong_with_the_coarser_triangles_is_told_by_their_field(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="on such triangles panel front cannot be put round wearer") as told:
        begin(write(tmp_path, {"coarse": "15 cm", "over": {"body": "wearer", "clearance": "0.1 mm"}}))
    assert (told.value.field, told.value.value) == ("objects[0].model.coarse", "15 cm")


@pytest.mark.full
def test_what_cuts_the_body_between_coarser_triangles_is_untangled_from_it(tmp_path: Path) -> None:
    """A column with six sharp edges."""
    run = begin(write(tmp_path, {"coarse": "5 cm"}, around=6))
    told = {one["operation"]: one["facts"] for one in run.arranged}
    assert told["untangle"]["crossings"] > 0.0 and not crossed(run)
    with pytest.raises(BadInput, match=r"one-0 passes through (itself|wearer)") as refused:
        begin(write(tmp_path, {"coarse": "5 cm"}, around=6, operations=[]))
    assert "shorter edges" in str(refused.value.remedy)


@pytest.mark.full
def test_objects_that_change_keep_where_they_came_to_rest(tmp_path: Path) -> None:
    """Also after a change of the scene, from which their fabrics are built again."""
    run = begin(write(tmp_path, {}, SHEET))
    run.set("gravity=[0, -5, 0]")
    for fabric, piece in zip(run.parts(), run.pieces, strict=True):
        np.testing.assert_allclose(fabric.position, run.state.x[piece.start : piece.stop], atol=1e-12)


@pytest.mark.full
def test_what_a_recording_has_of_other_triangles_is_not_taken(tmp_path: Path) -> None:
    scene = write(tmp_path, {})
    loaded = scene_file.read(scene)
    loaded.settled = np.zeros((3, 3)), np.zeros((3, 3))
    np.testing.assert_array_equal(Simulation.with_bodies(loaded).state.x, begin(scene).state.x)


@pytest.mark.full
def test_what_is_wrong_with_the_step_is_told_as_without_coarser_triangles(tmp_path: Path) -> None:
    with pytest.raises(BadInput) as told:
        begin(write(tmp_path, {}, solver={"plugin": "respa", "dt": "10 ms"}))
    assert told.value.field == "solver.dt"


def test_a_force_that_knows_vertices_by_number_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nuno.simulation.run.takes_any_numbering", lambda loaded: False)
    with pytest.raises(BadInput, match=r"objects\[0\]\.model\.coarse: a force knows vertices by number"):
        begin(write(tmp_path, {}))


def test_a_step_that_fails_on_coarser_triangles_ends_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lost = SimpleNamespace(report=StepReport("diverged", 1, "all is lost"))
    monkeypatch.setattr(Simulation, "step", lambda self: lost)
    with pytest.raises(RunFailed, match=r"on coarser triangles, frame 0: all is lost"):
        begin(write(tmp_path, {}))


@pytest.mark.full
def test_what_is_wrong_on_any_triangles_is_told_as_without_coarser_ones(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="the pattern has no such panel") as told:
        begin(write(tmp_path, {"fabrics": {"frnot": "denim"}}))
    assert told.value.field == "objects[0].model.fabrics"
