"""A dyeing as a run: the plain loop's amounts, recorded, verified, resumed; files that cannot be used."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import yaml
from dye_scene import arrays, step_plainly, write_scene
from live_run import Run
from PIL import Image

import nuno
from nuno.cli import main
from nuno.dye.run import DyeRun
from nuno.recording.reader import control_events
from nuno.resimulation.verification import verify
from nuno.runtime import supervisor
from nuno.runtime.service import Options
from nuno.scene import scene_file
from nuno.scene.json_schema import scene_schema
from nuno.scene.warnings import scene_warnings
from nuno_dye.cloths.cells import CellsCloth
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import DYE_CHECKPOINT

PROGRAM = """
import json, os, sys
from nuno.cli import main
code = main(["run", "scene.yaml", "--no-view", "--record", "one.mcap"])
print(json.dumps([code, sorted(sys.modules)]))
sys.stdout.flush()
os._exit(0)
"""
RED = {"name": "red", "D0": "0.7 mm^2/h"}
BLUE = {"name": "blue", "D0": "1.93 mm^2/h", "adsorption": 0.5, "isotherm": {"plugin": "langmuir", "K": 2.0}}


def test_the_exact_scene_equals_a_plain_loop(tmp_path: Path) -> None:
    data = arrays()
    result = nuno.run(write_scene(tmp_path, data=data), record=tmp_path / "run.mcap")
    phi, fixed = data["phi"].copy(), data["fixed"].copy()
    for _ in range(10):
        step_plainly(data, phi, fixed, 1.8, 0.5, 2.0)
    assert main(["export", str(result.path), "--npz", str(tmp_path / "out.npz")]) == 0
    with np.load(tmp_path / "out.npz") as out:
        assert np.abs(out["phi"] - phi).max() < 1e-12 and np.abs(out["fixed"] - fixed).max() < 1e-12
        assert np.array_equal(out["phi"], result.phi) and np.array_equal(out["fixed"], result.fixed)
        assert out["t"] == pytest.approx(18.0, rel=1e-15)
    assert fixed.max() > 0.05 and not np.array_equal(phi, data["phi"])
    assert result.report["totals"]["steps"] == 10
    assert result.report["dye"]["balance"] < 1e-13


def test_any_frame_of_dye_is_had_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Between checkpoints and to the last bit: what a run that ends there has."""
    record = {"checkpoint_every": "7.2 s"}
    path = nuno.run(write_scene(tmp_path, record=record), record=tmp_path / "run.mcap").path
    ended = nuno.run(tmp_path / "scene.yaml", "duration=10.8 s")
    with nuno.open(path) as recording:
        assert [point.frame for point in recording.checkpoints(DYE_CHECKPOINT.name)] == [4, 8, 10]
        (moment,) = nuno.states(recording, [6])
        with pytest.raises(BadInput, match="a cloth that is dyed alone feels no forces"):
            list(nuno.states(recording, [6], forces=True))
    assert moment.digest == ended.digest and moment.t == ended.t
    assert moment.phi is not None and moment.fixed is not None and ended.phi is not None and ended.fixed is not None
    assert moment.phi.tobytes() == ended.phi.tobytes() and moment.fixed.tobytes() == ended.fixed.tobytes()
    assert moment.x.shape == (0, 3) and moment.fabric is None
    assert main(["export", str(path), "--frame", "6", "--npz", str(tmp_path / "six.npz")]) == 0
    with np.load(tmp_path / "six.npz") as out:
        assert np.array_equal(out["phi"], ended.phi) and float(out["t"]) == moment.t
    assert main(["export", str(path), "--forces", str(tmp_path / "no.npz")]) == 2
    assert "--forces: a recording of dye" in capsys.readouterr().err


