"""Control of a run that goes on: what it answers is what it does; what set changes."""

from __future__ import annotations

import io
import json
import shutil
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from garment_scene import DROP, PASTE, SHEET, alone, write
from live_run import Live, Run, start_long, wait_until
from scenes import write_scene

import nuno
from nuno.bus.encodings import decode_arrays
from nuno.bus.messages import Bus
from nuno.bus.sessions import spoke
from nuno.cli import main
from nuno.cli.active_runs import SLOW
from nuno.exports.tables import export_scene
from nuno.recording.reader import CHANGES, control_events
from nuno.recording.writer import part_of
from nuno.report.run_report import lines, make_report
from nuno.resimulation.verification import verify
from nuno.runtime import runs
from nuno.runtime.driver import Driver
from nuno.runtime.service import Options
from nuno.runtime.supervisor import Deployment
from nuno.scene import scene_file
from nuno.scene.override import apply_override
from nuno.simulation.cloth import build_fabric
from nuno.simulation.run import Simulation
from nuno.simulation.service import NOW
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import DYE_STATUS, STATUS, Event
from soak import same_bits
from soak.scenes import CASES


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Run]:
    """A run that stands still after its first frames."""
    wind = {"plugin": "particle_wind", "strength": "1 mN"}
    run = start_long(tmp_path, forces=[wind], gravity=[0.0, -9.81, 0.0])
    run.control("pause")
    yield run
    if run.thread.is_alive():
        run.stop()


def test_control_pauses_steps_changes_and_stops(run: Run) -> None:
    paused = run.control("status")
    assert paused["state"] == "paused"
    assert run.control("status")["frame"] == paused["frame"]
    run.control("step", frames=3)
    assert run.wait_until_paused() == paused["frame"] + 3
    assert run.control("set", item="damping=2.5")["ok"]
    assert not run.control("set", item="dampin=2.5")["ok"]
    assert not run.control("dance")["ok"]
    run.control("resume")
    assert run.stop().state == "stopped"
    with nuno.open(run.record) as recording:
        assert [event.text for event in control_events(recording)] == ["pause", "step", "set", "resume", "stop"]


def test_a_report_and_an_exported_scene_name_what_was_changed_during_the_run(tmp_path: Path) -> None:
    """Energy also comes from a change of gravity, and what a change brings in is not left out; a resumed run, too."""
    run = start_long(tmp_path, damping=0.0)
    run.control("pause")
    frame = run.wait_until_paused()
    for item in ("gravity=[0, 0, -1.62]", "damping=2.5", "forces=[{plugin: particle_wind, strength: 1 mN}]"):
        assert run.control("set", item=item)["ok"]
    run.control("step", frames=2)
    run.wait_until_paused()
    report = make_report(run.loaded, run.stop())
    assert [text.partition("=")[0] for text in report["steered"]] == ["gravity", "damping", "forces"]
    assert all(text.endswith(f"(frame {frame})") for text in report["steered"])
    headings = {text.partition(": ")[0] for text in report["left_out"]}
    assert not headings & {"viscous damping", "wind and other forces"} and "wrinkles" in headings
    (balance,) = (text for name, text in lines(report) if name == "balance")
    assert balance.endswith(
        "J by damping, wind and other forces, friction and moving bodies, and by the changes during the run"
    )
    (scene,) = export_scene(run.record, tmp_path / "own.yaml")
    assert all(f"# without a change during the run: {text}\n" in scene.read_text() for text in report["steered"])
    end = (frame + 4) / run.loaded.scene.frame_rate
    again = nuno.resume(run.record, {"duration": end}, record=tmp_path / "again.mcap")
    assert again.report["steered"] == report["steered"]


FOLD = {"wrinkle": {"object": "other", "lines": [{"on_faces": [{"face": 20, "at": [0.3, 0.3, 0.4]},
        {"face": 30, "at": [0.3, 0.3, 0.4]}], "height": 0.01}]}}  # fmt: skip
