"""How long a command takes, and that what it works out is left at once where the run is to end."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from live_run import Run, wait_until
from scenes import write_chain, write_scene

import nuno
from nuno import process
from nuno.cli import main
from nuno.formatting import roughly
from nuno.python_api import progress
from nuno.python_api.plan import RuntimeEstimate, run_seconds
from nuno.python_api.progress import ProgressLine
from nuno.runtime import driver as watchdog
from nuno.runtime import launch, stepper
from nuno.runtime.driver import FrameWatchdog
from nuno.runtime.stepper import Stepped
from nuno.scene import scene_file
from nuno.simulation.run import Simulation
from nuno.simulation.solver_selection.cloth import decide
from nuno.simulation.solver_selection.trials import Budget
from nuno_bench.gallery import command as gallery
from nuno_bench.gallery.kind import Gallery, ShownScene
from nuno_bench.sweep.executor import Executor
from nuno_bench.validation import command as suite
from nuno_bench.validation.law import Outcome
from nuno_contact.offset.contact_state import NOW
from nuno_schemas.errors import BadInput, RunFailed

ENDLESS = {"plugin": "symplectic_euler", "dt": "2 ns"}
"""Ten million steps a frame, of 4,000 vertices: about a minute."""
SOON = 30.0
"""Longest that what is left may take to end here [s], on however busy a machine: frames take minutes."""


def write_long(folder: Path, k: float = 100.0, **fields: Any) -> Path:
    """A scene of a chain of 4,000 vertices with springs of k [N/m]."""
    path = write_scene(folder, **fields)
    write_chain(folder, 4000)
    net = dict(np.load(folder / "chain.npz"))
    np.savez(folder / "chain.npz", **net | {"k": np.full_like(net["k"], k)})
    return path


STIFF = 2.5e13
"""With such springs a frame has a million stable steps, so that one trial takes a minute."""


@contextmanager
def command(code: str, *args: str) -> Iterator[subprocess.Popen[str]]:
    """A process that runs some code as the `nuno` command would, whose stderr is read."""
    # A shell that runs tests in the background has interrupts ignored, which a child inherits.
    begin = "import signal, sys\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
    begin += "from nuno import process\nprocess.end_when_terminated()\n"
    with subprocess.Popen([sys.executable, "-c", begin + code, *args], stderr=subprocess.PIPE, text=True) as child:
        try:
            yield child
        finally:
            child.kill()


def read_until(child: subprocess.Popen[str], words: str) -> None:
    """Read what a process says until it says that."""
    assert child.stderr is not None
    assert any(words in line for line in child.stderr), words


@pytest.mark.parametrize("processes", [False, pytest.param(True, marks=pytest.mark.full)])
def test_stop_leaves_the_frame_that_is_being_stepped(processes: bool, tmp_path: Path) -> None:
    """The run ends with the frame before it, from which it can be gone on."""
    run = Run(write_long(tmp_path, solver=ENDLESS, record={}), tmp_path / "a.mcap", processes)
    run.wait(lambda: run.frame == 0)
    began = time.monotonic()
    outcome = run.stop()
    assert time.monotonic() - began < SOON
    assert outcome.state == "stopped" and outcome.summary["frame"] == 0
    with nuno.open(tmp_path / "a.mcap") as recording:
        assert [frame.number for frame in recording.frames()] == [0]
        point = recording.last_checkpoint(recording.common_checkpoint().t)
        assert point.frame == 0 and point.digest == outcome.summary["digest"]


@pytest.mark.parametrize("processes", [False, pytest.param(True, marks=pytest.mark.full)])
def test_pause_leaves_the_frame_that_is_being_stepped(processes: bool, tmp_path: Path) -> None:
    """It is answered in the frame, which is begun again where the run goes on."""
    run = Run(write_long(tmp_path, solver=ENDLESS, record={}), tmp_path / "a.mcap", processes)
    run.wait(lambda: run.frame == 0)
    for _ in range(2):
        assert run.control("pause")["state"] == "paused"
        assert run.control("status")["frame"] == 0
        assert run.control("resume")["state"] == "running"
    outcome = run.stop()
    assert outcome.state == "stopped" and outcome.summary["frame"] == 0
    with nuno.open(tmp_path / "a.mcap") as recording:
        assert recording.last_checkpoint(recording.common_checkpoint().t).digest == outcome.summary["digest"]


CONTACT = {
    "nuno": 1, "name": "lying", "duration": 0.1, "frame_rate": 20, "damping": 1.0,
    "objects": [{"name": "sheet", "model": {"plugin": "sheet", "size": [0.2, 0.2], "resolution": [9, 9], "plane": "xz",
                                            "centre": [0.003, 0.104, 0.002], "cells": "triangles", "fabric": "denim"}}],
    "bodies": [{"name": "box", "friction": 0.5,
                "collider": {"plugin": "mesh", "shape": "box", "size": [0.1, 0.2, 0.1], "resolution": 16},
                "motion": {"plugin": "keyframes", "times": [0, 1], "positions": [[0, 0, 0], [0.1, 0.5, 0]]}}],
    "cloth_contact": {"plugin": "offset", "thickness": "2 mm", "bodies": ["box"]},
}  # fmt: skip
"""A sheet on a box that rises, so that cloth contact has friction's anchors to keep."""