def test_no_service_of_moving_cloth_is_started(tmp_path: Path) -> None:
    write_scene(tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=tmp_path, env=os.environ, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    code, modules = json.loads(done.stdout.splitlines()[-1])
    assert code == 0 and "nuno.dye.service" in modules
    unneeded = ("nuno.simulation.", "nuno.collision.service", "nuno_integrators", "nuno_cloth", "nuno_contact")
    # Every start of a run loads these.
    planned = ("nuno.simulation.cloth", "nuno.simulation.start_checks", "nuno.simulation.solver_selection")
    assert [name for name in modules if any(word in name for word in unneeded) and not name.startswith(planned)] == []
    with nuno.open(tmp_path / "one.mcap") as recording:
        assert recording.report()["services"] == ["dye", "recorder"]
        assert recording.complete and recording.counts["dye/concentration"] == 11


def test_the_recording_verifies_and_tells_where_it_differs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = nuno.run(write_scene(tmp_path), record=tmp_path / "run.mcap").path
    assert main(["verify", str(path)]) == 0
    assert "equal to the last bit: 11 frames" in capsys.readouterr().out
    monkeypatch.setattr("nuno_dye.laws.isotherms.Langmuir.prepare", _weaker)
    with nuno.open(path) as recording:
        found = verify(recording)
    assert found.frame == 1 and found.compared == 1 and found.part == "dye"
    assert found.difference is not None and found.difference.frame == 1
    assert found.difference.quantity == "mobile dye" and " of cell (" in found.difference.index


def _weaker(self: Any, config: Any) -> Any:
    from nuno_schemas.dye import Isotherm

    return Isotherm("langmuir", 0.5 * config.K)


@pytest.mark.quick(solver=["rkl2"])
@pytest.mark.parametrize("solver", ["explicit", "rkl2", "implicit"])
def test_a_resumed_run_ends_in_the_same_bits(solver: str, tmp_path: Path) -> None:
    """Of dye alone, whose kernel is chosen by the start: by its end no cell is as full as at the start."""
    data = arrays()
    data["resist"] = np.zeros_like(data["resist"])
    dyes = [BLUE, RED]
    data |= {name: np.stack([data[name], data[name]]) for name in ("phi", "fixed")}
    scene = write_scene(tmp_path, data=data, dyes=dyes, solver={"plugin": solver, "dt": "1.8 s"})
    whole = nuno.run(scene, record=tmp_path / "whole.mcap")
    part = nuno.run(scene, "duration=9 s", record=tmp_path / "part.mcap")
    options = Options(record=tmp_path / "resumed.mcap", resume=part.path)
    resumed = supervisor.supervise(scene_file.read(scene), options)
    assert resumed.state == "done" and resumed.summary["digest"] == whole.digest
    with nuno.open(tmp_path / "resumed.mcap") as ours, nuno.open(whole.path) as reference:
        assert ours.marks() == reference.marks()
        assert ours.series()["mobile_red"].tolist() == reference.series()["mobile_red"].tolist()


def test_a_dyeing_is_resumed_in_the_cells_that_were_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = nuno.run(write_scene(tmp_path), "duration=9 s", record=tmp_path / "part.mcap").path
    build = CellsCloth.build

    def denser(*given: Any) -> Any:
        cells, state = build(*given)
        return replace(cells, porosity=0.9 * cells.porosity), state

    monkeypatch.setattr(CellsCloth, "build", denser)
    with pytest.raises(BadInput, match="porosity: the scene's models build other cloth now"):
        nuno.resume(path, duration="18 s", record=tmp_path / "resumed.mcap")
    assert not (tmp_path / "resumed.mcap").exists()


@pytest.mark.full
@pytest.mark.parametrize("how", [{"threads": 1}, {"threads": 2}, {"processes": True}])
def test_where_it_runs_changes_no_bit(how: dict[str, Any], tmp_path: Path) -> None:
    scene = write_scene(tmp_path, data=arrays(150, 150))
    with nuno.open(nuno.run(scene, record=tmp_path / "one.mcap", **how).path) as recording:
        assert recording.complete
        assert verify(recording, threads=1).frame is None


def test_a_scene_that_is_faster_takes_the_same_steps(tmp_path: Path) -> None:
    """Ten frames of 1.8 s of dyeing, in 18 s and in 1024 times less, which is exact."""
    drop = {"kind": "drop", "place": ["0.2 mm", "0.2 mm"], "diameter": "0.2 mm", "start": "9 s"}
    cloth = yaml.safe_load(write_scene(tmp_path).read_text())["dye"]["cloth"] | {"supply": [drop]}
    slow = nuno.run(write_scene(tmp_path, cloth=cloth), record=tmp_path / "slow.mcap")
    short = {"speed": 1024, "duration": 18.0 / 1024.0, "frame_rate": 1024.0 * (1 / 1.8)}
    fast = nuno.run(write_scene(tmp_path, cloth=cloth, **short), record=tmp_path / "fast.mcap")
    assert fast.digest == slow.digest and fast.t == pytest.approx(18.0 / 1024.0)
    series = [result.recording.series() for result in (slow, fast)]
    assert np.array_equal(series[0]["time"], series[1]["time"])
    assert np.array_equal(series[1]["time"], 1024.0 * series[1]["t"])
    assert verify(fast.recording).frame is None


def test_a_speed_has_units(tmp_path: Path) -> None:
    dye = scene_file.read(write_scene(tmp_path, speed="30 min/s")).scene.dye
    assert dye is not None and dye.speed == 1800.0


def test_a_checkpoint_is_kept_where_the_scene_asks(tmp_path: Path) -> None:
    result = nuno.run(write_scene(tmp_path, record={"checkpoint_every": "3.6 s"}), record=tmp_path / "run.mcap")
    assert result.recording.counts["dye/checkpoint"] == 5


def test_substeps_are_taken_only_where_they_are_allowed(tmp_path: Path) -> None:
    slow = {"solver": {"plugin": "explicit", "dt": "18 s"}, "frame_rate": 1 / 18}
    with pytest.raises(BadInput, match="above the stability limit") as refused:
        nuno.run(write_scene(tmp_path, **slow))
    assert "dye.solver.dt: " in str(refused.value) and "s for explicit" in str(refused.value)
    slow["solver"] = {"plugin": "explicit", "dt": "18 s", "substeps": "allowed"}
    result = nuno.run(write_scene(tmp_path, **slow))
    assert 18.0 / result.report["totals"]["steps"] <= result.report["dt_limit"]
    assert result.report["totals"]["steps"] == np.ceil(18.0 / result.report["dt_limit"])


def test_an_automatic_step_is_stable(tmp_path: Path) -> None:
    result = nuno.run(write_scene(tmp_path, solver="explicit", frame_rate=1 / 18, until="duration", objects=[]))
    assert 0.5 * result.report["dt_limit"] < result.report["dt"] <= 0.9 * result.report["dt_limit"]


@pytest.mark.parametrize(
    ("fields", "field", "words"),
    [
        ({"frame_rate": 1.0}, "dye.solver.dt", "a frame is shorter than a step"),
        ({"frame_rate": 60, "speed": 60}, "dye.solver.dt", "a dye.speed of at least 108"),
        ({"speed": "3 m/s"}, "dye.speed", "cannot be converted"),
        ({"speed": 0}, "dye.speed", "more than 0"),
        (
            {"frame_rate": 0.4, "solver": {"plugin": "explicit", "dt": "1.8 s", "strict": True}},
            "dye.solver.dt",
            "not a whole number of steps",
        ),
        ({"dyes": [BLUE | {"isotherm": {"plugin": "langmuire", "K": 2}}]}, "dye.dyes[0].isotherm.plugin", "langmuir"),
        ({"dyes": [BLUE | {"isotherm": {"plugin": "freundlich", "k": 1, "b": 0.05}}]}, "dye.dyes[0].isotherm.b", "0.1"),
        ({"dyes": [{"name": "blue", "D0": 1e-10, "adsorption": 1}]}, "dye.dyes[0].adsorption", "isotherm"),
        ({"dyes": [{**BLUE, "adsorption": 0, "uptake": "amount"}]}, "dye.dyes[0].uptake", "no uptake"),
        ({"dyes": [{"name": "blue", "D0": 1e-10, "uptake": "amount"}]}, "dye.dyes[0].uptake", "no uptake"),
        ({"dyes": [RED, RED]}, "dye.dyes[1].name", "used twice"),
        ({"dyes": [RED | {"D0": "1 mm/h"}]}, "dye.dyes[0].D0", "cannot be converted"),
        ({"dyes": []}, "dye.dyes", "too short"),
        ({"solver": "implicitt"}, "dye.solver.plugin", "known: explicit"),
        ({"cloth": {"plugin": "cells", "file": "none.npz", "cell_size": 1, "tau3": {}}}, "dye.cloth.tau3.I", "missing"),
        ({"bodies": [{"name": "b", "collider": {"plugin": "sphere", "radius": 1}}]}, "bodies", "leave `bodies`"),
        ({"objects": [{"name": "a", "model": {"plugin": "sheet"}}]}, "objects", "leave `objects`"),
        ({"until": "rest"}, "until", "leave `until`"),
        ({"accuracy": "normal"}, "accuracy", "leave one of them out"),
    ],
)
def test_scenes_are_refused_by_name(fields: dict[str, Any], field: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput) as refused:
        nuno.run(write_scene(tmp_path, **fields))
    assert f"{field}: " in str(refused.value) and words in str(refused.value)


@pytest.mark.parametrize(("name", "value"), [("porosity", 1.5), ("resist", np.nan), ("phi", -1.0), ("fixed", 2.0)])
def test_arrays_are_refused_before_anything_starts(name: str, value: float, tmp_path: Path) -> None:
    data = arrays()
    data[name][0, 1, 2] = value
    with pytest.raises(BadInput, match=r"dye\.cloth") as refused:
        nuno.run(write_scene(tmp_path, data=data), record=tmp_path / "run.mcap")
    assert refused.value.problem and f"{name}[0, 1, 2]" in str(refused.value)
    assert list(tmp_path.glob("*.mcap*")) == []


def test_a_run_of_dye_answers_control(tmp_path: Path) -> None:
    run = Run(write_scene(tmp_path, duration="200000 s"), tmp_path / "long.mcap")
    assert run.moved.wait(60)
    assert run.control("pause")["state"] == "paused"
    before = run.wait_until_paused()
    assert run.control("step", frames=3)["left"] == 3
    assert run.wait_until_paused() == before + 3
    refused = run.control("set", item="dye.solver.dt=1 s")
    assert not refused["ok"] and "nuno control RUN add" in refused["error"]
    assert run.stop().state == "stopped"
    with nuno.open(tmp_path / "long.mcap") as recording:
        assert recording.complete
        assert [event.text for event in control_events(recording)] == ["pause", "step", "stop"]
        assert verify(recording).frame is None


def test_the_schema_for_editors_knows_dye(tmp_path: Path) -> None:
    validator = jsonschema.Draft202012Validator(scene_schema())
    scene = yaml.safe_load(write_scene(tmp_path).read_text())
    validator.validate(scene)
    validator.validate(yaml.safe_load(write_scene(tmp_path, solver="explicit", dyes=[RED]).read_text()))
    for wrong in (write_scene(tmp_path, solver="euler"), write_scene(tmp_path, dyes=[BLUE | {"D1": 1}])):
        assert not validator.is_valid(yaml.safe_load(wrong.read_text()))


def test_a_plan_names_what_runs_and_the_limit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", str(write_scene(tmp_path))]) == 0
    said = capsys.readouterr().out
    assert "services  dye, recorder" in said and "198 cells of 0.05 mm" in said
    assert "simulation and collision services: nothing in the scene moves" in said
    limit = DyeRun(scene_file.read(tmp_path / "scene.yaml"), 1).limit
    assert f"limit {limit * 1e3:.4g} ms" in said


def test_amounts_are_a_table(tmp_path: Path) -> None:
    path = nuno.run(write_scene(tmp_path), record=tmp_path / "run.mcap").path
    assert main(["export", str(path), "--csv", str(tmp_path / "out.csv")]) == 0
    assert (
        (tmp_path / "out.csv")
        .read_text()
        .startswith("frame,t [s],steps,step_seconds [s],time [s],balance [1],mobile_blue")
    )


def test_the_nearest_step_of_dye_is_taken_and_told_of(tmp_path: Path) -> None:
    loaded = scene_file.read(write_scene(tmp_path), ["dye.solver={plugin: explicit, dt: 0.5 s}"])
    dyeing = DyeRun(loaded, 1)
    assert dyeing.steps == 4 and dyeing.dt == pytest.approx(0.45)
    assert [text.partition(":")[0] for text in scene_warnings(loaded)] == ["dye.solver.dt"]


def test_a_step_given_on_the_command_line_is_told_to_stand_there(tmp_path: Path) -> None:
    loaded = scene_file.read(write_scene(tmp_path), ["dye.solver={plugin: explicit, dt: 1.7 s, strict: true}"])
    with pytest.raises(BadInput, match="not a whole number of steps") as refused:
        DyeRun(loaded, 1)
    assert str(refused.value).startswith("--set: dye.solver.dt: a frame is not a whole number of steps\n")


STENCIL = {"kind": "image", "file": "stencil.png"}
CLOTH = {"plugin": "woven", "cells": [12, 8], "tau3": {"I": 1, "II": 1, "III": 1}}


def grey(path: Path, *size: int) -> None:
    Image.new("L", size).save(path)


def red(path: Path, *size: int) -> None:
    Image.new("RGB", size, (200, 0, 0)).save(path)


def write(folder: Path, **cloth: Any) -> Path:
    """A scene, a field a line."""
    dye = {"cloth": CLOTH | cloth, "dyes": [{"name": "blue", "D0": 1e-9}]}
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump({"nuno": 1, "name": "dyed", "duration": 10, "frame_rate": 1, "dye": dye}))
    return path