STEERED = {"cloth": (("set", "gravity=[0, -1.62, 0]"),), "dye": (("add", {"resist": PASTE}), ("add", {"supply": DROP}))}
STEERED["both"] = (*STEERED["cloth"], ("add", FOLD), *STEERED["dye"])


@pytest.mark.parametrize("part", STEERED)
def test_a_resumed_run_makes_the_changes_after_its_checkpoint_again(part: str, tmp_path: Path) -> None:
    """Of a recording cut after them: bits, events and report are those of the run that was not cut."""
    models = {"other": SHEET | {"centre": [1, 0, 0], "cells": "triangles"}, "sheet": SHEET}
    fields: dict[str, Any] = {"objects": [{"name": name, "model": model} for name, model in models.items()]}
    fields |= {"dye": None} if part == "cloth" else {}
    scene = alone(tmp_path) if part == "dye" else write(tmp_path, **fields)
    run = Run(scene, tmp_path / "whole.mcap", paused=True)
    run.step_to(5)
    for action, item in STEERED[part]:
        assert run.control(action, item=item if isinstance(item, str) else json.dumps(item))["ok"]
    run.step_to(6)
    assert run.control("set", item="gravity=[0, -3.7, 0]")["ok"] == (part != "dye")
    cut = Path(shutil.copy(part_of(run.record), tmp_path / "cut.mcap.part"))
    run.control("resume")
    assert run.join().state == "done"
    with nuno.open(cut) as recording:
        assert recording.common_checkpoint().t == pytest.approx(4 / run.loaded.scene.frame_rate)
    again = nuno.resume(cut, record=tmp_path / "again.mcap")
    assert again.digest == run.report["digest"] and again.report["steered"] == run.report["steered"]
    with nuno.open(run.record) as whole:
        assert again.recording.marks() == whole.marks()
        assert again.recording.marks(DYE_STATUS.name) == whole.marks(DYE_STATUS.name)
        assert changes(again.recording) == changes(whole) and len(changes(whole)) >= len(STEERED[part])
    assert verify(again.recording).frame is None


def changes(recording: nuno.Recording) -> list[Event]:
    """By service, each in order: two that step write independently."""
    found = [event for event in control_events(recording) if event.text in CHANGES]
    return sorted(found, key=lambda event: event.service)


def test_a_recorded_change_that_another_one_forbids_is_named(tmp_path: Path) -> None:
    """The force that it changes is taken away before its frame: the run goes on without it, and says so."""
    wind = {"plugin": "particle_wind", "strength": "1 mN"}
    scene = write_scene(tmp_path, forces=[wind], duration=0.2, record={"checkpoint_every": 0.04})
    run = Run(scene, tmp_path / "whole.mcap", paused=True)
    run.step_to(3)
    assert run.control("set", item="forces.particle_wind.strength=2 mN")["ok"]
    cut = Path(shutil.copy(part_of(run.record), tmp_path / "cut.mcap.part"))
    run.stop()
    options = Options(record=tmp_path / "again.mcap", resume=cut)
    again = Live(scene_file.read(scene), options, Deployment(paused=True))
    again.wait_until_paused()
    assert again.control("set", item="forces=[]")["ok"]
    again.control("resume")
    assert again.join().state == "done"
    with nuno.open(tmp_path / "again.mcap") as recording:
        assert [(event.frame, event.args["item"]) for event in changes(recording)] == [(2, "forces=[]")]
        (warning,) = (event for event in recording.events() if event.kind == "warning" and event.frame == 3)
        assert "forces" in warning.text and verify(recording).frame is None


