"""Runs: the same bits wherever services run, control, resume, and what happens when one dies."""

from __future__ import annotations

import functools
import os
import re
import signal
from collections.abc import Callable
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import psutil
import pytest
from live_run import Run, start_long, wait_until
from scenes import BALL, write_scene

import nuno
from nuno.bus.messages import Bus, PendingReply
from nuno.bus.sessions import hub_at
from nuno.cli import main
from nuno.collision.bodies import Bodies, build_bodies
from nuno.collision.messages import POSES_QUERY
from nuno.plugin_contract import registry
from nuno.recording.reader import control_events, open_recording
from nuno.resimulation.verification import verify
from nuno.runtime import supervisor
from nuno.runtime import supervisor as oversight
from nuno.runtime.service import Options
from nuno.runtime.supervisor import Deployment
from nuno.scene import scene_file, shipped
from nuno.scene.scene_file import Loaded
from nuno.scene.warnings import scene_warnings
from nuno.simulation.run import Simulation
from nuno_cloth.models.sheet import Sheet
from nuno_contact.motions import keyframes
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Fabric
from nuno_schemas.messages import BODIES


def test_threads_and_processes_end_in_the_same_bits(tmp_path: Path) -> None:
    scene = write_scene(tmp_path, bodies=BALL)
    threads = nuno.run(scene)
    processes = nuno.run(scene, processes=True)
    assert threads.state == processes.state == "done"
    assert threads.digest == processes.digest
    assert (threads.x == processes.x).all()
    for result in (threads, processes):
        assert result.report["missing"] == result.report["refused"] == 0
        assert result.report["frames"]["sent"] == result.report["frames"]["recorded"] == 26


def test_only_services_that_were_started_by_hand_are_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those started here are alive, and may compile their kernels for as long as a slow machine takes."""
    monkeypatch.setattr(oversight, "START_TIMEOUT", 0.0)
    scene = scene_file.read(write_scene(tmp_path, duration=0.1))
    assert supervisor.supervise(scene, Options()).state == "done"
    with hub_at(None, None) as (_, endpoint):
        outcome = supervisor.supervise(scene, Options(), Deployment(connect=endpoint))
    assert outcome.state == "failed" and "not ready within 0 s: simulation" in outcome.error


def test_a_scene_starts_only_the_services_it_needs(tmp_path: Path) -> None:
    assert nuno.run(write_scene(tmp_path)).report["services"] == ["simulation", "recorder"]
    assert nuno.run(write_scene(tmp_path, bodies=BALL)).report["services"] == ["simulation", "collision", "recorder"]


def test_bodies_that_nobody_else_moves_are_not_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Threads share one set of them, and the recording has their poses of each frame."""
    asked, built = list[str](), list[Bodies]()
    ask, build = Bus.ask_ahead, build_bodies

    def note_query(bus: Bus, name: str, payload: bytes = b"", timeout: float = 10.0) -> PendingReply:
        asked.append(name)
        return ask(bus, name, payload, timeout)

    def note_bodies(loaded: Loaded) -> Bodies:
        built.append(build(loaded))
        return built[-1]

    monkeypatch.setattr(Bus, "ask_ahead", note_query)
    monkeypatch.setattr("nuno.collision.bodies.build_bodies", note_bodies)
    nuno.run(write_scene(tmp_path, bodies=BALL), record=tmp_path / "run.mcap")
    assert POSES_QUERY not in asked and len(built) == 1
    with open_recording(tmp_path / "run.mcap") as recording:
        assert len(list(recording.messages([BODIES.name]))) == 26


def frames_in(path: Path) -> int:
    """Frames that can be read from a recording, finished or not."""
    with nuno.open(path) as recording:
        return sum(1 for _ in recording.frames())


@pytest.fixture
def long_run(tmp_path: Path) -> Callable[..., Run]:
    return functools.partial(start_long, tmp_path)


@pytest.mark.quick(service=["simulation"])
@pytest.mark.parametrize("service", ["simulation", "collision", "recorder"])
def test_killed_service_ends_the_run_and_is_named(long_run: Callable[..., Run], service: str) -> None:
    run = long_run(processes=True)
    record = run.options.record
    assert record is not None
    wait_until(lambda: frames_in(record.with_name(record.name + ".part")) > 0)
    child = next(
        p for p in psutil.Process().children() if p.cmdline()[4:6] == ["serve", service] and run.run in p.cmdline()
    )
    os.kill(child.pid, signal.SIGKILL)
    outcome = run.join()
    assert outcome.state == "failed"
    assert f"the {service} service died" in outcome.error
    assert frames_in(record if record.exists() else record.with_name(record.name + ".part")) > 0


