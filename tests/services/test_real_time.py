"""`nuno run --real-time`: frames wait for the clock, and the run says where it cannot keep up with it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
from live_run import Run, wait_until
from scenes import BALL, write_scene

import nuno
from nuno.cli import main
from nuno.python_api.plan import keep_up
from nuno.runtime.driver import Clock
from nuno.scene import scene_file
from nuno.simulation.run import Simulation
from nuno.simulation.solver_selection.cloth import decide
from nuno_schemas.messages import STATE

DURATION, RATE, PAUSE = 0.5, 25.0, 1.5


def run(folder: Path, *flags: str) -> tuple[float, dict[str, Any], list[str]]:
    """Wall time of a run's frames [s], what the report says of the clock, and the warnings."""
    path = write_scene(folder, duration=DURATION, frame_rate=RATE)
    assert main(["run", str(path), "--no-view", "--real-time", "--record", str(folder / "a.mcap"), *flags]) == 0
    with nuno.open(folder / "a.mcap") as recording:
        report = recording.report()
        assert [frame.number for frame in recording.frames()] == list(range(13))
        events = [event.text for event in recording.events() if event.kind == "warning"]
    return report["wall_seconds"], report["clock"], events


@pytest.mark.parametrize("flags", [[], pytest.param(["--processes"], marks=pytest.mark.full)])
def test_a_run_takes_as_long_as_it_simulates(flags: list[str], tmp_path: Path) -> None:
    """To the same bits as one that does not wait."""
    wall, clock, warnings = run(tmp_path, *flags)
    assert wall > 11.9 / RATE
    assert clock["frames"] == 12 and bool(clock["late"]) is any("clock" in text for text in warnings)
    free = nuno.run(write_scene(tmp_path, duration=DURATION, frame_rate=RATE))
    assert free.report["clock"] is None
    with nuno.open(tmp_path / "a.mcap") as recording:
        assert recording.metadata["end"]["digest"] == free.digest


def test_what_cannot_keep_up_says_so_and_catches_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One frame that takes seven of them makes that many late; those after it do not wait until they are in time."""
    step = Simulation.step

    def slow(simulation: Simulation) -> Any:
        if simulation.frame == 3:
            time.sleep(7.0 / RATE)
        return step(simulation)

    monkeypatch.setattr(Simulation, "step", slow)
    wall, clock, warnings = run(tmp_path)
    assert wall > 11.9 / RATE and clock["late"] >= 5 and clock["most"] > 5.5 / RATE
    assert [text for text in warnings if text.startswith("cannot keep up with the clock: frame 4 is ")]
    assert f"{clock['late']} of 12 were late" in capsys.readouterr().out


def test_pauses_are_none_of_the_clocks(tmp_path: Path) -> None:
    live = Run(write_scene(tmp_path, duration=DURATION, frame_rate=RATE), tmp_path / "b.mcap", real_time=True)
    wait_until(lambda: live.frame >= 2)
    live.control("pause")
    live.wait_until_paused()
    time.sleep(PAUSE)
    live.control("resume")
    outcome = live.join()
    assert outcome.state == "done" and outcome.summary["clock"]["frames"] == 12
    assert outcome.summary["paused_seconds"] > 0.9 * PAUSE and outcome.summary["clock"]["most"] < 0.9 * PAUSE


@pytest.mark.full
def test_accuracy_is_dropped_for_the_clock_only_where_the_scene_leaves_it_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And only where a frame takes longer than it lasts, and a coarser one less: which is then said."""
    sheet = {"plugin": "sheet", "size": [0.2, 0.2], "resolution": [7, 7], "pin": ["top-row"], "fabric": "denim"}
    given = {"objects": [{"name": "cloth", "model": sheet}], "duration": 0.2, "frame_rate": RATE, "solver": "auto"}
    normal = decide(scene_file.read(write_scene(tmp_path, **given)))
    preview = decide(scene_file.read(write_scene(tmp_path, **given, accuracy="preview")))
    assert normal.value("solver") != preview.value("solver")
    kept = Simulation.with_bodies(normal).steps
    coarse = Simulation.with_bodies(preview).steps
    assert coarse < kept

    def chosen(of_coarse: float, of_normal: float, **more: Any) -> tuple[int, str]:
        monkeypatch.setattr(
            Simulation, "time_frame", lambda simulation: of_coarse if simulation.steps == coarse else of_normal
        )
        found = keep_up(scene_file.read(write_scene(tmp_path, **given, **more)))
        return Simulation.with_bodies(found).steps, found.why

    assert chosen(0.01, 1.0)[0] == coarse and "for the clock" in chosen(0.01, 1.0)[1]
    assert chosen(0.01, 0.02)[0] == kept  # it keeps up as it is
    assert chosen(2.0, 1.0)[0] == kept  # nothing would be gained
    assert chosen(0.01, 1.0, accuracy="normal")[0] == kept


def test_what_is_added_while_the_clock_is_waited_for_is_no_second_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each frame is there once, as it was before; the change is of the next one."""
    hold = Clock.hold

    def add(clock: Clock, began: float) -> None:
        if clock._driver.stepper.frame == 3:
            answer = clock._driver.control({"action": "add", "item": "attach: {body: ball, vertices: [1]}"})
            assert answer["ok"], answer
        hold(clock, began)

    monkeypatch.setattr(Clock, "hold", add)
    path = write_scene(tmp_path, duration=0.24, frame_rate=RATE, bodies=BALL)
    found = nuno.run(path, real_time=True, record=tmp_path / "a.mcap")
    assert found.report["changes"][0]["frame"] == 3
    with nuno.open(tmp_path / "a.mcap") as recording:
        assert [frame.number for frame in recording.frames()] == list(range(7))
        assert len(recording.series()["t"]) == 7 and recording.counts[STATE.name] == 7
    assert nuno.verify(tmp_path / "a.mcap").frame is None