def test_a_run_may_wait_before_its_first_frame_and_says_where_its_cloth_is(tmp_path: Path) -> None:
    run = Run(write_scene(tmp_path), tmp_path / "waits.mcap", paused=True)
    wait_until(lambda: run.run in runs.running() and answers(run))
    assert (run.control("status")["state"], run.control("status")["frame"]) == ("paused", 0)
    assert runs.scene_path(run.run) == (tmp_path / "scene.yaml").resolve()
    with spoke(run.endpoint) as session:
        arrays, text = decode_arrays(Bus(session, run.run, "test").ask(NOW))
        run.control("resume")
        assert run.join().state == "done"
    with nuno.open(run.record) as recording:
        first = next(iter(recording.frames()))
        assert (text["frame"], text["t"], text["vertices"]) == (0, 0.0, len(first.x))
        assert np.array_equal(arrays["x"], build_fabric(run.loaded)[0].position)
        assert [event.text for event in control_events(recording)] == ["resume"]


def answers(run: Run) -> bool:
    """Whether the simulation is there to be asked."""
    try:
        return bool(run.control("status")["ok"])
    except RunFailed:
        return False


@pytest.fixture
def leave(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Run, threading.Event]]:
    """A run within a frame that takes until the event is set."""
    before, enter, entered, leave = Driver.step_frame, *(threading.Event() for _ in range(3))

    def step_frame(self: Driver) -> Any:
        if enter.is_set():
            entered.set()
            leave.wait(30)
        return before(self)

    monkeypatch.setattr(Driver, "step_frame", step_frame)
    run = start_long(tmp_path)
    enter.set()
    assert entered.wait(30)
    yield run, leave
    leave.set()
    run.stop()


class Opened(io.StringIO):
    """Text that sets an event once there is any."""

    def __init__(self, event: threading.Event) -> None:
        super().__init__()
        self.event = event

    def write(self, text: str) -> int:
        self.event.set()
        return super().write(text)