def leave_within(simulation: Simulation) -> Stepped:
    """Step a frame until half of it is done."""
    contact: Any = simulation.memory.work.packed.bodies[-1]  # type: ignore[attr-defined]
    frames: list[Stepped] = []
    contact.clock[NOW] = 0.0
    stepping = threading.Thread(target=lambda: frames.append(simulation.step()))
    stepping.start()
    wait_until(lambda: contact.clock[NOW] > 0.5 or bool(frames))
    simulation.leave[0] = 1
    stepping.join()
    simulation.leave[0] = 0
    return frames[0]


@pytest.mark.parametrize("solver", ["symplectic_euler", pytest.param("respa", marks=pytest.mark.full)])
def test_an_abandoned_frame_is_stepped_again_to_the_same_bits(solver: str, tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(yaml.safe_dump(CONTACT | {"solver": {"plugin": solver, "dt": "50 us"}}))
    digests: list[list[str]] = []
    for disturbed in (False, True):
        simulation = Simulation.with_bodies(scene_file.read(path), 1)
        simulation.present()
        digests.append([])
        while not simulation.finished:
            if disturbed and simulation.frame in (0, 1):
                assert leave_within(simulation).report.status == "left"
                simulation.step_back()
            digests[-1].append(simulation.step().digest)
    assert digests[0] == digests[1]


@pytest.mark.parametrize("processes", [False, pytest.param(True, marks=pytest.mark.full)])
def test_a_frame_beyond_the_scenes_limit_ends_the_run_as_failed(processes: bool, tmp_path: Path) -> None:
    """With its number and a remedy; the recording can be gone on from."""
    run = Run(write_long(tmp_path, solver=ENDLESS, frame_limit=0.2, record={}), tmp_path / "a.mcap", processes)
    outcome = run.join()
    assert outcome.state == "failed"
    assert re.fullmatch(
        r"failed: frame 1 was given up after .* s, and frame_limit is 0\.2 s; .* a larger frame_limit .*",
        outcome.problem,
    )
    with nuno.open(outcome.recording(tmp_path / "a.mcap")) as recording:
        assert recording.last_checkpoint(recording.common_checkpoint().t).digest == outcome.summary["digest"]


def test_what_takes_the_time_of_an_abandoned_frame_is_said(tmp_path: Path) -> None:
    """Cloth contact by the time of the frame without it; not where that takes as long."""
    path = tmp_path / "scene.yaml"
    path.write_text(yaml.safe_dump(CONTACT | {"solver": {"plugin": "symplectic_euler", "dt": "50 us"}}))
    simulation = Simulation.with_bodies(scene_file.read(path), 1)
    simulation.present()
    assert leave_within(simulation).report.status == "left"
    (share,) = simulation.divide_left(1000.0).values()
    assert 0.99 < share < 1.0
    simulation.leave[0] = 1
    assert not simulation.divide_left(1000.0)


@pytest.mark.parametrize(
    "fields", [{"solver": ENDLESS}, {"solver": {"plugin": "symplectic_euler"}, "accuracy": "normal"}]
)
def test_a_plan_refuses_frames_beyond_the_scenes_limit(
    fields: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Those of trials, and the one by which it tells how long the run takes."""
    path = write_long(tmp_path, STIFF if "accuracy" in fields else 100.0, frame_limit=0.1, **fields)
    assert main(["plan", str(path)]) == 2
    said = capsys.readouterr().err
    assert "frame_limit" in said and "takes longer" in said and "0.1 s" in said


@pytest.mark.parametrize("solver", ["leapfrog", "respa", "implicit_euler", "xpbd"])
@pytest.mark.full
def test_each_solver_leaves_a_frame_and_the_state_as_it_was(solver: str, tmp_path: Path) -> None:
    simulation = Simulation(scene_file.read(write_long(tmp_path, solver=ENDLESS | {"plugin": solver})), None, None, 1)
    simulation.present()
    before, timer = simulation.digest(), threading.Timer(0.1, lambda: simulation.leave.__setitem__(0, 1))
    timer.start()
    frame = simulation.step()
    assert frame.report.status == "left" and frame.number == simulation.frame == 0
    assert simulation.digest() == before


def test_what_holds_a_frame_is_said_while_it_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hundred times longer than the frames before; not of one that takes as long as they do, and once a frame."""
    monkeypatch.setattr(watchdog, "LEAST", 0.0)
    said: list[tuple[str, str, int]] = []
    context: Any = SimpleNamespace(
        bus=SimpleNamespace(service="simulation", run="run"), orphaned=lambda: False,
        event=lambda kind, text, frame, t: said.append((kind, text, frame)),
    )  # fmt: skip
    attendant = FrameWatchdog(context)
    attendant.holds = lambda: "12 vertices of skirt pinched"
    for number in range(1, 6):
        with attendant.frame(number, 0.1 * number):
            if number == 5:
                wait_until(lambda: bool(said))
                time.sleep(3 * watchdog.CHECK_INTERVAL)
    attendant.close()
    ((kind, text, frame),) = said
    assert kind == "warning" and frame == 5 and not attendant.leave[0]
    assert text.startswith("frame 6 has taken ") and text.endswith(" times the usual: 12 vertices of skirt pinched")


def test_a_frame_is_left_only_while_it_is_stepped() -> None:
    """What is measured between frames, and at the end, is not cut short by a stop that came before."""
    context: Any = SimpleNamespace(bus=SimpleNamespace(service="simulation", run="run"), orphaned=lambda: False)
    question: Any = SimpleNamespace(name="control", json=lambda: {"action": "stop"})
    attendant = FrameWatchdog(context)
    attendant.prepared()
    attendant.note_query(question)
    time.sleep(watchdog.LEAVE_AFTER + 4 * watchdog.CHECK_INTERVAL)
    assert not attendant.leave[0]
    with attendant.frame(1, 0.1):
        wait_until(lambda: bool(attendant.leave[0]))
    attendant.close()


def test_a_measurement_at_the_end_is_left_where_the_run_is_to_end() -> None:
    """It repeats frames, which may take long; without a request it goes on."""
    context: Any = SimpleNamespace(bus=SimpleNamespace(service="simulation", run="run"), orphaned=lambda: False)
    question: Any = SimpleNamespace(name="finish/simulation")
    attendant = FrameWatchdog(context)
    attendant.prepared()
    with attendant.measuring():
        assert not attendant.leave[0]
        attendant.note_query(question)
        wait_until(lambda: bool(attendant.leave[0]))
    attendant.close()


def test_stop_ends_a_run_that_is_being_prepared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What else is asked for has no answer until it is ready."""
    prepared, preparing = threading.Event(), threading.Event()

    def present(self: Simulation) -> Stepped:
        preparing.set()
        assert prepared.wait(SOON)
        raise RunFailed("left")

    monkeypatch.setattr(Simulation, "present", present)
    run = Run(write_scene(tmp_path), tmp_path / "a.mcap")
    assert preparing.wait(SOON)
    with pytest.raises(RunFailed, match="nobody answers control"):
        run.control("pause")
    assert run.control("stop")["state"] == "stopped"
    outcome = run.join()
    assert not prepared.is_set() and outcome.problem == "failed: stopped while it was prepared"
    prepared.set()


def test_preparation_is_left_where_the_supervisor_goes() -> None:
    context: Any = SimpleNamespace(bus=SimpleNamespace(service="dye", run="run"), orphaned=lambda: True)
    attendant = FrameWatchdog(context)
    wait_until(lambda: bool(attendant.leave[0]))
    wait_until(lambda: all(thread.name != "dye watchdog" for thread in threading.enumerate()))


def test_trials_end_with_their_budget_and_what_is_known_is_taken(tmp_path: Path) -> None:
    """Of this chain nothing: the first solver at its longest stable step, which is said, and that its error is not."""
    said: list[str] = []
    fields = {"solver": {"plugin": "symplectic_euler"}, "accuracy": "normal"}
    began = time.monotonic()
    loaded = scene_file.read(write_long(tmp_path, STIFF, **fields))
    found = decide(loaded, Budget(0.3, said.append))
    assert time.monotonic() - began < SOON
    assert "stable; how far they are off is not known, trials were ended after 0.3 s: --budget" in found.why
    assert found.scene.solver.plugin == "symplectic_euler" and not found.scene.undecided
    plain = scene_file.read(write_long(tmp_path, STIFF, solver={"plugin": "symplectic_euler"}))
    assert float(found.scene.solver.dt) <= Simulation(plain, None, None, 1).limit.dt


@pytest.mark.full
def test_what_a_run_would_refuse_is_not_tried(tmp_path: Path) -> None:
    """No explicit solver that needs more steps a frame than a run may have."""
    path, said = write_scene(tmp_path, solver="auto"), list[str]()
    net = dict(np.load(tmp_path / "chain.npz"))
    np.savez(tmp_path / "chain.npz", **net | {"k": np.full_like(net["k"], 1e20)})
    budget = Budget(600.0, said.append)
    assert decide(scene_file.read(path), budget).scene.solver.plugin == "tr_bdf2"


@pytest.mark.parametrize("text", ["0 s", "-1 s", "soon", "3 kg"])
def test_a_budget_that_is_none_is_refused(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from nuno.cli import main

    assert main(["plan", str(write_scene(tmp_path)), "--budget", text]) == 2
    assert "--budget" in capsys.readouterr().err


def test_a_signal_ends_what_runs_in_foreign_code() -> None:
    """Python would handle it in the main thread alone, after a minute."""
    code = """
import ctypes
def work():
    print("ready", file=sys.stderr, flush=True)
    ctypes.CDLL(None).sleep(60)
try:
    process.attended(work, lambda: print("left", file=sys.stderr, flush=True))
except process.Terminated:
    process.leave(7)
"""
    with command(code) as child:
        read_until(child, "ready")
        child.send_signal(signal.SIGTERM)
        assert child.wait(SOON) == 7
        assert child.stderr is not None and child.stderr.read() == "left\n"


def test_what_is_attended_gives_and_raises_what_it_does() -> None:
    from nuno.process import attended

    def refuse() -> None:
        raise BadInput("no")

    assert attended(lambda: threading.current_thread() is threading.main_thread()) is False
    with pytest.raises(BadInput, match="no"):
        attended(refuse)


@pytest.mark.full
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("words", [["plan"], ["run", "--no-view", "--no-record"]])
def test_a_signal_ends_trials(words: list[str], number: signal.Signals, tmp_path: Path) -> None:
    path = write_long(tmp_path, STIFF, solver={"plugin": "symplectic_euler"}, accuracy="normal")
    code = "from nuno import cli\nfrom nuno.simulation.solver_selection import trials\ntrials.SILENT = -1.0\n"
    code += "process.leave(cli.main(sys.argv[1:]))"
    with command(code, words[0], str(path), *words[1:]) as child:
        read_until(child, "trying symplectic_euler with ")
        child.send_signal(number)
        assert child.wait(SOON) == 1
        assert child.stderr is not None
        assert child.stderr.read().splitlines()[-1] == ("terminated" if number == signal.SIGTERM else "interrupted")


@pytest.mark.full
@pytest.mark.parametrize(("where", "flags"), [("prepare", []), ("frame", []), ("frame", ["--processes"])])
def test_a_signal_ends_a_run_whatever_it_does(where: str, flags: list[str], tmp_path: Path) -> None:
    """While a service compiles, here for an hour, and in a frame that takes minutes."""
    path, record = write_long(tmp_path, solver=ENDLESS), tmp_path / "a.mcap"
    code = "import ctypes\nfrom nuno import cli\nfrom nuno.simulation.run import Simulation\n"
    if where == "prepare":
        code += "Simulation.present = lambda self: ctypes.CDLL(None).sleep(3600)\n"
    code += "process.leave(cli.main(sys.argv[1:]))"
    with command(code, "run", str(path), "--no-view", "--record", str(record), *flags) as child:
        read_until(child, "preparing" if where == "prepare" else "0.00 of")
        child.send_signal(signal.SIGTERM)
        assert child.wait(SOON) == 1
    if where == "frame":
        with nuno.open(record) as recording:
            assert recording.last_checkpoint(recording.common_checkpoint().t).frame == 0


def test_a_process_that_is_not_ready_is_terminated_where_the_run_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """It may import modules or compile kernels, and so never look whether its supervisor is gone."""
    command = [sys.executable, "-c", "import time; time.sleep(3600)"]
    monkeypatch.setattr(launch, "serve_command", lambda *_: command)
    unready: Any = SimpleNamespace(alive=set, gone=lambda name: False)
    scene: Any = SimpleNamespace(services=["simulation"])
    some: Any = None
    with launch.processes(some, some, scene, "", "", unready) as exited:
        assert not exited()
    assert exited() == {"simulation": "ended by SIGTERM"}


def test_what_is_left_follows_from_what_is_done() -> None:
    """Twice as slow as expected so far: so is the rest taken to be."""
    pace = RuntimeEstimate({"a": 1.0, "b": 2.0, "c": 3.0})
    assert pace.left == 6.0
    pace.taken["b"] = 4.0
    assert pace.left == 8.0
    pace.taken |= {"a": 2.0, "c": 6.0}
    assert pace.left == 0.0
    assert [roughly(s) for s in (0.42, 8.0, 61.0, 480.0, 5000.0)] == [
        "about 0.42 s", "about 8 s", "about 1 min", "about 8 min", "about 1.4 h",
    ]  # fmt: skip


def test_a_scenes_time_is_that_of_a_frame_measured_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a clock that goes on by 20 ms in each frame, and by a second in what compiles."""
    loaded, advance, times = scene_file.read(write_scene(tmp_path)), Simulation.advance, [0.0]

    def slow(simulation: Simulation, *poses: object) -> object:
        times.append(times[-1] + (0.02 if len(times) > 1 else 1.0))
        return advance(simulation, *poses)  # type: ignore[arg-type]

    monkeypatch.setattr(Simulation, "advance", slow)
    monkeypatch.setattr(stepper, "time", SimpleNamespace(perf_counter=lambda: times[-1]))
    assert run_seconds(loaded) == pytest.approx(0.02 * loaded.scene.frames)


def test_a_gallery_says_first_how_long_it_takes_and_then_what_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three scenes that are expected to take 60, 120 and 180 s; the first takes a thousandth of that."""
    scenes = {name: write_scene(tmp_path).rename(tmp_path / f"{name}.yaml") for name in ("one", "two", "three")}

    def run_scene(path: Path) -> ShownScene:
        time.sleep(0.06)
        return ShownScene(path.stem, "")

    kind = Gallery("t", "l", lambda: scenes, run_scene, "")
    expected = iter((60.0, 120.0, 180.0))
    monkeypatch.setattr(gallery, "KINDS", {"knit": kind})
    monkeypatch.setattr(gallery, "run_seconds", lambda loaded: next(expected))
    assert main(["gallery", "knit", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().err.splitlines()
    assert said[1] == "steps take about 6 min, compiling and pictures apart"
    assert said[2] == "one, 1 of 3 ..."
    left = [float(re.fullmatch(rf"{name}, about ([0-9.]+) s left \.\.\.", line)[1])  # type: ignore[index]
            for name, line in zip(("two, 2 of 3", "three, 3 of 3"), said[3:], strict=True)]  # fmt: skip
    assert 0.3 <= left[0] < 1.5 and 0.1 <= left[1] < left[0]


def test_validate_says_what_is_left_by_the_mean_of_what_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Checks of 10 ms each, said at every one: so many times 10 ms are left."""

    def check_named(task: tuple[str, str]) -> Outcome:
        time.sleep(0.01)
        return Outcome(*task, "passed")

    monkeypatch.setattr(suite, "check_named", check_named)
    monkeypatch.setattr(suite, "SAY_EVERY", 0.0)
    parts, said = suite.choose_parts(["one step", "projectile", "rotation"], []), list[str]()
    outcomes = suite.check_all(parts, Executor(), said.append)
    every = [(case.name, solver) for part in parts for case in part.cases for solver in part.solvers]
    assert [(one.case, one.solver) for one in outcomes] == every
    assert said[0] == f"{len(every)} checks; the first of them tell how long all take"
    for line, done in zip(said[1:], range(2, len(every)), strict=True):
        number, left = re.fullmatch(rf"{done} of {len(every)}, about ([0-9.]+) s left()", line).groups()[::-1]  # type: ignore[union-attr]
        assert number == "" and 0.009 * (len(every) - done) <= float(left) < 0.1 * (len(every) - done)


def test_a_run_says_how_long_it_takes_and_what_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """At 0.1 s of the scene in a second of the clock, 0.5 s of it take five; less, where it may end before."""
    clock = [100.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: clock[0])
    for until, ends in (("duration", ""), ("rest", " at most, less where it comes to rest before")):
        with ProgressLine(scene_file.read(write_scene(tmp_path, until=until)).scene) as line:
            for frame in range(26):
                line.show(frame / 50)
                clock[0] += 0.2
        said = capsys.readouterr().err.splitlines()
        assert said[0].startswith("0.00 of 0.5 s")
        assert f"the run takes about 5 s{ends}" in said[:6] and sum("the run takes" in text for text in said) == 1
        assert "0.30 of 0.5 s  0.10x real time, about 2 s left" in said
        assert said[-1] == "0.50 of 0.5 s  0.10x real time"


def test_a_pause_changes_no_estimate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Frames of 0.2 s, with an hour's pause in the middle: 5 s in all, and 2 s left at 0.3 s of 0.5."""
    clock = [100.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: clock[0])
    with ProgressLine(scene_file.read(write_scene(tmp_path)).scene, bar=False) as line:
        for frame in range(26):
            if frame == 12:
                clock[0] += 3600.0
            line.show(frame / 50, 3600.0 if frame >= 12 else 0.0)
            clock[0] += 0.2
    said = capsys.readouterr().err.splitlines()
    assert [text for text in said if "the run takes" in text] == ["the run takes about 5 s"]
    assert "0.30 of 0.5 s  0.10x real time, about 2 s left" in said


@pytest.mark.parametrize(("seconds", "word"), [(2.0, "longer"), (0.02, "shorter")])
def test_a_run_whose_frames_change_says_how_long_it_takes_now(
    seconds: float, word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """50 frames of 0.2 s, then 50 that are ten times as long, or as short: what is said comes to be the truth."""
    clock = [100.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: clock[0])
    with ProgressLine(scene_file.read(write_scene(tmp_path, duration=2.0)).scene, bar=False) as line:
        for frame in range(101):
            line.show(frame / 50)
            clock[0] += 0.2 if frame < 50 else seconds
    said = [text for text in capsys.readouterr().err.splitlines() if text.startswith("the run takes")]
    assert said[0] == "the run takes about 20 s"
    assert all(
        re.fullmatch(rf"the run takes about .*, not about .*: frames take {word} now", text) for text in said[1:]
    )
    told = float(re.match(r"the run takes about ([0-9.]+) (s|min)", said[-1])[1])  # type: ignore[index]
    whole = 50 * (0.2 + seconds)
    assert 1 < len(said) <= 6 and told * (60 if " min" in said[-1].partition(",")[0] else 1) == pytest.approx(
        whole, rel=0.5
    )


def test_a_closed_terminal_ends_a_run_in_order_and_nohup_is_heeded() -> None:
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    try:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)  # whatever the tests themselves run under
        process.end_when_terminated()
        with pytest.raises(process.Terminated):
            signal.raise_signal(signal.SIGHUP)
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        process.end_when_terminated()
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
