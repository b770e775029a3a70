"""What a dyeing records and which solver it takes: auto keeps its promise, amounts come at their interval."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import garment_scene
import numpy as np
import pytest
from dye_closed_forms import CASES, promised_error
from dye_scene import CELL, TAU3, arrays, write_scene
from PIL import Image

import nuno
from nuno.cli import main
from nuno.dye.run import DyeRun
from nuno.recording.reader import Recording
from nuno.resimulation.verification import verify
from nuno.runtime import supervisor
from nuno.runtime.service import Options
from nuno.scene import scene_file
from nuno.scene.scene_file import Loaded
from nuno.simulation.solver_selection.cloth import decide
from nuno.simulation.solver_selection.trials import PROMISE
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.messages import CONCENTRATION, DYE_STATUS

RED = {"name": "red", "D0": "0.7 mm^2/h"}


def read(folder: Path, *overrides: str, **fields: Any) -> Loaded:
    data = arrays(16, 18)
    data["resist"] = 0.2 * data["resist"]
    long = {"duration": "4 h", "frame_rate": 1 / 7200.0} | fields
    return scene_file.read(write_scene(folder, data=data, solver="auto", **long), overrides)


def end_of(loaded: Loaded, steps: int = 0) -> Float:
    dyeing = DyeRun(loaded, 1, steps)
    while not dyeing.finished:
        dyeing.advance()
    return np.stack([dyeing.state.phi, dyeing.state.fixed])


@pytest.mark.full
@pytest.mark.parametrize("law", ["partition", "langmuir"])
def test_the_promise_counts_what_fibre_fixes_while_a_drop_spreads(law: str, tmp_path: Path) -> None:
    """Against small explicit steps: runs that begin alike agree with each other long before they are right."""
    isotherm = {"plugin": "partition", "k": 0.5} if law == "partition" else {"plugin": "langmuir", "K": 20}
    drop = {"kind": "drop", "place": [8 * CELL, 8 * CELL], "diameter": 7 * CELL}
    tau = dict.fromkeys(TAU3, 1.0)
    cloth = {"plugin": "cells", "file": "cells.npz", "cell_size": CELL, "tau3": tau, "supply": [drop]}
    fields: Any = {"dyes": [RED | {"adsorption": 0.02, "isotherm": isotherm}], "cloth": cloth}
    decided = decide(read(tmp_path, "accuracy=preview", **fields))
    explicit = read(tmp_path, "dye.solver=explicit", **fields)
    exact = end_of(explicit, 8 * DyeRun(explicit, 1).steps)
    assert np.abs(end_of(decided) - exact).max() <= 1.5 * PROMISE["preview"] * exact.max()


@pytest.mark.parametrize("accuracy", ["preview", "normal"])
def test_long_steps_are_taken_where_they_keep_the_promise(accuracy: Any, tmp_path: Path) -> None:
    decided = decide(read(tmp_path, f"accuracy={accuracy}", dyes=[RED]))
    assert decided.dye is not None and decided.scene.dye is not None
    assert decided.dye.solver.name == "rkl2" and isinstance(decided.scene.dye.solver.dt, float)
    assert f"{PROMISE[accuracy]:g} was asked for" in decided.why and accuracy in decided.why
    assert not decided.scene.undecided and "accuracy" not in decided.data
    exact = end_of(decided, 400)
    assert np.abs(end_of(decided) - exact).max() <= 1.5 * PROMISE[accuracy] * exact.max()


def test_the_choice_is_the_same_every_time_and_stands_in_the_recording(tmp_path: Path) -> None:
    first, second = (decide(read(tmp_path, dyes=[RED])) for _ in range(2))
    assert first.data == second.data and first.overrides == second.overrides
    result = nuno.run(tmp_path / "scene.yaml", record=tmp_path / "run.mcap")
    with nuno.open(result.path) as recording:
        assert recording.complete and verify(recording).frame is None
        assert recording.scene["dye"]["solver"] == first.data["dye"]["solver"]
    assert result.report["chosen"] == first.why


@pytest.mark.quick(name=["fibre", "disc"], frames=[1, 4])
@pytest.mark.parametrize(
    ("name", "length", "frames"),
    [("two-cells", 0.05, 200), *product(CASES, (9.0,), (1, 10)), *product(CASES, (900.0,), (4,))],
)
def test_the_promise_is_kept_against_the_exact_evolution(name: str, length: float, frames: int, tmp_path: Path) -> None:
    """Whether a frame holds many explicit steps, a few or a part of one, and the error of the first frames falls or
    grows until long after them.
    """
    for level, promise in PROMISE.items():
        assert promised_error(name, length, frames, level, tmp_path) <= promise, level


def test_a_late_drop_spreads_in_long_steps_as_one_at_the_start_does(tmp_path: Path) -> None:
    def run(start: float) -> list[Float]:
        drop = {"kind": "drop", "place": [8 * CELL, 8 * CELL], "diameter": 7 * CELL, "start": start}
        cloth = {"plugin": "cells", "file": "cells.npz", "cell_size": CELL, "tau3": TAU3, "supply": [drop]}
        fixed = {"adsorption": 0.02, "isotherm": {"plugin": "langmuir", "K": 20}}
        data = arrays(16, 18)
        data["phi"] *= 0.0
        path = write_scene(tmp_path, data=data, solver={"plugin": "rkl2", "dt": "30 min"}, cloth=cloth,
                           dyes=[RED | fixed], duration="5 h", frame_rate=1 / 3600.0)  # fmt: skip
        dyeing, out = DyeRun(scene_file.read(path), 1), []
        while not dyeing.finished:
            dyeing.advance()
            out.append(np.stack([dyeing.state.phi, dyeing.state.fixed]))
        return out

    at_once, late = run(0.0), run(7200.0)
    assert not late[1].any() and at_once[0][1].any()
    np.testing.assert_array_equal(late[2:], at_once[:3])


@pytest.mark.parametrize("hours", [0.5, 0.6, 2.75])
def test_supplies_wait_no_longer_than_for_an_explicit_step(hours: float, tmp_path: Path) -> None:
    """Frames of two hours: the last one comes in the second frame."""
    drop = {"kind": "drop", "place": [4 * CELL, 4 * CELL], "diameter": 5 * CELL, "start": f"{hours} h"}
    cloth = {"plugin": "cells", "file": "cells.npz", "cell_size": CELL, "tau3": TAU3, "supply": [drop]}
    loaded = read(tmp_path, "accuracy=preview", dyes=[RED], cloth=cloth, duration="8 h")
    longest = DyeRun(scene_file.read(tmp_path / "scene.yaml", ["dye.solver=explicit"]), 1).dt
    chosen = DyeRun(decide(loaded), 1)
    entry = chosen.supplies.entries[0]
    assert 0.0 <= entry.first * chosen.dt - 3600.0 * hours <= longest * (1.0 + 1e-9)
    if hours == 0.5:
        assert chosen.steps == 4 * round(chosen.steps / 4) < 7200.0 / longest, "long steps that end at its time"


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("dye.solver={plugin: auto, dt: 1 s}", "auto chooses this as well"),
        ("dye.solver={plugin: auto, substeps: allowed}", "auto chooses this as well"),
    ],
)
def test_what_auto_chooses_cannot_be_given(override: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=said):
        read(tmp_path, override)


def test_accuracy_beside_a_named_solver_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="accuracy chooses the solver of the dye"):
        read(tmp_path, "dye.solver=rkl2", "accuracy=normal")


def frames(recording: Recording) -> list[int]:
    """Those whose amounts are there."""
    marks = recording.marks(DYE_STATUS.name)
    return [marks[message.log_time][0] for message in recording.messages([CONCENTRATION.name])]


def amounts(recording: Recording) -> list[bytes]:
    return [message.payload for message in recording.messages([CONCENTRATION.name])]


RARE = {"dye_every": "5.4 s"}
"""Each third frame."""


@pytest.fixture(scope="module")
def rare(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rare")
    return nuno.run(write_scene(folder, record=RARE), record=folder / "run.mcap").path


def test_amounts_come_at_their_interval_and_at_the_end(rare: Path) -> None:
    with nuno.open(rare) as recording:
        assert recording.complete and frames(recording) == [0, 3, 6, 9, 10]
        assert recording.counts[DYE_STATUS.name] == 11 and verify(recording).compared == 11
        shown = amounts(recording)
    every = nuno.run(write_scene(rare.parent), record=rare.with_name("every.mcap")).recording
    assert frames(every) == list(range(11))
    assert shown == [amounts(every)[frame] for frame in (0, 3, 6, 9, 10)]


def test_an_interval_longer_than_services_may_lag_behind_holds_nothing_up(tmp_path: Path) -> None:
    result = nuno.run(write_scene(tmp_path, record={"dye_every": "1 h"}), record=tmp_path / "run.mcap")
    assert result.recording.complete and frames(result.recording) == [0, 10]


def test_a_resumed_run_records_what_an_unbroken_one_does(tmp_path: Path) -> None:
    """From a checkpoint at frame 4, of which the amounts are recorded for that."""
    record = RARE | {"checkpoint_every": "7.2 s"}
    whole = nuno.run(write_scene(tmp_path, record=record), record=tmp_path / "whole.mcap").recording
    assert frames(whole) == [0, 3, 4, 6, 8, 9, 10]
    part = nuno.run(write_scene(tmp_path, record=record), "duration=7.2 s", record=tmp_path / "part.mcap")
    options = Options(record=tmp_path / "on.mcap", resume=part.path)
    assert supervisor.supervise(scene_file.read(write_scene(tmp_path, record=record)), options).state == "done"
    with nuno.open(tmp_path / "on.mcap") as resumed:
        assert frames(resumed) == frames(whole) and amounts(resumed) == amounts(whole)
        assert verify(resumed).frame is None


def test_a_garment_s_dye_is_as_rare_as_asked(tmp_path: Path) -> None:
    scene = garment_scene.write(tmp_path, record={"dye_every": 0.06})
    result = nuno.run(scene, record=tmp_path / "run.mcap")
    assert result.recording.complete and frames(result.recording) == [0, 3, 6, 9, 10]
    assert verify(result.recording).dyed == 11


def test_exports_take_what_is_there(rare: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(rare), "--gif", str(tmp_path / "a.gif"), "--png", str(tmp_path / "a.png")]) == 0
    with Image.open(tmp_path / "a.gif") as image:
        assert image.n_frames == 5  # type: ignore[attr-defined]
    assert main(["export", str(rare), "--png", str(tmp_path / "b.png"), "--frame", "6"]) == 0
    capsys.readouterr()
    assert main(["export", str(rare), "--png", str(tmp_path / "c.png"), "--frame", "7"]) == 2
    assert "the nearest is frame 6" in capsys.readouterr().err
    assert main(["export", str(rare), "--png", str(tmp_path / "c.png"), "--frame", "11"]) == 2
    assert "no such frame" in capsys.readouterr().err


def test_a_replay_from_between_begins_with_what_was_there(rare: Path, tmp_path: Path) -> None:
    from rrd import read

    for start, shown in ((0.0, 5), (8.0, 4)):
        target = tmp_path / f"{start:g}.rrd"
        assert main(["replay", str(rare), "--fast", "--start", str(start), "--save", str(target)]) == 0
        assert len(read(target, "/picture", "EncodedImage:blob")) == shown


def test_a_plan_counts_them(rare: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Float32 of 11 frames or of 5, and one checkpoint of float64: within a tenth of the files."""
    every = nuno.run(write_scene(tmp_path), record=tmp_path / "every.mcap").path
    for record, file in ((RARE, rare), ({}, every)):
        assert main(["plan", str(write_scene(tmp_path, record=record))]) == 0
        line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("storage"))
        number, unit = line.split()[1:3]
        assert float(number) * {"kB": 1e3, "MB": 1e6}[unit] == pytest.approx(file.stat().st_size, rel=0.1)