def test_a_service_that_raises_ends_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from nuno.collision.service import Collision

    def fail(self: Collision, message: object) -> None:
        raise OSError("the sensor is on fire")

    monkeypatch.setattr(Collision, "measure", fail)
    with pytest.raises(RunFailed, match=r"collision service died.*the sensor is on fire"):
        nuno.run(write_scene(tmp_path, bodies=BALL))


def test_of_services_that_are_gone_the_one_that_said_why_is_named() -> None:
    """The simulation ends where another has failed, and its token may go before its word comes."""
    errors = {"collision": "the sensor is on fire"}
    watched = SimpleNamespace(
        paused=False, ended=None, without={}, dispensable=set(), needed=["simulation", "collision"], blamed="",
        cut_off=str, errors=errors, bus=SimpleNamespace(ask_json=lambda *question: {}),
        watch=SimpleNamespace(alive=set), strange=set(), plan=SimpleNamespace(services=()), progress=None,
        _drain=lambda timeout=0.0: False,
        say=lambda *words: None, silence=SimpleNamespace(look=lambda say: None), slow_consumers=None,
        _hear=lambda names: False, _why=lambda name: errors.get(name, oversight.GONE),
    )  # fmt: skip
    said = oversight.Supervisor.follow(cast("oversight.Supervisor", watched))
    assert said == "the collision service died: the sensor is on fire"


def test_divergence_fails_plainly_and_keeps_the_recording(tmp_path: Path) -> None:
    scene = write_scene(tmp_path, solver={"plugin": "euler", "dt": "20 ms"}, allow_unstable=True, duration=20.0)
    record = tmp_path / "diverged.mcap"
    with pytest.raises(RunFailed, match="diverged"):
        nuno.run(scene, record=record)
    recording = nuno.open(record)
    assert recording.report()["state"] == "diverged"


@pytest.mark.parametrize("residual", [0.1, 0.01])
def test_auto_takes_a_step_that_its_solver_resolves(residual: float) -> None:
    chosen = f"solver={{plugin: xpbd, residual: {residual}, dt: auto}}"
    simulation = Simulation(scene_file.read(shipped.find("stiff-sheet"), [chosen]), None, None, 1)
    assert simulation.limit.dt == np.inf
    reach = 2.0 * np.sqrt(residual / (1.0 - residual))
    assert simulation.limit.resolved * simulation.limit.omega == pytest.approx(reach)
    assert 0.99 * simulation.limit.resolved < simulation.dt <= simulation.limit.resolved
    longer = scene_file.read(shipped.find("stiff-sheet"), [chosen.replace("dt: auto", "dt: 8.3333333333e-3")])
    assert Simulation(longer, None, None, 1).steps == 2, "what is longer is stable as well"


def test_step_above_the_limit_is_refused_with_limit_and_remedy(tmp_path: Path) -> None:
    scene = write_scene(tmp_path, solver={"plugin": "symplectic_euler", "dt": "20 ms"})
    with pytest.raises(BadInput, match="above the stability limit") as caught:
        nuno.run(scene, record=tmp_path / "refused.mcap")
    assert "limit:" in str(caught.value)
    assert "allow_unstable" in str(caught.value)
    assert not list(tmp_path.glob("refused*"))


def test_a_step_that_is_too_long_and_divides_no_frame_is_refused_for_its_length_first(tmp_path: Path) -> None:
    """What is named as a remedy for the other fault must not be above the limit."""
    for dt, problem in (("19 ms", "above the stability limit"), ("0.99 ms", "not a whole number of steps")):
        scene = write_scene(tmp_path, solver={"plugin": "symplectic_euler", "dt": dt, "strict": True})
        with pytest.raises(BadInput, match=problem) as caught:
            nuno.run(scene)
        assert "dt: auto" in str(caught.value)


@pytest.mark.parametrize(("dt", "steps"), [("0.139 ms", 120), ("0.97 ms", 17), ("0.99 ms", 17), ("1/6000 s", 100)])
def test_of_a_step_that_divides_no_frame_the_nearest_is_taken_that_does(dt: str, steps: int, tmp_path: Path) -> None:
    scene = write_scene(tmp_path, frame_rate=60, solver={"plugin": "symplectic_euler", "dt": dt})
    loaded = scene_file.read(scene)
    simulation, said = Simulation(loaded, None, None, 1), scene_warnings(loaded)
    assert (simulation.steps, simulation.dt) == (steps, 1.0 / 60.0 / steps)
    asked = loaded.scene.solver.dt
    assert isinstance(asked, float)
    assert all(abs(simulation.dt - asked) <= abs(1.0 / 60.0 / n - asked) for n in range(1, 200))
    if dt == "1/6000 s":
        assert said == []
    else:
        assert [text.partition(":")[0] for text in said] == ["solver.dt"]
        assert f"{steps} of {simulation.dt:.7g} s are taken" in said[0] and "strict" in said[0]