Fault = tuple[dict[str, Any], str, Callable[[Path], object], str, str]
FAULTS: dict[str, Fault] = {
    "no WIF": (
        {"weave": {"plugin": "wif", "file": "mine.wif"}}, "mine.wif",
        lambda path: path.write_text("[WARP]\nThreads=2\n"), "dye.cloth.weave.file", "no section [WIF]",
    ),
    "stencil of another size": (
        {"resist": [{"kind": "paste", "points": [[0, 0]], "width": 1e-4}, STENCIL]}, "stencil.png",
        lambda path: grey(path, 12, 9), "dye.cloth.resist[1].file", "the image has not the cloth's size",
    ),
    "coloured stencil": (
        {"resist": [STENCIL]}, "stencil.png", lambda path: red(path, 12, 8), "dye.cloth.resist[0].file",
        "the image is in colour",
    ),
    "stencil that is none": (
        {"resist": [STENCIL]}, "stencil.png", lambda path: path.write_text("x"), "dye.cloth.resist[0].file",
        "cannot be read as PNG",
    ),
    "arrays that are none": (
        {"plugin": "cells", "file": "mine.npz", "cell_size": 1e-4, "cells": None}, "mine.npz",
        lambda path: path.write_text("x"), "dye.cloth.file", "not a readable .npz file",
    ),
    "photograph that is none": (
        {"plugin": "photograph", "file": "cloth.png", "colours": {"warp": "#ff0000", "weft": "#0000ff"},
         "tau3": {"I": 1, "II": 1}, "cells": None}, "cloth.png",
        lambda path: path.write_text("x"), "dye.cloth.file", "cannot be read as PNG or JPEG",
    ),
}  # fmt: skip


@pytest.mark.parametrize("overridden", [False, True])
@pytest.mark.parametrize("fault", FAULTS)
def test_a_file_s_fault_names_the_field_that_names_it(fault: str, overridden: bool, tmp_path: Path) -> None:
    cloth, name, make, field, words = FAULTS[fault]
    make(tmp_path / name)
    scene = write(tmp_path, **{key: value for key, value in cloth.items() if value is not None})
    text = scene.read_text()
    if cloth.get("cells", 0) is None:
        text = text.replace("    cells:\n    - 12\n    - 8\n", "")
    overrides = []
    if overridden:
        text = text.replace(name, "another")
        overrides = [f"{field}={name}"]
    scene.write_text(text)
    with pytest.raises(BadInput) as refused:
        DyeRun(scene_file.read(scene, overrides), 1)
    line = next((n for n, line in enumerate(text.splitlines(), 1) if name in line), None)
    place = "--set" if overridden else f"{scene}:{line}"
    said = str(refused.value)
    assert said.startswith(f"{tmp_path / name}:") and words in said
    assert f"(the file is named in {place}: {field})" in said