def test_whoever_waits_for_a_long_frame_is_told_why(
    leave: tuple[Run, threading.Event], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The frame ends only once it is said."""
    monkeypatch.setattr("nuno.bus.messages.WAITING_AFTER", 0.05)
    said = Opened(leave[1])
    monkeypatch.setattr(sys, "stderr", said)
    assert main(["control", leave[0].run, "pause"]) == 0
    assert said.getvalue().splitlines() == [SLOW] and "paused at frame" in capsys.readouterr().out


def test_a_request_that_is_given_up_is_carried_out_and_that_is_said(
    leave: tuple[Run, threading.Event], monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patient:
        patient.setattr("nuno.runtime.supervisor.CONTROL_TIMEOUT", 0.5)
        with pytest.raises(RunFailed, match=r"within 0\.5 s; it may still do what it was asked for"):
            leave[0].control("pause")
    leave[1].set()
    assert leave[0].wait_until_paused() > 0


def test_a_step_says_that_the_run_pauses_again(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    assert run.control("status")["left"] == 0
    # Asked in one go, before the first of the frames can be over.
    assert run.control("step", frames=500)["left"] == 500
    run.control("pause")
    assert run.control("status")["left"] == 0
    assert main(["control", run.run, "step"]) == 0
    assert f"{run.run}: running for 1 frame, then paused; at frame" in capsys.readouterr().out


def test_a_step_counts_the_frames_after_it_was_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also while a frame that is done waits to be acknowledged."""
    before, asked = Driver.wait_for, list[int]()

    def wait_for(self: Driver, frame: int) -> None:
        if self.stepper.frame == 3 and not asked:
            asked.append(self.control({"action": "step", "frames": 2})["left"])
        before(self, frame)

    monkeypatch.setattr(Driver, "wait_for", wait_for)
    run = start_long(tmp_path)
    assert run.wait_until_paused() == 5 and asked == [2]
    run.stop()


def test_set_answers_with_the_old_and_the_new_value(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    for item, old, new in (
        ("damping=2.5", 0.0, 2.5),
        ("damping=1 1/s", 2.5, 1.0),
        ("gravity[1]=-1.6", -9.81, -1.6),
        ("forces.0.strength=2 mN", 0.001, 0.002),
        ("forces.0.beta=0.5", 0.0, 0.5),
    ):
        answer = run.control("set", item=item)
        assert answer["ok"], answer
        assert (answer["field"], answer["old"], answer["new"]) == (item.partition("=")[0], old, new)
    capsys.readouterr()
    assert main(["control", run.run, "set", "gravity=[0, 0, -3.7]"]) == 0
    assert "gravity [0.0, -1.6, 0.0] -> [0.0, 0.0, -3.7]; paused at frame" in capsys.readouterr().out


def test_time_spent_paused_is_counted_apart(run: Run) -> None:
    run.control("status")  # it is paused when it answers
    began = time.perf_counter()
    time.sleep(0.5)
    waited = time.perf_counter() - began
    outcome = run.stop()
    whole = outcome.seconds["run"]
    report = run.report
    # Of the whole run, at least the sleep was a pause; and the parts make up no more than the whole.
    assert report["paused_seconds"] >= waited
    assert report["wall_seconds"] + report["paused_seconds"] <= whole
    assert report["wall_seconds"] <= whole - waited
    assert report["real_time_factor"] == pytest.approx(report["simulated_seconds"] / report["wall_seconds"])


def test_a_wait_before_the_first_frame_is_a_pause(tmp_path: Path) -> None:
    """Neither wall time of the run nor a delay of its clock; the parts make up no more than the whole."""
    run = Run(write_scene(tmp_path, duration=0.2), tmp_path / "waits.mcap", paused=True, real_time=True)
    run.wait_until_paused()
    began = time.perf_counter()
    time.sleep(1.0)
    waited = time.perf_counter() - began
    run.control("resume")
    report, whole = run.report, run.join().seconds["run"]
    assert report["paused_seconds"] >= waited
    assert report["wall_seconds"] + report["paused_seconds"] <= whole
    assert report["wall_seconds"] < report["simulated_seconds"] + waited  # its clock does not wait for it, too
    with nuno.open(run.record) as recording:
        statuses = [recording.said(message) for message in recording.messages([STATUS.name])]
    assert min(status["paused_seconds"] for status in statuses) >= waited


def test_a_fields_value_is_what_the_scene_gives_or_leaves_to_the_default(tmp_path: Path) -> None:
    loaded = scene_file.read(
        write_scene(tmp_path, damping="2 1/s", forces=[{"plugin": "particle_wind", "strength": 0.0}])
    )
    assert loaded.value("damping") == 2.0
    assert loaded.value("gravity[1]") == loaded.value("gravity.1") == -9.81
    assert loaded.value("forces.0.plugin") == "particle_wind"
    assert loaded.value("forces[0].gamma") == 0.0
    assert loaded.value("forces.1.plugin") is None
    assert loaded.value("nothing.0") is None


def test_what_nobody_answers_is_not_waited_for_and_says_why(run: Run) -> None:
    with spoke(run.endpoint) as session, pytest.raises(RunFailed, match=r"nobody answers no/such: .* not yet, or"):
        Bus(session, run.run, "test").ask("no/such", timeout=60.0)


WIND = "forces=[{plugin: wind, velocity: [3, 0, 1]}]"


def sheet(folder: Path, **fields: Any) -> Simulation:
    """A small sheet held by its upper corners, without forces; nothing but its objects is given."""
    model = {"plugin": "sheet", "size": [0.3, 0.3], "resolution": [6, 6], "fabric": "denim", "pin": ["top-corners"]}
    scene = {"nuno": 1, "name": "flag", "duration": 1, "objects": [{"name": "cloth", "model": model}]}
    scene |= {"solver": {"plugin": "symplectic_euler", "dt": 1 / 60 / 80}}
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump(scene | fields))
    return Simulation(scene_file.read(path), None, None, 1)


@pytest.mark.parametrize(
    ("items", "fields"),
    [
        ([WIND], {"forces": [{"plugin": "wind", "velocity": [3, 0, 1]}]}),
        ([WIND, "forces.wind.velocity=[0, 0, 5 m/s]"], {"forces": [{"plugin": "wind", "velocity": [0, 0, 5]}]}),
        ([WIND, "forces.0.velocity.2=-4"], {"forces": [{"plugin": "wind", "velocity": [3, 0, -4]}]}),
        (["forces=[{plugin: wind}]", "forces.0.velocity.0=7"], {"forces": [{"plugin": "wind", "velocity": [7, 0, 0]}]}),
        ([WIND, "forces=[]"], {}),
        (["gravity.1=-1.6"], {"gravity": [0, -1.6, 0]}),
    ],
)  # fmt: skip
def test_what_is_set_acts_as_if_the_scene_had_had_it(items: list[str], fields: dict[str, Any], tmp_path: Path) -> None:
    """To the last bit, also where the scene leaves the field to its default."""
    changed = sheet(tmp_path)
    still = sheet(tmp_path).advance(None, None).digest
    for item in items:
        changed.set(item)
    assert changed.loaded.value(items[-1].partition("=")[0]) is not None
    found = changed.advance(None, None).digest
    assert found == sheet(tmp_path, **fields).advance(None, None).digest
    assert (found == still) is (not fields)


@pytest.mark.parametrize(
    ("item", "field", "said"),
    [
        ("forces.0.velocity=[5, 0, 0]", "forces.0.velocity", "forces holds an empty list; give all of it"),
        ("forces.wind.velocity=[5, 0, 0]", "forces.wind.velocity", "forces holds an empty list; give all of it"),
        ("forces=[{plugin: wind, velocty: 1}]", "forces[0].velocty", "did you mean 'velocity'"),
        ("forces=[{plugin: wind, velocity: [9000, 0, 0]}]", "forces", "would make the present step unstable"),
        ("gravity.3=1", "gravity.3", "gravity holds a list of 3"),
        ("damping=1e9", "damping", "would make the present step unstable"),
    ],
)
@pytest.mark.parametrize("dt", ["auto", 1 / 60 / 80])
def test_what_is_refused_is_named_and_changes_nothing(
    item: str, field: str, said: str, dt: object, tmp_path: Path
) -> None:
    """By its own path: a step that the user gave is not at fault."""
    simulation = sheet(tmp_path, solver={"plugin": "symplectic_euler", "dt": dt})
    with pytest.raises(BadInput) as refused:
        simulation.set(item)
    assert refused.value.field == field and said in str(refused.value)
    unchanged = sheet(tmp_path, solver={"plugin": "symplectic_euler", "dt": dt})
    assert simulation.advance(None, None).digest == unchanged.advance(None, None).digest


def test_part_of_a_field_that_the_scene_leaves_out_is_set_before_a_run_as_well(tmp_path: Path) -> None:
    sheet(tmp_path)
    assert scene_file.read(tmp_path / "scene.yaml", ["gravity.1=-1.6"]).scene.gravity == (0.0, -1.6, 0.0)
    with pytest.raises(BadInput, match=r"forces\.0\.plugin: no such field"):
        scene_file.read(tmp_path / "scene.yaml", ["forces.0.plugin=wind"])


def test_two_forces_of_one_plugin_are_told_apart_by_their_numbers() -> None:
    data = {"forces": [{"plugin": "own"}, {"plugin": "own"}, {"plugin": "wind"}]}
    with pytest.raises(BadInput, match="a list of 3, counted from 0, own, own, wind"):
        apply_override(data, "forces.own.k=5")
    apply_override(data, "forces.1.k=5")
    apply_override(data, "forces.wind.k=6")
    assert data == {"forces": [{"plugin": "own"}, {"plugin": "own", "k": 5}, {"plugin": "wind", "k": 6}]}


@pytest.mark.full
def test_wind_that_is_set_is_recorded_resumed_and_verified_to_the_same_bits() -> None:
    """On threads, unrecorded, paused, resumed at a frame before, between or after the changes, and simulated again."""
    assert [change[1] for change in CASES["wind, changed"].changes] == ["set", "set"]
    ways, digests = same_bits.run(quick=True, seed=1, names=("wind, changed",))
    assert ways.samples[0] >= 8 and digests.samples == (1,), digests.note