def test_a_rounded_step_is_told_of_in_plan_and_report(tmp_path: Path) -> None:
    scene = write_scene(
        tmp_path, frame_rate=60, duration=2 / 60, solver={"plugin": "symplectic_euler", "dt": "0.139 ms"}
    )
    words = "solver.dt: a frame is 119.904 steps of 0.000139 s: 120 of 0.0001388889 s are taken"
    assert f"WARNING   {words}" in str(nuno.plan(scene))
    with pytest.warns(UserWarning, match=re.escape(words)):
        report = nuno.run(scene).report
    assert (report["dt"], report["steps_per_frame"]) == (1.0 / 60.0 / 120, 120)


def test_the_nearest_step_is_no_longer_than_what_is_stable(tmp_path: Path) -> None:
    """Where only the step itself is below the limit, the error names one that divides a frame and is stable."""

    def made(dt: float) -> Simulation:
        scene = write_scene(tmp_path, frame_rate=rate, solver={"plugin": "symplectic_euler", "dt": dt})
        return Simulation(scene_file.read(scene), None, None, 1)

    rate = 60.0
    limit = made(1e-4).limit.dt
    rate = 1.0 / (10.03 * limit)  # ten steps are just too long
    assert made(0.9999 / rate / 11).steps == 11
    with pytest.raises(BadInput, match="above the stability limit") as caught:
        made(0.999 * limit)
    found = re.search(r"dt: ([\d.e-]+) s", str(caught.value))
    assert found is not None and "the nearest to" in str(caught.value)
    assert made(float(found[1])).steps == 11
    rate = 2.0 / limit
    with pytest.raises(BadInput, match="a frame is shorter than a step"):
        made(0.9 * limit)


@pytest.mark.parametrize("frame_rate", [30.0, 48.0, 59.94])
def test_what_is_named_as_a_remedy_for_a_step_is_taken(frame_rate: float, tmp_path: Path) -> None:
    def made(dt: str) -> Simulation:
        solver = {"plugin": "symplectic_euler", "dt": dt, "strict": True}
        scene = write_scene(tmp_path, frame_rate=frame_rate, solver=solver)
        return Simulation(scene_file.read(scene), None, None, 1)

    with pytest.raises(BadInput, match="not a whole number of steps") as caught:
        made("0.97 ms")
    choices = re.findall(r"([\d.]+ s) \((\d+) steps\)", str(caught.value))
    assert [made(dt).steps for dt, _ in choices] == [int(steps) for _, steps in choices]
    assert made(f"100/{round(100 * 40 * frame_rate)} s").steps == 40


def test_a_recording_that_will_be_replaced_is_named_before_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, record = write_scene(tmp_path, duration=0.1), tmp_path / "keep.mcap"
    said, command = f"replaces {record} once the new one is whole", ["run", str(scene), "--record", str(record)]
    assert main([*command, "--no-view"]) == 0
    assert said not in capsys.readouterr().out
    assert main([*command, "--no-view"]) == 0
    assert capsys.readouterr().out.startswith(f"{said}\n")


def test_nothing_listens_beyond_loopback(long_run: Callable[..., Run]) -> None:
    run = long_run()
    sockets = [
        c for c in psutil.Process().net_connections() if c.status == psutil.CONN_LISTEN or c.type.name == "SOCK_DGRAM"
    ]
    run.control("stop")
    run.join()
    assert sockets
    assert {c.laddr.ip for c in sockets} == {"127.0.0.1"}


def test_resumed_recording_holds_the_whole_run_and_verifies(tmp_path: Path) -> None:
    scene = write_scene(tmp_path, bodies=BALL)
    whole = nuno.run(scene, record=tmp_path / "whole.mcap")
    part = nuno.run(scene, "duration=0.24", record=tmp_path / "part.mcap")
    target = tmp_path / "resumed.mcap"
    command = ["run", "--resume", str(part.path), "--set", "duration=0.5", "--record", str(target), "--no-view"]
    assert main(command) == 0
    with nuno.open(target) as resumed, nuno.open(whole.path) as reference:
        assert [f.digest for f in resumed.frames()] == [f.digest for f in reference.frames()]
        assert resumed.complete
        assert verify(resumed).frame is None


