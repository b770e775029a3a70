"""`import nuno` in a script or a notebook."""

from __future__ import annotations

import inspect
import signal
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest
from scenes import CHAIN, write_chain, write_scene

import nuno
from nuno.cli import main
from nuno.recording.restore import restored_scene
from nuno.supervision.supervisor import Supervisor
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.scene import Scene

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
