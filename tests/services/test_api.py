"""import nuno in a script or a notebook: runs, scenes as objects, and what is done with recordings."""

from __future__ import annotations

import argparse
import csv
import inspect
import signal
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scenes import CHAIN, write_chain, write_scene

import nuno
from nuno.cli import main
from nuno.cli.recordings import export_arguments
from nuno.python_api.export import ExportRequest
from nuno.recording.writer import part_of
from nuno.runtime.launch import Plan
from nuno.runtime.outcome import Outcome
from nuno.runtime.supervisor import Supervisor
from nuno.scene.recorded_scene import restored_scene
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.scene import Scene
from nuno_schemas.scene import Scene as Fields

REFUSALS: dict[str, tuple[Callable[[Path], object], str]] = {
    "an override's field": (lambda _: nuno.run(CHAIN, "solver.dtt=1"), "overrides: solver.dtt: no such field"),
    "an override's form": (lambda _: nuno.run(CHAIN, "solver"), 'for example "solver.dt=1ms"'),
    "an override's kind": (lambda _: nuno.run(CHAIN, 1), '"duration=1"'),  # type: ignore[arg-type]
    "an override's value": (lambda _: nuno.run(CHAIN, {"solver.dt": object()}), "overrides: solver.dt: holds what"),
    "a mapping's field": (lambda _: nuno.run(CHAIN, {"solver.dtt": 1}), "overrides: solver.dtt: no such field"),
    "a keyword": (lambda _: nuno.run(CHAIN, durration=1), "did you mean 'duration'"),
    "a folder": (lambda _: nuno.run(CHAIN, roots=["nowhere"]), "roots: no such folder"),
    "a file": (lambda _: nuno.run(CHAIN), "name its folder with roots=[DIR]"),
    "a record": (lambda to: nuno.run(CHAIN, record=to / "a.txt", roots=[to]), "record: a recording's name ends in"),
    "threads": (lambda _: nuno.run(CHAIN, threads=-1), "threads: the number of threads"),
    "a field": (lambda _: nuno.run(CHAIN | {"durration": 1}), "the scene given: durration: no such field"),
    "what is no scene's": (
        lambda _: nuno.run(CHAIN | {"seed": object()}),
        "given: holds what a scene cannot",
    ),
}


@pytest.mark.parametrize("processes", [False, pytest.param(True, marks=pytest.mark.full)])
def test_a_mapping_runs_wherever_its_services_are(processes: bool, tmp_path: Path) -> None:
    write_chain(tmp_path)
    assert nuno.run(CHAIN, roots=[tmp_path], processes=processes).t == pytest.approx(0.1)


def test_overrides_are_texts_mappings_and_keywords(tmp_path: Path) -> None:
    """All to the same bits; the last one counts. `record` is the file's, of the scene only in a mapping."""
    write_chain(tmp_path)
    found = [
        nuno.run(CHAIN, *overrides, roots=[tmp_path], **fields)
        for overrides, fields in (
            (("duration=0.06", "solver.dt=5e-4", "solver.plugin=rk4"), {}),
            (({"solver.dt": 5e-4, "solver.plugin": "rk4"},), {"duration": 0.06}),
            (({"duration": "1 s"}, "objects.chain.model.file=chain.npz"),
             {"duration": "60 ms", "solver": {"plugin": "rk4", "dt": "0.5 ms"}}),
        )
    ]  # fmt: skip
    assert [one.t for one in found] == pytest.approx([0.06] * 3)
    assert len({one.digest for one in found}) == 1
    assert set(Scene.model_fields) & set(inspect.signature(nuno.run).parameters) == {"record"}


@pytest.mark.parametrize("fault", REFUSALS)
def test_refusals_speak_of_the_calls_own_arguments(fault: str, tmp_path: Path) -> None:
    write_chain(tmp_path)
    call, words = REFUSALS[fault]
    with pytest.raises(BadInput) as caught:
        call(tmp_path)
    said = str(caught.value)
    assert words in said
    assert "--" not in said
    assert "scene.yaml" not in said