@pytest.mark.parametrize("changed", ["cloth", "motion", "version"])
def test_a_run_is_resumed_with_what_it_was_recorded_with(
    changed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A plugin that builds other cloth or moves bodies otherwise is refused; another version stays on record."""
    motion = {"plugin": "keyframes", "times": [0.0, 1.0], "positions": [[0.0, 0.0, 0.0], [0.0, -1.0, 0.0]]}
    model = {"plugin": "sheet", "size": [0.4, 0.4], "resolution": [5, 5], "pin": ["top-row"]}
    objects = [{"name": "sheet", "model": model}]
    bodies, solver = [BALL[0] | {"motion": motion}], {"plugin": "symplectic_euler", "dt": "auto"}
    scene = write_scene(tmp_path, objects=objects, bodies=bodies, solver=solver, duration=0.1)
    part = nuno.run(scene, record=tmp_path / "part.mcap")
    if changed == "cloth":
        build = Sheet.build
        monkeypatch.setattr(Sheet, "build", lambda *given: _longer(build(*given)))
    elif changed == "motion":
        pose = keyframes._Keys.pose
        monkeypatch.setattr(keyframes._Keys, "pose", lambda keys, t: pose(keys, 2.0 * t))
    else:
        monkeypatch.setattr(registry, "package_version", lambda group, name: "nuno 9.9")
    target = tmp_path / "resumed.mcap"
    command = ["run", "--resume", str(part.path), "--set", "duration=0.2", "--record", str(target), "--no-view"]
    assert main(command) == (0 if changed == "version" else 2)
    said = capsys.readouterr()
    if changed == "version":
        with nuno.open(target) as resumed:
            found = resumed.metadata["resumed"]
            assert found["nuno.motions/keyframes"] == f"nuno {metadata.version('nuno')} before 0.1 s"
            assert len(found) == len(resumed.metadata["plugins"])
            assert sum("equal bits" in event.text for event in resumed.events()) == len(found)
    else:
        assert {"cloth": "other cloth", "motion": "bodies are elsewhere"}[changed] in said.err
        assert not target.exists() and part.path.is_file()


def _longer(fabric: Fabric) -> Fabric:
    """The same whose springs are one per cent longer at rest."""
    assert fabric.springs is not None
    return replace(fabric, springs=replace(fabric.springs, rest=1.01 * fabric.springs.rest))


def test_a_change_while_running_is_replayed_at_its_frame(long_run: Callable[..., Run]) -> None:
    run = long_run()
    run.control("pause")
    run.control("set", item="damping=3.0")
    run.control("step", frames=5)
    wait_until(lambda: run.control("status")["state"] == "paused")
    run.control("stop")
    run.join()
    with nuno.open(run.options.record) as recording:  # type: ignore[arg-type]
        assert verify(recording).frame is None


def test_a_change_at_the_last_checkpoint_outlives_a_resume(long_run: Callable[..., Run], tmp_path: Path) -> None:
    run = long_run()
    run.control("pause")
    frame = int(str(run.control("status")["frame"]))
    run.control("set", item="damping=3.0")
    run.control("stop")
    run.join()
    target = tmp_path / "on.mcap"
    duration = (frame + 10) / 50
    command = ["run", "--resume", str(run.options.record), "--set", f"duration={duration}", "--record", str(target)]
    assert main([*command, "--no-view"]) == 0
    with nuno.open(target) as recording:
        assert [event.args["item"] for event in control_events(recording) if event.text == "set"] == ["damping=3.0"]
        assert verify(recording).frame is None


def test_a_refused_change_leaves_the_step_alone(tmp_path: Path) -> None:
    solver = {"plugin": "symplectic_euler", "dt": "auto"}
    simulation = Simulation(scene_file.read(write_scene(tmp_path, solver=solver)), None, None, 1)
    step = (simulation.steps, simulation.dt)
    simulation.set("damping=100")
    with pytest.raises(BadInput):
        simulation.set("damping=1e9")
    assert (simulation.steps, simulation.dt) == step
    assert simulation.loaded.scene.damping == 100.0


def test_pinned_vertices_stand_still_whatever_their_velocity(tmp_path: Path) -> None:
    scene = write_scene(tmp_path)
    with np.load(tmp_path / "chain.npz") as file:
        arrays = dict(file)
    arrays["v"][:] = [1.0, 2.0, 3.0]
    np.savez(tmp_path / "chain.npz", **arrays)
    result = nuno.run(scene)
    assert (result.x[0] == arrays["x"][0]).all()
    assert not result.v[0].any()
    assert (result.x[1:] != arrays["x"][1:]).any()