@pytest.mark.full
def test_services_in_processes_call_the_scene_as_the_caller_does(tmp_path: Path) -> None:
    with pytest.raises(BadInput) as caught:
        nuno.run(CHAIN, roots=[tmp_path], processes=True)
    said = str(caught.value)
    assert "the scene given: objects[0].model.file: no such file" in said
    assert "scene.yaml" not in said


@pytest.mark.full
def test_a_resumed_scene_is_called_by_its_recording(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    result = nuno.run(write_scene(tmp_path, duration=0.1), record=tmp_path / "run.mcap")
    with nuno.open(result.path) as recording, restored_scene(recording) as loaded:
        error = loaded.at("solver.dt", BadInput("too long"))
        assert str(error) == f"the scene in {result.path}: solver.dt: too long"
    target = tmp_path / "on.mcap"
    flags = ["--resume", str(result.path), "--no-view", "--record", str(target)]
    assert main(["run", *flags, "--set", "duration=never"]) == 2
    assert "scene.yaml" not in capfd.readouterr().err
    assert main(["run", *flags, "--set", "duration=0.2", "--processes"]) == 0
    with nuno.open(target) as recording:
        assert recording.complete


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where temporary files go."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return folder


def test_a_recording_goes_with_its_result(tmp_path: Path, temporary: Path) -> None:
    """A sweep leaves nothing; what still reads it keeps it."""
    write_chain(tmp_path)
    for _ in range(3):
        result = nuno.run(CHAIN, roots=[tmp_path])
        assert result.path.is_file()
        assert [path.suffix for path in temporary.rglob("*") if path.is_file()] == [".mcap"]
    path, recording = result.path, result.recording
    frames = recording.frames()
    del result, recording
    assert path.is_file()
    assert [frame.number for frame in frames] == list(range(6))
    del frames
    assert list(temporary.iterdir()) == []


def test_a_run_that_fails_keeps_its_recording_and_one_that_is_refused_leaves_nothing(
    tmp_path: Path, temporary: Path
) -> None:
    write_chain(tmp_path)
    with pytest.raises(BadInput):
        nuno.run(CHAIN, "solver.dt=1s", roots=[tmp_path])
    with pytest.raises(BadInput):
        nuno.run(CHAIN, roots=[tmp_path], threads=-1)
    assert list(temporary.iterdir()) == []
    with pytest.raises(RunFailed, match="diverged") as caught:
        nuno.run(CHAIN, "solver.dt=20ms", "allow_unstable=true", "duration=20", roots=[tmp_path])
    (kept,) = temporary.rglob("*.mcap")
    assert str(kept) in str(caught.value)
    with nuno.open(kept) as recording:
        assert recording.counts["sim/state"] > 1


@pytest.mark.usefixtures("interruptible")
def test_ctrl_c_ends_the_caller_too_and_keeps_the_recording(
    tmp_path: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A loop over scenes is not to go on with the next one."""
    write_chain(tmp_path)
    follow = Supervisor.follow

    def follow_until_interrupted(supervisor: Supervisor) -> str:
        signal.raise_signal(signal.SIGINT)
        return follow(supervisor)

    monkeypatch.setattr(Supervisor, "follow", follow_until_interrupted)
    with pytest.raises(KeyboardInterrupt, match="interrupted") as caught:
        nuno.run(CHAIN, "duration=400", roots=[tmp_path])
    (kept,) = temporary.rglob("*.mcap")
    assert str(kept) in str(caught.value)
    with nuno.open(kept) as recording:
        assert recording.metadata["end"]["state"] == "interrupted"


WRITTEN = CHAIN | {"duration": "100 ms"}


@pytest.fixture
def chain(tmp_path: Path) -> nuno.Scene:
    write_chain(tmp_path)
    return nuno.Scene(WRITTEN, roots=[tmp_path])


@pytest.fixture
def result(chain: nuno.Scene) -> nuno.Result:
    return nuno.run(chain)


def test_a_scene_has_its_fields_as_meant_and_as_written(chain: nuno.Scene) -> None:
    assert (chain.duration, chain.solver.plugin, chain.seed) == (0.1, "symplectic_euler", 0)
    assert chain.fields.duration == chain.duration
    assert (chain["duration"], chain["objects.chain.model.file"]) == ("100 ms", "chain.npz")
    assert set(Fields.model_fields) <= set(dir(chain)) and "solver.dt" in chain._ipython_key_completions_()
    assert yaml.safe_load(str(chain)) == WRITTEN
    with pytest.raises(KeyError, match=r"solver\.dtt"):
        chain["solver.dtt"]
    with pytest.raises(AttributeError, match="durations"):
        _ = chain.durations


def test_a_copy_is_changed_and_its_original_is_not(chain: nuno.Scene, tmp_path: Path) -> None:
    """Copies of copies, too; the last change counts. They run to the same bits as overrides of the call do."""
    changed = chain.copy({"solver.plugin": "rk4"}, duration=0.06).copy("duration=40 ms")
    assert (changed.duration, changed.solver.plugin) == (0.04, "rk4")
    assert (chain.duration, chain.solver.plugin) == (0.1, "symplectic_euler") and WRITTEN["duration"] == "100 ms"
    direct = nuno.run(CHAIN, {"solver.plugin": "rk4"}, duration=0.04, roots=[tmp_path])
    assert nuno.run(changed).digest == direct.digest
    assert nuno.run(chain, {"solver.plugin": "rk4"}, duration=0.04).digest == direct.digest
    # What it was made of is its own.
    given = CHAIN | {"solver": dict(CHAIN["solver"])}
    kept = nuno.Scene(given, roots=[tmp_path])
    given["solver"]["dt"] = "never"
    assert nuno.run(kept).t == pytest.approx(0.1)


def test_a_plan_is_that_of_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_scene(tmp_path, duration=0.1)
    plan = nuno.plan(path)
    assert main(["plan", str(path)]) == 0
    told = [line for line in capsys.readouterr().out.splitlines() if not line.startswith("time")]
    assert [line for line in str(plan).splitlines() if not line.startswith("time")] == told
    assert dict(plan)["services"] == "simulation, recorder"


def test_a_recording_is_verified_and_gone_on_with(result: nuno.Result, tmp_path: Path) -> None:
    """By its result, its file, or open; on to the bits of a run as long."""
    for recording in (result, result.path, result.recording):
        assert nuno.verify(recording).compared == 6
    longer = nuno.resume(result, duration="200 ms")
    assert longer.t == pytest.approx(0.2)
    write_chain(tmp_path)
    assert longer.digest == nuno.run(CHAIN, duration=0.2, roots=[tmp_path]).digest
    with longer.recording as recording:
        assert [frame.number for frame in recording.frames()] == list(range(11))


def test_files_are_those_of_the_command_line(result: nuno.Result, tmp_path: Path) -> None:
    files = nuno.export(result, npz=tmp_path / "a.npz", csv=tmp_path / "a.csv", frame=3)
    assert main(["export", str(result.path), "--npz", str(tmp_path / "b.npz"), "--frame", "3"]) == 0
    assert files == [tmp_path / "a.npz", tmp_path / "a.csv"]
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_the_table_is_that_of_the_file(result: nuno.Result, tmp_path: Path) -> None:
    table = result.to_dataframe()
    nuno.export(result, csv=tmp_path / "a.csv")
    with (tmp_path / "a.csv").open(newline="") as stream:
        rows = list(csv.reader(stream))
    assert [name.split(" ")[0] for name in rows[0]] == list(table.columns)
    np.testing.assert_array_equal(np.array(rows[1:], float), table.to_numpy(float))


def test_plots_are_of_the_series(result: nuno.Result) -> None:
    axes, table = result.plot("energy", "stretch"), result.to_dataframe()
    drawn = {str(line.get_label()).partition(" [")[0]: line.get_data() for line in axes.lines}
    assert {str(line.get_label()).partition(" [")[2] for line in axes.lines} == {"J]", "1]"}
    assert set(drawn) == {name for name in table if name.startswith("energy_")} | {"stretch"}
    for name, (t, values) in drawn.items():
        np.testing.assert_array_equal(t, table["t"])
        np.testing.assert_array_equal(values, table[name])


def test_pictures_are_of_a_frame_and_a_side(tmp_path: Path) -> None:
    """Of a sheet in the x-y plane, seen as wide from the front and the back, and as a line from its sides."""
    model = {"plugin": "sheet", "resolution": [5, 5], "size": [0.4, 0.4], "pin": ["top-row"]}
    objects: list[dict[str, Any]] = [{"name": "sheet", "colour": "#ff0000", "model": model}]
    result = nuno.run(write_scene(tmp_path, objects=objects, duration=0.04))
    wide = {}
    for side in ("front", "back", "left", "right"):
        image = np.asarray(result.picture(side, 0, "view.elevation=0deg", size=(120, 120)), np.int64)
        red = (image[..., 0] > 2 * image[..., 1]).any(axis=0)
        wide[side] = int(red.sum())
    assert wide["front"] == wide["back"] > 10 * max(wide["left"], wide["right"])
    assert "data:image/png;base64," in result._repr_html_()


REFUSED: dict[str, tuple[Callable[[nuno.Result], object], str]] = {
    "no such series": (lambda one: one.plot("enrgy"), "did you mean 'energy'"),
    "no such side": (lambda one: one.picture("fromt"), "did you mean 'front'"),
    "no such file": (lambda one: nuno.export(one, pgn="a.png"), "did you mean 'png'"),
    "nothing": (lambda one: nuno.export(one, frame=1), "nothing to export was asked for"),
    "no such colour": (lambda one: nuno.export(one, png="a.png", colour="strech"), "did you mean 'stretch'"),
    "no such frame": (lambda one: nuno.export(one, png="a.png", frame=99), "frame: no such frame"),
    "another ending": (lambda one: nuno.export(one, png="a.jpg"), "must end in .png"),
    "the end": (lambda one: nuno.resume(one), '"duration=0.2s"'),
    "another solver": (lambda one: nuno.resume(one, {"solver.dt": 1}), "cannot change when a run goes on"),
    "no recording": (lambda one: nuno.verify("nowhere.mcap"), "nowhere.mcap: cannot be read"),
}


@pytest.mark.parametrize("fault", REFUSED)
def test_refusals_are_in_the_words_of_the_call(
    fault: str, result: nuno.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    call, words = REFUSED[fault]
    with pytest.raises(BadInput) as caught:
        call(result)
    assert words in str(caught.value) and "--" not in str(caught.value)
    assert not list(tmp_path.glob("a.*"))


def test_export_takes_every_flag_of_the_command() -> None:
    parser = argparse.ArgumentParser()
    export_arguments(parser)
    names = {action.dest for action in parser._actions} - {"help", "recording", "progress"}
    assert names == set(ExportRequest.model_fields)


def test_a_result_does_not_answer_from_the_file_of_another_run(tmp_path: Path) -> None:
    scene, record = write_scene(tmp_path, duration=0.06), tmp_path / "run.mcap"
    first = nuno.run(scene, record=record)
    opened = first.recording
    assert nuno.verify(first).frame is None
    second = nuno.run(scene, "gravity=[0, -1, 0]", record=record)
    assert nuno.verify(second).frame is None
    uses: tuple[Callable[[], object], ...] = (
        lambda: first.recording, lambda: nuno.verify(first), lambda: nuno.export(first, npz=tmp_path / "a.npz"),
        first.to_dataframe, lambda: next(nuno.states(first)), lambda: nuno.resume(first, duration=0.1),
        lambda: nuno.resume(opened, duration=0.1),
    )  # fmt: skip
    for use in uses:
        with pytest.raises(BadInput, match="replaced by that of another run"):
            use()
    assert next(opened.frames()).number == 0, "a recording that was open before is read on"
    opened.close()


def test_the_recording_of_a_run_whose_recorder_died_is_found(tmp_path: Path) -> None:
    result = nuno.run(write_scene(tmp_path, duration=0.06), record=tmp_path / "run.mcap")
    plan = Plan(("simulation", "recorder"), (), ())
    outcome = Outcome(result.report["run"], "failed", "the recorder service died", plan, {})
    assert outcome.recording(result.path) == result.path
    assert replace(outcome, run="another").recording(result.path) is None, "an older one of this name"
    part = result.path.rename(part_of(result.path))
    assert outcome.recording(result.path) == part
    assert outcome.recording(tmp_path / "none.mcap") is None
